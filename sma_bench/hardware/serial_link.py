"""The serial link to the bench's Uno: an exclusive port, a thread that reads, callers that drive.

It connects and reconnects by itself, but never arms by itself. While the caller is late, the newest
command is repeated for a quarter of a second: a busy host or a lost byte stops nothing. When the
caller hangs for longer the repetition ends, and the device's own timeout switches off."""

import contextlib
import copy
import fcntl
import math
import os
import select
import termios
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import serial

from sma_bench.errors import InputError
from sma_bench.hardware import serial_messages as messages
from sma_bench.hardware.serial_messages import NUMBERS, DeviceState, Named, Refused, Telemetry

BY_ID = Path("/dev/serial/by-id")
BAUD_RATE, _BITS_PER_BYTE = 500_000, 10
_READ_TIMEOUT, _WRITE_TIMEOUT = 0.05, 0.2  # s
BINARY_ABOVE = 100  # Hz: text telemetry up to here, binary above
_ASKS, _ANSWER_TIMEOUT = 3, 0.5  # s; the device answers within a few ms
_LATEST = 5.0  # s after our timeout until which an answer may be ours, not another host's
_LONGEST_WAIT = 0.1  # s of silence that one read counts for
_REPEAT_PERIOD, _REPEAT_FOR = 0.05, 0.25  # s, of the newest command; after its caller gave it
_PING_PERIOD = 0.0837  # s, no multiple of a window: pings must meet pauses between frames
_COUNTERS_PERIOD, SILENCE_LIMIT = 1.0, 1.0  # s
_REMEMBERED, _TICK = 64, 1e-6  # commands whose times are kept; s between two stamps, at least
_LONGEST_WINDOW = 1_100_000  # us, at the lowest rate of 1 Hz, with one window of another rate
_LONG_PAUSE = 0.75  # share of the device's timeout: after a longer pause this host is the cause
_DRIVING_COMMANDS = "ACDR"  # an answer to one of these that was not asked shows another host
_NOT_OUR_SESSION = messages.REASONS.index("wrong nonce or session")


class LinkError(Exception):
    """The device did not do what was asked; one line says why."""


class LateAnswer(LinkError):
    """No answer in time; the device may have obeyed."""


def find_port(folder: Path = BY_ID) -> str:
    """The only serial device with a stable name. InputError: none, or several."""
    names = sorted(map(str, folder.glob("*")))  # none if there is no such folder
    if len(names) != 1:
        found = ", ".join(names) or "none"
        raise InputError(f"port: {found} in {folder}, expected one device, or give the port")
    return names[0]


class _ExclusivePort(serial.Serial):
    """A port that no other program can open, not even one that ignores pyserial's lock."""

    def open(self) -> None:
        super().open()
        try:
            fcntl.ioctl(self.fileno(), termios.TIOCEXCL)
        except OSError:
            self.close()
            raise

    def write(self, data: bytes) -> int:
        """Write all of `data`. pyserial's own may report a timeout when all has been written."""
        left, end = memoryview(data), time.monotonic() + _WRITE_TIMEOUT
        while left:
            try:
                left = left[os.write(self.fileno(), left) :]
            except BlockingIOError:
                pass
            except OSError as error:
                raise serial.SerialException(f"write failed: {error}") from None
            patience = max(end - time.monotonic(), 0.0)
            if left and not select.select([], [self.fileno()], [], patience)[1]:
                raise serial.SerialTimeoutException("Write timeout")
        return len(data)

    def close(self) -> None:
        if self.is_open:
            with contextlib.suppress(OSError):
                fcntl.ioctl(self.fileno(), termios.TIOCNXCL)
        super().close()


def open_port(path: str) -> serial.Serial:
    """Open `path` exclusively. OSError: it cannot be opened, or another host has it."""
    return _ExclusivePort(path, BAUD_RATE, timeout=_READ_TIMEOUT, write_timeout=_WRITE_TIMEOUT,
                          exclusive=True)


