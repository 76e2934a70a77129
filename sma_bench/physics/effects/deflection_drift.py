"""A deflection reading whose zero drifts.

    delta_read = delta + b t + d t^2 + w [1 - exp(-t/t_w)] + k M
    t_m dM/dt = T - T_inf - M,    M: mean of all wires

Source: warming electronics, a creeping mount: two terms of its series; electronics that settle
after they were switched on; a mount that warms with the wires. `Readings.deflection_reading`
applies it."""

import math

import numpy as np
from numpy.typing import ArrayLike

from sma_bench.arrays import Array
from sma_bench.compiled import borrowing
from sma_bench.parameters import Parameters
from sma_bench.physics import columns as at


def zero(parameters: Parameters, time: ArrayLike, mount: Array) -> Array:
    """(n,) m, drift of the reading at `time` (n,) s; the wires have warmed `mount` by (n, w) K."""
    seconds, names = np.asarray(time, float), ("rate", "bend", "warm_up", "warm_up_time", "by_heat")
    rate, bend, most, slow, by_heat = (parameters[f"effect.deflection_drift.{n}"] for n in names)
    settled = -np.expm1(-seconds / slow) * most
    warmed = by_heat * np.mean(mount, axis=-1)
    return np.asarray((rate + bend * seconds) * seconds + settled + warmed)


@borrowing
def after_step(wires, i, fraction_before, step):
    """Warm the mount by wire i."""
    if wires[i, at.BY_HEAT] != 0.0:
        rise = wires[i, at.TEMPERATURE] - wires[i, at.AMBIENT] - wires[i, at.MOUNT]
        wires[i, at.MOUNT] -= rise * math.expm1(-step / wires[i, at.MOUNT_TIME])
