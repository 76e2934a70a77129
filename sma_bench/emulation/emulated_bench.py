"""Uno, wires, pins and a port in one: what a host opens instead of a bench."""

import contextlib
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

from sma_bench.emulation.build import build_uno
from sma_bench.emulation.emulated_uno import EmulatedUno
from sma_bench.emulation.pin_watch import PinWatch
from sma_bench.emulation.plant import Plant
from sma_bench.emulation.pty_bench import PtyBench, on_a_port
from sma_bench.parameters import Parameters

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
        opening of the port; its time runs with the wall's, but for `port.lag`."""
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
