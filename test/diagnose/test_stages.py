"""The stage of a gap: of its effect, of parameters that moved beyond belief, or of an effect that
would put the same signals off."""

from types import SimpleNamespace

import numpy as np
import pytest

from sma_bench.diagnose.decision import FLEXIBLE, Candidate, Decision
from sma_bench.diagnose.sizes import Cell
from sma_bench.diagnose.stages import stage_of_recalibration, stages_of
from sma_bench.parameters.table import TRANSITIONS

RESISTANCE, LOSS = "wire.resistance", "wire.heat_transfer_coefficient"
CAPACITY = "wire.specific_heat"
INFLUENCES = ("wire.stress_influence_austenite", "wire.stress_influence_martensite")
STARTS = (*TRANSITIONS.values(), *INFLUENCES)
STROKE = "composite.deflection_per_strain"
NAMES = (RESISTANCE, LOSS, CAPACITY, *STARTS, STROKE)
ALL = ("front_1.current", "front_1.temperature", "deflection")
# All that an experimenter would look for, in another order than that of the chain.
RANKED = ("latent_heat", "transition_drift", "temperature_lag", "supply_drop", "deflection_drift")


def candidate(name, probability, effects=()):
    fit = SimpleNamespace(unknowns=SimpleNamespace(effects=effects)) if effects else None
    return Candidate(name, probability, fit, 1.0, 0.0)


def decision(verdict, *candidates):
    return Decision(verdict, (), candidates)


UNEXPLAINED = decision("unexplained", candidate("unexplained", 0.9))


def searched(moved=(), shows=(), flexible=0.0, ranked=RANKED, event=""):
    x = np.array([dict(moved).get(name, 0.0) for name in NAMES])
    return SimpleNamespace(
        recalibrated=SimpleNamespace(
            unknowns=SimpleNamespace(bench_names=NAMES), x=np.array([*x, 5.0])
        ),  # 5: a shape, of no stage
        left=SimpleNamespace(shows=tuple(shows)),
        left_by_best=SimpleNamespace(outlier=20.0 if event else 0.0, event=event),
        flexible=SimpleNamespace(gain=flexible),
        ranked=list(ranked),
        gain=lambda name: -20.0 * list(ranked).index(name),
    )


def cells(**shares):
    """One cell of each signal of ALL; shares by quantity."""
    return [
        Cell(name, "drive", "front", 1.0, shares.get(name.rpartition(".")[2], 0.0), 1.0)
        for name in ALL
    ]


def stage_of(said, found, missing):
    return next(iter(stages_of(said, found, missing)), "")


@pytest.mark.parametrize(
    ("moved", "stage"),
    [
        ({RESISTANCE: 3.0, LOSS: 1.0, STROKE: 1.0}, "electrical"),
        ({RESISTANCE: 0.5, LOSS: -3.0, CAPACITY: 2.0, STROKE: 2.0}, "thermal"),
        ({RESISTANCE: 1.5, STARTS[0]: 4.0, STARTS[3]: -2.5}, "transformation"),
        ({STROKE: -3.0, STARTS[1]: 1.5}, "mechanical"),
        # Six numbers moved by their deviations are no surprise, one by three of its own is.
        ({RESISTANCE: 3.0, **dict.fromkeys(STARTS, 1.3)}, "electrical"),
        # As far as believed, whatever their sum: that tells of no stage.
        (dict.fromkeys(STARTS, 1.2), ""),
    ],
)
def test_recalibration_has_the_stage_whose_parameters_moved_beyond_belief(moved, stage):
    assert stage_of_recalibration(searched(moved)) == stage
    slack = candidate("slack", 0.02, ("slack",))
    said = decision("recalibration", candidate("recalibration", 0.9), slack)
    assert stage_of(said, searched(moved), []) == (stage or "mechanical")


OTHER_WAY = ("ambient_drift", "deflection_drift")


@pytest.mark.parametrize(
    ("found", "shares", "stage"),
    [
        # Behind temperatures that are right; a deflection that does not follow; all; none.
        ({"shows": ("deflection",)}, {}, "transformation"),
        ({"shows": ("front_1.temperature", "deflection")}, {}, "thermal"),
        ({"shows": ("front_1.temperature",)}, {}, "sensor"),
        ({"shows": ALL}, {}, "electrical"),
        ({"shows": ("front_1.current",)}, {}, "electrical"),  # no effect does this
        ({}, {}, "thermal"),  # of the nearest effect
        # A single event is of what can jump: a beam slips, no wire's temperature does.
        ({"event": "deflection", "ranked": OTHER_WAY}, {}, "mechanical"),
        ({"event": "front_1.temperature", "ranked": OTHER_WAY}, {}, "sensor"),
        # A sure smooth response tells which signals are off.
        ({"flexible": FLEXIBLE + 1.0}, {"temperature": 0.9, "deflection": 0.1}, "sensor"),
        ({"flexible": FLEXIBLE - 1.0}, {"temperature": 0.9, "deflection": 0.1}, "thermal"),
        # And so do parameters that nobody believes in.
        ({"moved": {STARTS[0]: 6.0}, "shows": ("front_1.temperature",)}, {}, "transformation"),
        ({"moved": {STARTS[0]: 1.0}, "shows": ("front_1.temperature",)}, {}, "sensor"),
    ],
)
def test_what_is_unexplained_has_the_stage_of_what_would_put_the_same_off(found, shares, stage):
    assert stage_of(UNEXPLAINED, searched(**found), cells(**shares)) == stage
