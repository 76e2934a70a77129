"""The serial protocol (docs/serial_protocol.md): lines, frames, and messages in SI units."""

import binascii
import struct
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

LINE_END = b"\n"
FRAME_END = b"\0"
_CHECKSUM_BYTES = 2
# Far above any message: what is longer has lost its end.
_LONGEST = 512


def checksum(body: bytes) -> int:
    """CRC-16/CCITT-FALSE."""
    return binascii.crc_hqx(body, 0xFFFF)


def line(body: str) -> bytes:
    """A command or message as a line, ready to send."""
    encoded = body.encode("ascii")
    return encoded + b"*%04X" % checksum(encoded) + LINE_END


def frame(body: bytes) -> bytes:
    """A message as a binary frame, its delimiter included."""
    sealed = body + checksum(body).to_bytes(_CHECKSUM_BYTES, "little")
    stuffed = b""
    for piece in sealed.split(FRAME_END):
        for at in range(0, max(len(piece), 1), 254):
            block = piece[at : at + 254]
            is_last = at + 254 >= len(piece)
            stuffed += bytes([len(block) + 1 if is_last else 255]) + block
    return stuffed + FRAME_END


def open_line(text: bytes) -> bytes | None:
    """The body of a line without its end; None when the checksum is absent or wrong."""
    text = text.removesuffix(b"\r")
    body, star, digits = text[:-5], text[-5:-4], text[-4:]
    if star != b"*" or digits != b"%04X" % checksum(body):
        return None
    return body


def open_frame(stuffed: bytes) -> bytes | None:
    """The body of a frame without its delimiter; None when it is damaged."""
    sealed = bytearray()
    at = 0
    while at < len(stuffed):
        code = stuffed[at]
        if code == 0 or at + code > len(stuffed):
            return None
        sealed += stuffed[at + 1 : at + code]
        at += code
        if code < 255 and at < len(stuffed):
            sealed.append(0)
    body, crc = bytes(sealed[:-_CHECKSUM_BYTES]), sealed[-_CHECKSUM_BYTES:]
    if not body or int.from_bytes(crc, "little") != checksum(body):
        return None
    return body


class Splitter:
    """Cuts a stream of bytes into the bodies of messages."""

    def __init__(self) -> None:
        self._pending = b""
        self._binary = False
        self._in_step = False
        self.damaged = 0

    @property
    def binary(self) -> bool:
        """True when frames are expected, not lines."""
        return self._binary

    def expect(self, binary: bool) -> None:
        """Forget what is pending and expect frames (`binary`) or lines from here on."""
        self._pending = b""
        self._binary = binary
        self._in_step = False

    def feed(self, received: bytes) -> list[bytes]:
        """Bodies of the messages that `received` completes; damaged ones are counted."""
        end = FRAME_END if self._binary else LINE_END
        *complete, self._pending = (self._pending + received).split(end)
        if len(self._pending) > _LONGEST:
            self.damaged += 1
            self._pending = b""
        return [body for piece in complete if (body := self._open(piece)) is not None]

    def _open(self, piece: bytes) -> bytes | None:
        if not piece.strip():
            return None
        body = open_frame(piece) if self._binary else open_line(piece)
        # The first piece may have begun before this host listened.
        self.damaged += body is None and self._in_step
        self._in_step = True
        return body


# --- messages as values in SI units

PROTOCOL_VERSION = 2
CHANNELS = 4
STOP = b"!"

_LEAST_DUTY = 1.0 / 65536.0
_BINARY = struct.Struct("<HIBBHHHhhHHHHHHH")
_HIGHEST_SEQUENCE = 0xFFFF

CAUSES = (
    "", "stop byte", "command timeout", "over-current of the front board",
    "over-current of the back board", "duty above its limit", "on for longer than allowed",
    "supply out of range", "main loop hung", "converter dead",
    "current with all outputs off", "more current than the outputs explain",
    "more heat than allowed", "output interrupt lost", "an output differs from what was set",
)
TIMEOUT_CAUSE = CAUSES.index("command timeout")
REASONS = (
    "accepted", "wrong checksum", "bad format", "line too long", "not armed",
    "wrong nonce or session", "old sequence number", "above the voltage limit",
    "above the duty limit", "supply out of range or just started", "rate not possible",
    "stopped: reset first", "armed already", "current flows though every output is off",
    "beyond the device's own limits",
)
RESETS = ((1, "power-on"), (2, "reset pin"), (4, "brown-out"), (8, "watchdog"))


class ProtocolError(ValueError):
    """A message with a good checksum that still cannot be understood."""