@dataclass
class LinkStatus:
    """State of device and link; counts are since the start, those with * of this connection."""

    connected: bool = False
    device: messages.DeviceIdentity | None = None
    state: DeviceState = DeviceState.IDLE
    cause: int = 0
    trip: messages.Trip | None = None  # the last one, which the device stores without power
    left: str = ""  # fault from before this connection, until it is acknowledged
    telemetry: int = 0
    lost: int = 0
    damaged: int = 0  # *
    not_understood: int = 0  # *
    refused: int = 0
    last_refusal: str = ""
    silence: str = ""  # cause of the device's command timeout, as far as this host knows
    unasked: str = ""  # newest answer to another host's question since this host armed
    counters: dict[str, str] = field(default_factory=dict)  # the device's own, once a second
    connections: int = 0
    round_trip: float = math.nan  # s, of a ping
    command_latency: float = math.nan  # s, from a command to the telemetry that echoes it
    drift: float = 0.0
    clock_uncertainty: float = math.inf  # s
    problem: str = ""
    newest: Telemetry | None = field(default=None, repr=False)  # *

    @property
    def stopped(self) -> bool:
        return self.state in (DeviceState.STOPPED, DeviceState.STILL_FLOWING)

    @property
    def cause_text(self) -> str:
        """Why the device stopped, in words; "" when it did not."""
        return messages.name_of(messages.CAUSES, self.cause)

    @property
    def fault(self) -> str:
        """Why the device cannot drive, "" when it can."""
        if not self.connected:
            return f"not connected: {self.problem or 'no handshake yet'}"
        if not self.stopped:
            return self.left
        timed_out = self.cause == messages.TIMEOUT_CAUSE and self.silence
        return f"{self.cause_text}, found by the device{f' ({self.silence})' if timed_out else ''}"

    def note(self, telemetry: Telemetry) -> None:
        if self.newest is not None:
            self.lost += (telemetry.sequence - self.newest.sequence - 1) % NUMBERS
        self.newest = telemetry
        self.telemetry += 1
        self.state, self.cause = DeviceState(telemetry.state), telemetry.cause

    def restarted(self, telemetry: Telemetry, period_us: int) -> bool:
        """True if the device restarted since the last frame: its clock went back or, where the
        clock's wrap hides that, the time does not match the missed windows of `period_us`."""
        if self.newest is None:
            return False
        elapsed = (telemetry.time_us - self.newest.time_us) % messages.TURN
        windows = (telemetry.sequence - self.newest.sequence) % NUMBERS
        left = (elapsed - windows * period_us + period_us) % (NUMBERS * period_us)
        # The window in which the rate was set is shorter or longer, but never that long.
        is_next = windows == 1 and elapsed < _LONGEST_WINDOW
        return elapsed > messages.TURN // 2 or (not is_next and left > 2 * period_us)

    @property
    def diagnostics(self) -> dict[str, Any]:
        """Values to publish; their names contain the units."""
        values = {"connections": self.connections, "frames": self.telemetry,
                  "lost_frames": self.lost, "crc_errors": self.damaged,
                  "not_understood": self.not_understood, "refused_by_device": self.refused,
                  "last_refusal": self.last_refusal,
                  "round_trip_ms": f"{1e3 * self.round_trip:.2f}",
                  "command_latency_ms": f"{1e3 * self.command_latency:.1f}",
                  "clock_drift_ppm": f"{1e6 * self.drift:.0f}",
                  "clock_uncertainty_ms": f"{1e3 * self.clock_uncertainty:.3f}"}
        if device := self.device:
            values |= {"firmware": f"{device.name} {device.build}", "last_reset": device.reset}
            values["last_trip"] = str(self.trip or "not kept by this firmware")
        return values | {f"device_{name}": count for name, count in self.counters.items()}


