"""The link to the bench's Uno: one thread reads, whoever drives the bench writes.

It connects by itself, again and again, and never arms by itself. The newest command is said again
while its driver is late, for a quarter of a second: a busy host, or a byte lost on the way, ends
nothing. A driver that hangs is spoken for no longer, and the device's own timeout switches off.
"""

import contextlib
import copy
import math
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

from sma_bench.errors import InputError
from sma_bench.hardware.conversation import Conversation, LinkError, Port, transmission_time
from sma_bench.hardware.device import (
    HANDSHAKE_LINES,
    DeviceClock,
    DeviceIdentity,
    LinkStatus,
    Reading,
)
from sma_bench.hardware.serial_messages import (
    CHANNELS,
    STOP,
    TIMEOUT_CAUSE,
    DeviceState,
    Message,
    Named,
    Pong,
    Refused,
    Telemetry,
    command,
)

BINARY_ABOVE = 100
"""Hz: text telemetry up to here, binary above."""

_ASKS = 3
_LONGEST_WAIT = 0.1
_NUMBERS = 1 << 16
# s between two sendings of a command, and how long its driver may be away meanwhile.
_REPEAT = 0.05
_SPOKEN_FOR = 0.25
_REMEMBERED = 64
# Of the device's timeout: a pause in which all is this host's fault.
_LONG_PAUSE = 0.75


@dataclass(frozen=True)
class LinkOptions:
    """Times in s, rate of telemetry in Hz (a divisor of 1000, to 500)."""

    rate: int = 100
    # No multiple of a telemetry period: pings must meet the pauses between frames too.
    ping_period: float = 0.0837
    counters_period: float = 1.0
    greeting_timeout: float = 2.5
    silence_limit: float = 1.0
    first_back_off: float = 0.5
    longest_back_off: float = 8.0


def _ignore(_: object) -> None:
    pass


