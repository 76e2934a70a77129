"""The last minute of one signal, small enough to send to a page and with every peak in it."""

import math
from collections import deque

SPAN = 60.0
"""s that a trace remembers"""
BUCKET = 0.1
"""s of which only the least and the largest reading are kept"""


class Trace:
    """Readings over their time of arrival, s of a clock that never goes back."""

    def __init__(self) -> None:
        self.latest = math.nan
        self.heard = -math.inf
        self._closed: deque[tuple[float, float]] = deque(maxlen=round(2 * SPAN / BUCKET))
        self._count = 0
        self._bucket = -1
        self._least = self._largest = (0.0, 0.0)

    def add(self, time: float, value: float) -> None:
        """Take a reading; NaN is heard, and leaves a gap."""
        self.latest, self.heard = value, time
        if not math.isfinite(value):
            return
        bucket = math.floor(time / BUCKET)
        if bucket != self._bucket:
            self._close()
            self._bucket = bucket
            self._least = self._largest = (time, value)
        elif value < self._least[1]:
            self._least = (time, value)
        elif value > self._largest[1]:
            self._largest = (time, value)

    def since(self, count: int) -> tuple[int, list[tuple[float, float]]]:
        """Points (time, value) after the first `count` of all time, and the count to ask next."""
        missing = min(self._count - count, len(self._closed))
        if missing <= 0:
            return self._count, []
        return self._count, list(self._closed)[-missing:]

    def _close(self) -> None:
        if self._bucket < 0:
            return
        points = sorted({self._least, self._largest})
        self._closed.extend(points)
        self._count += len(points)
