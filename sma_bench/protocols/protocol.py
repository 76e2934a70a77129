"""A protocol: piecewise-linear levels of every channel, as pure functions of time: volts, of a
reference kelvin or metres.
"""

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from sma_bench.parameters import Parameters

Array = NDArray[np.float64]

# A command clock sums periods such as 0.05 s; the rounding of that sum must not delay a step by
# one whole period.
_TIME_ROUNDING = 1e-6
PAPER_FORCE = 1.0  # N, E6 (section III.B.1)


TEMPERATURE, DEFLECTION = "temperature", "deflection"
# What still counts as settled: the means of the two halves of a window differ by less [K, m].
SETTLED_WITHIN = {TEMPERATURE: 0.1, DEFLECTION: 0.05e-3}


@dataclass(frozen=True)
class Until:
    """What ends a step before its time, whichever comes first.

    Attributes:
        above, below: level by quantity, K of the hottest wire that the step drives or m of the
            deflection.
        settled: quantities that must all have settled, over a window of `over` s; ("",) stands for
            whatever is measured.
    """

    above: Mapping[str, float] = field(default_factory=dict)
    below: Mapping[str, float] = field(default_factory=dict)
    settled: tuple[str, ...] = ()
    over: float = 5.0

    @property
    def quantities(self) -> set[str]:
        """What has to be measured."""
        return {*self.above, *self.below, *self.settled} - {""}


@dataclass(frozen=True)
class Segment:
    """A straight line: from `start` to `stop` (levels, one per channel) in `duration` s at most.

    `step` is what people and markers call it; `until` ends it earlier; `force` (N) is what the load
    frame has come to by its end, None where it goes on holding what it held.
    """

    step: str
    duration: float
    start: tuple[float, ...]
    stop: tuple[float, ...]
    until: Until | None = None
    force: float | None = None


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
        """Length of the protocol in s; where steps wait for something, the longest."""
        return float(self._edges[-1])

    @property
    def waits(self) -> bool:
        """Whether a step ends by what is measured."""
        return any(segment.until for segment in self.segments)

    @property
    def pulls(self) -> bool:
        """Whether its steps change the force that a load frame holds."""
        return any(segment.force is not None for segment in self.segments)

    def forces(self, time: Array, first: float) -> Array:
        """(n,) N that the load frame holds, `first` before any step says so."""
        held = [first]
        for segment in self.segments:
            held.append(held[-1] if segment.force is None else segment.force)
        return np.interp(time, self._edges, held)

    @property
    def length(self) -> str:
        """The duration in words."""
        return f"{self.duration:g} s{' at most' * self.waits}"

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

    def place(self, t: float) -> tuple[int, float]:
        """Number of the segment at `t` s, and s from there to its end."""
        index = int(self._index(np.array([t + _TIME_ROUNDING]))[0])
        return index, float(self._edges[index + 1]) - t

    def _index(self, time: Array) -> NDArray[np.intp]:
        index = np.searchsorted(self._edges, time, side="right") - 1
        return np.clip(index, 0, len(self.segments) - 1)


class Waiting:
    """Ends the steps of a protocol by what is measured: readings in, s to pass over out.

    Its times are the bench's, in s.
    """

    def __init__(self, protocol: Protocol) -> None:
        self.protocol = protocol
        self._segment, self._begun = -1, 0.0
        self._last: dict[tuple[str, str], float] = {}
        self._since: dict[tuple[str, str], deque[tuple[float, float]]] = {}

    def heard(self, quantity: str, channel: str, value: float, time: float) -> None:
        """A reading in K of a channel, or in m; NaN is none."""
        if np.isfinite(value):
            self._last[quantity, channel] = value
            history = self._since.setdefault((quantity, channel), deque())
            history.append((time, value))
            until = self.protocol.segments[max(self._segment, 0)].until or Until()
            while history[0][0] < time - until.over:
                history.popleft()

    def passed_over(self, elapsed: float, time: float) -> float:
        """s of the protocol that are left out at `elapsed` s of it: a step has found its end.

        A step lasts one call at least.
        """
        index, left = self.protocol.place(elapsed)
        if index != self._segment:
            self._segment, self._begun = index, time
            self._since.clear()
            return 0.0
        segment = self.protocol.segments[index]
        return left if segment.until and self._over(segment, segment.until, time) else 0.0

    def _over(self, segment: Segment, until: Until, time: float) -> bool:
        now = {quantity: self._now(segment, quantity) for quantity in until.quantities}
        return (
            any(now[quantity] >= level for quantity, level in until.above.items())
            or any(now[quantity] <= level for quantity, level in until.below.items())
            or (bool(until.settled) and self._settled(segment, until, time))
        )

    def _now(self, segment: Segment, quantity: str) -> float:
        return max((self._last[key] for key in self._keys(segment, quantity)), default=np.nan)

    def _keys(self, segment: Segment, quantity: str) -> list[tuple[str, str]]:
        """Readings that count: of the wires that are driven, where any is."""
        names, rest = self.protocol.channels, self.protocol.rest
        levels = zip(names, segment.start, segment.stop, strict=True)
        driven = {name for name, start, stop in levels if start != rest or stop != rest}
        keys = [key for key in self._last if quantity in ("", key[0])]
        own = [key for key in keys if key[0] == DEFLECTION or key[1] in driven]
        return own if any(key[0] != DEFLECTION for key in own) else keys

    def _settled(self, segment: Segment, until: Until, time: float) -> bool:
        keys = [key for quantity in until.settled for key in self._keys(segment, quantity)]
        full = time - self._begun >= until.over
        return full and bool(keys) and all(self._at_rest(key, until.over, time) for key in keys)

    def _at_rest(self, key: tuple[str, str], over: float, time: float) -> bool:
        history = [(t, value) for t, value in self._since.get(key, ()) if t > time - over]
        older = [value for t, value in history if t <= time - 0.5 * over]
        newer = [value for t, value in history if t > time - 0.5 * over]
        if not older or not newer:
            return False
        return bool(abs(np.mean(newer) - np.mean(older)) < SETTLED_WITHIN[key[0]])
