"""The device's microseconds on the host's clock: offset and drift, estimated from pings."""

import math
from collections import deque

import numpy as np

_MICROSECOND = 1e-6
_WRAP = 1 << 32
# An Uno's ceramic resonator is good for half a percent.
_DRIFT_STD = 5e-3
# s: scheduling of the host beyond what a round trip shows.
_JITTER = 2e-5
# Of the shortest half round trip: how much the way there varies among equally short ones.
_SCATTER = 0.1
_WINDOW = 60.0
_MOST = 600


class DeviceClock:
    """Host time = offset + (1 + drift) device time, a weighted straight line.

    Of a ping four times are known: sent and heard on the host's clock, arrived and left on the
    device's. The middles of both pairs are one moment, if both ways took equally long; half of
    what the ways took bounds the error. What a ping took beyond the shortest one was spent
    waiting, on one way or the other: the shortest ones weigh most.
    Host times are seconds of one monotonic clock.
    """

    def __init__(self) -> None:
        self._last_us: int | None = None
        self._turns = 0
        self._points: deque[tuple[float, float, float]] = deque(maxlen=_MOST)
        self._line = (0.0, 0.0, 1.0)
        self.uncertainty = math.inf
        """s, bound of the error: half of what the ways of the quickest ping took"""

    @property
    def drift(self) -> float:
        """Host seconds per device second, less one."""
        return self._line[2] - 1.0

    @property
    def synchronised(self) -> bool:
        """True as soon as one ping was answered."""
        return bool(self._points)

    def add(self, sent: float, arrived_us: int, left_us: int, heard: float) -> None:
        """A ping that had left the host at `sent` and whose answer was heard at `heard` (s)."""
        arrived, left = self._seconds(arrived_us), self._seconds(left_us)
        if heard < sent or left < arrived:
            return
        half = max(0.0, 0.5 * ((heard - sent) - (left - arrived)))
        device = 0.5 * (arrived + left)
        self._points.append((device, 0.5 * (sent + heard), half))
        while self._points[0][0] < device - _WINDOW:
            self._points.popleft()
        self._fit()

    def host_time(self, time_us: int) -> float:
        """Host time (s) of a device stamp; NaN before the first ping was answered."""
        if not self.synchronised:
            return math.nan
        reference, at_reference, slope = self._line
        return at_reference + slope * (self._seconds(time_us) - reference)

    def _seconds(self, time_us: int) -> float:
        """Stamps wrap after 71.6 min; each lies within half of that from the one before."""
        if self._last_us is None:
            self._last_us = time_us
        step = (time_us - self._last_us + _WRAP // 2) % _WRAP - _WRAP // 2
        self._turns += step
        self._last_us = time_us
        return self._turns * _MICROSECOND

    def _fit(self) -> None:
        """Least squares with a prior of no drift, about the newest point."""
        device, host, half = np.array(self._points).T
        reference, start = device[-1], host[-1]
        x, y = device - reference, host - device - (start - reference)
        shortest = half.min()
        weight = 1.0 / ((half - shortest) ** 2 + (_SCATTER * shortest) ** 2 + _JITTER**2)
        matrix = np.array(
            [
                [weight.sum(), (weight * x).sum()],
                [(weight * x).sum(), (weight * x**2).sum() + _DRIFT_STD**-2],
            ]
        )
        offset, drift = np.linalg.solve(matrix, [(weight * y).sum(), (weight * x * y).sum()])
        self._line = (float(reference), float(start + offset), float(1.0 + drift))
        self.uncertainty = float(shortest)
