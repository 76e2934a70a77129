"""The device's port: found and opened for one host only, and questions and answers on it; a new
connection is a new conversation.
"""

import contextlib
import fcntl
import os
import select
import termios
import threading
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Protocol

import serial

from sma_bench.errors import InputError
from sma_bench.hardware.serial_messages import (
    REASONS,
    Accepted,
    Message,
    Named,
    Pong,
    ProtocolError,
    Refused,
    Splitter,
    Telemetry,
    command,
    decode,
    line,
)

BAUD_RATE = 500_000
_BITS_PER_BYTE = 10
BY_ID = Path("/dev/serial/by-id")
_READ_TIMEOUT = 0.05
_WRITE_TIMEOUT = 0.2


def transmission_time(body: str) -> float:
    """s that a line takes on the cable."""
    return _BITS_PER_BYTE * len(line(body)) / BAUD_RATE


class Port(Protocol):
    """What the link needs of a pyserial port."""

    timeout: float | None
    """s that a read waits for its first byte"""

    @property
    def in_waiting(self) -> int:
        """Bytes that can be read at once."""

    def read(self, size: int = 1) -> bytes:
        """Up to `size` bytes; none after the timeout."""

    def write(self, data: bytes) -> int | None:
        """Send all of `data`."""

    def close(self) -> None:
        """Give the port back."""


def find_port(folder: Path = BY_ID) -> str:
    """The one serial device with a stable name.

    Raises:
        InputError: none, or several: the message names them.
    """
    names = sorted(str(path) for path in folder.glob("*")) if folder.is_dir() else []
    if len(names) != 1:
        found = ", ".join(names) or "none"
        raise InputError(f"port: {found} in {folder}, expected one device, or give the port")
    return names[0]


class _OwnPort(serial.Serial):
    """A port that no other program can open, not even one that ignores pyserial's lock."""

    def take(self) -> None:
        fcntl.ioctl(self.fileno(), termios.TIOCEXCL)

    def write(self, data: bytes) -> int:
        """All of `data`; pyserial's own calls it a timeout, too, when everything was sent but the
        process was kept waiting right after."""
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


def open_port(path: str) -> Port:
    """Open `path` for this program alone.

    Raises:
        OSError: it is not there, cannot be opened, or another host has it.
    """
    port = _OwnPort(
        path, BAUD_RATE, timeout=_READ_TIMEOUT, write_timeout=_WRITE_TIMEOUT, exclusive=True
    )
    try:
        port.take()
    except OSError:
        port.close()
        raise
    return port


ANSWER_TIMEOUT = 0.5
"""s; the device answers within a few ms."""

Answers = list[Message]

# What changes who drives is always asked for, and answered one at a time.
_ALWAYS_ASKED = "ACDR"
_NOT_OUR_SESSION = REASONS.index("wrong nonce or session")


class LinkError(Exception):
    """The device did not do what was asked; one line says why."""


class Conversation:
    """One thread calls `receive` again and again; any thread may send and ask."""

    def __init__(self, port: Port, clock: Callable[[], float] = time.monotonic) -> None:
        self._port = port
        self._now = clock
        self._splitter = Splitter()
        self._writing = threading.Lock()
        self._one_question = threading.Lock()
        self._answered = threading.Condition()
        self._answers: Answers = []
        self._asked = ""
        self._open = True
        self.not_understood = 0
        self.unasked = ""
        """the newest answer to a question that this host did not ask: another one speaks too"""

    @property
    def damaged(self) -> int:
        """Messages with a wrong checksum, or none."""
        return self._splitter.damaged

    def expect(self, binary: bool) -> None:
        """The device was commanded to send frames (`binary`) or lines."""
        self._splitter.expect(binary)

    def close(self) -> None:
        """Give the port back; whoever sends or asks from here on gets a LinkError."""
        with self._writing:
            self._open = False
            self._port.close()

    def send(self, data: bytes) -> None:
        """Bytes to the device.

        Raises:
            LinkError: the port is closed or broken.
        """
        with self._writing:
            if not self._open:
                raise LinkError("the port is closed")
            try:
                self._port.write(data)
            except OSError as error:
                raise LinkError(f"cannot write: {error}") from None

    def say(self, letter: str, *numbers: int) -> None:
        """A command whose answer nobody waits for.

        Raises:
            LinkError: as `send`.
        """
        self.send(line(command(letter, *numbers)))

    def receive(self, patience: float = 0.05) -> tuple[list[Message], float]:
        """What came in, and the host time when it was read; answers go to whoever asked.

        Waits no longer than `patience` s.

        Raises:
            OSError: the port is gone.
        """
        self._port.timeout = max(patience, 0.0)
        received = self._port.read(max(1, self._port.in_waiting))
        now = self._now()
        messages: list[Message] = []
        for body in self._splitter.feed(received):
            try:
                messages.append(decode(body))
            except ProtocolError:
                self.not_understood += 1
        answers: Answers = [m for m in messages if not isinstance(m, Telemetry | Pong)]
        # Before they are handed over: whoever asked may be gone a moment later.
        for answer in answers:
            if isinstance(answer, Accepted | Refused):
                foreign = answer.letter in _ALWAYS_ASKED and answer.letter != self._asked
                if isinstance(answer, Refused) and answer.letter == "V":
                    foreign = answer.reason == _NOT_OUR_SESSION
                self.unasked = str(answer) if foreign else self.unasked
        # Counters, second by second for months: nobody takes them from here.
        if answers and self._asked:
            with self._answered:
                self._answers = self._answers + answers
                self._answered.notify_all()
        return messages, now

    def ask(
        self,
        letter: str,
        *numbers: int,
        complete: Callable[[Answers], bool] = bool,
        pump: bool = False,
    ) -> Answers:
        """The answers to a command, once they are `complete`.

        `pump` for the thread that otherwise receives.

        Raises:
            LinkError: they do not come in time, or the port is closed.
        """
        with self._one_question:
            self._asked = letter
            try:
                self._answers = []
                self.say(letter, *numbers)
                return self._wait(letter, complete, pump)
            finally:
                self._asked = ""

    def ask_for_consent(self, letter: str, *numbers: int) -> int:
        """The value with which a command was accepted.

        Raises:
            LinkError: it was refused; or as `ask`.
        """

        def concerning(answers: Answers) -> list[Accepted | Refused]:
            return [a for a in answers if isinstance(a, Accepted | Refused) and a.letter == letter]

        answers = self.ask(letter, *numbers, complete=lambda a: bool(concerning(a)))
        answer = concerning(answers)[0]
        if isinstance(answer, Refused):
            raise LinkError(str(answer))
        return answer.value

    def ask_named(self, letter: str, kinds: Iterable[str], pump: bool = False) -> dict[str, Named]:
        """The `key=value` lines of all `kinds`.

        Raises:
            LinkError: as `ask`.
        """
        wanted = frozenset(kinds)

        def by_kind(answers: Answers) -> dict[str, Named]:
            return {a.letter: a for a in answers if isinstance(a, Named)}

        return by_kind(
            self.ask(letter, complete=lambda a: by_kind(a).keys() >= wanted, pump=pump)
        )

    def _wait(self, letter: str, complete: Callable[[Answers], bool], pump: bool) -> Answers:
        until = self._now() + ANSWER_TIMEOUT
        while not complete(self._answers):
            if not self._open or self._now() > until:
                raise LinkError(f"no answer to {letter}")
            if pump:
                self.receive()
            else:
                with self._answered:
                    self._answered.wait_for(
                        lambda: complete(self._answers) or not self._open, ANSWER_TIMEOUT
                    )
        return self._answers
