"""Coloured noise of a residual as an autoregression, and its removal (prewhitening)."""

import math
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_toeplitz

from sma_bench.identify.estimate import Array

HIGHEST_ORDER = 20


@dataclass(frozen=True)
class Colour:
    """r[k] = sum_j coefficients[j] r[k-1-j] + innovation e[k], for a scaled residual r.

    `coefficients` (p,), empty for white noise; `innovation` and `scatter` are the standard
    deviations of e and of r.
    """

    coefficients: Array
    innovation: float
    scatter: float

    def whiten(self, values: Array) -> Array:
        """(n,) or (n, k) columns with the predictable part removed, of unit variance.

        The first p rows, which have no full past, keep theirs and count as white.
        """
        order = len(self.coefficients)
        if not order:
            return values / self.innovation
        from scipy.signal import lfilter  # half a second to load

        white = lfilter(np.concatenate([[1.0], -self.coefficients]), [1.0], values, axis=0)
        white = np.asarray(white) / self.innovation
        white[:order] = values[:order] / self.scatter
        return white


WHITE = Colour(np.zeros(0), 1.0, 1.0)


def estimate_colour(residual: Array) -> Colour:
    """Autoregression by Yule and Walker's equations, its order by the Bayesian criterion.

    Args:
        residual: (n,), already scaled to about unit variance; the scale goes into `innovation`.
    """
    n = len(residual)
    power = float(np.mean(residual**2))
    scatter = math.sqrt(power) or 1.0
    if n < 50 or power == 0.0:
        return Colour(np.zeros(0), scatter, scatter)
    limit = min(HIGHEST_ORDER, n // 20)
    covariance = np.array(
        [float(residual[: n - lag] @ residual[lag:]) / n for lag in range(limit + 1)]
    )
    best, chosen = n * math.log(power), Colour(np.zeros(0), scatter, scatter)
    for order in range(1, limit + 1):
        coefficients = solve_toeplitz(covariance[:order], covariance[1 : order + 1])
        variance = covariance[0] - float(coefficients @ covariance[1 : order + 1])
        criterion = n * math.log(max(variance, 1e-12 * power)) + order * math.log(n)
        if criterion < best:
            best, chosen = criterion, Colour(np.asarray(coefficients), math.sqrt(variance), scatter)
    return chosen


def white_noise_level(values: Array) -> float:
    """Standard deviation of what changes from sample to sample, quantisation included.

    From second differences, so that a smooth course drops out.

    Args:
        values: (n,) samples of one signal.
    """
    second = np.diff(values, 2)
    # The median of a coarsely quantised signal jumps by a step; clipped squares do not.
    robust = 1.4826 * float(np.median(np.abs(second)))
    limit = 5.0 * max(robust, float(np.sqrt(np.mean(second**2))) / 5.0)
    return float(np.sqrt(np.mean(np.minimum(second**2, limit**2)) / 6.0))
