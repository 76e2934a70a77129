"""Residuals of one signal in bins of time, and how far they may be off without a gap."""

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sma_bench.estimation.noise_model import Noise, estimate_noise, resolution, white_noise_level

Array = NDArray[np.float64]

BIN = 0.2  # s, as the diagnosis has it
_MEMORY = 300  # bins from which noise is learned
_SAMPLES = 400  # samples from which the scatter of neighbours is taken
_FEWEST_SAMPLES = 20
# Of a sample: no bench is simulated, and no voltage known, to less.
_LEAST = {"current": 2e-3, "temperature": 0.02, "deflection": 5e-6, "force": 5e-3}
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
        surprise: standard deviations by which the energy or the level is beyond that of noise.
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
        self._bins: deque[Bin] = deque(maxlen=_MEMORY)

    def samples(self, value: Array, residual: Array) -> None:
        """Measured values (n,), and measured less predicted."""
        self._values.extend(value.tolist())
        self._residuals.extend(residual.tolist())

    def add(self, one: Bin) -> None:
        """The next bin."""
        self._bins.append(one)

    def clear(self) -> None:
        """Forget the bins; the samples' noise stays."""
        self._bins.clear()

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
        steps = resolution(np.array(self._values)) / np.sqrt(12.0)
        white = white_noise_level(np.array(self._residuals))
        return float(max(white, steps, _LEAST[self.quantity]))

    def read(self, allowed: float, sides: int, fewest: int, window: float) -> Reading | None:
        """What the bins of the last `window` s say, None while there are too few.

        Args:
            allowed: slow drift that the sensor may have, in the signal's unit.
            sides: how many there are; fewest: bins that make a verdict.
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
        noise = self._noise(level, time, count, scatter, allowed)
        last = slice(min(int(np.searchsorted(time, time[-1] - window)), len(time) - fewest), None)
        tolerance = np.hypot(steady, off)
        squares = (residual / tolerance)[last] ** 2
        gap = np.full(sides, np.nan)
        for k in range(sides):
            here = side[last] == k
            if here.any():
                gap[k] = np.sqrt(squares[here].sum() / len(squares))
        power = float(cause @ cause)
        told = power > 0.1 * float(tolerance @ tolerance)
        energy, surprise = _judge(noise, level[last])
        return Reading(
            energy, surprise, gap, noise, scatter, residual[last], cause[last], tolerance[last],
            float(residual @ cause) / power if told else np.nan,
        )

    @staticmethod
    def _noise(level: Array, time: Array, count: Array, scatter: float, allowed: float) -> Noise:
        """Noise that the bins show, but no more than a sensor may have."""
        white = scatter / float(np.sqrt(np.median(count)))
        period = round(float(np.median(np.diff(time))), 2)
        found = estimate_noise([level], white, max(period, 0.01), allowed)
        drift = min(found.drift, allowed)
        return Noise(
            min(found.white, _MOST_WHITE * white), drift, found.time, found.period, allowed
        )


def _judge(noise: Noise, level: Array) -> tuple[float, float]:
    """Energy of the whitened level (n,), and how surprising it is as noise."""
    white, ones = noise.whiten(level), noise.whiten(np.ones(len(level)))
    energy = float(np.mean(white**2))
    from_energy = (energy - 1.0) * float(np.sqrt(0.5 * len(level)))
    from_level = abs(float(ones @ white)) / float(np.sqrt(ones @ ones))
    return energy, max(from_energy, from_level)
