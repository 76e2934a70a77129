"""Noise of a signal: white noise of the samples plus a slow drift, and how to whiten it; and what
samples alone show: their scatter, the step of a converter, the error of a mean.

    r_k = u_k + w_k,   u_k = phi u_(k-1) + v_k,   phi = exp(-dt/tau)

As an innovations process this is ARMA(1,1): (1 - phi B) r = (1 + theta B) e, so whitening is one
short recursion (Box, Jenkins and Reinsel, Time Series Analysis, ch. 3)."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solveh_banded

from sma_bench.arrays import Array
from sma_bench.compiled import compiled

_TIMES = np.geomspace(0.3, 200.0, 8)  # s, of drift, that are tried
_SLOW = 3.0  # s: the prior on the size of a drift holds for slower ones
_WANDERING = 25.0  # s: a wandering zero is slower
_UNUSUAL = 0.35  # standard deviation of log(drift/usual)
_RATIOS = np.geomspace(0.1, 100.0, 13)  # drift over white, that are tried
_FEW_LEVELS = 0.2  # of the samples: with more distinct values a signal counts as continuous
_OFTEN, _EXACT = 0.01, 0.01  # least share of moves by one step; of the smallest gap: rounding
_HARMONICS = 50  # of a converter's error
_MOST_LAGS = 200  # of correlated noise


@dataclass(frozen=True)
class Noise:
    """White level of a bin of one signal, in its unit, and drift, the standard deviation of u, with
    `time` tau [s] and `period` s between bins. A slow drift larger than the `usual` of an
    instrument costs probability, unless the sensor's zero is taken to wander (`wanders`)."""

    white: float
    drift: float
    time: float
    period: float
    usual: float = np.inf
    wanders: bool = False

    @property
    def log_prior(self) -> float:
        """Log prior of the drift; 0 up to the usual size."""
        return float(_log_prior(self.drift, self.time, self.usual, self.wanders))

    def drift_in(self, residual: Array) -> Array:
        """Most probable drift u (b,) in a residual (b,)."""
        if self.drift == 0.0:
            return np.zeros_like(residual)
        if len(residual) < 2:  # no off-diagonal
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
        return math.hypot(self.white, self.drift)

    def whiten(self, columns: Array) -> Array:
        return whiten(columns, [len(columns)], [self])

    @cached_property
    def arma(self) -> tuple[float, float, float]:
        """phi, theta and the standard deviation of the innovations."""
        phi = float(np.exp(-self.period / self.time))
        driven = self.drift**2 * (1.0 - phi**2)
        variance = (1.0 + phi**2) * self.white**2 + driven
        lagged = -phi * self.white**2
        power = 0.5 * (variance + np.sqrt(max(variance**2 - 4.0 * lagged**2, 0.0)))
        return phi, lagged / power, float(np.sqrt(power))

    def log_scale(self, bins: int) -> float:
        """Log of the whitening's determinant, inverted."""
        return (bins - 1) * float(np.log(self.arma[2])) + float(np.log(self.total))


def _log_prior(drift: Array | float, time: Array | float, usual: float, wanders: bool) -> Array:
    excess = np.log(np.maximum(np.asarray(drift) / usual, 1.0)) / _UNUSUAL
    seconds = np.asarray(time)
    free = (seconds < _SLOW) | (wanders & (seconds > _WANDERING))
    return np.asarray(np.where(free, 0.0, -0.5 * excess**2))


def first_guess(white: float, period: float, usual: float = np.inf) -> Noise:
    """Noise before any fit, with a generous drift."""
    return Noise(white, 3.0 * white, 5.0, period, usual)


