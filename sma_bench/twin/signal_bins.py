"""Residuals of one signal in bins of time, and how far they may be off without a gap."""

from collections import deque
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky, solve_triangular, toeplitz
from scipy.stats import chi2

from sma_bench.estimation.noise_model import Noise, estimate_noise, resolution, white_noise_level

Array = NDArray[np.float64]

BIN = 0.2  # s, as the diagnosis has it
MEMORY = 350  # bins from which noise is learned, and which are judged by it
_SLOW = 30.0  # s that noise must be known for; a drift slower than that is not seen in less
_FAST = 3.0  # s; no faster one is granted unseen
_CHANCE = 0.01
_SAMPLES = 400  # samples from which the scatter of neighbours is taken
_FEWEST_SAMPLES = 20
# Of a sample: no bench is simulated, and no voltage known, to less.
_LEAST = {"current": 2e-3, "temperature": 0.02, "deflection": 5e-6, "force": 5e-3}
# Standard deviations; `./bench check twin_alarms` shows how often noise is as surprising.
SURPRISING = 5.5
STAYS = 0.75  # of the threshold: a gap is over below that
_MOST_WHITE = 2.0  # of the scatter of neighbours: a residual that scatters more is a gap


@dataclass(frozen=True)
class Bin:
    """Mean residual of a bin.

    `off`: what moments and zeros that are not known may add to it, one standard deviation, in the
    signal's unit; `cause`: what the residual is compared with, the signal's own prediction; `side`:
    number of the side it belongs to.
    """

    time: float
    residual: float
    count: int
    off: float
    cause: float
    side: int


@dataclass(frozen=True)
class Reading:
    """What the last bins of a signal say.

    Attributes:
        energy: mean square of the whitened residual, 1 for noise.
        surprise: standard deviations by which the energy or the level is beyond that of the noise
            before the window.
        gap: root mean square of the residual over the noise of a sample; per side, NaN where the
            signal was not on that side.
        noise: of the sensor, as learned; scatter: of a sample.
        residual, cause: (n,) of the bins; tolerance: (n,) in the signal's unit.
        share: residual over cause, least squares over all bins at hand, not just the last; NaN
            where the causes are no larger than the tolerance.
    """

    energy: float
    surprise: float
    gap: Array
    noise: Noise
    scatter: float
    residual: Array
    cause: Array
    tolerance: Array
    share: float


