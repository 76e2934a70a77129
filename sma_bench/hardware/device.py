"""The device behind a serial link: what it is, how its clock runs, what the link counts of it."""

import math
from collections import deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from sma_bench.errors import InputError
from sma_bench.hardware.serial_messages import (
    CAUSES,
    CHANNELS,
    PROTOCOL_VERSION,
    DeviceState,
    Named,
    Telemetry,
    name_of,
    resets,
)

# --- Who answered the handshake, whether this host may drive it, and what its clock says.


HANDSHAKE_LINES = frozenset("HLM")


@dataclass(frozen=True)
class DeviceIdentity:
    """A device's name, build and limits (V, A, s), as its handshake says."""

    name: str
    build: str
    reset: str
    maximum_voltage: float
    command_timeout: float
    maximum_duty: float
    maximum_mean_current: float
    maximum_peak_current: float
    maximum_on_time: float
    supply_range: tuple[float, float]
    least_resistance: float
    hot_voltage: float
    """root mean square of a wire's volts over about `hot_time`"""
    hot_time: float

    @classmethod
    def from_lines(cls, lines: Mapping[str, Named]) -> "DeviceIdentity":
        """From the H, L and M lines.

        Raises:
            InputError: another protocol, another number of channels, or something left out.
        """
        said = {key: value for line in lines.values() for key, value in line.values.items()}
        try:
            for key, expected in (("protocol", PROTOCOL_VERSION), ("channels", CHANNELS)):
                if int(said[key]) != expected:
                    raise ValueError(f"the device has {key} {said[key]}, expected {expected}")
            cause = int(said["before"])
            stopped = f", after: {name_of(CAUSES, cause)}" if cause else ""
            return cls(
                name=said["name"],
                build=said["build"],
                reset=resets(int(said["reset"])) + stopped,
                maximum_voltage=1e-3 * int(said["max_mv"]),
                command_timeout=1e-3 * int(said["timeout_ms"]),
                maximum_duty=int(said["duty"]) / 65536.0,
                maximum_mean_current=1e-3 * int(said["mean_ma"]),
                maximum_peak_current=1e-3 * int(said["peak_ma"]),
                maximum_on_time=float(int(said["on_s"])),
                supply_range=(1e-3 * int(said["supply_min_mv"]), 1e-3 * int(said["supply_max_mv"])),
                least_resistance=1e-3 * int(said["least_mohm"]),
                hot_voltage=1e-3 * int(said["hot_mv"]),
                hot_time=1e-3 * int(said["hot_ms"]),
            )
        except KeyError as error:
            raise InputError(f"handshake: {error.args[0]} is missing") from None
        except ValueError as error:
            raise InputError(f"handshake: {error}") from None


# --- The device's microseconds on the host's clock: offset and drift, from what was heard
# earliest.

Array = NDArray[np.float64]

_MICROSECOND = 1e-6
_WRAP = 1 << 32
# An Uno's ceramic resonator is good for half a percent; twice that is a broken one.
_MOST_DRIFT = 1e-2
# s of the device's clock: one point a bin, the earliest heard.
_BIN = 0.1
_WINDOW = 30.0
_PINGS = 400
# Of the pings: the share whose answers came most promptly, and of these the one in the way there.
_PROMPT = 0.1
_FEWEST_PROMPT = 5
_SOONEST = 0.2


class DeviceClock:
    """Host time = offset + (1 + drift) device time.

    What delays a message (the host's scheduling, a full cable, a busy computer) only ever makes
    it later. So the line that no frame was heard before, and that is as late as that allows, has
    the drift, and lies behind the device's clock by the least time that a frame takes; delays,
    however long and frequent, do not move it (Moon, Skelly, Towsley, INFOCOM 1999, for packets).
    How far behind, pings show: the soonest question there and the soonest answer back took equally
    long, as far as anyone can know. Host times are seconds of one monotonic clock.
    """

    def __init__(self) -> None:
        self._last_us: int | None = None
        self._turns = 0
        self._frames = _Earliest()
        self._answers = _Earliest()
        self._pings: deque[tuple[float, float, float, float]] = deque(maxlen=_PINGS)
        self._line = (0.0, 0.0, 1.0)
        self.uncertainty = math.inf
        """s, bound of the error: half of what the quickest ways there and back took"""

    @property
    def drift(self) -> float:
        """Host seconds per device second, less one."""
        return self._line[2] - 1.0

    @property
    def synchronised(self) -> bool:
        """True as soon as one ping was answered."""
        return bool(self._pings)

    def heard(self, time_us: int, heard: float) -> None:
        """A frame of the device's time `time_us` was heard at `heard` (s)."""
        self._frames.add(self._seconds(time_us), heard)

    def add(self, sent: float, arrived_us: int, left_us: int, heard: float) -> None:
        """A ping that had left the host at `sent` and whose answer was heard at `heard` (s)."""
        arrived, left = self._seconds(arrived_us), self._seconds(left_us)
        if heard < sent or left < arrived:
            return
        self._answers.add(left, heard)
        self._pings.append((sent, arrived, left, heard))
        while self._pings[0][1] < arrived - _WINDOW:
            self._pings.popleft()
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
        sent, arrived, left, heard = np.array(self._pings).T
        reference = arrived[-1]
        many = 2 * len(self._frames) > len(self._answers)
        level, drift = (self._frames if many else self._answers).line(reference)
        slope = 1.0 + drift
        back = heard - level - slope * (left - reference)
        there = level + slope * (arrived - reference) - sent
        # A device that is late itself (an emulated one) seems to have been asked sooner than it
        # was: only the pings with prompt answers show what the way there takes.
        prompt = np.argsort(back)[: max(_FEWEST_PROMPT, round(_PROMPT * len(back)))]
        soonest = float(np.quantile(there[prompt], _SOONEST))
        behind = 0.5 * (soonest - float(back.min()))
        self._line = (float(reference), level - behind, slope)
        self.uncertainty = 0.5 * max(0.0, soonest + float(back.min()))


