"""The device's microseconds on the host's clock, from what was heard earliest."""

import math
from collections import deque

import numpy as np

from sma_bench.hardware.serial_messages import TURN

_MOST_DRIFT = 1e-2  # an Uno's ceramic resonator is good for half a percent; twice that is broken
_BIN, _WINDOW = 0.1, 30.0  # s of the device's clock: one point a bin, the earliest heard
_PINGS = 400
# Of the pings: the share whose answers came most promptly, and of these the one in the way there.
_PROMPT, _FEWEST_PROMPT, _SOONEST = 0.1, 5, 0.2
_Points = deque[tuple[float, float]]  # device s, host s


class DeviceClock:
    """Host time = offset + (1 + drift) device time; host times are s of one monotonic clock. What
    delays a message (the host's scheduling, a full cable, a busy computer) only ever makes it
    later. So the line that no frame was heard before, and that is as late as that allows, has the
    drift, and lies behind the device's clock by the least time that a frame takes; no delay moves
    it (Moon, Skelly, Towsley, INFOCOM 1999, for packets). How far behind, pings show: the soonest
    question there and the soonest answer back took equally long, as far as anyone can know."""

    def __init__(self) -> None:
        self._last_us: int | None = None
        self._turns = 0
        self._frames, self._answers = _Points(), _Points()
        self._pings: deque[tuple[float, float, float, float]] = deque(maxlen=_PINGS)
        self._origin = (math.nan, math.nan)
        self.drift = 0.0  # host seconds per device second, less one
        # s, bound of the error: half of what the quickest ways there and back took.
        self.uncertainty = math.inf

    def heard(self, time_us: int, heard: float) -> None:
        """A frame of the device's time `time_us` was heard at `heard` (s)."""
        _keep(self._frames, self._seconds(time_us), heard)

    def add(self, sent: float, arrived_us: int, left_us: int, heard: float) -> None:
        """A ping that had left the host at `sent` and whose answer was heard at `heard` (s)."""
        arrived, left = self._seconds(arrived_us), self._seconds(left_us)
        if heard < sent or left < arrived:
            return
        _keep(self._answers, left, heard)
        self._pings.append((sent, arrived, left, heard))
        while self._pings[0][1] < arrived - _WINDOW:
            self._pings.popleft()
        # The line that nothing was heard before, and how far it lies behind.
        sents, arrivals, lefts, heards = np.array(self._pings).T
        many = 2 * len(self._frames) > len(self._answers)
        level, self.drift = _line_below(self._frames if many else self._answers, arrived)
        back = heards - level - (1.0 + self.drift) * (lefts - arrived)
        there = level + (1.0 + self.drift) * (arrivals - arrived) - sents
        # A device that is late itself (an emulated one) seems to have been asked sooner than it
        # was: only the pings with prompt answers show what the way there takes.
        prompt = np.argsort(back)[: max(_FEWEST_PROMPT, round(_PROMPT * len(back)))]
        soonest, quickest = float(np.quantile(there[prompt], _SOONEST)), float(back.min())
        self._origin = (arrived, level - 0.5 * (soonest - quickest))
        self.uncertainty = 0.5 * max(0.0, soonest + quickest)

    def host_time(self, time_us: int) -> float:
        """Host time (s) of a device stamp; NaN before the first ping was answered."""
        device, host = self._origin
        return host + (1.0 + self.drift) * (self._seconds(time_us) - device)

    def _seconds(self, time_us: int) -> float:
        """Stamps wrap after 71.6 min; each lies within half of that from the one before."""
        last = time_us if self._last_us is None else self._last_us
        self._turns += (time_us - last + TURN // 2) % TURN - TURN // 2
        self._last_us = time_us
        return self._turns * 1e-6


def _keep(points: _Points, device: float, host: float) -> None:
    """Keep a message if it came earliest in its bin."""
    if points and int(points[-1][0] / _BIN) == int(device / _BIN):
        if host - device < points[-1][1] - points[-1][0]:
            points[-1] = (device, host)
        return
    points.append((device, host))
    while points[0][0] < device - _WINDOW:
        points.popleft()


def _line_below(points: _Points, reference: float) -> tuple[float, float]:
    """Host time at device time `reference`, and the drift, of the line below all points that comes
    closest to them in the mean: the edge of their lower convex hull there."""
    device, host = np.array(points).T
    x, late = device - reference, host - device
    left, right, drift, middle = 0, len(points) - 1, 0.0, x.mean()
    for _ in range(right):  # each line is lower in the middle than the one before
        drift = float((late[right] - late[left]) / (x[right] - x[left]))
        lowest = int((late - drift * x).argmin())
        if lowest in (left, right):
            break
        left, right = (lowest, right) if x[lowest] < middle else (left, lowest)
    drift = min(max(drift, -_MOST_DRIFT), _MOST_DRIFT)
    return reference + float((late - drift * x).min()), drift
