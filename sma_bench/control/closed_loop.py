"""A controller and a simulated bench in one loop, and how well a reference was followed."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sma_bench.control.deflection import DeflectionController
from sma_bench.control.temperature import Heating, TemperatureController
from sma_bench.errors import InputError
from sma_bench.parameters import Parameters
from sma_bench.physics import Bench
from sma_bench.physics.operating_point import maximum_deflection

# --- What a controller may be asked for: one line for a reference that the bench cannot follow.


def temperature_reference_fault(reference: Sequence[float], parameters: Parameters) -> str:
    """Why wire temperatures [K], one a channel, cannot be followed, or "".

    Ambient temperature or less only means that a wire is not heated.
    """
    channels = len(parameters["bench.channels"])
    if len(reference) != channels:
        return f"reference has {len(reference)} temperatures, expected {channels}"
    highest = Heating.of(parameters).maximum_temperature
    for kelvin in reference:
        if not math.isfinite(kelvin):
            return f"reference has {kelvin} K, expected finite temperatures"
        if not 0.0 < kelvin <= highest:
            return f"reference has {kelvin:g} K, expected above 0 and at most {highest:g} K"
    return ""


def deflection_reference_fault(reference: Sequence[float], parameters: Parameters) -> str:
    """Why a deflection [m], the only element, cannot be followed, or ""."""
    (metres,) = reference
    if not math.isfinite(metres):
        return f"reference is {metres} m, expected a finite deflection"
    side = "front" if metres > 0.0 else "back"
    if metres == 0.0:
        return ""
    if side not in parameters["bench.channel_sides"]:
        return f"reference is {metres:g} m, but there is no wire on the {side}"
    largest = maximum_deflection(parameters, side)
    if abs(metres) > largest:
        return f"reference is {metres:g} m, expected at most {largest:.4g} m to the {side}"
    return ""


# --- How well a reference was followed: figures of a step and of a whole run.

Array = NDArray[np.float64]


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

    Raises:
        InputError: fewer than 4 samples, or no step.
    """
    seconds, values = np.asarray(time, float), np.asarray(actual, float)
    if seconds.size < 4 or start == stop:
        raise InputError(
            f"step of {seconds.size} samples from {start} to {stop}, expected 4 or more and a step"
        )
    beyond = (values - stop) / (stop - start)
    outside = np.flatnonzero(np.abs(values - stop) > band)
    last = seconds[min(outside[-1] + 1, seconds.size - 1)] if outside.size else seconds[0]
    return StepFigures(
        steady_error=float(np.mean(values[-(seconds.size // 4):]) - stop),
        overshoot=float(max(beyond.max(), 0.0)),
        settling_time=float(last - seconds[0]),
    )


# --- A controller and a simulated bench in one loop, with sensor noise; no ROS, no clock.

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
