"""Every measure of the withheld-effect check: a number with its interval from judged cases."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import yaml
from numpy.typing import NDArray
from scipy import stats

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
    """One row of the result: the number `of` all judged cases, and what measures.yaml says of it;
    inside a band, floor and aim are (low, high)."""

    name: str
    of: Callable[[Cases], Measured]
    definition: str = ""
    better: Literal["higher", "lower", "inside"] = "higher"
    style: Literal["share", "number", "points", "seconds"] = "share"
    floor: Bound = None
    aim: Bound = None

    def reaches(self, value: float, bound: Bound) -> bool:
        """Whether a value is at least as good as a bound."""
        if bound is None or math.isnan(value):
            return False
        if isinstance(bound, tuple):
            return bound[0] <= value <= bound[1]
        return value >= bound if self.better == "higher" else value <= bound

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


def of_kind(*kinds: str, above: float = -math.inf) -> Callable[[Judged], bool]:
    """Cases of these kinds with a gap above so many noise standard deviations."""
    return lambda case: case.label.kind in kinds and case.label.severity > above


def claimed(value: Callable[[float, float], float], level: float = 0.5) -> Callable:
    """Quantile of a function of claimed and true fraction, of cases that claim one."""
    return lambda cases: quantile(
        [value(claim.fraction, true) for claim, true in (c.claim for c in cases if c.claim)], level
    )


def of_known(value: Callable[[Judged], float], level: float = 0.5) -> Callable:
    """Quantile of a number that some cases have not (NaN)."""
    return lambda cases: quantile([v for v in map(value, cases) if not math.isnan(v)], level)


def clean(case: Judged) -> bool:
    """Nothing is wrong."""
    return case.label.kind == "none" and not case.label.kinetics


def distinguishable(case: Judged) -> bool:
    """One effect, five standard deviations off every rival."""
    return case.label.kind == "single" and case.label.distinguishable


def shrinkage_coverage(cases: Cases) -> Measured:
    """Share of claimed 90 % intervals that hold the true fraction."""
    claims = [case.claim for case in cases if case.claim]
    return proportion([c.ci90[0] <= true <= c.ci90[1] for c, true in claims])


def first_choice_calibration(cases: Cases) -> Measured:
    """Calibration error of the most probable candidates' probabilities."""
    stated = [(c.first_choice.probability, c.first_choice_right) for c in cases if c.first_choice]
    return calibration_error([p for p, _ in stated], [right for _, right in stated])


single, pair, recalibration = of_kind("single"), of_kind("pair"), of_kind("recalibration")
_effects_seen = of_kind("single", "pair", "outside", above=DETECTABLE)
_single_seen = of_kind("single", above=DETECTABLE)
_detectable = of_kind("single", "pair", "outside", "recalibration", above=DETECTABLE)
_OF: dict[str, Callable[[Cases], Measured]] = {
    "detection of gaps above twice the noise": share_of(lambda c: c.says_gap, _detectable),
    "false alarms on no effect": share_of(lambda c: c.alarms, clean),
    "false alarms on benign kinetics mismatch": share_of(
        lambda c: c.alarms, lambda c: c.label.kind == "none" and c.label.kinetics),
    "first choice right, singles above twice the noise": share_of(
        lambda c: c.first_choice_right, _single_seen),
    "singles named and right": share_of(
        lambda c: c.verdict == "effect" and c.first_choice_right, _single_seen),
    "wrong parameters said as such, with the parameter": share_of(
        lambda c: c.verdict == "recalibration" and bool(c.moved & c.label.wrong),
        of_kind("recalibration", above=DETECTABLE)),
    "90 % set holds the truth": share_of(lambda c: c.set_holds_truth, lambda c: not pair(c)),
    "90 % set, mean size": lambda cases: mean(
        [float(len(c.credible_set)) for c in cases if c.answer]),
    "probability given to the truth": lambda cases: mean([c.truth_probability for c in cases]),
    "out-of-library: abstains or flags": share_of(
        lambda c: c.abstains_or_flags, of_kind("outside", above=DETECTABLE)),
    "confident and wrong": share_of(lambda c: c.confident_and_wrong, lambda c: True),
    "claimed against true shrinkage, median": claimed(lambda said, true: abs(said - true)),
    "claimed against true shrinkage, 90th percentile": claimed(
        lambda said, true: abs(said - true), 0.9),
    "90 % interval of shrinkage covers": shrinkage_coverage,
    "pairs: at least one": share_of(lambda c: bool(c.named & c.label.names), pair),
    "pairs: both": share_of(lambda c: c.label.names <= c.named, pair),
    **{f"where: {key}": share_of(
        lambda c, key=key: c.place_right(key), lambda c: _detectable(c) and bool(c.label.where))
       for key in ("signal", "phase", "stage", "side")},
    "of the ambiguous, settled rightly": share_of(lambda c: c.resolved, lambda c: c.followed),
    "answered": share_of(lambda c: c.answer is not None, lambda c: True),
    **{f"false alarms, {noise} noise": share_of(
        lambda c: c.alarms, lambda c, noise=noise: clean(c) and c.label.noise == noise)
       for noise in ("white", "coloured", "drift")},
    "wrong parameters taken for an effect": share_of(lambda c: c.alarms, recalibration),
    "recalibration recognised": share_of(lambda c: c.first_choice_right, recalibration),
    "effects seen as effects": share_of(
        lambda c: c.answer is not None and c.alarms, _effects_seen),
    "first choice right, distinguishable singles": share_of(
        lambda c: c.first_choice_right, distinguishable),
    "first choice right, all singles": share_of(lambda c: c.first_choice_right, single),
    "first choice in the right stage, all singles": share_of(lambda c: c.family_right, single),
    "probability given to the truth, distinguishable singles": lambda cases: mean(
        [c.truth_probability for c in cases if distinguishable(c)]),
    "abstention": share_of(lambda c: c.abstains, lambda c: True),
    "calibration error": first_choice_calibration,
    "true shrinkage, median": claimed(lambda _, true: true),
    "claimed minus true shrinkage, median": claimed(lambda said, true: said - true),
    "parameter error before, median": of_known(lambda c: c.parameter_error[0]),
    "parameter error after, median": of_known(lambda c: c.parameter_error[1]),
    "time to answer, median": of_known(lambda c: c.seconds),
    "time to answer, 90th percentile": of_known(lambda c: c.seconds, 0.9),
}  # fmt: skip


def _read() -> Iterator[tuple[Measure, ...]]:
    """Those with a floor and an aim, and those that are reported besides."""
    document = yaml.safe_load(Path(__file__).with_name("measures.yaml").read_text("utf-8"))
    for rows in document.values():
        yield tuple(
            Measure(name, _OF[name],
                    **{k: tuple(v) if isinstance(v, list) else v for k, v in row.items()})
            for name, row in rows.items()
        )  # fmt: skip


TARGETS, OTHERS = _read()
