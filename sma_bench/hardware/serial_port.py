"""Finding and opening the device's port, for one host only."""

import contextlib
import fcntl
import os
import select
import termios
import time
from pathlib import Path
from typing import Protocol

import serial

from sma_bench.errors import InputError
from sma_bench.hardware.serial_messages import line

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
