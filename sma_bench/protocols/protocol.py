"""A protocol: piecewise-linear levels of every channel, as pure functions of time.

Levels are volts; of a reference they are kelvin or metres.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from sma_bench.parameters import Parameters

Array = NDArray[np.float64]

# A command clock sums periods such as 0.05 s; the rounding of that sum must not delay a step by
# one whole period.
_TIME_ROUNDING = 1e-6
PAPER_FORCE = 1.0  # N, E6 (section III.B.1)


@dataclass(frozen=True)
class Segment:
    """A straight line: from `start` to `stop` (levels, one per channel) in `duration` s.

    `step` is what people and markers call it.
    """

    step: str
    duration: float
    start: tuple[float, ...]
    stop: tuple[float, ...]


@dataclass(frozen=True)
class Protocol:
    """Named sequence of segments for `channels`; `rest` before its start and after its end.

    `load` is the load.kind of a bench whose own is not given.
    """

    name: str
    channels: tuple[str, ...]
    segments: tuple[Segment, ...]
    description: str = ""
    rest: float = 0.0
    load: str = ""

    def bench(self, parameters: Parameters) -> Parameters:
        """The bench that runs it: one whose load nobody gave holds what the protocol asks for,
        `load.force`, or the paper's 1 N."""
        if not self.load or parameters["load.kind"] or len(parameters["bench.channels"]) > 1:
            return parameters
        force = parameters["load.force"] or PAPER_FORCE
        return parameters.replace({"load.kind": self.load, "load.force": force})

    @cached_property
    def _edges(self) -> Array:
        return np.concatenate([[0.0], np.cumsum([s.duration for s in self.segments])])

    @cached_property
    def _levels(self) -> tuple[Array, Array]:
        return (
            np.array([s.start for s in self.segments], dtype=float),
            np.array([s.stop for s in self.segments], dtype=float),
        )

    @property
    def duration(self) -> float:
        """Length of the protocol in s."""
        return float(self._edges[-1])

    @property
    def maximum_voltage(self) -> float:
        """Largest voltage on any channel in V."""
        return float(max(level.max() for level in self._levels))

    def voltage(self, t: float) -> Array:
        """Voltage (w,) in V of every channel at `t` s; at a jump, the value after it."""
        return self.voltages(np.array([t], dtype=float))[0]

    def level(self, t: float) -> Array:
        """Level (w,) of every channel at `t` s, in the unit of the protocol."""
        return self.voltage(t)

    def voltages(self, time: Array) -> Array:
        """Voltage (n, w) in V at `time` (n,) in s."""
        time = np.asarray(time, dtype=float) + _TIME_ROUNDING
        inside = (time >= 0.0) & (time < self.duration)
        index = self._index(time)
        start, stop = self._levels
        length = self._edges[index + 1] - self._edges[index]
        fraction = np.clip((time - _TIME_ROUNDING - self._edges[index]) / length, 0.0, 1.0)
        level = start[index] + fraction[:, None] * (stop[index] - start[index])
        return np.where(inside[:, None], level, self.rest)

    def sample(self, period: float) -> tuple[Array, Array]:
        """Time (n,) in s from 0 to past the end every `period` s, and voltage (n, w) in V.

        The last sample is 0 V.

        Raises:
            ValueError: the period is not positive.
        """
        if not period > 0.0:
            raise ValueError(f"sample period is {period} s, expected more than 0")
        count = int(np.ceil(self.duration / period - _TIME_ROUNDING)) + 1
        time: Array = np.arange(count, dtype=np.float64) * np.float64(period)
        return time, self.voltages(time)

    def step_at(self, t: float) -> str:
        """Name of the step at `t` s; "" before the start and after the end."""
        if not 0.0 <= t + _TIME_ROUNDING < self.duration:
            return ""
        return self.segments[int(self._index(np.array([t + _TIME_ROUNDING]))[0])].step

    def _index(self, time: Array) -> NDArray[np.intp]:
        index = np.searchsorted(self._edges, time, side="right") - 1
        return np.clip(index, 0, len(self.segments) - 1)
