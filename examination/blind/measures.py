"""Every measure of the withheld-effect check: a number with its interval from judged cases."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from examination.blind.case_files import Claim
from examination.blind.judgement import Judged

Array = NDArray[np.float64]

# --- Intervals of what was counted and measured over a limited number of cases.

CONFIDENCE = 0.95
_BOOTSTRAP = {"n_resamples": 2000, "method": "percentile", "confidence_level": CONFIDENCE}
_SEED = 20240229


@dataclass(frozen=True)
class Measured:
    """A value with its 95 % interval over `n` cases; `hits` of a proportion."""

    value: float
    low: float
    high: float
    n: int
    hits: int | None = None


NOTHING = Measured(math.nan, math.nan, math.nan, 0)


def proportion(outcomes: Sequence[bool]) -> Measured:
    """Share of True with its exact interval (Clopper and Pearson)."""
    if not outcomes:
        return NOTHING
    hits, n = sum(map(bool, outcomes)), len(outcomes)
    low, high = stats.binomtest(hits, n).proportion_ci(CONFIDENCE, method="exact")
    return Measured(hits / n, float(low), float(high), n, hits)


def mean(values: Sequence[float]) -> Measured:
    """Mean with a percentile bootstrap interval; the same values give the same interval."""
    return _bootstrapped(lambda x, axis=-1: np.mean(x, axis=axis), values)


def quantile(values: Sequence[float], level: float) -> Measured:
    """Quantile with the interval between two order statistics, free of any distribution; infinite
    where the values are too few for a bound."""
    if not values:
        return NOTHING
    value = float(np.quantile(values, level))
    found = stats.quantile_test(values, q=value, p=level).confidence_interval(CONFIDENCE)
    low, high = (-math.inf if math.isnan(found.low) else float(found.low),
                 math.inf if math.isnan(found.high) else float(found.high))  # fmt: skip
    return Measured(value, low, high, len(values))


def calibration_error(stated: Sequence[float], right: Sequence[bool], bins: int = 10) -> Measured:
    """Expected calibration error: mean distance of stated probability and frequency over bins.

    sum_b n_b/n |mean stated in b - share right in b| (Naeini et al., AAAI 2015), with a bootstrap
    interval over cases.
    """

    def error(probability: Array, hit: Array) -> float:
        sums = np.bincount(bin_of(probability, bins), weights=probability - hit)
        return float(np.abs(sums).sum() / len(hit))

    return _bootstrapped(error, stated, [float(r) for r in right])


def bin_of(probability: Array, bins: int) -> NDArray[np.intp]:
    """Number of the equally wide bin that a probability falls into; 1 belongs to the last."""
    return np.minimum((np.asarray(probability) * bins).astype(np.intp), bins - 1)


def _bootstrapped(statistic: Callable[..., float], *data: Sequence[float]) -> Measured:
    n = len(data[0])
    if not n:
        return NOTHING
    columns = tuple(np.asarray(column, dtype=float) for column in data)
    value = float(statistic(*columns))
    if n == 1 or all(np.ptp(column) == 0.0 for column in columns):  # nothing to resample
        return Measured(value, value, value, n)
    found = stats.bootstrap(
        columns, statistic, paired=True, random_state=np.random.default_rng(_SEED), **_BOOTSTRAP
    ).confidence_interval
    return Measured(value, float(found.low), float(found.high), n)


# --- Which cases a measure is over.
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


def of_kind(*kinds: str) -> Callable[[Judged], bool]:
    """Whatever their gap."""
    return lambda case: case.label.kind in kinds


def seen(*kinds: str) -> Callable[[Judged], bool]:
    """With a gap above twice the noise."""
    return lambda case: case.label.kind in kinds and case.label.severity > DETECTABLE


def clean(case: Judged) -> bool:
    """Nothing is wrong."""
    return case.label.kind == "none" and not case.label.kinetics


def kinetics(case: Judged) -> bool:
    """Nothing is wrong but mildly different kinetics."""
    return case.label.kind == "none" and case.label.kinetics


def distinguishable(case: Judged) -> bool:
    """One effect, five standard deviations off every rival."""
    return case.label.kind == "single" and case.label.distinguishable


def placed(case: Judged) -> bool:
    """Detectable, and the label says where."""
    return detectable(case) and bool(case.label.where)


def anyone(_: Judged) -> bool:
    """Every case."""
    return True


EFFECT_KINDS = ("single", "pair", "outside")
single, pair = of_kind("single"), of_kind("pair")
detectable = seen(*EFFECT_KINDS, "recalibration")


def place(key: str) -> Callable[[Cases], Measured]:
    """Share of `placed` cases whose signal, phase, side or stage is right."""
    return share_of(lambda c: c.place_right(key), placed)


def _claims(cases: Cases) -> list[tuple[Claim, float]]:
    """Claim and true fraction of every case that claims to shrink a gap that is there."""
    return [case.claim for case in cases if case.claim]


def claimed(value: Callable[[float, float], float], level: float = 0.5) -> Callable:
    """Quantile of a function of claimed and true fraction."""
    return lambda cases: quantile([value(c.fraction, true) for c, true in _claims(cases)], level)


def shrinkage_coverage(cases: Cases) -> Measured:
    """Share of claimed 90 % intervals that hold the true fraction."""
    return proportion([c.ci90[0] <= true <= c.ci90[1] for c, true in _claims(cases)])


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
        share_of(lambda c: c.first_choice_right, seen("single")), floor=0.90, aim=0.95,
    ),
    Measure(
        "singles named and right", "the same; the verdict is `effect`, too",
        share_of(lambda c: c.verdict == "effect" and c.first_choice_right, seen("single")),
        floor=0.80, aim=0.90,
    ),
    Measure(
        "wrong parameters said as such, with the parameter",
        "parameters 2.5 to 5 stated deviations off and no effect, gap above 2; verdict "
        "recalibration, and the improved file has one of them 2 deviations or more from where it "
        "was believed",
        share_of(lambda c: c.verdict == "recalibration" and bool(c.moved & c.label.wrong),
                 seen("recalibration")), floor=0.70, aim=0.85,
    ),
    Measure(
        "90 % set holds the truth",
        "all cases but pairs; the fewest candidates that make 90 % have the truth among them",
        share_of(lambda c: c.set_holds_truth, lambda c: not pair(c)), floor=0.90, aim=0.92,
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
        share_of(lambda c: c.abstains_or_flags, seen("outside")), floor=0.90, aim=0.97,
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
        claimed(lambda said, true: abs(said - true)), "lower", "points", floor=0.01, aim=0.005,
    ),
    Measure(
        "claimed against true shrinkage, 90th percentile", "the same",
        claimed(lambda said, true: abs(said - true), 0.9), "lower", "points", floor=0.07, aim=0.04,
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
        share_of(lambda c: c.alarms, of_kind("recalibration")), "lower",
    ),
    Measure(
        "recalibration recognised", "recalibration cases; most probable candidate",
        share_of(lambda c: c.first_choice_right, of_kind("recalibration")),
    ),
    Measure(
        "effects seen as effects", "single, pair, outside with a gap above 2; alarms as above",
        share_of(
            lambda c: c.answer is not None and c.alarms,
            seen(*EFFECT_KINDS),
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
    Measure(
        "true shrinkage, median", "cases that claim one", claimed(lambda _, true: true),
        style="points",
    ),
    Measure(
        "claimed minus true shrinkage, median", "the same",
        claimed(lambda said, true: said - true), "inside", "points",
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
