"""How sure a mean is: coloured noise, and what a converter's steps hide."""

import math
from collections.abc import Sequence

import numpy as np

from sma_bench.identify.estimate import Array

_FEW_LEVELS = 0.2
_OFTEN = 0.01
_EXACT = 0.01
_HARMONICS = 50


def resolution(values: Array) -> float:
    """Step of a quantised signal in its own unit; 0 when none is seen.

    The step is what all distinct values are whole multiples apart. A quiet signal at a few levels
    shows the levels' spacing only: that counts as a step if samples often move by just one of it,
    or if it is finer than the closest two levels.

    Args:
        values: (n,) samples.
    """
    levels = np.unique(np.round(values, 9))
    if len(levels) < 2 or len(levels) > _FEW_LEVELS * len(values):
        return 0.0
    gaps = np.diff(levels)
    step = _common_step(gaps)
    if step == 0.0 or step < 0.4 * float(gaps.min()):
        return step
    single = np.abs(np.abs(np.diff(values)) - step) < 0.1 * step
    return step if float(np.mean(single)) > _OFTEN else 0.0


def _common_step(gaps: Array) -> float:
    """Greatest common divisor of measured gaps (Euclid), 0 where there is none to speak of."""
    smallest = _EXACT * float(gaps.min())
    step = float(gaps[0])
    for gap in np.unique(np.round(gaps, 9)):
        a, b = max(step, float(gap)), min(step, float(gap))
        while b > smallest:
            rest = a % b
            # A remainder just below the divisor is rounding, not a remainder.
            a, b = b, 0.0 if b - rest < smallest else rest
        step = a
    return step if step > 2.0 * smallest else 0.0


def quantisation_variance(scatter: float, step: float) -> float:
    """Variance of the mean's error that averaging cannot remove, in the signal's unit squared.

    Noise of standard deviation s before a converter of step q smooths its staircase; what is left
    of the mean's error has variance sum_k q^2/(2 pi^2 k^2) exp(-4 pi^2 k^2 s^2/q^2), which is
    q^2/12 without noise (Widrow and Kollar, Quantization Noise, 2008, ch. 9).

    Args:
        scatter: standard deviation of the samples as recorded, so including the quantisation.
        step: the converter's step; 0 for a continuous signal.
    """
    if step <= 0.0:
        return 0.0
    before = max(scatter**2 - step**2 / 12.0, 0.0)
    k = np.arange(1, _HARMONICS + 1)
    decay = np.exp(-4.0 * np.pi**2 * k**2 * before / step**2)
    return float(np.sum(step**2 / (2.0 * np.pi**2 * k**2) * decay))


def autocorrelation(residuals: Sequence[Array], longest: int = 200) -> Array:
    """Autocorrelation of stretches of one noise process, cut where it is no longer seen.

    Args:
        residuals: stretches (n_i,), each without gaps worth mentioning.

    Returns:
        (m,) correlations at lags 0 .. m-1; [1.] for white noise. The sum is cut at the first lag
        below twice its own standard error (Geyer's initial positive sequence, made stricter).
    """
    usable = [r - r.mean() for r in residuals if len(r) > 3]
    total = sum(len(r) for r in usable)
    power = sum(float(r @ r) for r in usable)
    if total == 0 or power == 0.0:
        return np.ones(1)
    found = [1.0]
    for lag in range(1, min(longest, max(len(r) for r in usable) // 3) + 1):
        pairs = [(r[:-lag], r[lag:]) for r in usable if len(r) > lag]
        count = sum(len(a) for a, _ in pairs)
        value = sum(float(a @ b) for a, b in pairs) / power * total / count
        if value < 2.0 / math.sqrt(count):
            break
        found.append(value)
    return np.array(found)


def inflation(correlation: Array) -> float:
    """Factor 1 + 2 sum rho by which coloured noise enlarges the variance of a mean (>= 1)."""
    return float(max(1.0, 2.0 * np.sum(correlation) - 1.0))
