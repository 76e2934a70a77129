"""Closed loops on a simulated bench, and how well a reference was followed."""

import numpy as np

from sma_bench.parameters import Parameters
from sma_bench.synthetic.bench_records import run_loop

# What a lab's own identification leaves these uncertain by; those of the table are of Table I,
# read by sensors as good as their data sheets say.
_AFTER_IDENTIFICATION = {
    "wire.resistance": 0.03,
    "wire.heat_transfer_coefficient": 8.0,
    "wire.specific_heat": 10.0,
    "environment.ambient_temperature": 0.5,
}


def identified(values=None):
    """The table's bench, changed by `values`, as a lab has identified it."""
    return Parameters.of_paper().replace(values or {}, _AFTER_IDENTIFICATION)


def off_by_deviations(parameters, names, seed, deviations=1.0):
    """A bench that differs from its identified parameters by what they are uncertain."""
    draws = deviations * np.random.default_rng(seed).standard_normal(len(names))
    return parameters.replace(
        {n: parameters[n] + z * parameters.std(n) for n, z in zip(names, draws, strict=True)}
    )


def rmse(reference, actual):
    """Root mean square of actual - reference, in their unit."""
    return float(np.sqrt(np.mean(np.square(np.subtract(actual, reference)))))


def step_figures(time, actual, start, stop, band):
    """Of a step from `start` to `stop` at time[0], (n,) s, and what became of it, (n,): the mean
    error over the last quarter, in its unit; the overshoot, part of the step; s until the value
    stays within `band` of the reference."""
    assert time.size >= 4 and start != stop
    outside = np.flatnonzero(np.abs(actual - stop) > band)
    last = time[min(outside[-1] + 1, time.size - 1)] if outside.size else time[0]
    overshoot = max(((actual - stop) / (stop - start)).max(), 0.0)
    return np.mean(actual[-(time.size // 4) :]) - stop, overshoot, last - time[0]


def run_deflection(bench, controller, reference, duration, loop):
    """Run a deflection controller; reference: m at a time in s."""
    return run_loop(
        bench, lambda plant: np.array(plant.deflection), lambda t: np.array(reference(t)),
        lambda wanted, read, ahead: controller.step(
            float(wanted), float(read), loop.period, float(ahead)
        ),
        duration, loop,
    )  # fmt: skip
