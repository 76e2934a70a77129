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
    from effect_references import COMPOSITE

    influences = {"austenite": 7.3e6, "martensite": 8.0e6}
    return COMPOSITE.replace({f"wire.stress_influence_{p}": c for p, c in influences.items()})
