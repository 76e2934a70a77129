"""The serial protocol (docs/serial_protocol.md): lines, frames, messages in SI units, the clock."""

import binascii
import math
import struct
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from sma_bench.errors import InputError

LINE_END, FRAME_END, STOP = b"\n", b"\0", b"!"
_LONGEST = 512  # bytes, far above any message: more means that a delimiter was lost


def checksum(body: bytes) -> int:
    """CRC-16/CCITT-FALSE."""
    return binascii.crc_hqx(body, 0xFFFF)


def line(body: str) -> bytes:
    """A command or message as a line, ready to send."""
    encoded = body.encode("ascii")
    return encoded + b"*%04X" % checksum(encoded) + LINE_END


def open_line(text: bytes) -> bytes | None:
    """The body of a line without its end; None when the checksum is absent or wrong."""
    body, star, digits = text.removesuffix(b"\r").rpartition(b"*")
    return body if star and digits == b"%04X" % checksum(body) else None


def open_frame(stuffed: bytes) -> bytes | None:
    """The body of a binary frame (COBS) without its delimiter; None when it is damaged."""
    sealed, at = bytearray(), 0
    while at < len(stuffed):
        code = stuffed[at]
        if code == 0 or at + code > len(stuffed):
            return None
        sealed += stuffed[at + 1 : at + code]
        at += code
        if code < 255 and at < len(stuffed):
            sealed.append(0)
    body, crc = bytes(sealed[:-2]), int.from_bytes(sealed[-2:], "little")
    return body if body and crc == checksum(body) else None


class Splitter:
    """Cuts a stream of bytes into the bodies of messages; `damaged` counts invalid ones."""

    def __init__(self) -> None:
        self.damaged = 0
        self.expect(binary=False)

    def expect(self, binary: bool) -> None:
        """Drop pending bytes and expect frames (`binary`) or lines from here on."""
        self._pending, self._binary = b"", binary
        self._in_step = False  # the first piece may have begun before this host listened

    def feed(self, received: bytes) -> list[bytes]:
        end, unseal = (FRAME_END, open_frame) if self._binary else (LINE_END, open_line)
        *complete, self._pending = (self._pending + received).split(end)
        bodies = [unseal(piece) for piece in complete if piece.strip()]
        self.damaged += sum(body is None for body in (bodies if self._in_step else bodies[1:]))
        self._in_step |= bool(bodies)
        if len(self._pending) > _LONGEST:
            self.damaged += 1
            self._pending = b""
        return [body for body in bodies if body is not None]


# --- Messages as values in SI units

PROTOCOL_VERSION, CHANNELS = 2, 4
NUMBERS = 1 << 16  # sequence numbers before they begin again; a command's largest is one less
TURN = 1 << 32  # us before the device's clock begins again
_DUTY, _BINARY = 1.0 / 65536.0, struct.Struct("<HIBBHHHhhHHHHHHH")
CAUSES = ("", "stop byte", "command timeout", "over-current of the front board",
          "over-current of the back board", "duty above its limit", "on for longer than allowed",
          "supply out of range", "main loop hung", "converter dead",
          "current with all outputs off", "more current than the outputs explain",
          "more heat than allowed", "output interrupt lost", "an output differs from what was set",
          "restarted while armed", "reason lost with the power")
STOP_CAUSE, TIMEOUT_CAUSE = CAUSES.index("stop byte"), CAUSES.index("command timeout")
LOST_CAUSE = CAUSES.index("reason lost with the power")
REASONS = ("accepted", "wrong checksum", "bad format", "line too long", "not armed",
           "wrong nonce or session", "old sequence number", "above the voltage limit",
           "above the duty limit", "supply out of range or just started", "rate not possible",
           "stopped: reset first", "armed already", "current flows though every output is off",
           "beyond the device's own limits")
RESETS = ((1, "power-on"), (2, "reset pin"), (4, "brown-out"), (8, "watchdog"))


class ProtocolError(ValueError):
    """A message with a good checksum that still cannot be understood."""


# STILL_FLOWING is stopped, and current flows though every output is off.
DeviceState = IntEnum("DeviceState", "IDLE ARMED STOPPED STILL_FLOWING", start=0)


