"""How well a reference was followed: figures of a step and of a whole run."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sma_bench.errors import InputError

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
