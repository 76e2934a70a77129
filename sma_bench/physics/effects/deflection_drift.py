"""A deflection reading whose zero drifts.

    delta_read = delta + b t + d t^2

Source: warming electronics, a creeping mount; two terms of its series.
`Simulation.deflection_reading` applies it.
"""

import numpy as np
from numpy.typing import ArrayLike

from sma_bench.arrays import Array
from sma_bench.parameters import Parameters
from sma_bench.parameters.parameter import Effect, Parameter

EFFECT = Effect(
    "sensor",
    (Parameter("rate", "m/s", 0.0, "Drift of the deflection reading; 0 is off.",
               "assumed: to 5 % of the stroke", -1e-3, 1e-3, uncertainty=1e-5),
     Parameter("bend", "m/s2", 0.0, "Growth of that drift.",
               "assumed: of the order of the drift over some minutes", -1e-5, 1e-5,
               uncertainty=1e-7)),
    shows="the rest position wanders with time, whatever is driven", acts_on=("deflection",),
    loads=("clamped", "force", "spring", "antagonist", "beam"),
)


def zero(parameters: Parameters, time: ArrayLike) -> Array:
    """(n,) m, drift of the reading `time` (n,) s after the start."""
    seconds = np.asarray(time, dtype=np.float64)
    rate = parameters["effect.deflection_drift.rate"]
    bend = parameters["effect.deflection_drift.bend"]
    return np.asarray((rate + bend * seconds) * seconds, dtype=np.float64)
