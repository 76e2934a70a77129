"""The numbers that a decision is made of: what every candidate gains, does and leaves."""

from dataclasses import dataclass, field

import numpy as np

from sma_bench.compiled import in_threads
from sma_bench.diagnose.left_over import Left
from sma_bench.diagnose.process_noise import process_noise
from sma_bench.diagnose.result import JOIN
from sma_bench.diagnose.search import Search
from sma_bench.diagnose.sizes import contribution, largest_gap
from sma_bench.estimation.residual import DRIFT_EFFECT
from sma_bench.estimation.solver import Fit


@dataclass(frozen=True)
class Facts:
    """Of one candidate: an effect, or two."""

    gain: float  # evidence over recalibration [nats]
    gap: float  # what it does, in the noise of a sample
    partner: float  # what the smaller of two does; of one the same
    unsteady: float  # scatter of its size between stretches, of what noise lets it
    own: float  # largest prior deviation of the effects' own numbers
    parts: dict[str, float] = field(default_factory=dict)  # what each of the effects does, in noise


@dataclass(frozen=True)
class Weighed:
    """Of one search."""

    candidates: dict[str, Facts]
    moved: float  # gap between the parameters as believed and as recalibrated, in noise
    surprise: float  # of recalibration: squared prior deviations of the bench's parameters
    deviation: float  # the largest of them
    as_stated: float  # evidence of the parameters as believed over recalibration [nats]
    left_by_best: dict[str, float]  # of Left
    beyond: float  # nats that a smooth response gains over the best candidate
    # nats that a smooth input to each stage gains over recalibration, and over the best
    inputs: dict[str, float]
    inputs_by_best: dict[str, float]
    records: int


def weighed(search: Search) -> Weighed:
    """Everything that the decision looks at."""
    recalibrated, fits = search.recalibrated, effect_fits(search)

    def facts(name: str, fitted: Fit) -> Facts:
        effects, first = fitted.unknowns.effects, fitted.unknowns.baseline
        gap, gain = own_gap(fitted), fitted.evidence - recalibrated.evidence
        parts = {e: own_gap(fitted, (e,)) for e in effects} if len(effects) > 1 else {name: gap}
        # What gains nothing needs no size, and a zero that wanders has none that stays.
        unsteady = 1.0
        if effects != (DRIFT_EFFECT,) and gain > 0.0:
            unsteady = float(fitted.jackknifed[first] / fitted.std[first])
        own = float(np.max(np.abs(fitted.x[first:])))
        return Facts(gain, gap, min(parts.values()), unsteady, own, parts)

    own = recalibrated.x[: recalibrated.unknowns.bench]
    return Weighed(
        dict(zip(fits, in_threads(facts, list(fits.items())), strict=True)),
        largest_gap(recalibrated.problem, recalibrated.predicted - search.nominal.predicted),
        recalibrated.surprise, float(np.max(np.abs(own), initial=0.0)),
        search.nominal.evidence - recalibrated.evidence, plain(search.left_by_best),
        search.beyond.gain,
        _inputs(recalibrated), _inputs(search.best), len(search.problem.observations),
    )  # fmt: skip


def _inputs(fitted: Fit) -> dict[str, float]:
    return {stage: one.gain for stage, one in process_noise(fitted).items()}


def effect_fits(search: Search) -> dict[str, Fit]:
    """Of every single and pair, by its name."""
    return {**search.singles, **{JOIN.join(key): fit for key, fit in search.pairs.items()}}


def own_gap(fitted: Fit, names: tuple[str, ...] = ()) -> float:
    """What the effects of a candidate do, or some of them, the rest of its model as it is."""
    return largest_gap(fitted.problem, contribution(fitted, names or fitted.unknowns.effects))


def plain(left: Left) -> dict[str, float]:
    """Its numbers."""
    return {name: value for name, value in vars(left).items() if name != "signal"}
