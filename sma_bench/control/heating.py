"""Power of a wire as the controlled input: v = sqrt(P R) makes eq. (2) linear.

Limits of the power: what voltage and current allow, and what keeps the wire below its highest
temperature by the model, whatever a sensor says: an infrared spot wider than the wire reads low.
"""

import math
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sma_bench.errors import InputError
from sma_bench.parameters import Parameters
from sma_bench.physics.heat import heat_loss, time_constant

Array = NDArray[np.float64]

# Below the bench's limit, which switches off: room for a model that errs by some percent.
TEMPERATURE_MARGIN = 10.0
# Of the bench's largest current, which switches off: room for the noise of its sensor.
CURRENT_SHARE = 0.9


@dataclass(frozen=True)
class Heating:
    """Constants of one heated wire.

    Attributes:
        resistance: ohm; ambient: K; loss: h A_c [W/K]; time_constant: s.
        maximum_power: W; power_rate: W/s; maximum_temperature: K.
    """

    resistance: float
    ambient: float
    loss: float
    time_constant: float
    maximum_power: float
    power_rate: float
    maximum_temperature: float

    @classmethod
    def of(
        cls, parameters: Parameters, maximum_power: float = 0.0, power_rate: float = 0.0
    ) -> Self:
        """A wire of the bench.

        Args:
            maximum_power: W, below what the bench's voltage and current allow; 0 for just that.
            power_rate: W/s; 0 for no limit.

        Raises:
            InputError: a negative limit.
        """
        for name, value in (("maximum_power", maximum_power), ("power_rate", power_rate)):
            if not 0.0 <= value < math.inf:
                raise InputError(f"heating: {name} is {value}, expected 0 or more")
        ohm = parameters["wire.resistance"]
        ampere = CURRENT_SHARE * parameters["bench.maximum_current"]
        volt = min(parameters["bench.maximum_voltage"], ohm * ampere)
        return cls(
            resistance=ohm,
            ambient=parameters["environment.ambient_temperature"],
            loss=heat_loss(parameters),
            time_constant=time_constant(parameters),
            maximum_power=min(volt**2 / ohm, maximum_power or math.inf),
            power_rate=power_rate or math.inf,
            maximum_temperature=parameters["bench.maximum_temperature"] - TEMPERATURE_MARGIN,
        )

    def voltage(self, power: ArrayLike) -> Array:
        """V that heat with P [W]."""
        return np.sqrt(np.asarray(power, float) * self.resistance)

    def holding_power(self, temperature: ArrayLike) -> Array:
        """P [W] that holds T [K]."""
        return self.loss * (np.asarray(temperature, float) - self.ambient)

    def power_toward(self, goal: ArrayLike, temperature: ArrayLike, dt: float) -> Array:
        """P [W], of either sign, that leads from T to `goal` [K] within dt: eq. (2) inverted."""
        decay = math.exp(-dt / self.time_constant)
        start = np.asarray(temperature, float)
        return self.holding_power((np.asarray(goal, float) - start * decay) / (1.0 - decay))

    def after(self, temperature: ArrayLike, power: ArrayLike, dt: float) -> Array:
        """T [K] after dt at P [W]: eq. (2) solved."""
        steady = self.ambient + np.asarray(power, float) / self.loss
        decay = math.exp(-dt / self.time_constant)
        return steady + (np.asarray(temperature, float) - steady) * decay


class HeatBudget:
    """Model temperatures of wires under the powers applied, and the power left to them."""

    def __init__(self, heating: Heating, wires: int) -> None:
        self._heating = heating
        self.temperature = np.full(wires, heating.ambient)

    def highest_power(self, dt: float) -> Array:
        """(w,) W that neither the supply nor the highest temperature forbids for dt."""
        limit = self._heating.power_toward(
            self._heating.maximum_temperature, self.temperature, dt
        )
        return np.clip(limit, 0.0, self._heating.maximum_power)

    def spend(self, power: ArrayLike, dt: float) -> None:
        """Powers (w,) [W] were applied for dt."""
        self.temperature = self._heating.after(self.temperature, power, dt)
