"""A deflection reading whose zero drifts.

    delta_read = delta + b t + d t^2 + w [1 - exp(-t/t_w)] + k M
    t_m dM/dt = T - T_inf - M,    M: mean of all wires

b, d: first two terms of a series for a slow drift (warming electronics, a creeping mount); w:
electronics that warm up after power-on; k: a mount that warms with the wires. Source: assumed.
`Readings.deflection_reading` applies it."""

import math

import numpy as np
from numpy.typing import ArrayLike

from sma_bench.arrays import Array
from sma_bench.compiled import borrowing
from sma_bench.parameters import Parameters
from sma_bench.physics import columns as at


def zero(parameters: Parameters, time: ArrayLike, mount: Array) -> Array:
    """(n,) m, drift of the reading at `time` (n,) s; `mount`: (n, w) K, warming by each wire."""
    seconds, names = np.asarray(time, float), ("rate", "bend", "warm_up", "warm_up_time", "by_heat")
    rate, bend, most, slow, by_heat = (parameters[f"effect.deflection_drift.{n}"] for n in names)
    settled = -np.expm1(-seconds / slow) * most
    warmed = by_heat * np.mean(mount, axis=-1)
    return np.asarray((rate + bend * seconds) * seconds + settled + warmed)


@borrowing
def after_step(wires, i, fraction_before, step):
    """After a step: update the warming of the mount by wire i."""
    if wires[i, at.BY_HEAT] != 0.0:
        rise = wires[i, at.TEMPERATURE] - wires[i, at.AMBIENT] - wires[i, at.MOUNT]
        wires[i, at.MOUNT] -= rise * math.expm1(-step / wires[i, at.MOUNT_TIME])