def estimate_noise(residuals: Sequence[Array], white: float, period: float, usual: float = np.inf,
                   wanders: bool = False) -> Noise:
    """Most likely noise of one sensor from its residuals (b_i,), one a record. The white level is
    at least 0.9 `white`, a bin's noise from the scatter of its samples, which no fit can lower. A
    slow drift of many times the `usual` is improbable: it may be the bench itself."""
    shapes, (drifts, times), whitening = _shapes(period)
    powers = np.zeros(len(shapes))
    for residual in residuals:
        _add_powers(np.ascontiguousarray(residual), *whitening, powers)
    total = sum(len(r) for r in residuals)
    scales = np.maximum(np.sqrt(powers / total), 0.9 * white)
    _, _, inverse, first = whitening
    bulk = (len(residuals) - total) * np.log(inverse) - len(residuals) * np.log(first)
    likelihood = -0.5 * powers / scales**2 - total * np.log(scales) - bulk
    likelihood += _log_prior(scales * drifts, times, usual, wanders)
    best = int(np.argmax(likelihood))
    scale, shape = float(scales[best]), shapes[best]
    return Noise(scale, shape.drift * scale, shape.time, period, usual, wanders)


@cache
def _shapes(period: float) -> tuple[tuple[Noise, ...], Array, tuple[Array, ...]]:
    """Noises of white level 1 to try; drift and time of each; arguments of `_add_powers`."""
    drifting = (Noise(1.0, float(r), float(tau), period) for r in _RATIOS for tau in _TIMES)
    shapes = (Noise(1.0, 0.0, float(_TIMES[0]), period), *drifting)
    phi, theta, innovation, total = np.array([(*s.arma, s.total) for s in shapes]).T
    whitening = phi.copy(), theta.copy(), 1.0 / innovation, 1.0 / total
    return shapes, np.array([(s.drift, s.time) for s in shapes]).T, whitening


def whiten(rows: Array, bins: Sequence[int], noises: Sequence[Noise]) -> Array:
    """Rows (n,) or (n, k), made independent with unit variance; `bins`: rows of each noise."""
    white = np.array(rows, dtype=np.float64, order="C")
    numbers = np.array([(*noise.arma, noise.total) for noise in noises]).reshape(-1, 4)
    _whiten(white.reshape(len(white), -1), np.array(bins), numbers)
    return white


@compiled
def _whiten(columns: Array, bins: NDArray[np.int64], noises: Array) -> None:
    """Write ARMA(1,1) innovations over the columns (n, k); noises (m, 4): phi, theta, standard
    deviations of the innovations and of the first sample."""
    i = 0
    for number in range(bins.shape[0]):
        phi, theta, scale = noises[number, 0], noises[number, 1], 1.0 / noises[number, 3]
        before, white = np.zeros(columns.shape[1]), np.zeros(columns.shape[1])
        for _ in range(bins[number]):
            for k in range(columns.shape[1]):
                white[k] = columns[i, k] - phi * before[k] - theta * white[k]
                before[k] = columns[i, k]
                columns[i, k] = white[k] * scale
            scale = 1.0 / noises[number, 2]
            i += 1


@compiled
def _add_powers(residual: Array, phi: Array, theta: Array, scale: Array, first: Array,
                powers: Array) -> None:
    """Add the power of the whitened residual (b,) under each noise (m,) to `powers` (m,)."""
    innovation = np.full(phi.shape[0], residual[0])
    power = (innovation * first) ** 2
    for i in range(1, residual.shape[0]):
        for k in range(phi.shape[0]):
            innovation[k] = residual[i] - phi[k] * residual[i - 1] - theta[k] * innovation[k]
            power[k] += (innovation[k] * scale[k]) ** 2
    powers += power


def scatter(values: Array) -> float:
    """Standard deviation of points (n,) about a smooth curve, by the median second difference."""
    return 1.4826 * float(np.median(np.abs(np.diff(values, 2)))) / math.sqrt(6.0)


def white_noise_level(values: Array) -> float:
    """Standard deviation of the noise between samples of a signal (n,), quantisation included:
    from second differences, in which a smooth signal cancels."""
    second = np.diff(values, 2)
    # The median of a coarsely quantised signal jumps by a step; clipped squares do not.
    robust = 1.4826 * float(np.median(np.abs(second)))
    limit = 5.0 * max(robust, float(np.sqrt(np.mean(second**2))) / 5.0)
    return float(np.sqrt(np.mean(np.minimum(second**2, limit**2)) / 6.0))


