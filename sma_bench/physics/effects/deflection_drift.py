"""A deflection reading whose zero drifts.

    delta_read = delta + b t + d t^2 + w [1 - exp(-t/t_w)] + k M
    t_m dM/dt = T - T_inf - M,    M: mean of all wires

Source: warming electronics, a creeping mount: two terms of its series; electronics that settle
after they were switched on; a mount that warms with the wires. `Readings.deflection_reading`
applies it.
"""

import math

import numpy as np
from numpy.typing import ArrayLike

from sma_bench.arrays import Array
from sma_bench.compiled import borrowing
from sma_bench.parameters import Parameters
from sma_bench.parameters.parameter import Effect, Parameter
from sma_bench.physics import columns as at

EFFECT = Effect(
    "sensor",
    (Parameter("rate", "m/s", 0.0, "Drift of the deflection reading; 0 is off.",
               "assumed: to 5 % of the stroke", -1e-3, 1e-3, uncertainty=1e-5),
     Parameter("bend", "m/s2", 0.0, "Growth of that drift.",
               "assumed: of the order of the drift over some minutes", -1e-5, 1e-5,
               uncertainty=1e-7),
     Parameter("warm_up", "m", 0.0, "Drift after a long time of electronics that settle; 0 is off.",
               "assumed: to 5 % of the stroke", -0.1, 0.1, uncertainty=2e-4),
     Parameter("warm_up_time", "s", 60.0, "Time in which they settle.", "assumed: minutes", 1.0,
               1e5, uncertainty=60.0),
     Parameter("by_heat", "m/K", 0.0, "Drift by a mount that is a kelvin warmer; 0 is off.",
               "assumed: aluminium of some centimetres", -1e-3, 1e-3, uncertainty=1e-5),
     Parameter("mount_time", "s", 20.0, "Time in which the mount warms with the wires.",
               "assumed: seconds to minutes", 0.1, 1e5, uncertainty=20.0)),
    shows="the rest position wanders with time, whatever is driven", acts_on=("deflection",),
    loads=("clamped", "force", "spring", "antagonist", "beam"), marks=("EVOLVES",),
    forms={"steady": ("rate", "bend"), "warm_up": ("warm_up", "warm_up_time"),
           "by_heat": ("by_heat", "mount_time")},
    columns={"by_heat": "BY_HEAT", "mount_time": "MOUNT_TIME"}, state=("MOUNT",),
)


def zero(parameters: Parameters, time: ArrayLike, mount: Array) -> Array:
    """(n,) m, drift of the reading `time` (n,) s after the start, where the wires have warmed the
    mount by (n, w) K."""
    seconds = np.asarray(time, dtype=np.float64)
    rate = parameters["effect.deflection_drift.rate"]
    bend = parameters["effect.deflection_drift.bend"]
    settled = -np.expm1(-seconds / parameters["effect.deflection_drift.warm_up_time"])
    settled *= parameters["effect.deflection_drift.warm_up"]
    warmed = parameters["effect.deflection_drift.by_heat"] * np.mean(mount, axis=-1)
    return np.asarray((rate + bend * seconds) * seconds + settled + warmed, dtype=np.float64)


@borrowing
def after_step(wires, i, fraction_before, step):
    """Warm the mount by wire i."""
    if wires[i, at.BY_HEAT] != 0.0:
        rise = wires[i, at.TEMPERATURE] - wires[i, at.AMBIENT] - wires[i, at.MOUNT]
        wires[i, at.MOUNT] -= rise * math.expm1(-step / wires[i, at.MOUNT_TIME])
