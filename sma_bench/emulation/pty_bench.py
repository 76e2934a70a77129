"""The emulated Uno behind a pseudo terminal, in real time: what a host opens instead of a cable."""

import contextlib
import os
import select
import threading
import time
import tty
from collections.abc import Callable, Iterator
from typing import Protocol

SLICE = 5e-4
_PRIORITY = 1
# How much faster than the wall's the device's time may go to catch up a delay: its command timeout
# is on that time, and a host that was never silent must not seem to be.
_CATCH_UP = 1.25
# s that are caught up as fast as it can.
_AT_ONCE = 5e-3


class Device(Protocol):
    """An emulated board, whatever runs its firmware."""

    def run(self, seconds: float) -> None:
        """Let its time pass."""

    def write(self, data: bytes) -> None:
        """Bytes to it."""

    def read(self) -> bytes:
        """Bytes from it."""


class PtyBench:
    """Runs a device at the speed of the wall clock; `path` is the port to open."""

    def __init__(
        self,
        device: Device,
        each_slice: Callable[[], None] | None = None,
        on_open: Callable[[], None] | None = None,
    ) -> None:
        """`each_slice()` lets a plant pass the same time, in the same thread; so does `on_open()`
        what somebody causes who opens the port."""
        self.device = device
        self._each_slice = each_slice
        self._on_open = on_open
        self.plug()
        self._jobs: list[Callable[[], None]] = []
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="emulated bench", daemon=True)
        self.began = 0.0
        self.lag = 0.0
        """s that the device's time is behind the wall's: a loaded computer"""
        self.largest_lag = 0.0

    def start(self) -> None:
        """Time begins."""
        self.began = time.monotonic()
        self._thread.start()

    def stop(self) -> None:
        """Time ends, and the port is gone as if its cable were pulled."""
        self._stopping.set()
        self._thread.join()
        self.unplug()

    def plug(self) -> None:
        """A new cable, with a `path` of its own. Between two slices (`do`), or before `start`."""
        self._master, slave = os.openpty()
        tty.setraw(slave)
        os.set_blocking(self._master, False)
        self.path = os.ttyname(slave)
        # The master hangs up while nobody has the other end: so an opening shows.
        os.close(slave)
        self._end = select.poll()
        self._end.register(self._master, select.POLLIN)
        self._is_open = False
        self._plugged = True

    def unplug(self) -> None:
        """Pull the cable; the device goes on. Between two slices (`do`), or after the end."""
        if self._plugged:
            self._plugged = False
            os.close(self._master)

    def do(self, job: Callable[[], None]) -> None:
        """Run `job` between two slices and wait for it."""
        done = threading.Event()

        def announced() -> None:
            job()
            done.set()

        self.request(announced)
        done.wait()

    def request(self, job: Callable[[], None]) -> None:
        """Have `job` run between two slices."""
        self._jobs.append(job)

    def _run(self) -> None:
        # A late emulator is a device whose clock stumbles. Not everybody may ask for this.
        with contextlib.suppress(OSError):
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(_PRIORITY))
        due = soonest = self.began
        while not self._stopping.is_set():
            while self._jobs:
                self._jobs.pop(0)()
            self._carry()
            self.device.run(SLICE)
            if self._each_slice is not None:
                self._each_slice()
            # Every delay is caught up: the device's clock must not slip against the wall's.
            now = time.monotonic()
            due += SLICE
            soonest = max(soonest + SLICE / _CATCH_UP, now - _AT_ONCE)
            self.lag = max(0.0, now - due)
            self.largest_lag = max(self.largest_lag, self.lag)
            time.sleep(max(0.0, max(due, soonest) - now))

    def _carry(self) -> None:
        # Nobody may have opened the port, and nobody may read: bytes are then lost, as on a cable.
        if not self._plugged or not self._opened():
            self.device.read()
            return
        with contextlib.suppress(OSError):
            self.device.write(os.read(self._master, 4096))
        sent = self.device.read()
        if sent:
            with contextlib.suppress(BlockingIOError):
                os.write(self._master, sent)

    def _opened(self) -> bool:
        """Whether somebody has the port open; whoever opens it is noticed first."""
        events = self._end.poll(0)
        is_open = not (events and events[0][1] & select.POLLHUP)
        if is_open and not self._is_open and self._on_open is not None:
            self._on_open()
        self._is_open = is_open
        return is_open


@contextlib.contextmanager
def on_a_port(
    device: Device,
    each_slice: Callable[[], None] | None = None,
    on_open: Callable[[], None] | None = None,
) -> Iterator[PtyBench]:
    """The device behind a port, for as long as the context lasts."""
    bench = PtyBench(device, each_slice, on_open)
    bench.start()
    try:
        yield bench
    finally:
        bench.stop()
