"""A deflection reading whose zero drifts.

    delta_read = delta + b t + d t^2

Source: warming electronics, a creeping mount; two terms of its series.
`Simulation.deflection_reading` applies it.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sma_bench.parameters import Parameters
from sma_bench.physics.effects.effect import Effect

EFFECT = Effect(
    "deflection_drift",
    "sensor",
    {},
    "the rest position wanders with time, whatever is driven",
    ("deflection",),
)


def zero(parameters: Parameters, time: ArrayLike) -> NDArray[np.float64]:
    """(n,) m, drift of the reading `time` (n,) s after the start."""
    seconds = np.asarray(time, dtype=np.float64)
    rate = parameters["effect.deflection_drift.rate"]
    bend = parameters["effect.deflection_drift.bend"]
    return np.asarray((rate + bend * seconds) * seconds, dtype=np.float64)
