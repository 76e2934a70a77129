"""The stage of the chain in which a gap arises, from all explanations by their probability.

An effect has its stage; recalibration has that of the parameters which had to move furthest; what
nothing explains has that of the first signal in which it lies, as far along the chain as sensors
tell: without temperatures a deflection says nothing of where it went wrong.
"""

from collections.abc import Sequence

from sma_bench.diagnose.decision import NO_GAP, RECALIBRATION, UNEXPLAINED, Decision
from sma_bench.diagnose.search import Search
from sma_bench.diagnose.sizes import Cell
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
_FIRST_SEEN_IN = {"current": ELECTRICAL, "temperature": THERMAL, "deflection": MECHANICAL}
_NOTICEABLE = 0.2  # of what is missing


def stage_of(decision: Decision, found: Search, missing: Sequence[Cell]) -> str:
    """The most probable stage; "" where there is no gap.

    Args:
        missing: cells of what no candidate explains, the largest share first.
    """
    if decision.verdict == NO_GAP:
        return ""
    shares: dict[str, float] = {}
    for candidate in decision.candidates:
        stages: list[str] = [EFFECTS[name].stage for name in candidate.effects]
        if candidate.name == RECALIBRATION:
            stages = [stage_of_recalibration(found)]
        elif candidate.name == UNEXPLAINED:
            stages = [_stage_of_missing(missing, found)]
        for stage in stages:
            shares[stage] = shares.get(stage, 0.0) + candidate.probability / len(stages)
    return max(shares, key=lambda stage: shares[stage]) if shares else ""


def stage_of_recalibration(found: Search) -> str:
    """The stage whose parameters moved furthest, in squared prior deviations."""
    moved: dict[str, float] = {}
    unknowns = found.recalibrated.unknowns
    for name, x in zip(unknowns.prior.names, found.recalibrated.x.tolist(), strict=False):
        stage = _STAGES.get(name, MECHANICAL)
        moved[stage] = moved.get(stage, 0.0) + x * x
    return max(moved, key=lambda stage: moved[stage])


def _stage_of_missing(missing: Sequence[Cell], found: Search) -> str:
    shares: dict[str, float] = {}
    for cell in missing:
        quantity = cell.signal.rpartition(".")[2]
        shares[quantity] = shares.get(quantity, 0.0) + cell.share
    for quantity, stage in _FIRST_SEEN_IN.items():
        if shares.get(quantity, 0.0) > _NOTICEABLE and (
            stage != MECHANICAL or "temperature" in shares
        ):
            return stage
    return EFFECTS[found.ranked[0]].stage if found.ranked else MECHANICAL