class SerialLink:
    """See the module. `on_reading` and `on_event` are called in the link's own thread."""

    def __init__(
        self,
        open_port: Callable[[], Port],
        options: LinkOptions | None = None,
        on_reading: Callable[[Reading], None] = _ignore,
        on_event: Callable[[str], None] = _ignore,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._open_port = open_port
        self._options = options or LinkOptions()
        self._on_reading = on_reading
        self._on_event = on_event
        self._now = clock
        self._conversation: Conversation | None = None
        self._device_clock = DeviceClock()
        self._status = LinkStatus()
        self._changed = threading.Condition()
        self._driving = threading.Lock()
        self._session: int | None = None
        self._sequence = 0
        self._volts: tuple[int, ...] = ()
        self._said: deque[float] = deque(maxlen=_REMEMBERED)
        self._drove = self._refused = -math.inf
        self._unheard: tuple[int, float] | None = None
        self._ping = (0, 0.0)
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._live, name="serial link", daemon=True)

    # --- for whoever drives the bench ---------------------------------------------------------

    def start(self) -> None:
        """Begin to connect; returns at once."""
        self._thread.start()

    def close(self) -> None:
        """Outputs off, port closed."""
        self.stop()
        self._closing.set()
        if self._thread.is_alive():
            self._thread.join()

    @property
    def status(self) -> LinkStatus:
        """A copy of the present state and counts."""
        with self._changed:
            return copy.copy(self._status)

    def wait_connected(self, timeout: float) -> bool:
        """True as soon as the handshake succeeded, False after `timeout` s."""
        with self._changed:
            return self._changed.wait_for(lambda: self._status.connected, timeout)

    def arm(self) -> None:
        """Ask the device to accept voltages.

        Raises:
            LinkError: not connected, stopped, no supply, no answer.
        """
        conversation = self._connected()
        conversation.unasked = self._status.unasked = ""
        greeting = conversation.ask_named("?", "H")["H"]
        if "nonce" not in greeting.values:
            raise LinkError("the device has just restarted")
        session = conversation.ask_for_consent("A", int(greeting.values["nonce"]))
        self._status.last_refusal = self._status.silence = ""
        with self._driving:
            self._session, self._sequence, self._unheard = session, 0, None
            # Spoken for from now on, at 0 V.
            self._said.clear()
            self._volts, self._drove = (0,) * CHANNELS, self._now()

    def limit(self, numbers: Sequence[int]) -> None:
        """Set the device's limits for this rig: mV, mA mean, mA peak, mohm, mV and ms of heat.

        Raises:
            LinkError: not connected, armed, beyond the device's own limits, no answer.
        """
        self._connected().ask_for_consent("C", *numbers)

    def drive(self, millivolts: Sequence[int]) -> int:
        """Send one voltage command (mV, four channels); its sequence number, echoed by telemetry.

        Raises:
            LinkError: not armed, or the port is gone.
            ValueError: not four numbers that the protocol can carry.
        """
        if len(millivolts) != CHANNELS:
            raise ValueError(f"{len(millivolts)} voltages, expected {CHANNELS}")
        with self._driving:
            self._volts = tuple(millivolts)
            self._drove = self._now()
            return self._say_volts()

    def _say_volts(self) -> int:
        if self._session is None:
            raise LinkError("not armed")
        sequence = (self._sequence + 1) % _NUMBERS
        conversation = self._connected()
        try:
            conversation.say("V", self._session, sequence, *self._volts)
        except LinkError as error:  # the writer may know before the link's thread does
            raise LinkError(f"not connected: {error}") from None
        self._sequence = sequence
        self._said.append(self._now())
        self._unheard = self._unheard or (sequence, self._now())
        return sequence

    def stop(self) -> None:
        """Emergency stop: one byte, never refused; harmless when nothing is connected."""
        self._session = None
        conversation = self._conversation
        if conversation is not None:
            with contextlib.suppress(LinkError):
                conversation.send(STOP)

    def disarm(self) -> None:
        """Outputs off, without a latched cause.

        Raises:
            LinkError: not connected, no answer.
        """
        self._session = None
        self._connected().ask_for_consent("D")

    def reset(self) -> None:
        """Forget the latched cause; arming is another request.

        Raises:
            LinkError: not connected, no answer.
        """
        self._session = None
        self._connected().ask_for_consent("R")
        with self._changed:
            # The next telemetry says the same, a little later.
            self._status.state, self._status.cause = DeviceState.IDLE, 0

    def counters(self) -> dict[str, int]:
        """The device's own counters (S line).

        Raises:
            LinkError: not connected, no answer.
        """
        line = self._connected().ask_named("S", "S")["S"]
        return {key: int(value) for key, value in line.values.items()}

    def _connected(self) -> Conversation:
        conversation = self._conversation
        if conversation is None or not self._status.connected:
            raise LinkError(f"not connected: {self._status.problem or 'no handshake yet'}")
        return conversation

    # --- the thread ---------------------------------------------------------------------------

    def _live(self) -> None:
        back_off = self._options.first_back_off
        while not self._closing.is_set():
            try:
                conversation = self._connect()
                back_off = self._options.first_back_off
                self._serve(conversation)
            except (OSError, LinkError, InputError) as error:
                self._lose(str(error))
            except Exception as error:  # a thread that died would go on looking connected
                self._lose(f"{type(error).__name__}: {error}")
            lost, self._conversation = self._conversation, None
            if lost is not None:
                with contextlib.suppress(OSError):
                    lost.close()
            self._closing.wait(back_off)
            back_off = min(2.0 * back_off, self._options.longest_back_off)

    def _connect(self) -> Conversation:
        conversation = Conversation(self._open_port(), self._now)
        self._conversation = conversation
        self._device_clock = DeviceClock()
        # Opening may have reset the device; asking its bootloader would hold it there.
        until = self._now() + self._options.greeting_timeout
        while self._now() < until and not self._closing.is_set():
            if conversation.receive()[0]:
                break
        device = self._identify(conversation)
        binary = self._options.rate > BINARY_ABOVE
        conversation.say("B" if binary else "T", self._options.rate)
        conversation.expect(binary)
        with self._changed:
            self._status.start_anew(device)
            self._changed.notify_all()
        self._on_event(f"connected to {device.name} {device.build}, last reset: {device.reset}")
        return conversation

    def _identify(self, conversation: Conversation) -> DeviceIdentity:
        for _ in range(_ASKS):
            # Ends whatever a former host left of a line, and its binary mode.
            conversation.send(b"\n")
            conversation.say("T", BINARY_ABOVE)
            with contextlib.suppress(LinkError):
                return DeviceIdentity.from_lines(
                    conversation.ask_named("?", HANDSHAKE_LINES, pump=True)
                )
        raise LinkError("no answer to the handshake: is the bench's firmware on this port?")

    def _serve(self, conversation: Conversation) -> None:
        last = next_ping = self._now()
        next_count = last + self._options.counters_period
        silence = 0.0
        while not self._closing.is_set():
            messages, now = conversation.receive(next_ping - self._now())
            for message in messages:
                self._act(message, now)
            self._status.damaged = conversation.damaged
            self._status.not_understood = conversation.not_understood
            self._status.unasked = conversation.unasked
            # A host that was stopped itself has not listened: no wait counts for longer than asked.
            silence = 0.0 if messages else silence + min(now - last, _LONGEST_WAIT)
            last = now
            with self._driving, contextlib.suppress(LinkError):  # its driver is late
                said = self._said[-1] if self._said else -math.inf
                if now - said > _REPEAT and now - self._drove < _SPOKEN_FOR:
                    self._say_volts()
            if silence > self._options.silence_limit:
                raise LinkError(f"the device is silent for {silence:.2f} s")
            if now >= next_ping:
                next_ping = now + self._options.ping_period
                number = (self._ping[0] + 1) % _NUMBERS
                conversation.say("P", number)
                # Its last byte leaves when the cable has carried all of them.
                self._ping = (number, self._now() + transmission_time(command("P", number)))
            # Not together with a ping: at 500 Hz there is no time for two answers in a window.
            if now >= next_count and next_ping - now < 0.5 * self._options.ping_period:
                next_count = now + self._options.counters_period
                conversation.say("S")

    def _act(self, message: Message, now: float) -> None:
        if isinstance(message, Telemetry):
            self._take(message, now)
        elif isinstance(message, Pong):
            number, sent = self._ping
            if message.identity == number:
                self._device_clock.add(sent, message.arrived_us, message.left_us, now)
                self._status.round_trip = now - sent
                self._status.drift = self._device_clock.drift
                self._status.clock_uncertainty = self._device_clock.uncertainty
        elif isinstance(message, Refused):
            self._status.refused += 1
            self._status.last_refusal, self._refused = str(message), now
        elif isinstance(message, Named) and message.letter == "S":
            self._status.counters = {key: int(value) for key, value in message.values.items()}
        elif isinstance(message, Named) and message.letter == "H" and "nonce" not in message.values:
            # Clock and count may have gone on as if nothing had happened: a host that stood still
            # for as long as the device ran before sees no step.
            raise LinkError("the device restarted by itself")

    def _why_silent(self, now: float) -> str:
        with self._driving:
            said = (*self._said, now)
        device = self._status.device
        pause = max((after - before for before, after in pairwise(said)), default=0.0)
        timeout = device.command_timeout if device else math.inf
        if pause > _LONG_PAUSE * timeout:
            return f"this computer sent nothing for {pause:.2f} s"
        return self._status.last_refusal if now - self._refused < 2.0 * timeout else ""

    def _take(self, telemetry: Telemetry, now: float) -> None:
        if telemetry.state > max(DeviceState):
            raise LinkError(f"the device is in state {telemetry.state}, which nobody knows here")
        if self._status.restarted(telemetry, round(1e6 / self._options.rate)):
            raise LinkError("the device restarted by itself")
        with self._changed:
            stopped_already = self._status.stopped
            if telemetry.cause == TIMEOUT_CAUSE and not stopped_already:
                self._status.silence = self._why_silent(now)
            self._status.note(telemetry)
        if self._status.stopped and not stopped_already:
            self._session = None
            self._on_event(f"the device stopped: {self._status.cause_text}")
        if self._unheard is not None:
            sequence, sent = self._unheard
            if (telemetry.echo - sequence) % _NUMBERS < _NUMBERS // 2:
                self._status.command_latency, self._unheard = now - sent, None
        self._device_clock.heard(telemetry.time_us, now)
        if self._device_clock.synchronised:
            # A window cannot end after it was received.
            ended = min(self._device_clock.host_time(telemetry.time_us), now)
            self._on_reading(Reading(telemetry, ended - 0.5 / self._options.rate))

    def _lose(self, problem: str) -> None:
        with self._changed:
            news = self._status.connected or problem != self._status.problem
            self._status.connected, self._status.problem = False, problem
            self._changed.notify_all()
        # After the reason is known: the driver's next command must not get "not armed".
        if self._session is not None:
            self.stop()
        if news:
            self._on_event(f"not connected: {problem}")
