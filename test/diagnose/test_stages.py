"""The stage of a gap: of its effect, of the parameters that moved, or of where it is first seen."""

from types import SimpleNamespace

import numpy as np
import pytest

from sma_bench.diagnose.decision import Candidate, Decision
from sma_bench.diagnose.sizes import Cell
from sma_bench.diagnose.stages import stage_of, stage_of_recalibration

NAMES = (
    "wire.resistance", "wire.heat_transfer_coefficient", "wire.martensite_start_temperature",
    "composite.deflection_per_strain",
)


def candidate(name, probability, effects=()):
    fit = SimpleNamespace(unknowns=SimpleNamespace(effects=effects)) if effects else None
    return Candidate(name, probability, fit, 1.0, 0.0)


def searched(x=(0.0, 0.0, 0.0, 0.0), ranked=("latent_heat",)):
    unknowns = SimpleNamespace(prior=SimpleNamespace(names=NAMES))
    recalibrated = SimpleNamespace(unknowns=unknowns, x=np.array([*x, 5.0]))  # 5: a shape
    return SimpleNamespace(recalibrated=recalibrated, ranked=list(ranked))


def cell(signal, share):
    return Cell(signal, "drive", "front", 1.0, share, 1.0)


def decision(verdict, *candidates):
    return Decision(verdict, (), candidates)


@pytest.mark.parametrize("x, stage", [
    ((3.0, 1.0, 1.0, 1.0), "electrical"),
    ((0.5, -3.0, 1.0, 2.0), "thermal"),
    ((0.5, 1.0, 2.0, -1.0), "transformation"),
    ((0.0, 0.0, 0.0, 2.0), "mechanical"),
])
def test_recalibration_has_the_stage_whose_parameters_moved_furthest(x, stage):
    assert stage_of_recalibration(searched(x)) == stage
    found = stage_of(decision("recalibration", candidate("recalibration", 1.0)), searched(x), [])
    assert found == stage


def test_effects_add_up_by_stage():
    said = decision(
        "ambiguous",
        candidate("recalibration", 0.3),
        candidate("latent_heat", 0.25, ("latent_heat",)),
        candidate("ambient_drift+slack", 0.3, ("ambient_drift", "slack")),
        candidate("slack", 0.15, ("slack",)),
    )
    assert stage_of(said, searched((9.0, 0.0, 0.0, 0.0)), []) == "thermal"


@pytest.mark.parametrize("cells, stage", [
    ([cell("deflection", 0.7), cell("front_1.current", 0.3)], "electrical"),
    ([cell("deflection", 0.6), cell("back_1.temperature", 0.4)], "thermal"),
    ([cell("deflection", 0.9), cell("back_1.temperature", 0.1)], "mechanical"),
    ([cell("deflection", 1.0)], "transformation"),
])
def test_what_is_unexplained_has_the_stage_where_it_is_first_seen(cells, stage):
    said = decision("unexplained", candidate("unexplained", 1.0))
    # Without temperatures the effect that comes nearest is the only lead.
    assert stage_of(said, searched(ranked=("partial_transformation",)), cells) == stage


def test_without_a_gap_there_is_no_stage():
    assert stage_of(decision("no_gap", candidate("no_gap", 1.0)), searched(), []) == ""
