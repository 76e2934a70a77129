"""Measured voltages of all channels in the order of their stamps, and what is wrong with them."""

import math
from collections import deque

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_BACK = 0.5  # s; a stamp further back than that is a clock set back, or a record that begins anew
_QUEUE = 5000


class Drive:
    """Readings of each channel until every channel has one as late: only then is it known what
    drove the bench up to there. A voltage is held until the channel's next reading.

    Attributes:
        dropped: readings left out by reason.
    """

    def __init__(self, wires: int, timeout: float) -> None:
        """`timeout` s: a longer hole between two readings of a channel hides what drove it."""
        self._timeout = timeout
        self.dropped = {"not a number": 0, "out of order": 0}
        self._waiting: list[deque[tuple[float, float]]] = [
            deque(maxlen=_QUEUE) for _ in range(wires)
        ]
        self._latest = [-math.inf] * wires
        self._held = [math.nan] * wires

    def take(self, wire: int, time: float, volt: float) -> str:
        """A reading at `time` s; why the twin must begin anew, or ""."""
        if not math.isfinite(volt):
            self.dropped["not a number"] += 1
            return ""
        passed, reason = time - self._latest[wire], ""
        if passed < -_BACK:
            reason = f"time went back by {-passed:.3g} s"
        elif passed <= 0.0:
            self.dropped["out of order"] += 1
            return ""
        elif self._timeout < passed < math.inf:
            reason = f"no voltages for {passed:.3g} s"
        if reason:
            self.clear()
        self._latest[wire] = time
        self._waiting[wire].append((time, volt))
        return reason

    def clear(self) -> None:
        """Forget everything but the counts."""
        for k, waiting in enumerate(self._waiting):
            waiting.clear()
            self._latest[k], self._held[k] = -math.inf, math.nan

    @property
    def known_until(self) -> float:
        """s; -inf until every channel has been heard."""
        return min(self._latest)

    def missing(self) -> list[int]:
        """Wires not heard of."""
        return [k for k, latest in enumerate(self._latest) if latest == -math.inf]

    def changes(self) -> tuple[Array, Array]:
        """Times (n,) s of the readings, as far as all channels are known, and the voltages (n, w) V
        held from each on; NaN for a wire whose first reading is yet to come."""
        until = self.known_until
        times: list[float] = []
        volts: list[list[float]] = []
        while True:
            time = min((w[0][0] for w in self._waiting if w), default=math.inf)
            if time > until:
                break
            for k, waiting in enumerate(self._waiting):
                if waiting and waiting[0][0] == time:
                    self._held[k] = waiting.popleft()[1]
            times.append(time)
            volts.append(list(self._held))
        return np.array(times), np.array(volts).reshape(len(times), len(self._held))
