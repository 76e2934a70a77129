"""Temperature control of wires (experiment E8): one PI a wire, from temperature to power."""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sma_bench.control.heating import HeatBudget, Heating
from sma_bench.control.pi import PI, Gains, OutputLimits
from sma_bench.errors import InputError
from sma_bench.parameters import Parameters

Array = NDArray[np.float64]


class TemperatureController:
    """Reference and measured temperatures in, voltages out.

    In power the wire is a lag, 1/(h A_c) over m c_p/(h A_c): the gains follow from the identified
    parameters by Skogestad's rule.
    """

    def __init__(
        self,
        parameters: Parameters,
        period: float,
        *,
        delay: float = 0.0,
        closed_loop_time: float = 0.0,
        maximum_power: float = 0.0,
        power_rate: float = 0.0,
    ) -> None:
        """Tuned for steps of `period` s.

        Args:
            delay: s from a temperature to the power that answers it, beyond half a period, which
                the held output is late by itself.
            closed_loop_time, maximum_power, power_rate: as `Gains.simc`, `Heating.of`.

        Raises:
            InputError: a number out of range.
        """
        if not 0.0 < period < math.inf:
            raise InputError(f"temperature control: period is {period} s, expected above 0")
        self._wires = len(parameters["bench.channels"])
        self.heating = Heating.of(parameters, maximum_power, power_rate)
        self.gains = Gains.simc(
            1.0 / self.heating.loss, self.heating.time_constant, 0.5 * period + delay,
            closed_loop_time,
        )
        self.reset()

    def reset(self) -> None:
        """Forget everything; wires are taken to be at ambient temperature."""
        self._loops: list[PI | None] = [None] * self._wires
        self._budget = HeatBudget(self.heating, self._wires)

    def step(self, reference: ArrayLike, measured: ArrayLike, dt: float) -> Array:
        """Voltages (w,) [V] from now until `dt` s later.

        Args:
            reference, measured: (w,) K; NaN switches a wire off, and so does a reference that
                needs no heat: ambient temperature or less.

        Raises:
            InputError: wrong shape, or dt not above 0.
        """
        wanted, kelvin = (np.asarray(values, float) for values in (reference, measured))
        for name, values in (("reference", wanted), ("measured", kelvin)):
            if values.shape != (self._wires,):
                raise InputError(
                    f"temperature control: {name} has shape {values.shape}, "
                    f"expected ({self._wires},)"
                )
        if not 0.0 < dt < math.inf:
            raise InputError(f"temperature control: dt is {dt} s, expected above 0")
        highest = self._budget.highest_power(dt)
        power = np.array(
            [self._power(i, wanted[i], kelvin[i], highest[i], dt) for i in range(self._wires)]
        )
        self._budget.spend(power, dt)
        return self.heating.voltage(power)

    def _power(
        self, wire: int, reference: float, measured: float, highest: float, dt: float
    ) -> float:
        if not math.isfinite(reference + measured) or reference <= self.heating.ambient:
            self._loops[wire] = None
            return 0.0
        loop = self._loops[wire]
        limits = OutputLimits(0.0, float(highest), self.heating.power_rate)
        if loop is None:
            # A wire that is warm already goes on as it is.
            loop = self._loops[wire] = PI(self.gains, limits)
            loop.take_over(float(self.heating.holding_power(measured)), measured, measured)
        loop.limits = limits
        return loop.step(float(reference), float(measured), dt)
