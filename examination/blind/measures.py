"""Intervals of what was counted and measured over a limited number of cases."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from examination.blind.judgement import Judged

CONFIDENCE = 0.95
_RESAMPLES = 2000
_SEED = 20240229

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Measured:
    """A value with its 95 % interval over `n` cases; `hits` of a proportion."""

    value: float
    low: float
    high: float
    n: int
    hits: int | None = None


NOTHING = Measured(math.nan, math.nan, math.nan, 0)


def clopper_pearson(hits: int, n: int, confidence: float = CONFIDENCE) -> tuple[float, float]:
    """Exact interval of a proportion (Clopper and Pearson, Biometrika 26, 1934).

    Args:
        hits: successes; n: trials, at least 1.
    """
    tail = (1.0 - confidence) / 2.0
    low = 0.0 if hits == 0 else float(stats.beta.ppf(tail, hits, n - hits + 1))
    high = 1.0 if hits == n else float(stats.beta.ppf(1.0 - tail, hits + 1, n - hits))
    return low, high


def proportion(outcomes: Sequence[bool]) -> Measured:
    """Share of True with its Clopper-Pearson interval."""
    if not outcomes:
        return NOTHING
    hits, n = sum(map(bool, outcomes)), len(outcomes)
    return Measured(hits / n, *clopper_pearson(hits, n), n, hits)


def mean(values: Sequence[float]) -> Measured:
    """Mean with a percentile bootstrap interval; the same values give the same interval."""
    if not values:
        return NOTHING
    numbers = np.asarray(values, dtype=float)
    resampled = numbers[_resamples(len(numbers))].mean(axis=1)
    return Measured(float(numbers.mean()), *_percentiles(resampled), len(numbers))


def quantile(values: Sequence[float], level: float) -> Measured:
    """Quantile with the interval between two order statistics, free of any distribution.

    The number of values below the true quantile is binomial (n, level) (David and Nagaraja, Order
    Statistics, section 7.1). Where n is too small for a bound, the bound is infinite.

    Args:
        values: one for each case, infinite for a case that has none.
    """
    if not values:
        return NOTHING
    ordered = np.sort(np.asarray(values, dtype=float))
    n, tail = len(ordered), (1.0 - CONFIDENCE) / 2.0
    below = int(stats.binom.ppf(tail, n, level)) - 1
    above = int(stats.binom.ppf(1.0 - tail, n, level))
    low = float(ordered[below]) if below >= 0 else -math.inf
    high = float(ordered[above]) if above < n else math.inf
    return Measured(_quantile(ordered, level), low, high, n)


def _quantile(ordered: Array, level: float) -> float:
    """Linear between order statistics, where infinite ones may be among them."""
    position = level * (len(ordered) - 1)
    lower, upper = ordered[math.floor(position)], ordered[math.ceil(position)]
    share = position - math.floor(position)
    return float(lower if share == 0.0 else lower * (1.0 - share) + upper * share)


def calibration_error(stated: Sequence[float], right: Sequence[bool], bins: int = 10) -> Measured:
    """Expected calibration error: mean distance of stated probability and frequency over bins.

    sum_b n_b/n |mean stated in b - share right in b| (Naeini et al., AAAI 2015), with a bootstrap
    interval over cases.
    """
    if not stated:
        return NOTHING
    probability, hit = np.asarray(stated, dtype=float), np.asarray(right, dtype=float)
    which = bin_of(probability, bins)
    value = _calibration_error(which, probability - hit, bins)
    resampled = [
        _calibration_error(which[rows], (probability - hit)[rows], bins)
        for rows in _resamples(len(hit))
    ]
    return Measured(value, *_percentiles(np.asarray(resampled)), len(hit))


def bin_of(probability: Array, bins: int) -> NDArray[np.intp]:
    """Number of the equally wide bin that a probability falls into; 1 belongs to the last."""
    return np.minimum((probability * bins).astype(np.intp), bins - 1)


def _calibration_error(which: NDArray[np.intp], excess: Array, bins: int) -> float:
    sums = np.bincount(which, weights=excess, minlength=bins)
    return float(np.sum(np.abs(sums)) / len(excess))


def _resamples(n: int) -> NDArray[np.int64]:
    return np.random.default_rng(_SEED).integers(0, n, size=(_RESAMPLES, n))


def _percentiles(resampled: Array) -> tuple[float, float]:
    tail = 50.0 * (1.0 - CONFIDENCE)
    low, high = np.percentile(resampled, [tail, 100.0 - tail])
    return float(low), float(high)


# --- Every measure of the withheld-effect check: a number with its interval from judged cases.
#
# A case without an answer (a crash, no time, against the contract) counts against the answerer:
# it detects nothing, alarms and is not right; it claims no shrinkage. DETECTABLE cases have a
# measured gap above twice the noise.

Cases = Sequence[Judged]
Bound = float | tuple[float, float] | None
DETECTABLE = 2.0


@dataclass(frozen=True)
class Measure:
    """One row of the result.

    Attributes:
        name: as in the table of floors and aims.
        definition: over which cases, and what counts.
        of: the number, from all judged cases.
        better: a higher or a lower value, or one inside a band (floor and aim are (low, high)).
        style: how it is printed.
        floor, aim: None for a measure that is reported only.
        given: measure in which another examinee must be as good before its value counts as better:
            who always raises an alarm detects everything.
    """

    name: str
    definition: str
    of: Callable[[Cases], Measured]
    better: Literal["higher", "lower", "inside"] = "higher"
    style: Literal["share", "number", "points", "seconds"] = "share"
    floor: Bound = None
    aim: Bound = None
    given: str = ""

    def reaches(self, value: float, bound: Bound) -> bool:
        """Whether a value is at least as good as a bound."""
        if bound is None or math.isnan(value):
            return False
        if isinstance(bound, tuple):
            return bound[0] <= value <= bound[1]
        return value >= bound if self.better == "higher" else value <= bound

    def better_than(self, one: float, other: float) -> bool:
        """Whether `one` is the better value; inside a band, the nearer one to its middle."""
        if self.better == "inside" and isinstance(self.aim, tuple):
            middle = sum(self.aim) / 2.0
            return abs(one - middle) < abs(other - middle)
        return one > other if self.better == "higher" else one < other

    def met(self, measured: Measured) -> str:
        """`aim`, `floor` or `missed` by the value itself; "" without cases or floor."""
        if self.floor is None or not measured.n:
            return ""
        if self.reaches(measured.value, self.aim):
            return "aim"
        return "floor" if self.reaches(measured.value, self.floor) else "missed"


def share_of(outcome: Callable[[Judged], bool], among: Callable[[Judged], bool]) -> Callable:
    """Proportion of the cases `among` that have the `outcome`."""
    return lambda cases: proportion([outcome(c) for c in cases if among(c)])


def single(case: Judged) -> bool:
    """One effect of the library."""
    return case.label.kind == "single"


def seen_single(case: Judged) -> bool:
    """One effect of the library with a gap above twice the noise."""
    return single(case) and detectable(case)


def mistaken(case: Judged) -> bool:
    """Wrong parameters and no effect, with a gap above twice the noise."""
    return case.label.kind == "recalibration" and detectable(case)


def distinguishable(case: Judged) -> bool:
    """One effect, five standard deviations off every rival."""
    return single(case) and case.label.distinguishable


def pair(case: Judged) -> bool:
    """Two effects."""
    return case.label.kind == "pair"


def detectable(case: Judged) -> bool:
    """Something is wrong, with a measured gap above twice the noise."""
    return case.label.kind != "none" and case.label.severity > DETECTABLE


def clean(case: Judged) -> bool:
    """Nothing is wrong."""
    return case.label.kind == "none" and not case.label.kinetics


def kinetics(case: Judged) -> bool:
    """Nothing is wrong but mildly different kinetics."""
    return case.label.kind == "none" and case.label.kinetics


def outside(case: Judged) -> bool:
    """Detectable effect that no library has."""
    return case.label.kind == "outside" and detectable(case)


def placed(case: Judged) -> bool:
    """Detectable, and the label says where."""
    return detectable(case) and bool(case.label.where)


def anyone(_: Judged) -> bool:
    """Every case."""
    return True


def not_pair(case: Judged) -> bool:
    """Every case but pairs."""
    return not pair(case)


def place(key: str) -> Callable[[Cases], Measured]:
    """Share of `placed` cases whose signal, phase, side or stage is right."""
    return share_of(lambda c: c.place_right(key), placed)


def _claims(cases: Cases) -> list[tuple[float, float, tuple[float, float]]]:
    """(claimed, true, interval) of every case that claims to shrink a gap that is there."""
    pairs = [case.claim for case in cases]
    return [(pair[0].fraction, pair[1], pair[0].ci90) for pair in pairs if pair]


def shrinkage_error(level: float) -> Callable[[Cases], Measured]:
    """Quantile of |claimed - true fraction|."""
    return lambda cases: quantile([abs(said - true) for said, true, _ in _claims(cases)], level)


def shrinkage_bias(cases: Cases) -> Measured:
    """Median of claimed - true fraction."""
    return quantile([said - true for said, true, _ in _claims(cases)], 0.5)


def shrinkage_coverage(cases: Cases) -> Measured:
    """Share of claimed 90 % intervals that hold the true fraction."""
    return proportion([low <= true <= high for _, true, (low, high) in _claims(cases)])


def true_shrinkage(cases: Cases) -> Measured:
    """Median true fraction where one is claimed."""
    return quantile([true for _, true, _ in _claims(cases)], 0.5)


def first_choice_calibration(cases: Cases) -> Measured:
    """Calibration error of the most probable candidates' probabilities."""
    stated = [(c.first_choice.probability, c.first_choice_right) for c in cases if c.first_choice]
    return calibration_error([p for p, _ in stated], [right for _, right in stated])


