"""A controller and a simulated bench in one loop, with sensor noise; no ROS, no clock."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sma_bench.control.deflection import DeflectionController
from sma_bench.control.temperature import TemperatureController
from sma_bench.parameters import Parameters
from sma_bench.physics import Bench

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Loop:
    """How the loop is closed.

    Attributes:
        period: s between commands.
        late: periods from a reading to the command that answers it.
        noise: standard deviation of a reading, in its unit; seed: of the noise.
        resolution: step of a reading; 0 for none.
    """

    period: float = 0.05
    late: int = 0
    noise: float = 0.0
    resolution: float = 0.0
    seed: int = 1


@dataclass(frozen=True, eq=False)
class ClosedLoop:
    """A run: reference, actual and measured (n,) or (n, w), voltage (n, w) at time (n,) s."""

    time: Array
    reference: Array
    actual: Array
    measured: Array
    voltage: Array


def run_temperature(
    bench: Parameters,
    controller: TemperatureController,
    reference: Callable[[float], Array],
    duration: float,
    loop: Loop,
) -> ClosedLoop:
    """Run a temperature controller on a bench whose parameters it may not know.

    Args:
        bench: what the bench really is; reference: (w,) K at a time in s.
    """
    return _run(
        bench,
        lambda plant: np.array(plant.temperature),
        reference,
        lambda wanted, read, _: controller.step(wanted, read, loop.period),
        duration,
        loop,
    )


def run_deflection(
    bench: Parameters,
    controller: DeflectionController,
    reference: Callable[[float], float],
    duration: float,
    loop: Loop,
) -> ClosedLoop:
    """Run a deflection controller likewise; reference: m at a time in s."""
    return _run(
        bench,
        lambda plant: np.array(plant.deflection),
        lambda t: np.array(reference(t)),
        lambda wanted, read, ahead: controller.step(
            float(wanted), float(read), loop.period, float(ahead)
        ),
        duration,
        loop,
    )


def run_voltages(
    bench: Parameters,
    voltage: Callable[[float], Array],
    reference: Callable[[float], float],
    duration: float,
    loop: Loop,
) -> ClosedLoop:
    """Voltages as a protocol gives them, no feedback: what a controller is compared with."""
    clock = iter(np.arange(_samples(duration, loop)) * loop.period)
    return _run(
        bench,
        lambda plant: np.array(plant.deflection),
        lambda t: np.array(reference(t)),
        lambda *_: voltage(float(next(clock))),
        duration,
        loop,
    )


def _samples(duration: float, loop: Loop) -> int:
    return round(duration / loop.period)


def _run(
    bench: Parameters,
    observe: Callable[[Bench], Array],
    reference: Callable[[float], Array],
    control: Callable[[Array, Array, Array], Array],
    duration: float,
    loop: Loop,
) -> ClosedLoop:
    plant, random = Bench(bench), np.random.default_rng(loop.seed)
    waiting = [np.zeros(len(bench["bench.channels"]))] * loop.late
    time: Array = loop.period * np.arange(_samples(duration, loop), dtype=np.float64)
    rows: list[tuple[Array, Array, Array, Array]] = []
    for t in time:
        actual = observe(plant)
        read = actual + loop.noise * random.standard_normal(actual.shape)
        if loop.resolution > 0.0:
            read = np.round(read / loop.resolution) * loop.resolution
        wanted = np.asarray(reference(float(t)), float)
        waiting.append(control(wanted, read, np.asarray(reference(float(t) + loop.period), float)))
        volts = waiting.pop(0)
        rows.append((wanted, actual, read, volts))
        plant.advance(volts, loop.period)
    return ClosedLoop(time, *(np.array(column) for column in zip(*rows, strict=True)))