class SignalBins:
    """One signal: residuals come in as samples for their noise, and as bins to be judged."""

    def __init__(self, quantity: str, wire: int) -> None:
        """`quantity` is current, temperature, deflection or force; `wire` its number."""
        self.quantity, self.wire = quantity, wire
        self._values: deque[float] = deque(maxlen=_SAMPLES)
        self._residuals: deque[float] = deque(maxlen=_SAMPLES)
        self._bins: deque[Bin] = deque(maxlen=MEMORY)
        self._learned: Noise | None = None
        self._scatter: float | None = None  # None where samples came since

    def samples(self, value: Array, residual: Array) -> None:
        """Measured values (n,), and measured less predicted."""
        self._values.extend(value.tolist())
        self._residuals.extend(residual.tolist())
        self._scatter = None

    def add(self, one: Bin) -> None:
        """The next bin."""
        self._bins.append(one)

    def clear(self) -> None:
        """Forget the bins; the samples' noise stays."""
        self._bins.clear()
        self._learned = None

    @property
    def bins(self) -> int:
        """Bins at hand."""
        return len(self._bins)

    @property
    def samples_a_bin(self) -> int:
        """Of the newest bin, 0 before there is one."""
        return self._bins[-1].count if self._bins else 0

    @property
    def scatter(self) -> float:
        """Standard deviation from sample to sample, the converter's steps included; NaN before
        there are enough."""
        if len(self._values) < _FEWEST_SAMPLES:
            return np.nan
        if self._scatter is None:
            steps = resolution(np.array(self._values)) / np.sqrt(12.0)
            white = white_noise_level(np.array(self._residuals))
            self._scatter = float(max(white, steps, _LEAST[self.quantity]))
        return self._scatter

    def read(
        self, allowed: float, sides: int, fewest: int, window: float, threshold: float = np.inf
    ) -> Reading | None:
        """What the bins of the last `window` s say, None while there are too few.

        Args:
            allowed: slow drift that the sensor may have, in the signal's unit.
            sides: how many there are; fewest: bins that make a verdict.
            threshold: a surprising gap beyond it is not learned as noise.
        """
        scatter = self.scatter
        if len(self._bins) < fewest or np.isnan(scatter):
            return None
        columns = np.array([(b.time, b.residual, b.count, b.off, b.cause, b.side)
                            for b in self._bins])  # fmt: skip
        time, residual, count, off, cause, side = columns.T
        steady = np.hypot(scatter, allowed)
        # Bins in which the moment of a reading matters count as much as they tell.
        level = residual * steady / np.hypot(steady, off)
        last = slice(min(int(np.searchsorted(time, time[-1] - window)), len(time) - fewest), None)
        noise = self._learned
        if noise is None or noise.usual != allowed:
            noise = self._noise(level, time, count, last.start, scatter, allowed)
        tolerance = np.hypot(steady, off)
        squares = (residual / tolerance)[last] ** 2
        gap = np.full(sides, np.nan)
        for k in range(sides):
            here = side[last] == k
            if here.any():
                gap[k] = np.sqrt(squares[here].sum() / len(squares))
        power = float(cause @ cause)
        told = power > 0.1 * float(tolerance @ tolerance)
        energy, surprise = judge(noise, level[last])
        size = float(np.sqrt(np.mean(squares)))
        if self._learned is not None and size >= STAYS * threshold:
            surprise = max(surprise, SURPRISING)  # once it has come, it is there until it goes
        self._learned = noise if size >= threshold * STAYS and surprise >= SURPRISING else None
        return Reading(
            energy, surprise, gap, noise, scatter, residual[last], cause[last], tolerance[last],
            float(residual @ cause) / power if told else np.nan,
        )

    @staticmethod
    def _noise(
        level: Array, time: Array, count: Array, stop: int, scatter: float, allowed: float
    ) -> Noise:
        """Noise that the bins up to `stop` show, but no more than a sensor may have; as much while
        they are too few to tell."""
        white = scatter / float(np.sqrt(np.median(count)))
        period = max(round(float(np.median(np.diff(time))), 2), 0.01)
        if stop < 2:
            return Noise(white, allowed, _FAST, period, allowed)
        found = estimate_noise([level[:stop]], white, period, allowed)
        # As fast as it was seen to go, and as far as it may: nobody has seen that within a minute.
        share = allowed / max(found.drift, 1e-3 * allowed)
        seen = max(share**2 * found.time, period)
        # So few bins may have shown a slower one by chance.
        surely = seen * float(chi2.ppf(_CHANCE, stop)) / stop
        return Noise(
            min(found.white, _MOST_WHITE * white), allowed, min(seen, max(surely, _FAST)),
            period, allowed,
        )  # fmt: skip


def judge(noise: Noise, level: Array) -> tuple[float, float]:
    """Energy of the whitened level (n,), and how surprising it is as noise."""
    white, ones = _whitened(noise, level)
    energy = float(np.mean(white**2))
    # Wilson and Hilferty's cube root: the tail of chi squared is not that of a Gaussian.
    spread = 2.0 / (9.0 * len(level))
    from_energy = (float(np.cbrt(energy)) - 1.0 + spread) / float(np.sqrt(spread))
    # That a drift goes to and fro about zero, half a minute does not show.
    if noise.time < _SLOW:
        white, ones = _whitened(replace(noise, time=_SLOW), level)
    from_level = abs(float(ones @ white)) / float(np.sqrt(ones @ ones))
    return energy, max(from_energy, from_level)


def _whitened(noise: Noise, level: Array) -> Array:
    """The level (n,) and ones, each with the noise as unit variance; exact from the first bin on,
    unlike the recursion that whitens long records."""
    lags = np.arange(len(level)) * (noise.period / noise.time)
    covariance = toeplitz(noise.drift**2 * np.exp(-lags))
    covariance[np.diag_indices_from(covariance)] += noise.white**2
    both = np.column_stack([level, np.ones(len(level))])
    return np.asarray(solve_triangular(cholesky(covariance, lower=True), both, lower=True).T)
