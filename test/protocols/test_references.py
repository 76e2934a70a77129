"""Reference files: levels in kelvin and metres, with the steps of protocols."""

from pathlib import Path

import numpy as np
import pytest

from sma_bench.errors import InputError
from sma_bench.parameters import Parameters, read_parameters
from sma_bench.protocols.reading import (
    DEFLECTION,
    QUANTITIES,
    TEMPERATURE,
    load_reference,
    parse_levels,
    shipped_names,
)

WIRE = Parameters.defaults()
COMPOSITE = read_parameters(Path(__file__).resolve().parents[2] / "config" / "composite_rig.yaml")


def test_staircase_of_e8_stays_below_a_s_and_rests_at_ambient():
    reference = load_reference("temperature_staircase", WIRE, TEMPERATURE)
    assert reference.duration == pytest.approx(115.0)
    levels = np.array([reference.level(t)[0] for t in np.arange(11) * 10.0 + 5.0])
    np.testing.assert_allclose(levels, [*np.arange(303.15, 329, 5), *np.arange(323.15, 303, -5)])
    assert levels.max() < WIRE["wire.austenite_start_temperature"]
    assert reference.level(-1.0) == reference.level(112.0) == reference.level(200.0) == 296.15
    assert reference.step_at(15.0) == "up 308.15 K"


def test_deflections_go_both_ways_and_wires_that_are_not_driven_rest_at_ambient():
    reference = load_reference("deflection_triangle", COMPOSITE, DEFLECTION)
    assert reference.channels == ("tip",)
    assert [reference.level(t)[0] for t in (0.0, 10.0, 15.0, 25.0, 40.0)] == pytest.approx(
        [0.0, 0.03, 0.015, 0.0, -0.03]
    )
    step = {"kind": "triangle", "peak": 310.0, "rise": 1.0, "fall": 1.0, "drive": "back"}
    reference = parse_levels({"unit": "K", "steps": [step]}, COMPOSITE, TEMPERATURE)
    np.testing.assert_allclose(reference.level(0.5), [296.15, 296.15, 303.075, 303.075])


def test_every_shipped_reference_is_read_by_one_quantity_and_refused_by_the_other():
    names = shipped_names(TEMPERATURE)
    assert {"temperature_staircase", "deflection_triangle"} <= set(names)
    for name in names:
        accepted = 0
        for quantity in QUANTITIES.values():
            try:
                load_reference(name, COMPOSITE, quantity)
                accepted += 1
            except InputError as error:
                assert f"expected {quantity.unit}" in str(error)
        assert accepted == 1


def test_bad_reference_is_one_line():
    stairs = {"kind": "staircase", "start": 300, "stop": 310, "increment": 3, "dwell": 1}
    for document, expected in (
        ({"steps": []}, "unit is None, expected K"),
        ({"unit": "m", "steps": []}, "unit is 'm', expected K"),
        ({"unit": "K", "steps": []}, "expected a list of one step"),
        ({"unit": "K", "steps": [{"kind": "hold", "level": "x", "duration": 1}]}, "number in K"),
        ({"unit": "K", "steps": [stairs]}, "increment 3 K does not divide 300 to 310 K"),
        (["unit"], "expected a mapping"),
    ):
        with pytest.raises(InputError, match=expected):
            parse_levels(document, WIRE, TEMPERATURE, "r.yaml")
    with pytest.raises(InputError, match="reference stairs: not one of .*temperature_staircase"):
        load_reference("stairs", WIRE, TEMPERATURE)