def parameter_error(which: int) -> Callable[[Cases], Measured]:
    """Median parameter error, of the lab's file (0) or the improved one (1)."""
    def of(cases: Cases) -> Measured:
        errors = [case.parameter_error[which] for case in cases]
        return quantile([error for error in errors if not math.isnan(error)], 0.5)

    return of


def seconds(level: float) -> Callable[[Cases], Measured]:
    """Quantile of the time to answer."""
    return lambda cases: quantile([c.seconds for c in cases if not math.isnan(c.seconds)], level)


def set_size(cases: Cases) -> Measured:
    """Mean number of candidates in the 90 % set."""
    sizes = [float(len(case.credible_set)) for case in cases if case.answer]
    return mean(sizes) if sizes else NOTHING


# --- The measures by name: those with a floor and an aim, and those that are reported besides.

# The table of floors and aims, row by row.
TARGETS = (
    Measure(
        "detection of gaps above twice the noise",
        "cases with something wrong and a measured gap above 2 noise standard deviations; any "
        "verdict but no_gap, an ambiguous one only without no_gap in its 90 % set",
        share_of(lambda c: c.says_gap, detectable), floor=0.97, aim=0.99,
        given="false alarms on no effect",
    ),
    Measure(
        "false alarms on no effect",
        "cases with nothing wrong, noise white, coloured or drifting; verdict effect or "
        "unexplained, or ambiguous with neither no_gap nor recalibration in its 90 % set",
        share_of(lambda c: c.alarms, clean), "lower", floor=0.02, aim=0.005,
    ),
    Measure(
        "false alarms on benign kinetics mismatch",
        "the same over cases with mildly different kinetics and nothing else",
        share_of(lambda c: c.alarms, kinetics), "lower", floor=0.10, aim=0.05,
    ),
    Measure(
        "first choice right, singles above twice the noise",
        "single effects with a measured gap above 2 noise standard deviations; the most probable "
        "candidate is the effect",
        share_of(lambda c: c.first_choice_right, seen_single), floor=0.90, aim=0.95,
    ),
    Measure(
        "singles named and right", "the same; the verdict is `effect`, too",
        share_of(lambda c: c.verdict == "effect" and c.first_choice_right, seen_single),
        floor=0.80, aim=0.90,
    ),
    Measure(
        "wrong parameters said as such, with the parameter",
        "parameters 2.5 to 5 stated deviations off and no effect, gap above 2; verdict "
        "recalibration, and the improved file has one of them 2 deviations or more from where it "
        "was believed",
        share_of(lambda c: c.verdict == "recalibration" and bool(c.moved & c.label.wrong),
                 mistaken), floor=0.70, aim=0.85,
    ),
    Measure(
        "90 % set holds the truth",
        "all cases but pairs; the fewest candidates that make 90 % have the truth among them",
        share_of(lambda c: c.set_holds_truth, not_pair), floor=0.90, aim=0.92,
    ),
    Measure(
        "90 % set, mean size", "all answers; number of candidates in the 90 % set",
        set_size, "lower", "number", floor=1.6, aim=1.3, given="90 % set holds the truth",
    ),
    Measure(
        "probability given to the truth",
        "all cases; summed over candidates that are made of nothing but what is true",
        lambda cases: mean([c.truth_probability for c in cases]), style="number",
        floor=0.82, aim=0.90,
    ),
    Measure(
        "out-of-library: abstains or flags",
        "effects that no library has, gap above 2; verdict ambiguous or unexplained, or "
        "unexplained in the 90 % set",
        share_of(lambda c: c.abstains_or_flags, outside), floor=0.90, aim=0.97,
    ),
    Measure(
        "confident and wrong",
        "all cases; verdict effect with a cause that shares nothing with the truth, or a candidate "
        "that shares nothing with it at 0.8 or more",
        share_of(lambda c: c.confident_and_wrong, anyone), "lower", floor=0.02, aim=0.01,
    ),
    Measure(
        "claimed against true shrinkage, median",
        "cases that claim to shrink a gap which is there; |claimed - true fraction| on a protocol "
        "that nobody saw",
        shrinkage_error(0.5), "lower", "points", floor=0.01, aim=0.005,
    ),
    Measure(
        "claimed against true shrinkage, 90th percentile", "the same",
        shrinkage_error(0.9), "lower", "points", floor=0.07, aim=0.04,
    ),
    Measure(
        "90 % interval of shrinkage covers", "the same cases; the true fraction is inside",
        shrinkage_coverage, "inside", floor=(0.84, 0.95), aim=(0.87, 0.93),
    ),
    Measure(
        "pairs: at least one", "pairs of effects; the cause (without one, the most probable "
        "candidate) names one of them or both",
        share_of(lambda c: bool(c.named & c.label.names), pair), floor=0.95, aim=0.98,
    ),
    Measure(
        "pairs: both", "the same; it names both",
        share_of(lambda c: c.label.names <= c.named, pair), floor=0.65, aim=0.80,
    ),
    Measure(
        "where: signal", "effects with a gap above 2; the quantity with the largest gap",
        place("signal"), floor=0.97, aim=0.99,
    ),
    Measure(
        "where: phase", "the same; drive, rest or initial",
        place("phase"), floor=0.90, aim=0.95,
    ),
    Measure(
        "where: stage", "the same; electrical, thermal, transformation, mechanical or sensor; of "
        "two effects that of the one with the larger gap, of wrong parameters that of any",
        place("stage"), floor=0.85, aim=0.93,
    ),
    Measure(
        "of the ambiguous, settled rightly",
        "ambiguous answers, what they ask for performed in the case's own world up to three times; "
        "the last answer is not ambiguous and its most probable candidate is right",
        share_of(lambda c: c.resolved, lambda c: c.followed), floor=0.70, aim=0.85,
    ),
)


