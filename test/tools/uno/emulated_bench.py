"""A bench on an emulated Uno: simulated wires at its pins, and a pseudo-terminal as serial port."""

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

# A triangulation sensor for 40 to 300 mm (GP2Y0A41SK0F's curve): V = SLOPE / (d + SHIFT) + OFFSET.
SLOPE = 0.124
SHIFT = 4.2e-3
OFFSET = 0.03
STANDOFF = 0.1


class Plant:
    """The physics of a rig, driven by the real pulses of the outputs and measured at the real pins.
    The rig's channels are connected to the first outputs; the others are open."""

    def __init__(self, uno: EmulatedUno, parameters: Parameters) -> None:
        self._uno = uno
        self._wires = len(parameters["bench.channels"])
        # The simulation gets the rms voltage of the outputs, whatever the drive.
        self.bench = Bench(parameters.replace({"bench.drive": "voltage"}))
        self._squares, self.time = np.array(uno.electrics.square_time), uno.time
        resistance = parameters["wire.resistance"] / parameters["wire.count"]
        uno.electrics.resistance[:] = [
            resistance if channel < self._wires else math.inf for channel in range(CHANNELS)
        ]
        self._show_deflection()

    def advance(self) -> None:
        """Advance the plant by the time that the Uno has just run."""
        dt = self._uno.time - self.time
        if dt > 0.0:
            before, self._squares = self._squares, np.array(self._uno.electrics.square_time)
            self.time = self._uno.time
            self.bench.advance(np.sqrt((self._squares - before) / dt)[: self._wires], dt)
            self._show_deflection()

    def run(self, seconds: float, step: float = 1e-3) -> None:
        """Run Uno and wires together."""
        for _ in range(round(seconds / step)):
            self._uno.run(step)
            self.advance()

    def _show_deflection(self) -> None:
        self._uno.electrics.range_voltage[:] = [
            SLOPE / (STANDOFF + sign * self.bench.deflection + SHIFT) + OFFSET
            for sign in (-1.0, 1.0)
        ]


class PinWatch:
    """When current could flow last, as on an oscilloscope; call `look` after every slice."""

    def __init__(self, uno: EmulatedUno) -> None:
        self._uno = uno
        self._on_time = 0.0
        self.last_on = 0.0
        """s of the Uno's clock: when an output was high, or a wire connected, for the last time"""

    def look(self) -> None:
        """Note whether current could flow since the last call."""
        on_time = sum(self._uno.electrics.on_time) + sum(self._uno.electrics.wire_time)
        if on_time > self._on_time:
            self.last_on = self._uno.time
        self._on_time = on_time

    @property
    def off_for(self) -> float:
        """s since current could flow last."""
        return self._uno.time - self.last_on


SLICE = 1e-3  # s, as often as a host asks a USB device
_PLANT_STEP = 5e-3  # s, far below the time constants of wires and sensors
_PRIORITY = 1
# To catch up a delay, the device's time runs at most this factor faster than real time: its
# command timeout runs on that time and must not expire although the host was never silent.
_CATCH_UP = 1.25
_AT_ONCE = 5e-3  # s, delays that are caught up without this limit