class DeviceState(IntEnum):
    """Of the device."""

    IDLE = 0
    ARMED = 1
    STOPPED = 2
    STILL_FLOWING = 3
    """stopped, and current flows though every output is off"""


@dataclass(frozen=True, slots=True)
class Telemetry:
    """One window of readings, means over the time before `time_us` of the device's clock."""

    sequence: int
    time_us: int
    state: int
    cause: int
    supply: float
    """V without load"""
    current: tuple[float, float]
    """A, mean through the front and the back board"""
    range_voltage: tuple[float, float]
    """V at the front and the back triangulation sensor"""
    duty: tuple[float, float, float, float]
    """share of the time that each channel is switched on, read back from the output"""
    echo: int
    """sequence number of the last accepted command"""
    drop: tuple[float, float] = (0.0, 0.0)
    """V that a pulse of the front, the back board takes from the supply"""


@dataclass(frozen=True, slots=True)
class Named:
    """A line of `key=value`: H (who), L and M (limits), S (counters)."""

    letter: str
    values: dict[str, str]


@dataclass(frozen=True, slots=True)
class Accepted:
    """`K letter value`."""

    letter: str
    value: int


@dataclass(frozen=True, slots=True)
class Refused:
    """`N letter reason`."""

    letter: str
    reason: int

    def __str__(self) -> str:
        return f"device refused {self.letter}: {name_of(REASONS, self.reason)}"


@dataclass(frozen=True, slots=True)
class Pong:
    """`P id arrived left`: the device's clock when the ping came and when the answer went."""

    identity: int
    arrived_us: int
    left_us: int


Message = Telemetry | Named | Accepted | Refused | Pong


def name_of(names: tuple[str, ...], number: int) -> str:
    """The name of a numbered cause or reason; newer firmware may know more of them."""
    return names[number] if number < len(names) else f"number {number}"


def resets(flags: int) -> str:
    """Words for the reset flags of an H line."""
    return ", ".join(name for bit, name in RESETS if flags & bit) or "unknown"


def command(letter: str, *numbers: int) -> str:
    """Body of a command.

    Raises:
        ValueError: a number that the protocol cannot carry.
    """
    for number in numbers:
        if not 0 <= number <= _HIGHEST_SEQUENCE:
            raise ValueError(f"command {letter} has {number}, expected 0 to {_HIGHEST_SEQUENCE}")
    return " ".join([letter, *map(str, numbers)])


def decode(body: bytes) -> Message:
    """The message in a body whose checksum was right.

    Raises:
        ProtocolError: it is not one that this host knows.
    """
    if body[:1] == b"B" and len(body) == 1 + _BINARY.size:
        return _telemetry(_BINARY.unpack(body[1:]))
    try:
        letter, *fields = body.decode("ascii").split(" ")
        return _DECODERS[letter](letter, fields)
    except (KeyError, ValueError, IndexError, struct.error):
        raise ProtocolError(
            f"message {body[:40]!r} is not of protocol {PROTOCOL_VERSION}"
        ) from None


def _telemetry(fields: tuple[int, ...]) -> Telemetry:
    sequence, time_us, state, cause, supply, *others = fields
    *drop, front, back, near, far, a, b, c, d, echo = others
    return Telemetry(
        sequence, time_us, state, cause, 1e-3 * supply, (1e-3 * front, 1e-3 * back),
        (1e-4 * near, 1e-4 * far),
        (a * _LEAST_DUTY, b * _LEAST_DUTY, c * _LEAST_DUTY, d * _LEAST_DUTY), echo,
        (1e-3 * drop[0], 1e-3 * drop[1]),
    )


def _named(letter: str, fields: list[str]) -> Named:
    pairs = [field.split("=", 1) for field in fields]
    return Named(letter, {pair[0]: pair[1] for pair in pairs})


def _typed(fields: list[str], *kinds: type) -> list[Any]:
    return [kind(field) for kind, field in zip(kinds, fields, strict=True)]


_DECODERS: dict[str, Callable[[str, list[str]], Message]] = {
    # Packing them refuses what a frame could not carry.
    "T": lambda _, fields: _telemetry(_BINARY.unpack(_BINARY.pack(*map(int, fields)))),
    "H": _named, "L": _named, "M": _named, "S": _named,
    "K": lambda _, fields: Accepted(*_typed(fields, str, int)),
    "N": lambda _, fields: Refused(*_typed(fields, str, int)),
    "P": lambda _, fields: Pong(*_typed(fields, int, int, int)),
}