def _noise_alarm(noise: str) -> Measure:
    return Measure(
        f"false alarms, {noise} noise", "cases with nothing wrong and this noise",
        share_of(lambda c: c.alarms, lambda c: clean(c) and c.label.noise == noise), "lower",
    )


# Reported without a floor.
OTHERS = (
    Measure(
        "answered", "all cases; an answer to the contract in time",
        share_of(lambda c: c.answer is not None, anyone),
    ),
    *(_noise_alarm(noise) for noise in ("white", "coloured", "drift")),
    Measure(
        "wrong parameters taken for an effect", "recalibration cases; alarms as above",
        share_of(lambda c: c.alarms, lambda c: c.label.kind == "recalibration"), "lower",
    ),
    Measure(
        "recalibration recognised", "recalibration cases; most probable candidate",
        share_of(lambda c: c.first_choice_right, lambda c: c.label.kind == "recalibration"),
    ),
    Measure(
        "effects seen as effects", "single, pair, outside with a gap above 2; alarms as above",
        share_of(
            lambda c: c.answer is not None and c.alarms,
            lambda c: detectable(c) and c.label.kind != "recalibration",
        ),
    ),
    Measure(
        "first choice right, distinguishable singles",
        "single effects that stand 5 standard deviations off every rival",
        share_of(lambda c: c.first_choice_right, distinguishable),
    ),
    Measure(
        "first choice right, all singles", "",
        share_of(lambda c: c.first_choice_right, single),
    ),
    Measure(
        "first choice in the right stage, all singles", "",
        share_of(lambda c: c.family_right, single),
    ),
    Measure(
        "probability given to the truth, distinguishable singles", "",
        lambda cases: mean([c.truth_probability for c in cases if distinguishable(c)]),
        style="number",
    ),
    Measure(
        "abstention", "all cases; verdict ambiguous or unexplained",
        share_of(lambda c: c.abstains, anyone), "lower",
    ),
    Measure(
        "calibration error", "most probable candidates; expected calibration error over ten bins",
        first_choice_calibration, "lower", "points",
    ),
    Measure("where: side", "effects with a gap above 2", place("side")),
    Measure("true shrinkage, median", "cases that claim one", true_shrinkage, style="points"),
    Measure(
        "claimed minus true shrinkage, median", "the same", shrinkage_bias, "inside", "points"
    ),
    Measure(
        "parameter error before, median", "root mean square over the stated parameters of "
        "(lab's - true)/stated standard deviation",
        parameter_error(0), "lower", "number",
    ),
    Measure(
        "parameter error after, median", "the same of the improved file",
        parameter_error(1), "lower", "number",
    ),
    Measure("time to answer, median", "", seconds(0.5), "lower", "seconds"),
    Measure("time to answer, 90th percentile", "", seconds(0.9), "lower", "seconds"),
)
