"""The numbers that a decision is made of: what every candidate gains, does and leaves."""

from dataclasses import dataclass

import numpy as np

from sma_bench.compiled import in_threads
from sma_bench.diagnose.result import JOIN
from sma_bench.diagnose.search import Search
from sma_bench.diagnose.sizes import contribution, largest_gap
from sma_bench.estimation.residual import DRIFT_EFFECT
from sma_bench.estimation.solver import Fit

REMARK = 0.1  # share of the gap below which a partner is a remark, and no second cause


@dataclass(frozen=True)
class Facts:
    """Of one candidate: an effect, or two."""

    gain: float  # evidence over recalibration [nats]
    gap: float  # what it does, in the noise of a sample
    unsteady: float  # scatter of its size between stretches, of what noise lets it
    own: float  # largest prior deviation of the effects' own numbers
    parts: dict[str, float]  # what each of the effects does, in noise


@dataclass(frozen=True)
class Weighed:
    """Of one search."""

    candidates: dict[str, Facts]
    moved: float  # gap between the parameters as believed and as recalibrated, in noise
    surprise: float  # of recalibration: squared prior deviations of the bench's parameters
    as_stated: float  # evidence of the parameters as believed over recalibration [nats]
    ratio: float  # of the best, in motion against at rest, and its largest outlier: of Left
    outlier: float
    beyond: float  # nats that a smooth response gains over the best
    input: float  # the same of a smooth input to some stage
    records: int

    def remarks(self) -> dict[str, tuple[str, str]]:
        """Pairs whose worse half by gain does next to nothing: the better half and that one."""
        found = {}
        for pair, facts in self.candidates.items():
            small, *main = sorted(facts.parts, key=lambda effect: self.candidates[effect].gain)
            if main and facts.parts[small] < REMARK * facts.parts[main[0]]:
                found[pair] = main[0], small
        return found


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
        return Facts(gain, gap, unsteady, own, parts)

    return Weighed(
        dict(zip(fits, in_threads(facts, list(fits.items())), strict=True)),
        largest_gap(recalibrated.problem, recalibrated.predicted - search.nominal.predicted),
        recalibrated.surprise, search.nominal.evidence - recalibrated.evidence,
        search.left_by_best.ratio, search.left_by_best.outlier, search.beyond.gain,
        max(one.gain for one in search.inputs_by_best.values()), len(search.problem.observations))


def effect_fits(search: Search) -> dict[str, Fit]:
    """Of every single and pair, by its name."""
    return {**search.singles, **{JOIN.join(key): fit for key, fit in search.pairs.items()}}


def own_gap(fitted: Fit, names: tuple[str, ...] = ()) -> float:
    """What the effects of a candidate do, or some of them, the rest of its model as it is."""
    return largest_gap(fitted.problem, contribution(fitted, names or fitted.unknowns.effects))
