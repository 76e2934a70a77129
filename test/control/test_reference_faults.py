"""References that a bench cannot follow are refused in one line."""

import math

import pytest

from sma_bench.control.deflection import deflection_reference_fault
from sma_bench.control.temperature import temperature_reference_fault
from sma_bench.parameters import Parameters

WIRE = Parameters.of_paper()
COMPOSITE = WIRE.replace(
    {"bench.channels": ["a", "b"], "bench.channel_sides": ["front", "back"]}
)
FRONT_ONLY = WIRE.replace(
    {"bench.channels": ["a", "b"], "bench.channel_sides": ["front", "front"]}
)


@pytest.mark.parametrize(
    ("reference", "expected"),
    [
        ([320.0], ""),
        ([280.0], ""),
        ([320.0, 320.0], "has 2 temperatures, expected 1"),
        ([math.nan], "has nan K"),
        ([-5.0], "has -5 K"),
        ([420.0], "at most 413.15 K"),
    ],
)
def test_temperature_reference(reference: list[float], expected: str) -> None:
    fault = temperature_reference_fault(reference, WIRE)
    assert expected in fault and bool(expected) == bool(fault)


@pytest.mark.parametrize(
    ("metres", "parameters", "expected"),
    [
        (0.02, COMPOSITE, ""),
        (-0.02, COMPOSITE, ""),
        (0.0, FRONT_ONLY, ""),
        (math.inf, COMPOSITE, "is inf m"),
        (0.08, COMPOSITE, "to the front"),
        (-0.08, COMPOSITE, "to the back"),
        (-0.01, FRONT_ONLY, "no wire on the back"),
    ],
)
def test_deflection_reference(metres: float, parameters: Parameters, expected: str) -> None:
    fault = deflection_reference_fault([metres], parameters)
    assert expected in fault and bool(expected) == bool(fault)