class SerialLink:
    """See the module. `on_reading` and `on_event` are called in the link's own thread."""

    greeting_timeout, first_back_off, longest_back_off = 2.5, 0.5, 8.0  # s

    def __init__(self, open_port: Callable[[], serial.Serial], rate: int = 100,
                 on_reading: Callable[[Telemetry], None] = lambda _: None,
                 on_event: Callable[[str], None] = lambda _: None,
                 clock: Callable[[], float] = time.monotonic) -> None:
        """`rate` of telemetry: Hz, a divisor of 1000, to 500."""
        self._open_port, self._rate, self._now = open_port, rate, clock
        self._on_reading, self._on_event = on_reading, on_event
        self._status = LinkStatus()
        self._heard = threading.Condition()  # an answer, or a change of the status
        # The connection: port, decoding, last ping, and the pending question.
        self._port: serial.Serial | None = None
        self._writing = threading.Lock()
        self._splitter, self._clock = messages.Splitter(), messages.DeviceClock()
        self._ping, self._ended = (0, 0.0), -math.inf  # number, s; end of the last window, s
        self._one_question, self._asked = threading.Lock(), ""
        self._answers: dict[str, messages.Answer] = {}
        self._overdue: dict[str, float] = {}  # letter of a late answer: s when we gave up
        # The session: its number, the newest command, times (s), and what is not yet echoed.
        self._driving = threading.Lock()
        self._session: int | None = None
        self._sequence, self._driven_at, self._refused_at = 0, -math.inf, -math.inf
        self._volts: tuple[int, ...] = ()
        self._sent_at: deque[float] = deque(maxlen=_REMEMBERED)
        self._not_echoed: tuple[int, float] | None = None
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._live, name="serial link", daemon=True)

    def start(self) -> None:
        """Begin to connect; returns at once."""
        self._thread.start()

    def close(self) -> None:
        self.stop()
        self._closing.set()
        if self._thread.is_alive():
            self._thread.join()

    @property
    def status(self) -> LinkStatus:
        with self._heard:
            return copy.copy(self._status)

    def wait_connected(self, timeout: float) -> bool:
        """True as soon as the handshake succeeded, False after `timeout` s."""
        with self._heard:
            return self._heard.wait_for(lambda: self._status.connected, timeout)

    # All but `stop` raise LinkError: not connected, no answer, or the device's refusal.

    def arm(self) -> None:
        """Make the device accept voltages; it refuses while stopped or without supply."""
        self._require_connected()
        self._status.unasked = ""
        greeting = self._ask("?", answer="H")
        if not isinstance(greeting, Named) or "nonce" not in greeting.values:
            raise LinkError("the device has just restarted")
        armed = self._ask("A", int(greeting.values["nonce"]))
        self._status.last_refusal = self._status.silence = ""
        with self._driving:
            self._session = armed.value if isinstance(armed, messages.Accepted) else None
            # 0 V is repeated from now on, until the caller's first command.
            self._sequence, self._volts, self._driven_at = 0, (0,) * messages.CHANNELS, self._now()
            self._not_echoed = None
            self._sent_at.clear()

    def limit(self, numbers: Sequence[int]) -> None:
        """Set limits within the device's own (mV, mA mean and peak, mohm, mV and ms of heat)."""
        self._require_connected()
        self._ask("C", *numbers)

    def drive(self, millivolts: Sequence[int]) -> None:
        """Send four voltages (mV). ValueError: not four, or too large for the protocol."""
        if len(millivolts) != messages.CHANNELS:
            raise ValueError(f"{len(millivolts)} voltages, expected {messages.CHANNELS}")
        with self._driving:
            self._volts, self._driven_at = tuple(millivolts), self._now()
            self._send_volts()

    def stop(self) -> None:
        """Emergency stop: one byte, never refused; harmless when nothing is connected."""
        self._session = None
        with contextlib.suppress(LinkError):
            self._send(messages.STOP)

    def reset(self) -> None:
        """Clear the latched cause; does not arm."""
        self._session = None
        self._require_connected()
        self._ask("R")
        with self._heard:  # the next telemetry says the same, a little later
            self._status.state, self._status.cause, self._status.left = DeviceState.IDLE, 0, ""

    def _require_connected(self) -> None:
        if not self._status.connected:
            raise LinkError(self._status.fault)

    def _send_volts(self) -> None:
        if self._session is None:
            raise LinkError("not armed")
        self._require_connected()
        sequence = (self._sequence + 1) % NUMBERS
        try:
            self._send_command("V", self._session, sequence, *self._volts)
        except LinkError as error:  # the caller may notice before the link's thread does
            raise LinkError(f"not connected: {error}") from None
        self._sequence = sequence
        self._sent_at.append(self._now())
        self._not_echoed = self._not_echoed or (sequence, self._now())

    def _send(self, data: bytes) -> None:
        with self._writing:
            if self._port is None:
                raise LinkError("the port is closed")
            try:
                self._port.write(data)
            except OSError as error:
                raise LinkError(f"cannot write: {error}") from None

    def _send_command(self, letter: str, *numbers: int) -> float:
        """Send a command without waiting for an answer; returns its time on the cable (s)."""
        data = messages.line(messages.command(letter, *numbers))
        self._send(data)
        return _BITS_PER_BYTE * len(data) / BAUD_RATE

    def _ask(self, letter: str, *numbers: int, answer: str = "") -> messages.Answer:
        """Send a command and return its answer; `answer`: letter of that, if not the command's.
        LateAnswer: none in time. LinkError: a refusal, or a closed port."""
        with self._one_question:
            port, self._answers, self._asked = self._port, {}, letter
            try:
                self._send_command(letter, *numbers)
                until = self._now() + _ANSWER_TIMEOUT
                with self._heard:
                    while (found := self._answers.get(answer or letter)) is None:
                        if self._port is not port or self._now() > until:
                            self._overdue[letter] = self._now()
                            raise LateAnswer(f"no answer to {letter}")
                        self._heard.wait(_READ_TIMEOUT)
            finally:
                self._asked = ""
        if isinstance(found, Refused):
            raise LinkError(str(found))
        return found

    def _receive(self, patience: float = _READ_TIMEOUT) -> tuple[list[messages.Message], float]:
        """Messages received within `patience` s, and when (host time). OSError: no port."""
        port = self._port
        assert port is not None
        port.timeout = max(patience, 0.0)
        received, now = port.read(max(1, port.in_waiting)), self._now()
        found: list[messages.Message] = []
        for body in self._splitter.feed(received):
            try:
                found.append(messages.decode(body))
            except messages.ProtocolError:
                self._status.not_understood += 1
        self._status.damaged = self._splitter.damaged
        return found, now

    def _live(self) -> None:
        back_off = self.first_back_off
        while not self._closing.is_set():
            try:
                self._connect()
                back_off = self.first_back_off
                self._serve()
            except Exception as error:  # if the thread died the status would stay "connected"
                known = isinstance(error, OSError | LinkError | InputError)
                problem = f"{'' if known else type(error).__name__ + ': '}{error}"
                with self._heard:
                    is_new = self._status.connected or problem != self._status.problem
                    self._status.connected, self._status.problem = False, problem
                    self._heard.notify_all()
                # Only now: the caller's next command must get the problem, not "not armed".
                if self._session is not None:
                    self.stop()
                if is_new:
                    self._on_event(f"not connected: {problem}")
            with self._writing:
                lost, self._port = self._port, None
                if lost is not None:
                    with contextlib.suppress(OSError):
                        lost.close()
            self._closing.wait(back_off)
            back_off = min(2.0 * back_off, self.longest_back_off)

    def _connect(self) -> None:
        status = self._status
        self._splitter, self._clock = messages.Splitter(), messages.DeviceClock()
        status.not_understood, status.unasked = 0, ""
        self._port = self._open_port()
        # Opening may have reset the device; bytes would keep it in its bootloader.
        until = self._now() + self.greeting_timeout
        while self._now() < until and not self._closing.is_set():
            if self._receive()[0]:
                break
        lines: dict[str, Named] = {}
        for _ in range(_ASKS):
            self._send(messages.LINE_END)  # ends an unfinished line of an earlier host
            self._send_command("T", BINARY_ABOVE)  # ends its binary mode
            self._send_command("?")
            until = self._now() + _ANSWER_TIMEOUT
            while self._now() < until and not lines.keys() >= set("HLM"):
                lines |= {m.letter: m for m in self._receive()[0] if isinstance(m, Named)}
            if lines.keys() >= set("HLM"):
                break
        else:
            raise LinkError("no answer to the handshake: is the bench's firmware on this port?")
        device = messages.DeviceIdentity.from_lines(lines)
        trip = messages.Trip.from_values(lines["H"].values)
        binary = self._rate > BINARY_ABOVE
        self._send_command("B" if binary else "T", self._rate)
        self._splitter.expect(binary)
        with self._heard:
            # With `newest` None, the first frame does not count as a restart or as losses.
            status.connected, status.device, status.problem = True, device, ""
            status.connections += 1
            status.state, status.cause, status.newest = DeviceState.IDLE, 0, None
            status.trip, status.left = trip, f"earlier: {trip}" if trip and trip.open else ""
            self._heard.notify_all()
        self._on_event(f"connected to {device.name} {device.build}, last reset: {device.reset}")

    def _serve(self) -> None:
        last = next_ping = self._now()
        next_count = last + _COUNTERS_PERIOD
        silence = 0.0
        while not self._closing.is_set():
            received, now = self._receive(next_ping - self._now())
            for message in received:
                self._act(message, now)
            # A host that was suspended itself has not listened: limit what one wait counts for.
            silence = 0.0 if received else silence + min(now - last, _LONGEST_WAIT)
            last = now
            with self._driving, contextlib.suppress(LinkError):  # repeat if the caller is late
                sent = self._sent_at[-1] if self._sent_at else -math.inf
                if now - sent > _REPEAT_PERIOD and now - self._driven_at < _REPEAT_FOR:
                    self._send_volts()
            if silence > SILENCE_LIMIT:
                raise LinkError(f"the device is silent for {silence:.2f} s")
            if now >= next_ping:
                next_ping = now + _PING_PERIOD
                number = (self._ping[0] + 1) % NUMBERS
                # It counts as sent when the cable has carried its last byte.
                on_cable = self._send_command("P", number)
                self._ping = number, self._now() + on_cable
            # Not together with a ping: at 500 Hz there is no time for two answers in a window.
            if now >= next_count and next_ping - now < 0.5 * _PING_PERIOD:
                next_count = now + _COUNTERS_PERIOD
                self._send_command("S")

    def _act(self, message: messages.Message, now: float) -> None:
        status = self._status
        if isinstance(message, Named | messages.Accepted | Refused):
            # Compare before handing over: the thread that asked then clears `_asked`.
            letter = message.letter
            foreign = letter in _DRIVING_COMMANDS and letter != self._asked
            if isinstance(message, Refused) and letter == "V":
                foreign = message.reason == _NOT_OUR_SESSION
            if foreign and now - self._overdue.pop(letter, -math.inf) > _LATEST:
                status.unasked = str(message)
            with self._heard:
                self._answers[letter] = message
                self._heard.notify_all()
        if isinstance(message, messages.Pong):
            number, sent = self._ping
            if message.identity == number:
                self._clock.add(sent, message.arrived_us, message.left_us, now)
                status.round_trip, status.drift = now - sent, self._clock.drift
                status.clock_uncertainty = self._clock.uncertainty
        elif isinstance(message, Refused):
            status.refused += 1
            status.last_refusal, self._refused_at = str(message), now
        elif isinstance(message, Named) and message.letter == "S":
            status.trip = messages.Trip.from_values(message.values)
            status.counters = {k: v for k, v in message.values.items() if "trip" not in k}
        elif isinstance(message, Named) and message.letter == "H" and "nonce" not in message.values:
            # The greeting of a restart. Clock and sequence may show no step: if this host was
            # suspended for as long as the device had run before, they seem to go on.
            raise LinkError("the device restarted by itself")
        if not isinstance(message, Telemetry):
            return
        # A window of readings.
        if message.state > max(DeviceState):
            raise LinkError(f"device state {message.state}, expected 0 to {max(DeviceState):d}")
        if status.restarted(message, round(1e6 / self._rate)):
            raise LinkError("the device restarted by itself")
        with self._heard:
            stopped_already = status.stopped
            if message.cause == messages.TIMEOUT_CAUSE and not stopped_already:
                status.silence = self._why_silent(now)
            status.note(message)
        if status.stopped and not stopped_already:
            self._session = None
            self._on_event(f"the device stopped: {status.cause_text}")
        if self._not_echoed is not None:
            sequence, sent = self._not_echoed
            if (message.echo - sequence) % NUMBERS < NUMBERS // 2:
                status.command_latency, self._not_echoed = now - sent, None
        self._clock.heard(message.time_us, now)
        ended = self._clock.host_time(message.time_us)
        if not math.isnan(ended):
            # A window cannot end after it was received or before the previous one, though the
            # estimate of the device's clock still changes, by milliseconds in the first seconds.
            self._ended = max(min(ended, now), self._ended + _TICK)
            self._on_reading(message._replace(time=self._ended - 0.5 / self._rate))

    def _why_silent(self, now: float) -> str:
        with self._driving:
            times = (*self._sent_at, now)
        device = self._status.device
        pause = max((after - before for before, after in pairwise(times)), default=0.0)
        timeout = device.command_timeout if device else math.inf
        if pause > _LONG_PAUSE * timeout:
            return f"this computer sent nothing for {pause:.2f} s"
        return self._status.last_refusal if now - self._refused_at < 2.0 * timeout else ""
