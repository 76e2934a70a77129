"""The stages of the chain in which a gap may arise, by the probability of all explanations.

An effect has its stage, of two the one that does more. Recalibration has the stage whose parameters
moved further than anyone believed; where all moved as far as believed they tell of no stage (six
transition numbers move further than one resistance by their number alone), and the most probable
effect does. What nothing explains has that of an effect which would put the same signals off; the
share that `unexplained` keeps without any sign of it tells of none.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from sma_bench.diagnose.decision import (
    FLEXIBLE,
    LEFT_OUTLIER,
    NO_GAP,
    RECALIBRATION,
    UNEXPLAINED,
    UNSEEN,
    Candidate,
    Decision,
    scale_of,
)
from sma_bench.diagnose.search import Search
from sma_bench.diagnose.sizes import Cell, contribution, largest_gap
from sma_bench.physics.effects import EFFECTS

ELECTRICAL, THERMAL, TRANSFORMATION, MECHANICAL, SENSOR = (
    "electrical", "thermal", "transformation", "mechanical", "sensor",
)
_STAGES = {
    "wire.resistance": ELECTRICAL,
    "wire.heat_transfer_coefficient": THERMAL,
    "wire.specific_heat": THERMAL,
    "environment.ambient_temperature": THERMAL,
    "wire.austenite_start_temperature": TRANSFORMATION,
    "wire.austenite_finish_temperature": TRANSFORMATION,
    "wire.martensite_start_temperature": TRANSFORMATION,
    "wire.martensite_finish_temperature": TRANSFORMATION,
    "wire.stress_influence_austenite": TRANSFORMATION,
    "wire.stress_influence_martensite": TRANSFORMATION,
}
_FIRST_OFF = {"current": ELECTRICAL, "temperature": THERMAL, "deflection": MECHANICAL}
# A wire's temperature does not jump, whatever happens; what holds it may slip.
_OF_AN_EVENT = {"current": ELECTRICAL, "temperature": SENSOR, "deflection": MECHANICAL}
_NOTICEABLE = 0.2  # of a smooth response
_CHANCE = 0.05  # that one of the stages moves so far though nothing is wrong with it


def stages_of(decision: Decision, found: Search, missing: Sequence[Cell]) -> dict[str, float]:
    """Probability of each stage, the most probable first; what tells of none is in no stage. Empty
    where there is no gap.

    Args:
        missing: cells of what no candidate explains, the largest share first.
    """
    if decision.verdict == NO_GAP:
        return {}
    shares: dict[str, float] = {}
    for candidate in decision.candidates:
        share = candidate.probability
        if candidate.name == UNEXPLAINED:
            benign = sum(
                c.probability for c in decision.candidates if c.name in (RECALIBRATION, NO_GAP)
            )
            share -= float(np.exp(UNSEEN)) * benign
        if share > 0.0:
            for stage, part in _stages_of_candidate(candidate, found, missing).items():
                shares[stage] = shares.get(stage, 0.0) + share * part
    ranked = sorted(shares, key=lambda s: shares[s], reverse=True)
    return {s: shares[s] for s in ranked} or {_moved_furthest(found)[0]: 0.0}


def _stages_of_candidate(
    candidate: Candidate, found: Search, missing: Sequence[Cell]
) -> dict[str, float]:
    """Shares of the stages that a candidate tells of."""
    if candidate.name == UNEXPLAINED:
        return _stages_of_missing(found, missing)
    if candidate.name == RECALIBRATION:
        stage = stage_of_recalibration(found)
    else:
        stage = _stage_of_effects(candidate)
    return {stage: 1.0} if stage else {}


def _stage_of_effects(candidate: Candidate) -> str:
    """Of the only effect, or of the one that does most; "" without any."""
    stages: list[str] = list(dict.fromkeys(EFFECTS[name].stage for name in candidate.effects))
    if len(stages) < 2 or candidate.fit is None:
        return stages[0] if stages else ""
    fitted = candidate.fit
    does = {
        name: largest_gap(fitted.problem, contribution(fitted, (name,)))
        for name in candidate.effects
    }
    return EFFECTS[max(does, key=lambda name: does[name])].stage


def stage_of_recalibration(found: Search) -> str:
    """The stage whose parameters moved further than was believed; "" where none did."""
    stage, chance = _moved_furthest(found)
    return stage if chance < _CHANCE else ""


def _moved_furthest(found: Search) -> tuple[str, float]:
    """The stage whose parameters moved the least believably, and how likely one of all stages
    moves so far by chance: squared prior deviations are chi squared."""
    moved: dict[str, list[float]] = {}
    unknowns = found.recalibrated.unknowns
    for name, x in zip(unknowns.bench_names, found.recalibrated.x.tolist(), strict=False):
        moved.setdefault(_STAGES.get(name, MECHANICAL), []).append(x)
    chances = {stage: float(chdtrc(len(xs), np.sum(np.square(xs)))) for stage, xs in moved.items()}
    least = min(chances, key=lambda stage: chances[stage])
    return least, chances[least] * len(moved)


def _stages_of_missing(found: Search, missing: Sequence[Cell]) -> dict[str, float]:
    """Where what nothing explains acts.

    Parameters that nobody believes in tell it, or the signal of a single event where nothing else
    is off; else the chain does: the stages of the effects that act on the signals that are off and
    on no other, by how near each comes. A temperature that is off without the deflection that it
    should drive is its sensor's doing, a deflection after right temperatures that of what comes
    behind them.
    """
    moved = stage_of_recalibration(found)
    if moved:
        return {moved: 1.0}
    off = {_quantity(name) for name in found.left.shows}
    if found.left_by_best.outlier > LEFT_OUTLIER and not off:
        return {_OF_AN_EVENT.get(_quantity(found.left_by_best.event), MECHANICAL): 1.0}
    if found.flexible.gain > FLEXIBLE:
        noticed: dict[str, float] = {}
        for cell in missing:
            quantity = _quantity(cell.signal)
            noticed[quantity] = noticed.get(quantity, 0.0) + cell.share
        off |= {quantity for quantity, share in noticed.items() if share > _NOTICEABLE}
    seen = {_quantity(cell.signal) for cell in missing}
    like = [n for n in found.ranked if not off or set(EFFECTS[n].acts_on) & seen == off]
    if not like:
        first = next((quantity for quantity in _FIRST_OFF if quantity in off), "deflection")
        return {_FIRST_OFF[first]: 1.0}
    gains = np.array([found.gain(name) for name in like])
    near = np.exp((gains - gains[0]) / scale_of(max(float(gains[0]), 0.0)))
    shares: dict[str, float] = {}
    for name, share in zip(like, near / near.sum(), strict=True):
        stage: str = EFFECTS[name].stage
        shares[stage] = shares.get(stage, 0.0) + float(share)
    return shares


def _quantity(signal: str) -> str:
    return signal.rpartition(".")[2]


def missing_term(found: Search) -> NDArray[np.float64]:
    """(n,) the course of what recalibration leaves unexplained, in the signals' units.

    A smooth response of free form is it only where it is sure: one that gains next to nothing is
    next to nothing, wherever it happens to be. Else it is all that is slower than the scatter of
    samples, what a fit has to take for the drift of a sensor.
    """
    if found.flexible.gain > FLEXIBLE:
        return found.flexible.response
    problem = found.recalibrated.problem
    left = found.recalibrated.left
    slow = np.concatenate(
        [problem.noise[b.signal.name].drift_in(left[b.rows]) for b in problem.blocks]
    )
    return slow if slow.any() else left
