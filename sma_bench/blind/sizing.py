"""How large a case's effects are: solved for their targets on the reality itself."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from sma_bench.blind.cases import NUISANCE_LIMIT, Case
from sma_bench.blind.deck import QUANTITIES
from sma_bench.blind.stage import COARSE, RECORDS, Array, Stage, gaps, largest
from sma_bench.blind.symptoms import EFFECTS, OUTSIDE, Draw, amount_for, draw

Features = Mapping[str, float]
ALL_QUANTITIES = QUANTITIES["all"]
# Features that a mildly different kinetics moves together, at amount 1.
MILD_KINETICS = {"grain_spread": 1.2, "kinetics_smoothness": 0.5}
_SHRINK = 0.8
_TRIALS = 8


@dataclass(frozen=True)
class Sized:
    """What a case's world holds.

    Attributes:
        base: features of the rig without what is hidden: nuisances (and mild kinetics).
        features: with all that is hidden.
        draws, amounts: by effect.
        nuisance_gap, kinetics_gap: measured, the largest of both records.
    """

    base: dict[str, float]
    features: dict[str, float]
    draws: dict[str, Draw]
    amounts: dict[str, float]
    nuisance_gap: float
    kinetics_gap: float

    def without(self, effect: str) -> dict[str, float]:
        """Features of a world in which this one effect is not there."""
        features = dict(self.base)
        for name, drawn in self.draws.items():
            if name != effect:
                features = drawn.features(features, self.amounts[name])
        return features


def size(case: Case, stage: Stage) -> Sized:
    """Find the features of a case: nuisances below their limit, effects at their targets."""
    little, nuisance_gap = _nuisances(case, stage)
    base, kinetics_gap = dict(little), 0.0
    if case.card.mild_kinetics:
        base = _mild_kinetics(case, stage, little)
        kinetics_gap = measured(stage, base, little)
    rng = case.stream("effect")
    features, draws, amounts = dict(base), {}, {}
    for name, target in zip(case.card.effects, case.card.targets, strict=True):
        drawn = draw({**EFFECTS, **OUTSIDE}[name], rng, stage.peak_current())
        natural = drawn.natural(rng)
        amount = natural
        if target is not None:
            amount = _amount(case, stage, base, drawn, natural, target)
        features = drawn.features(features, amount)
        draws[name], amounts[name] = drawn, amount
    return Sized(base, features, draws, amounts, nuisance_gap, kinetics_gap)


def measured(
    stage: Stage,
    features: Features,
    other: Features,
    quantities: tuple[str, ...] = ALL_QUANTITIES,
    fine: float = 1.0,
) -> float:
    """Gap over noise between two worlds: the largest over signals and records."""
    found = 0.0
    for record in RECORDS:
        one, two = (stage.read(f, record, fine) for f in (features, other))
        found = max(found, largest(gaps(one, two, stage.sensors, quantities)))
    return found


def _amount(
    case: Case, stage: Stage, base: Features, drawn: Draw, start: float, target: float
) -> float:
    quantities = QUANTITIES[case.card.signals]

    def gap(amount: float) -> float:
        return measured(stage, drawn.features(base, amount), base, quantities, COARSE)

    return amount_for(drawn, target, gap, start)


def _nuisances(case: Case, stage: Stage) -> tuple[dict[str, float], float]:
    """The rig's nuisances at their wanted gap, and the gap that both records measure."""
    wanted, scale = case.nuisance_gap, 1.0
    for trial in range(_TRIALS):
        features = {name: scale * value for name, value in case.nuisances.items()}
        fine = COARSE if trial == 0 else 1.0
        reached = measured(stage, features, {}, fine=fine)
        if trial and reached <= NUISANCE_LIMIT:
            return features, reached
        # The gap grows with the scale or its square: down by the root stays above nothing.
        scale *= wanted / reached if trial == 0 else min(wanted / reached, _SHRINK)
    return {}, 0.0


def _mild_kinetics(case: Case, stage: Stage, base: Features) -> dict[str, float]:
    """The base with a transformation smoother by the wanted gap."""
    rng = case.stream("effect")
    parts = {name: value * rng.uniform(0.3, 1.0) for name, value in MILD_KINETICS.items()}

    def features(amount: float) -> dict[str, float]:
        added = {name: base.get(name, 0.0) + amount * part for name, part in parts.items()}
        return {**base, **added, "kinetics_smoothness": min(added["kinetics_smoothness"], 1.0)}

    amount = 1.0
    for _ in range(3):
        reached = measured(stage, features(amount), base, fine=COARSE)
        # Smoothing acts by its variance: the gap grows between the first and second power.
        amount *= float(np.clip((case.mild_gap / reached) ** 0.7, 0.2, 3.0))
    return features(amount)


def readings_of(stage: Stage, features: Features) -> dict[str, dict[str, Array]]:
    """Noise-free readings of both records."""
    return {record: stage.read(features, record) for record in RECORDS}


def rounded(gap: Mapping[str, float]) -> dict[str, Any]:
    """Gaps as a label keeps them."""
    return {name: round(value, 4) for name, value in gap.items()}
