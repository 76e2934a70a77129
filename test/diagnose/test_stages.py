"""The stage of a gap: of its effect, of parameters that moved beyond belief, or of an effect that
would put the same signals off."""

from types import SimpleNamespace

import numpy as np
import pytest

from sma_bench.diagnose.decision import FLEXIBLE, Candidate, Decision
from sma_bench.diagnose.sizes import Cell
from sma_bench.diagnose.stages import stage_of_recalibration, stages_of

RESISTANCE, LOSS, CAPACITY = (
    "wire.resistance", "wire.heat_transfer_coefficient", "wire.specific_heat",
)
STARTS = (
    "wire.austenite_start_temperature", "wire.austenite_finish_temperature",
    "wire.martensite_start_temperature", "wire.martensite_finish_temperature",
    "wire.stress_influence_austenite", "wire.stress_influence_martensite",
)
STROKE = "composite.deflection_per_strain"
NAMES = (RESISTANCE, LOSS, CAPACITY, *STARTS, STROKE)
ALL = ("front_1.current", "front_1.temperature", "deflection")


def candidate(name, probability, effects=()):
    fit = SimpleNamespace(unknowns=SimpleNamespace(effects=effects)) if effects else None
    return Candidate(name, probability, fit, 1.0, 0.0)


# All that an experimenter would look for, in another order than that of the chain.
RANKED = (
    "latent_heat", "transition_drift", "temperature_lag", "supply_drop", "deflection_drift",
)


def searched(moved=(), shows=(), flexible=0.0, ranked=RANKED, event=""):
    x = np.array([dict(moved).get(name, 0.0) for name in NAMES])
    recalibrated = SimpleNamespace(
        unknowns=SimpleNamespace(bench_names=NAMES),
        x=np.array([*x, 5.0]),  # 5: a shape, of no stage
    )
    return SimpleNamespace(
        recalibrated=recalibrated, left=SimpleNamespace(shows=tuple(shows)),
        left_by_best=SimpleNamespace(outlier=20.0 if event else 0.0, event=event),
        flexible=SimpleNamespace(gain=flexible), ranked=list(ranked),
        gain=lambda name: -20.0 * list(ranked).index(name),
    )


def stage_of(said, found, missing):
    return next(iter(stages_of(said, found, missing)), "")


SLACK = candidate("slack", 0.02, ("slack",))


def cells(**shares):
    """One cell of each signal of ALL; shares by quantity."""
    return [
        Cell(name, "drive", "front", 1.0, shares.get(name.rpartition(".")[2], 0.0), 1.0)
        for name in ALL
    ]


def decision(verdict, *candidates):
    return Decision(verdict, (), candidates)


@pytest.mark.parametrize("moved, stage", [
    ({RESISTANCE: 3.0, LOSS: 1.0, STROKE: 1.0}, "electrical"),
    ({RESISTANCE: 0.5, LOSS: -3.0, CAPACITY: 2.0, STROKE: 2.0}, "thermal"),
    ({RESISTANCE: 1.5, STARTS[0]: 4.0, STARTS[3]: -2.5}, "transformation"),
    ({STROKE: -3.0, STARTS[1]: 1.5}, "mechanical"),
    # Six numbers moved by their deviations are no surprise, one by three of its own is.
    ({RESISTANCE: 3.0, **dict.fromkeys(STARTS, 1.3)}, "electrical"),
    # As far as believed, whatever their sum: that tells of no stage.
    (dict.fromkeys(STARTS, 1.2), ""),
    ({RESISTANCE: 2.0}, ""),
])
def test_recalibration_has_the_stage_whose_parameters_moved_beyond_belief(moved, stage):
    assert stage_of_recalibration(searched(moved)) == stage
    said = decision("recalibration", candidate("recalibration", 0.9), SLACK)
    assert stage_of(said, searched(moved), []) == (stage or "mechanical")


def test_every_stage_has_the_probability_of_its_explanations():
    said = decision(
        "effect",
        candidate("slack", 0.5, ("slack",)),
        candidate("latent_heat", 0.2, ("latent_heat",)),
        candidate("recalibration", 0.2),
        candidate("side_asymmetry", 0.1, ("side_asymmetry",)),
    )
    found = stages_of(said, searched({RESISTANCE: 0.1}), [])
    assert found == pytest.approx({"mechanical": 0.6, "thermal": 0.2})  # 0.2 tell of none
    assert list(found) == ["mechanical", "thermal"]
    electrical = stages_of(said, searched({RESISTANCE: 9.0}), [])
    assert electrical == pytest.approx({"mechanical": 0.6, "thermal": 0.2, "electrical": 0.2})


@pytest.mark.parametrize("shows, stage", [
    (("deflection",), "transformation"),  # behind temperatures that are right
    (("front_1.temperature", "deflection"), "thermal"),
    (("front_1.temperature",), "sensor"),  # the deflection does not follow
    (ALL, "electrical"),
    (("front_1.current",), "electrical"),  # no effect does this: the first that is off
    ((), "thermal"),  # of the nearest effect
])
def test_what_is_unexplained_has_the_stage_of_an_effect_that_puts_the_same_signals_off(
    shows, stage
):
    said = decision("unexplained", candidate("unexplained", 0.9))
    assert stage_of(said, searched(shows=shows), cells()) == stage


@pytest.mark.parametrize("event, stage", [
    ("deflection", "mechanical"),  # something slipped
    ("front_1.temperature", "sensor"),  # which no wire does
    ("front_1.current", "electrical"),
])
def test_a_single_event_has_the_stage_of_what_can_jump(event, stage):
    said = decision("unexplained", candidate("unexplained", 0.9))
    found = searched(event=event, ranked=("ambient_drift", "deflection_drift"))
    assert stage_of(said, found, cells()) == stage


def test_a_sure_smooth_response_tells_which_signals_are_off():
    said = decision("unexplained", candidate("unexplained", 0.9))
    response = cells(temperature=0.9, deflection=0.1)
    assert stage_of(said, searched(flexible=FLEXIBLE + 1.0), response) == "sensor"
    assert stage_of(said, searched(flexible=FLEXIBLE - 1.0), response) == "thermal"  # the nearest


def test_parameters_that_nobody_believes_in_tell_where_the_unexplained_is():
    said = decision("unexplained", candidate("unexplained", 0.9))
    moved = {STARTS[0]: 6.0, STARTS[3]: -6.0}
    found = searched(moved, shows=("front_1.temperature",))
    assert stage_of(said, found, cells()) == "transformation"
    believable = searched({STARTS[0]: 1.0, STARTS[3]: -1.0}, shows=("front_1.temperature",))
    assert stage_of(said, believable, cells()) == "sensor"


def test_without_a_gap_there_is_no_stage():
    assert stage_of(decision("no_gap", candidate("no_gap", 1.0)), searched(), []) == ""