def noise_floor(values: Array) -> float:
    """White noise of a sample of a signal (n,), at least that of its converter; never 0."""
    floor = max(white_noise_level(values), resolution(values) / np.sqrt(12.0))
    return float(floor) or 1e-6 * max(float(np.ptp(values)), 1e-12)


def resolution(values: Array) -> float:
    """Step of a quantised signal (n,) in its own unit; 0 when none is found.

    All distinct values lie whole multiples of the step apart. If the step is just the distance of
    the closest two levels, it counts only if samples often move by exactly one step."""
    levels = np.unique(np.round(values, 9))
    if len(levels) < 2 or len(levels) > _FEW_LEVELS * len(values):
        return 0.0
    gaps = np.diff(levels)
    # Greatest common divisor of measured gaps (Euclid), 0 if it is as small as rounding.
    smallest, step = _EXACT * float(gaps.min()), float(gaps[0])
    for gap in np.unique(np.round(gaps, 9)):
        a, b = max(step, float(gap)), min(step, float(gap))
        while b > smallest:
            rest = a % b
            # A remainder just below the divisor is rounding, not a remainder.
            a, b = b, 0.0 if b - rest < smallest else rest
        step = a
    step = step if step > 2.0 * smallest else 0.0
    if step == 0.0 or step < 0.4 * float(gaps.min()):
        return step
    single = np.abs(np.abs(np.diff(values)) - step) < 0.1 * step
    return step if float(np.mean(single)) > _OFTEN else 0.0


def coherence(inputs: Array, step: float, shape: Array | float = 1.0) -> Array:
    """(50,) share of each harmonic of a converter's error that is left in the mean over `inputs`
    (n,) times `shape`: 1 for a constant input, 0 for one spread evenly over whole steps."""
    k = np.arange(1, _HARMONICS + 1)
    turns = np.exp(2j * np.pi * np.outer(k, inputs / step))
    return np.asarray(np.abs(np.mean(shape * turns, axis=1)))


def quantisation_variance(scatter: float, step: float, left: Array | float = 1.0) -> float:
    """Variance of the mean's error that averaging cannot remove, in the signal's unit squared.

    Noise of standard deviation s before a converter of step q smooths its staircase; the error that
    the mean keeps has variance sum_k q^2/(2 pi^2 k^2) exp(-4 pi^2 k^2 s^2/q^2), which is
    q^2/12 without noise (Widrow and Kollar, Quantization Noise, 2008, ch. 9). `scatter`: standard
    deviation of the samples as recorded, with quantisation; `step`: q, 0 for a continuous
    signal; `left`: from `coherence`, for a moving input."""
    if step <= 0.0:
        return 0.0
    before = max(scatter**2 - step**2 / 12.0, 0.0)
    k = np.arange(1, _HARMONICS + 1)
    decay = np.exp(-4.0 * np.pi**2 * k**2 * before / step**2)
    return float(np.sum(step**2 / (2.0 * np.pi**2 * k**2) * decay * np.square(left)))


def inflation(residuals: Sequence[Array]) -> float:
    """Factor 1 + 2 sum rho by which coloured noise enlarges the variance of a mean (>= 1), from
    stretches (n_i,) of one noise process. The correlations rho are cut at the first lag below twice
    its own standard error (Geyer's initial positive sequence, made stricter)."""
    usable = [r - r.mean() for r in residuals if len(r) > 3]
    total = sum(len(r) for r in usable)
    power = sum(float(r @ r) for r in usable)
    if total == 0 or power == 0.0:
        return 1.0
    found = [1.0]
    for lag in range(1, min(_MOST_LAGS, max(len(r) for r in usable) // 3) + 1):
        pairs = [(r[:-lag], r[lag:]) for r in usable if len(r) > lag]
        count = sum(len(a) for a, _ in pairs)
        value = sum(float(a @ b) for a, b in pairs) / power * total / count
        if value < 2.0 / math.sqrt(count):
            break
        found.append(value)
    return float(2.0 * np.sum(found) - 1.0)
