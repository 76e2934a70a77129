"""Every measure of the withheld-effect check: a number with its interval from judged cases."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
import yaml
from numpy.typing import NDArray
from scipy import stats

from examination.blind.judgement import Judged, Label

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


# --- One row of the result.

Cases = Sequence[Judged]
Bound = float | tuple[float, float] | None
_STATISTICS: dict[str, Callable[[list], Measured]] = {
    "share": proportion,
    "mean": mean,
    "median": lambda values: quantile(values, 0.5),
    "90th percentile": lambda values: quantile(values, 0.9),
    "calibration": lambda pairs: calibration_error([p for p, _ in pairs], [r for _, r in pairs]),
}


@dataclass(frozen=True)
class Measure:
    """What measures.yaml says of it; inside a band, floor and aim are (low, high)."""

    name: str
    what: tuple[str, ...]
    among: Mapping[str, Any] = field(default_factory=dict, hash=False)
    definition: str = ""
    better: Literal["higher", "lower", "inside"] = "higher"
    style: Literal["share", "number", "points", "seconds"] = "share"
    floor: Bound = None
    aim: Bound = None

    @property
    def title(self) -> str:
        """Of a row, with its unit."""
        return self.name + (" (points)" if self.style == "points" else "")

    def of(self, cases: Cases) -> Measured:
        """The number of those judged cases that it is among."""
        statistic, name, *arguments = self.what
        found = [getattr(case, name) for case in cases if self._counts(case.label)]
        values = [value(*arguments) if arguments else value for value in found]
        return _STATISTICS[statistic]([v for v in values if v is not None and v == v])

    def _counts(self, label: Label) -> bool:
        if label.kind not in self.among.get("kinds", (label.kind,)):
            return False
        wanted = self.among.get("label", {}).items()
        above = label.severity > self.among.get("above", -math.inf)
        return above and all(getattr(label, name) == value for name, value in wanted)

    def met(self, measured: Measured) -> str:
        """`aim`, `floor` or `missed` by the value itself; "" without cases or floor."""
        if self.floor is None or not measured.n:
            return ""
        if self._reaches(measured.value, self.aim):
            return "aim"
        return "floor" if self._reaches(measured.value, self.floor) else "missed"

    def _reaches(self, value: float, bound: Bound) -> bool:
        if bound is None or math.isnan(value):
            return False
        if isinstance(bound, tuple):
            return bound[0] <= value <= bound[1]
        return value >= bound if self.better == "higher" else value <= bound


def _read() -> Iterator[tuple[Measure, ...]]:
    """Those with a floor and an aim, those that are reported besides, and those of groups."""
    document = yaml.safe_load(Path(__file__).with_name("measures.yaml").read_text("utf-8"))
    for rows in document.values():
        listed = {
            name: {k: tuple(v) if isinstance(v, list) else v for k, v in row.items()}
            for name, row in rows.items()
        }
        yield tuple(Measure(name, row.pop("of"), **row) for name, row in listed.items())


TARGETS, OTHERS, OF_GROUPS = _read()