class Telemetry(NamedTuple):
    """A window of readings, means until `time_us` of the device's clock; pairs: front and back."""

    sequence: int
    time_us: int
    state: int
    cause: int
    supply: float  # V without load
    current: tuple[float, float]  # A, mean through a board
    range_voltage: tuple[float, float]  # V of the triangulation sensors
    duty: tuple[float, float, float, float]  # share of time on, read back from the output
    echo: int  # sequence number of the last accepted command
    drop: tuple[float, float] = (0.0, 0.0)  # V that a pulse of a board takes from the supply
    time: float = math.nan  # of acquisition: the host's s at the middle of the window


class Named(NamedTuple):
    """A line of `key=value`: H (who), L and M (limits), S (counters)."""

    letter: str
    values: dict[str, str]


class Accepted(NamedTuple):
    letter: str
    value: int


class Refused(NamedTuple):
    letter: str
    reason: int

    def __str__(self) -> str:
        return f"device refused {self.letter}: {name_of(REASONS, self.reason)}"


class Pong(NamedTuple):
    """The device's clock when the ping arrived and when the answer left."""

    identity: int
    arrived_us: int
    left_us: int


Answer = Named | Accepted | Refused
Message = Telemetry | Answer | Pong


def name_of(names: tuple[str, ...], number: int) -> str:
    """The name of a numbered cause or reason; newer firmware may know more of them."""
    return names[number] if number < len(names) else f"number {number}"


def command(letter: str, *numbers: int) -> str:
    """Body of a command. Raises ValueError: a number that the protocol cannot carry."""
    for number in numbers:
        if not 0 <= number < NUMBERS:
            raise ValueError(f"command {letter} has {number}, expected 0 to {NUMBERS - 1}")
    return " ".join([letter, *map(str, numbers)])


def decode(body: bytes) -> Message:
    """The message in a body whose checksum was right. Raises ProtocolError: an unknown one."""
    packed = body[1:] if body[:1] == b"B" and len(body) == 1 + _BINARY.size else b""
    try:
        letter, *fields = [""] if packed else body.decode("ascii").split(" ")
        if letter == "T":  # packing rejects numbers that a frame could not hold
            packed = _BINARY.pack(*map(int, fields))
        if packed:
            sequence, time_us, state, cause, supply, *rest, echo = _BINARY.unpack(packed)
            drop_front, drop_back, front, back, near, far, *duty = rest
            a, b, c, d = (_DUTY * number for number in duty)
            return Telemetry(sequence, time_us, state, cause, 1e-3 * supply,
                             (1e-3 * front, 1e-3 * back), (1e-4 * near, 1e-4 * far), (a, b, c, d),
                             echo, (1e-3 * drop_front, 1e-3 * drop_back))
        if letter in ("H", "L", "M", "S"):
            return Named(letter, dict(field.split("=", 1) for field in fields))
        if letter == "P":
            identity, arrived, left = map(int, fields)
            return Pong(identity, arrived, left)
        if letter in ("K", "N"):
            about, number = fields
            return (Accepted if letter == "K" else Refused)(about, int(number))
        raise ValueError(letter)
    except (ValueError, struct.error):
        unknown = f"message {body[:40]!r} is not of protocol {PROTOCOL_VERSION}"
        raise ProtocolError(unknown) from None


class Trip(NamedTuple):
    """Why the device last stopped; it stores this without power."""

    cause: int  # 0: it never stopped
    seconds: float  # from the start before it
    open: bool  # not yet acknowledged

    @classmethod
    def from_values(cls, values: Mapping[str, str]) -> "Trip | None":
        """From an H or S line; None if the firmware stores no trips. InputError: not numbers."""
        words = [values.get(key, "") for key in ("trip", "trip_ds", "trip_open")]
        if not any(words):
            return None
        if not all(map(str.isdecimal, words)):
            raise InputError(f"the device's last trip is {words}, expected three numbers")
        cause, tenths, is_open = map(int, words)
        return cls(cause, 0.1 * tenths, is_open > 0)

    def __str__(self) -> str:
        if not self.cause:
            return "none"
        after = "" if self.cause == LOST_CAUSE else f", {self.seconds:.1f} s after a start"
        known = "not acknowledged" if self.open else "acknowledged"
        return f"{name_of(CAUSES, self.cause)}{after}, {known}"


