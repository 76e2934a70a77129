"""A bench on an emulated Uno: wires at its pins, and a port to open instead of a cable's."""

import contextlib
import math
import os
import select
import tempfile
import threading
import time
import tty
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from sma_bench.parameters import Parameters
from sma_bench.physics import Bench
from uno.emulated_uno import CHANNELS, EmulatedUno, build_uno

# --- Wires behind the pins: the heat of what the outputs did, the voltages of the sensors.

# A triangulation sensor for 40 to 300 mm (GP2Y0A41SK0F's curve): V = SLOPE / (d + SHIFT) + OFFSET.
SLOPE = 0.124
SHIFT = 4.2e-3
OFFSET = 0.03
STANDOFF = 0.1


class Plant:
    """The physics of a rig, driven by the outputs' real pulses and seen through the real pins."""

    def __init__(self, uno: EmulatedUno, parameters: Parameters) -> None:
        """The rig's channels hang on the first outputs; the others have nothing connected."""
        self._uno = uno
        self._wires = len(parameters["bench.channels"])
        # What the outputs did comes as volts that heat, whatever the drive.
        self.bench = Bench(parameters.replace({"bench.drive": "voltage"}))
        self._squares = np.array(uno.electrics.square_time)
        self._time = uno.time
        resistance = parameters["wire.resistance"] / parameters["wire.count"]
        uno.electrics.resistance[:] = [
            resistance if channel < self._wires else math.inf for channel in range(CHANNELS)
        ]
        self._show_deflection()

    def advance(self) -> None:
        """Let the time pass that the Uno has just run."""
        dt = self._uno.time - self._time
        if dt <= 0.0:
            return
        self._time = self._uno.time
        squares = np.array(self._uno.electrics.square_time)
        heating = np.sqrt((squares - self._squares) / dt)
        self._squares = squares
        self.bench.advance(heating[: self._wires], dt)
        self._show_deflection()

    def run(self, seconds: float, step: float = 1e-3) -> None:
        """Uno and wires together."""
        for _ in range(round(seconds / step)):
            self._uno.run(step)
            self.advance()

    def _show_deflection(self) -> None:
        deflection = self.bench.deflection
        self._uno.electrics.range_voltage[:] = [
            SLOPE / (distance + SHIFT) + OFFSET
            for distance in (STANDOFF - deflection, STANDOFF + deflection)
        ]


# --- When current could flow, as an oscilloscope at the pins and the wires would see it.

class PinWatch:
    """Call `look` after every slice of the Uno's time; answers are in s of its clock."""

    def __init__(self, uno: EmulatedUno) -> None:
        self._uno = uno
        self._on_time = 0.0
        self.last_on = 0.0

    def look(self) -> None:
        """Note whether any output was high, or any wire connected, since the last look."""
        on_time = sum(self._uno.electrics.on_time) + sum(self._uno.electrics.wire_time)
        if on_time > self._on_time:
            self.last_on = self._uno.time
        self._on_time = on_time

    @property
    def off_for(self) -> float:
        """Time since an output was high or a wire connected."""
        return self._uno.time - self.last_on


# --- The Uno behind a pseudo terminal, in real time.

SLICE = 5e-4
_PRIORITY = 1
# How much faster than the wall's the device's time may go to catch up a delay: its command timeout
# is on that time, and a host that was never silent must not seem to be.
_CATCH_UP = 1.25
# s that are caught up as fast as it can.
_AT_ONCE = 5e-3


class PtyBench:
    """Runs a device (run, write, read) at the speed of the wall clock; `path` is the port."""

    def __init__(
        self, device: Any, each_slice: Callable[[], None] | None = None,
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
        self.largest_lag = 0.0
        """s that the device's time was behind the wall's: a loaded computer"""

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

        self._jobs.append(announced)
        done.wait()

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
            self.largest_lag = max(self.largest_lag, now - due)
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
    device: Any, each_slice: Callable[[], None] | None = None,
    on_open: Callable[[], None] | None = None,
) -> Iterator[PtyBench]:
    """The device behind a port, for as long as the context lasts."""
    bench = PtyBench(device, each_slice, on_open)
    bench.start()
    try:
        yield bench
    finally:
        bench.stop()


# --- Uno, wires, pins and a port in one.

BOOTLOADER = 0.3
"""s; an Optiboot waits 1 s for somebody who uploads, the Uno's first bootloaders 2 s"""

_WARM_UP = 0.01


class EmulatedBench:
    """A rig on an emulated Uno, in real time; `path` is the port to open."""

    def __init__(
        self, uno: EmulatedUno, plant: Plant, pins: PinWatch, port: PtyBench, before: float
    ) -> None:
        """`before`: s of the Uno's clock when the wall's began to count."""
        self.uno = uno
        self.plant = plant
        self.pins = pins
        self.port = port
        self._before = before

    @property
    def path(self) -> str:
        """The port."""
        return self.port.path

    @property
    def program_start(self) -> float:
        """s of the monotonic clock at which the Uno's program began, which it does anew at every
        opening of the port; its time runs with the wall's, but for a loaded computer's delays."""
        return self.port.began - self._before + self.uno.electrics.started

    def do(self, job: Callable[[], None]) -> float:
        """Run `job` between two slices of time; when that was, in s of the Uno's clock."""
        times: list[float] = []

        def timed() -> None:
            times.append(self.uno.time)
            job()

        self.port.do(timed)
        return times[0]


@contextlib.contextmanager
def emulated_bench(
    parameters: Parameters, uno: EmulatedUno | None = None, bootloader: float = BOOTLOADER
) -> Iterator[EmulatedBench]:
    """A bench that is what the parameters say, as long as the context lasts.

    Args:
        uno: one just powered up; None to build one.
        bootloader: s between an opening of the port, which resets the Uno, and its program.

    Raises:
        InputError: the tools to build one are missing.
    """
    with tempfile.TemporaryDirectory(prefix="emulated_uno_") as folder:
        uno = uno or build_uno(Path(folder))
        uno.electrics.bootloader_time = bootloader
        plant, pins = Plant(uno, parameters), PinWatch(uno)
        plant.run(_WARM_UP)  # compiles the physics before time begins

        def each_slice() -> None:
            plant.advance()
            pins.look()

        before = uno.time
        with on_a_port(uno, each_slice, uno.reset) as port:
            yield EmulatedBench(uno, plant, pins, port, before)
