"""Current through a wire: eq. (3), with the effects that change it."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sma_bench.parameters import Parameters
from sma_bench.physics.effects.phase_dependent_resistance import LEAST

_CHANGE = "effect.phase_dependent_resistance.austenite_change"
_SLOPE = "effect.phase_dependent_resistance.temperature_coefficient"


def current(
    parameters: Parameters, voltage: ArrayLike, temperature: ArrayLike, fraction: ArrayLike
) -> NDArray[np.float64]:
    """I = n V/(R(xi, T) + n R_s) through the n wires of a channel; with all effects off eq. (3).

    A current source holds it whatever the resistance; of a duty it is the mean.

    Args:
        voltage: V, as the driver reads it or is commanded (`heat.heating_voltage`); temperature: K;
            fraction: of martensite; any shape.
    """
    volts, kelvin, xi = (np.asarray(a, dtype=np.float64) for a in (voltage, temperature, fraction))
    count = parameters["wire.count"]
    of_phase = 1.0 + parameters[_CHANGE] * (1.0 - xi)
    rise = kelvin - parameters["environment.ambient_temperature"]
    of_heat = np.maximum(1.0 + parameters[_SLOPE] * rise, LEAST)
    resistance = parameters["wire.resistance"] * of_phase * of_heat
    if parameters["bench.drive"] == "current":
        return np.asarray(count * volts / parameters["wire.resistance"])
    leads = parameters["bench.lead_resistance"] + parameters["effect.supply_drop.resistance"]
    return np.asarray(count * volts / (resistance + count * leads))
