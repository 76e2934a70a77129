"""The model's side of a comparison: what its simulation says that a sensor reads."""

import numpy as np
import numpy.typing as npt

from sma_bench.errors import InputError
from sma_bench.physics.simulate import Simulation

Array = npt.NDArray[np.float64]


def simulated_reading(simulation: Simulation, signal: str) -> Array:
    """(n,) of `front_1.current`, `front_1.temperature` or `deflection`, in SI units.

    Raises:
        InputError: the model has no such signal.
    """
    channel, _, quantity = signal.rpartition(".")
    if quantity == "deflection":
        return simulation.deflection_reading
    channels = simulation.parameters["bench.channels"]
    columns = {"current": "current", "temperature": "temperature_reading"}
    if channel not in channels or quantity not in columns:
        raise InputError(f"no simulated signal {signal}")
    read: Array = getattr(simulation, columns[quantity])
    return read[:, channels.index(channel)]
