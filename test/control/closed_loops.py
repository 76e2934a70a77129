"""Closed loops on a simulated bench, and how well a reference was followed."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sma_bench.control import DeflectionController
from sma_bench.parameters import Parameters
from sma_bench.synthetic.bench_records import ClosedLoopRun, Feedback, run_loop

Array = NDArray[np.float64]

# What a lab's own identification leaves these uncertain by; those of the table are of Table I,
# read by sensors as good as their data sheets say.
_AFTER_IDENTIFICATION = {
    "wire.resistance": 0.03,
    "wire.heat_transfer_coefficient": 8.0,
    "wire.specific_heat": 10.0,
    "environment.ambient_temperature": 0.5,
}


def identified(values: Mapping[str, Any] | None = None) -> Parameters:
    """The table's bench, changed by `values`, as a lab has identified it."""
    return Parameters.of_paper().replace(values or {}, _AFTER_IDENTIFICATION)


def rmse(reference: ArrayLike, actual: ArrayLike) -> float:
    """Root mean square of actual - reference, in their unit."""
    return float(np.sqrt(np.mean(np.square(np.subtract(actual, reference)))))


@dataclass(frozen=True)
class StepFigures:
    """Of one step of the reference.

    Attributes:
        steady_error: mean of actual - reference over the last quarter, in their unit.
        overshoot: beyond the reference in the direction of the step, part of the step.
        settling_time: s from the step until the actual value stays within `band`.
    """

    steady_error: float
    overshoot: float
    settling_time: float


def step_figures(
    time: ArrayLike, actual: ArrayLike, start: float, stop: float, band: float
) -> StepFigures:
    """Figures of a step from `start` to `stop` at time[0].

    Args:
        time: (n,) s from the step to just before the next one; actual: (n,).
        band: half width around the reference, in its unit.
    """
    seconds, values = np.asarray(time, float), np.asarray(actual, float)
    assert seconds.size >= 4 and start != stop
    beyond = (values - stop) / (stop - start)
    outside = np.flatnonzero(np.abs(values - stop) > band)
    last = seconds[min(outside[-1] + 1, seconds.size - 1)] if outside.size else seconds[0]
    return StepFigures(
        steady_error=float(np.mean(values[-(seconds.size // 4):]) - stop),
        overshoot=float(max(beyond.max(), 0.0)),
        settling_time=float(last - seconds[0]),
    )


def run_deflection(
    bench: Parameters,
    controller: DeflectionController,
    reference: Callable[[float], float],
    duration: float,
    loop: Feedback,
) -> ClosedLoopRun:
    """Run a deflection controller likewise; reference: m at a time in s."""
    return run_loop(
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
    loop: Feedback,
) -> ClosedLoopRun:
    """Voltages as a protocol gives them, no feedback: what a controller is compared with."""
    clock = iter(np.arange(round(duration / loop.period)) * loop.period)
    return run_loop(
        bench,
        lambda plant: np.array(plant.deflection),
        lambda t: np.array(reference(t)),
        lambda *_: voltage(float(next(clock))),
        duration,
        loop,
    )