@dataclass(frozen=True)
class DeviceIdentity:
    """The device's handshake: name, build, limits (V, A, s, ohm; hot_voltage: rms in hot_time)."""

    name: str
    build: str
    reset: str
    maximum_voltage: float
    command_timeout: float
    maximum_mean_current: float
    maximum_peak_current: float
    supply_range: tuple[float, float]
    least_resistance: float
    hot_voltage: float
    hot_time: float

    @classmethod
    def from_lines(cls, lines: Mapping[str, Named]) -> "DeviceIdentity":
        """From H, L, M lines. InputError: another protocol or number of channels, a missing key."""
        values = {key: value for line in lines.values() for key, value in line.values.items()}
        try:
            for key, expected in (("protocol", PROTOCOL_VERSION), ("channels", CHANNELS)):
                if int(values[key]) != expected:
                    raise ValueError(f"the device has {key} {values[key]}, expected {expected}")
            cause, flags = int(values["before"]), int(values["reset"])
            reset = ", ".join(name for bit, name in RESETS if flags & bit) or "unknown"
            stopped = f", after: {name_of(CAUSES, cause)}" if cause else ""
            volts, timeout, mean, peak, low, high, *rest = (1e-3 * int(values[key]) for key in (
                "max_mv", "timeout_ms", "mean_ma", "peak_ma", "supply_min_mv", "supply_max_mv",
                "least_mohm", "hot_mv", "hot_ms"))
            return cls(values["name"], values["build"], reset + stopped, volts, timeout, mean,
                       peak, (low, high), *rest)
        except KeyError as error:
            raise InputError(f"handshake: {error.args[0]} is missing") from None
        except ValueError as error:
            raise InputError(f"handshake: {error}") from None


# --- The device's clock in host time, from the messages with the least delay.

_MOST_DRIFT = 1e-2  # an Uno's ceramic resonator is good for half a percent; twice that is broken
_BIN, _WINDOW = 0.1, 30.0  # s of the device's clock; of each bin the least delayed message is used
_PINGS = 400
_PROMPT, _FEWEST_PROMPT = 0.1, 5  # share and least number of pings: those answered most promptly
_SOONEST = 0.2  # quantile of the delay to the device among these
_Points = deque[tuple[float, float]]  # device s, host s


class DeviceClock:
    """Host time = offset + (1 + drift) device time; host times are s of one monotonic clock. Delays
    only make messages later: the highest line below all arrivals has the drift, and lies behind
    the device's clock by the least delay of a frame (Moon, Skelly, Towsley, INFOCOM 1999). Pings
    give this delay, if the fastest ways to the device and back are equally long."""

    def __init__(self) -> None:
        self._last_us: int | None = None
        self._turns, self._frames, self._answers = 0, _Points(), _Points()
        self._pings: deque[tuple[float, float, float, float]] = deque(maxlen=_PINGS)
        self._origin = (math.nan, math.nan)
        self.drift = 0.0  # host seconds per device second, less one
        self.uncertainty = math.inf  # s: half of the least delay to the device and back

    def heard(self, time_us: int, heard: float) -> None:
        """Note a frame that the device stamped `time_us` and that arrived at `heard` (s)."""
        _keep(self._frames, self._seconds(time_us), heard)

    def add(self, sent: float, arrived_us: int, left_us: int, heard: float) -> None:
        """Note a ping that left the host at `sent` (s); its answer arrived at `heard` (s)."""
        arrived, left = self._seconds(arrived_us), self._seconds(left_us)
        if heard < sent or left < arrived:
            return
        _keep(self._answers, left, heard)
        self._pings.append((sent, arrived, left, heard))
        while self._pings[0][1] < arrived - _WINDOW:
            self._pings.popleft()
        # The line below all arrivals, and the delays of the pings relative to it.
        sents, arrivals, lefts, heards = np.array(self._pings).T
        many = 2 * len(self._frames) > len(self._answers)
        level, self.drift = _line_below(self._frames if many else self._answers, arrived)
        back = heards - level - (1.0 + self.drift) * (lefts - arrived)
        there = level + (1.0 + self.drift) * (arrivals - arrived) - sents
        # If the device's own clock lags (an emulated one), the way there looks shorter than it is:
        # only pings with prompt answers show its length.
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
    """Add a message if it is the least delayed of its bin."""
    if points and int(points[-1][0] / _BIN) == int(device / _BIN):
        if host - device < points[-1][1] - points[-1][0]:
            points[-1] = (device, host)
        return
    points.append((device, host))
    while points[0][0] < device - _WINDOW:
        points.popleft()


def _line_below(points: _Points, reference: float) -> tuple[float, float]:
    """Host time at device time `reference`, and drift, of the line below all points that is closest
    to them on average: an edge of their lower convex hull."""
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
