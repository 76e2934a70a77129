"""Intervals of what was counted and measured over a limited number of cases."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats

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
