"""Noise of a signal: white noise of the samples plus a slow drift, and how to whiten it.

    r_k = u_k + w_k,   u_k = phi u_(k-1) + v_k,   phi = exp(-dt/tau)

As an innovations process this is ARMA(1,1): (1 - phi B) r = (1 + theta B) e, so whitening is one
short recursion (Box, Jenkins and Reinsel, Time Series Analysis, ch. 3).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solveh_banded
from scipy.signal import lfilter

from sma_bench.compiled import compiled

Array = NDArray[np.float64]

_TIMES = np.geomspace(0.3, 200.0, 8)  # s
_SLOW = 3.0  # s: drift of a longer time than that must be of the usual size
_WANDERING = 25.0  # s: no faster is a zero that wanders
_UNUSUAL = 0.35  # standard deviation of the log of an unusual drift
_RATIOS = np.concatenate([[0.0], np.geomspace(0.1, 100.0, 13)])  # drift over white


@dataclass(frozen=True)
class Noise:
    """White level and drift of one signal.

    Attributes:
        white: of a bin, in the signal's unit; drift: standard deviation of u; time: tau [s].
        period: s between bins.
        usual: the drift that an instrument may have; a larger slow one costs probability.
        wanders: the sensor's zero is taken to wander, which then costs nothing.
    """

    white: float
    drift: float
    time: float
    period: float
    usual: float = np.inf
    wanders: bool = False

    @property
    def log_prior(self) -> float:
        """Log of how probable such a drift is of a sensor; 0 up to the usual one."""
        return float(_log_prior(self.drift, self.time, self.usual, self.wanders))

    def drift_in(self, residual: Array) -> Array:
        """Most probable u (b,) in a residual (b,): what is slow of it."""
        if self.drift == 0.0:
            return np.zeros_like(residual)
        if len(residual) < 2:  # no band beside the diagonal
            return residual * (self.drift**2 / (self.drift**2 + self.white**2))
        phi = np.exp(-self.period / self.time)
        driven = self.drift**2 * (1.0 - phi**2)
        diagonal = np.full(len(residual), (1.0 + phi**2) / driven)
        diagonal[[0, -1]] = 1.0 / driven
        bands = np.zeros((2, len(residual)))
        bands[0, 1:], bands[1] = -phi / driven, diagonal + 1.0 / self.white**2
        return np.asarray(solveh_banded(bands, residual / self.white**2))

    @property
    def total(self) -> float:
        """Standard deviation of the noise of a bin."""
        return float(np.hypot(self.white, self.drift))

    @property
    def innovation(self) -> float:
        """Standard deviation of what the past does not tell."""
        return self.arma[2]

    def whiten(self, columns: Array) -> Array:
        """Residuals or derivatives (b,) or (b, k) as independent ones of unit variance."""
        phi, theta, innovation = self.arma
        white = lfilter([1.0, -phi], [1.0, theta], columns, axis=0) / innovation
        white[0] *= innovation / self.total
        return np.asarray(white)

    @cached_property
    def arma(self) -> tuple[float, float, float]:
        """phi, theta and the standard deviation of the innovations."""
        phi = float(np.exp(-self.period / self.time))
        driven = self.drift**2 * (1.0 - phi**2)
        variance = (1.0 + phi**2) * self.white**2 + driven
        lagged = -phi * self.white**2
        power = 0.5 * (variance + np.sqrt(max(variance**2 - 4.0 * lagged**2, 0.0)))
        return phi, lagged / power, float(np.sqrt(power))

    def log_likelihood(self, residual: Array) -> float:
        """log p of a residual (b,), without the constant."""
        white = self.whiten(residual)
        return float(-0.5 * white @ white) - self.log_scale(len(residual))

    def log_scale(self, bins: int) -> float:
        """log of the whitening's determinant, inverted."""
        return (bins - 1) * float(np.log(self.innovation)) + float(np.log(self.total))


def _log_prior(
    drift: Array | float, time: Array | float, usual: float, wanders: bool
) -> Array:
    excess = np.log(np.maximum(np.asarray(drift) / usual, 1.0)) / _UNUSUAL
    seconds = np.asarray(time)
    free = (seconds < _SLOW) | (wanders & (seconds > _WANDERING))
    return np.asarray(np.where(free, 0.0, -0.5 * excess**2))


def first_guess(white: float, period: float, usual: float = np.inf) -> Noise:
    """Noise before anything has been fitted: generous with drift."""
    return Noise(white, 3.0 * white, 5.0, period, usual)


def estimate_noise(
    residuals: Sequence[Array],
    white: float,
    period: float,
    usual: float = np.inf,
    wanders: bool = False,
) -> Noise:
    """Most likely noise of what a fit leaves; the white part is at least nearly `white`.

    Args:
        residuals: (b_i,) one a record, of the same sensor.
        white: noise of a bin from sample to sample, which no fit can lower.
        usual, wanders: of `Noise`. A sensor that wanders slowly by many times that is not
            noisy, it is faulty, and what it seems to do may be the bench's doing.
    """
    shapes = _shapes(period)
    powers = np.zeros(len(shapes))
    for residual in residuals:
        _add_powers(np.ascontiguousarray(residual), *_recursions(shapes), powers)
    total = sum(len(r) for r in residuals)
    scales = np.maximum(np.sqrt(powers / total), 0.9 * white)
    bulk = np.array([sum(shape.log_scale(len(r)) for r in residuals) for shape in shapes])
    likelihood = -0.5 * powers / scales**2 - total * np.log(scales) - bulk
    drifts = scales * np.array([shape.drift for shape in shapes])
    times = np.array([shape.time for shape in shapes])
    likelihood += _log_prior(drifts, times, usual, wanders)
    best = int(np.argmax(likelihood))
    scale, shape = float(scales[best]), shapes[best]
    return Noise(scale, shape.drift * scale, shape.time, period, usual, wanders)


@cache
def _shapes(period: float) -> tuple[Noise, ...]:
    """Noises of white level 1 that are tried."""
    drifting = (
        Noise(1.0, float(ratio), float(tau), period) for ratio in _RATIOS[1:] for tau in _TIMES
    )
    return Noise(1.0, 0.0, float(_TIMES[0]), period), *drifting


@cache
def _recursions(shapes: tuple[Noise, ...]) -> tuple[Array, Array, Array, Array]:
    """phi, theta, 1/innovation and the first sample's factor of each."""
    rows = [(*shape.arma, shape.total) for shape in shapes]
    phi, theta, innovation, total = np.array(rows).T
    return phi.copy(), theta.copy(), 1.0 / innovation, 1.0 / total


@compiled
def _add_powers(
    residual: Array, phi: Array, theta: Array, scale: Array, first: Array, powers: Array
) -> None:
    """Add the power of the whitened residual (b,) under each noise (m,) to `powers` (m,)."""
    for k in range(phi.shape[0]):
        before, innovation = residual[0], residual[0]
        power = (before * first[k]) ** 2
        for i in range(1, residual.shape[0]):
            innovation = residual[i] - phi[k] * before - theta[k] * innovation
            before = residual[i]
            power += (innovation * scale[k]) ** 2
        powers[k] += power
