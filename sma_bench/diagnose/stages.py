"""The stage of the chain in which a gap arises, from all explanations by their probability.

An effect has its stage, of two the one that does more. Recalibration has the stage whose parameters
moved further than anyone believed; where all moved as far as believed they tell of no stage (six
transition numbers move further than one resistance by their number alone), and the most probable
effect does. What nothing explains has that of an effect which would put the same signals off.
"""

from collections.abc import Sequence

import numpy as np
from scipy.stats import chi2

from sma_bench.diagnose.decision import (
    FLEXIBLE,
    NO_GAP,
    RECALIBRATION,
    UNEXPLAINED,
    Candidate,
    Decision,
)
from sma_bench.diagnose.search import Search
from sma_bench.diagnose.sizes import Cell, contribution, largest_gap
from sma_bench.physics.effects import EFFECTS

ELECTRICAL, THERMAL, TRANSFORMATION, MECHANICAL = (
    "electrical", "thermal", "transformation", "mechanical",
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
_NOTICEABLE = 0.2  # of a smooth response
_CHANCE = 0.05  # that one of the stages moves so far though nothing is wrong with it


def stage_of(decision: Decision, found: Search, missing: Sequence[Cell]) -> str:
    """The most probable stage; "" where there is no gap.

    Args:
        missing: cells of what no candidate explains, the largest share first.
    """
    if decision.verdict == NO_GAP:
        return ""
    shares: dict[str, float] = {}
    for candidate in decision.candidates:
        stage = _stage_of_candidate(candidate, found, missing)
        if stage:
            shares[stage] = shares.get(stage, 0.0) + candidate.probability
    return max(shares, key=lambda s: shares[s]) if shares else _moved_furthest(found)[0]


def _stage_of_candidate(candidate: Candidate, found: Search, missing: Sequence[Cell]) -> str:
    if candidate.name == RECALIBRATION:
        return stage_of_recalibration(found)
    if candidate.name == UNEXPLAINED:
        return _stage_of_missing(found, missing)
    return _stage_of_effects(candidate)


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
    chances = {
        stage: float(chi2.logsf(np.sum(np.square(xs)), len(xs))) for stage, xs in moved.items()
    }
    least = min(chances, key=lambda stage: chances[stage])
    return least, float(np.exp(chances[least])) * len(moved)


def _stage_of_missing(found: Search, missing: Sequence[Cell]) -> str:
    """Where what nothing explains acts.

    Parameters that nobody believes in tell it; else the chain does: it is the stage of the effect
    that comes nearest and acts on the signals that are off and on no other. A temperature that is
    off without the deflection that it should drive is its sensor's doing, a deflection after right
    temperatures that of what comes behind them.
    """
    moved = stage_of_recalibration(found)
    if moved:
        return moved
    off = {_quantity(name) for name in found.left.shows}
    if found.flexible.gain > FLEXIBLE:
        off |= _noticed(missing)
    seen = {_quantity(cell.signal) for cell in missing}
    for effect in (EFFECTS[name] for name in found.ranked):
        if not off or set(effect.acts_on) & seen == off:
            return effect.stage
    first = next((quantity for quantity in _FIRST_OFF if quantity in off), "deflection")
    return _FIRST_OFF[first]


def _noticed(missing: Sequence[Cell]) -> set[str]:
    """Quantities that have a fair share of it."""
    shares: dict[str, float] = {}
    for cell in missing:
        quantity = _quantity(cell.signal)
        shares[quantity] = shares.get(quantity, 0.0) + cell.share
    return {quantity for quantity, share in shares.items() if share > _NOTICEABLE}


def _quantity(signal: str) -> str:
    return signal.rpartition(".")[2]