class _Earliest:
    """Of messages (device s, host s), those that came earliest, and the line below all of them."""

    def __init__(self) -> None:
        self._points: deque[tuple[float, float]] = deque()

    def __len__(self) -> int:
        return len(self._points)

    def add(self, device: float, host: float) -> None:
        """Keep it if it is the earliest of its bin."""
        points = self._points
        if points and int(points[-1][0] / _BIN) == int(device / _BIN):
            if host - device < points[-1][1] - points[-1][0]:
                points[-1] = (device, host)
            return
        points.append((device, host))
        while points[0][0] < device - _WINDOW:
            points.popleft()

    def line(self, reference: float) -> tuple[float, float]:
        """Host time at device time `reference`, and the drift, of the line below all points that
        comes closest to them in the mean."""
        device, host = np.array(self._points).T
        x, late = device - reference, host - device
        middle = float(x.mean())
        corners = _lower_hull(zip(x, late, strict=True))
        drift = 0.0
        for (x0, y0), (x1, y1) in zip(corners, corners[1:], strict=False):
            drift = (y1 - y0) / (x1 - x0)
            if x1 >= middle:
                break
        drift = min(max(drift, -_MOST_DRIFT), _MOST_DRIFT)
        return reference + float((late - drift * x).min()), drift


def _lower_hull(points: Iterable[tuple[float, float]]) -> list[tuple[float, float]]:
    """Corners of the lower convex hull of points in the order of their rising x (Andrew 1979)."""
    corners: list[tuple[float, float]] = []
    for x, y in points:
        while len(corners) > 1:
            (x0, y0), (x1, y1) = corners[-2:]
            if (y1 - y0) * (x - x0) < (y - y0) * (x1 - x0):
                break
            corners.pop()
        corners.append((float(x), float(y)))
    return corners


# --- What a serial link counts and reports.


_NUMBERS = 1 << 16
_CLOCK = 1 << 32


@dataclass(frozen=True)
class Reading:
    """Telemetry with its time of acquisition: host s, the middle of the window."""

    telemetry: Telemetry
    time: float


@dataclass
class LinkStatus:
    """A snapshot; counts are since the link was made."""

    connected: bool = False
    device: DeviceIdentity | None = None
    state: DeviceState = DeviceState.IDLE
    cause: int = 0
    telemetry: int = 0
    lost: int = 0
    damaged: int = 0
    not_understood: int = 0
    refused: int = 0
    last_refusal: str = ""
    silence: str = ""
    """why the device heard no command, as far as this host knows; "" unless it timed out"""
    unasked: str = ""
    """newest answer, since this host armed, to what it had not asked"""
    counters: dict[str, int] = field(default_factory=dict)
    """the device's own (S line), once a second"""
    connections: int = 0
    round_trip: float = float("nan")
    command_latency: float = float("nan")
    """s from sending a command to the telemetry that echoes it"""
    drift: float = 0.0
    clock_uncertainty: float = float("inf")
    problem: str = ""
    _last: Telemetry | None = field(default=None, repr=False)

    @property
    def newest(self) -> Telemetry | None:
        """The last frame of this connection."""
        return self._last

    @property
    def stopped(self) -> bool:
        """True where the device wants a reset first."""
        return self.state in (DeviceState.STOPPED, DeviceState.STILL_FLOWING)

    @property
    def cause_text(self) -> str:
        """Why the device stopped, in words; "" when it did not."""
        return name_of(CAUSES, self.cause)

    def note(self, telemetry: Telemetry) -> None:
        """Count a frame and those missing before it."""
        if self._last is not None:
            self.lost += (telemetry.sequence - self._last.sequence - 1) % _NUMBERS
        self._last = telemetry
        self.telemetry += 1
        self.state = DeviceState(telemetry.state)
        self.cause = telemetry.cause

    def start_anew(self, device: DeviceIdentity) -> None:
        """A new connection; its first frame is not late."""
        self.connected, self.device, self.problem = True, device, ""
        self.connections += 1
        self.state, self.cause = DeviceState.IDLE, 0
        self._last = None

    def restarted(self, telemetry: Telemetry, period_us: int) -> bool:
        """True when the device started anew since the last frame; windows last `period_us`.

        Its clock went back, or, where half a turn of the clock hides that, windows were missed
        that do not fill the time that seems to have passed.
        """
        if self._last is None:
            return False
        elapsed = (telemetry.time_us - self._last.time_us) % _CLOCK
        windows = (telemetry.sequence - self._last.sequence) % _NUMBERS
        left = (elapsed - windows * period_us + period_us) % (_NUMBERS * period_us)
        # The window in which the rate was set is shorter or longer.
        return elapsed > _CLOCK // 2 or (windows != 1 and left > 2 * period_us)