class PtyBench:
    """Runs a device (run, write, read) at the speed of the wall clock; `path` is the port.

    `each_slice()` advances a plant by the same time, in the same thread; `on_open()` is called
    there when the port is opened.
    """

    def __init__(
        self, device: Any, each_slice: Callable[[], None], on_open: Callable[[], None]
    ) -> None:
        self.device, self._each_slice, self._on_open = device, each_slice, on_open
        self.plug()
        self._jobs: list[Callable[[], None]] = []
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="emulated bench", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Stop, and remove the port as if its cable were unplugged."""
        self._stopping.set()
        self._thread.join()
        self.unplug()

    def plug(self) -> None:
        """Plug in a new cable, with a new `path`. Between two slices (`do`), or before a start."""
        self._master, slave = os.openpty()
        tty.setraw(slave)
        os.set_blocking(self._master, False)
        self.path = os.ttyname(slave)
        # The master reports a hang-up while the other end is closed; that shows when it is opened.
        os.close(slave)
        self._end = select.poll()
        self._end.register(self._master, select.POLLIN)
        self._is_open = False
        self._plugged = True

    def unplug(self) -> None:
        """Unplug the cable; the device goes on. Call between two slices (`do`) or after the end."""
        if self._plugged:
            self._plugged = False
            os.close(self._master)

    def do(self, job: Callable[[], object]) -> None:
        """Run `job` between two slices and wait for it."""
        done = threading.Event()
        self._jobs.append(lambda: (job(), done.set()))
        done.wait()

    def _run(self) -> None:
        # Real-time priority, if permitted: a late emulator is a device with an irregular clock.
        with contextlib.suppress(OSError):
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(_PRIORITY))
        due = soonest = time.monotonic()
        while not self._stopping.is_set():
            while self._jobs:
                self._jobs.pop(0)()
            self._carry()
            self.device.run(SLICE)
            self._each_slice()
            # Every delay is caught up: the device's clock must not fall behind wall time.
            now = time.monotonic()
            due += SLICE
            soonest = max(soonest + SLICE / _CATCH_UP, now - _AT_ONCE)
            time.sleep(max(0.0, max(due, soonest) - now))

    def _carry(self) -> None:
        # If nobody has opened the port or reads from it, bytes are lost, as on a cable.
        events = self._end.poll(0) if self._plugged else []
        is_open = self._plugged and not (events and events[0][1] & select.POLLHUP)
        if is_open and not self._is_open:
            self._on_open()
        self._is_open = is_open
        if not is_open:
            self.device.read()
            return
        with contextlib.suppress(OSError):
            self.device.write(os.read(self._master, 4096))
        sent = self.device.read()
        if sent:
            with contextlib.suppress(BlockingIOError):
                os.write(self._master, sent)


@contextlib.contextmanager
def on_a_port(
    device: Any,
    each_slice: Callable[[], None] = lambda: None,
    on_open: Callable[[], None] = lambda: None,
) -> Iterator[PtyBench]:
    """A device behind a port, for a `with` block."""
    bench = PtyBench(device, each_slice, on_open)
    try:
        yield bench
    finally:
        bench.stop()


BOOTLOADER = 0.3
"""s; an Optiboot waits 1 s for somebody who uploads, the Uno's first bootloaders 2 s"""

_WARM_UP = 0.01


class EmulatedBench:
    """A rig on an emulated Uno; `path` is the port to open."""

    def __init__(self, uno: EmulatedUno, parameters: Parameters) -> None:
        self.uno, self.plant, self.pins = uno, Plant(uno, parameters), PinWatch(uno)
        self.plant.run(_WARM_UP)  # compiles the physics before real time starts
        self.port: PtyBench

    def each_slice(self) -> None:
        """Called after each slice of the Uno's time."""
        if self.uno.time - self.plant.time >= _PLANT_STEP:
            self.plant.advance()
        self.pins.look()

    @property
    def path(self) -> str:
        """Path of the port."""
        return self.port.path

    def do(self, job: Callable[[], object]) -> float:
        """Run `job` between two slices; the time of that in s of the Uno's clock."""
        times: list[float] = []
        self.port.do(lambda: (times.append(self.uno.time), job()))
        return times[0]


@contextlib.contextmanager
def emulated_bench(
    parameters: Parameters, uno: EmulatedUno | None = None
) -> Iterator[EmulatedBench]:
    """A bench with these parameters in real time, for a `with` block; on an Uno just powered up,
    which is built if none is given. Raises InputError: the tools to build it are missing."""
    with tempfile.TemporaryDirectory(prefix="emulated_uno_") as folder:
        uno = uno or build_uno(Path(folder))
        uno.electrics.bootloader_time = BOOTLOADER
        bench = EmulatedBench(uno, parameters)
        with on_a_port(uno, bench.each_slice, uno.reset) as bench.port:
            yield bench
