"""Lets the tests of this folder share modules, and gives them the rigs they run on."""

import sys
from pathlib import Path

import pytest

from sma_bench.parameters import Parameters

sys.path.insert(0, str(Path(__file__).parent))


@pytest.fixture
def wire_rig() -> Parameters:
    """One clamped wire with the paper's numbers."""
    return Parameters.of_paper()


@pytest.fixture(scope="session")
def composite_rig() -> Parameters:
    """Two wires a side that bend a composite by a few centimetres."""
    return Parameters.of_paper().replace(
        {
            "bench.channels": ("front_1", "front_2", "back_1", "back_2"),
            "bench.channel_sides": ("front", "front", "back", "back"),
            "composite.deflection_per_strain": 1.0,
            "composite.stress_per_deflection_front": 5.0e9,
            "composite.stress_per_deflection_back": 4.0e9,
            "wire.stress_influence_austenite": 7.3e6,
            "wire.stress_influence_martensite": 8.0e6,
        }
    )
