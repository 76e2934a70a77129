"""Temperature control of wires (experiment E8): a PI controller with anti-windup, one a wire."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sma_bench.errors import InputError
from sma_bench.parameters import Parameters
from sma_bench.physics.heat import (
    heat_loss,
    heated_resistance,
    heating_voltage,
    time_constant,
)

# --- A PI controller with anti-windup, and the rule that tunes it.
#
#     u = sat[u_ff + K (r - y) + I],   dI/dt = K/T_i (r - y) + (sat[u] - u)/T_t
#
# sat limits the output and its rate. The second term (back-calculation) leads the integral back to
# what the output can do. I is kept in units of the output, so that gains may change without a
# bump.


@dataclass(frozen=True)
class Gains:
    """Gains of a PI controller; it validates itself.

    Attributes:
        proportional: K, output per unit of error.
        integral_time: T_i [s].
        tracking_time: T_t [s] of the anti-windup; T_i when not given.
    """

    proportional: float
    integral_time: float
    tracking_time: float = 0.0

    def __post_init__(self) -> None:
        if self.tracking_time == 0.0:
            object.__setattr__(self, "tracking_time", self.integral_time)
        if not math.isfinite(self.proportional):
            raise InputError(f"gains: proportional is {self.proportional}, expected finite")
        for name in ("integral_time", "tracking_time"):
            value = getattr(self, name)
            if not 0.0 < value < math.inf:
                raise InputError(f"gains: {name} is {value} s, expected positive and finite")

    @classmethod
    def simc(
        cls, gain: float, time_constant: float, delay: float, closed_loop_time: float = 0.0
    ) -> Self:
        """Tuned for gain e^(-delay s)/(time_constant s + 1) by Skogestad's rule (SIMC, 2003).

        K = tau/(k (tau_c + theta)), T_i = min(tau, 4 (tau_c + theta)). The reference step response
        then is that of a lag tau_c after the delay, without overshoot while T_i = tau.

        Args:
            gain: k, output of the plant per unit of its input.
            time_constant: tau [s]; delay: theta [s].
            closed_loop_time: tau_c [s]; 0 for half the time constant, or the delay if longer:
                slow enough for T_i = tau, fast enough to halve the time.

        Raises:
            InputError: a number that no plant has.
        """
        for name, value in (("time_constant", time_constant), ("gain", abs(gain))):
            if not 0.0 < value < math.inf:
                raise InputError(f"tuning: {name} is {value}, expected positive and finite")
        for name, value in (("delay", delay), ("closed_loop_time", closed_loop_time)):
            if not 0.0 <= value < math.inf:
                raise InputError(f"tuning: {name} is {value} s, expected 0 or more")
        wanted = (closed_loop_time or max(0.5 * time_constant, delay)) + delay
        return cls(time_constant / (gain * wanted), min(time_constant, 4.0 * wanted))


@dataclass(frozen=True)
class OutputLimits:
    """Range of the output and of its rate [1/s]; it validates itself."""

    low: float
    high: float
    rate: float = math.inf

    def __post_init__(self) -> None:
        if not self.low <= self.high:
            raise InputError(f"output limits: low is {self.low} above high {self.high}")
        if not self.rate > 0.0:
            raise InputError(f"output limits: rate is {self.rate}, expected more than 0")

    def applied(self, output: float, last: float, dt: float) -> float:
        """The output nearest to the wanted one; leaving the range's outside is never delayed."""
        step = self.rate * dt
        slowed = min(max(output, last - step), last + step)
        return min(max(slowed, self.low), self.high)


class PI:
    """One loop. Time comes in as dt; there is no clock."""

    def __init__(self, gains: Gains, limits: OutputLimits) -> None:
        self.gains = gains
        self.limits = limits
        self._integral = 0.0
        self._output = 0.0

    @property
    def output(self) -> float:
        """The last output."""
        return self._output

    def reset(self) -> None:
        """Forget everything; the output starts from 0 or the limit nearest to it."""
        self._integral = 0.0
        self._output = min(max(0.0, self.limits.low), self.limits.high)

    def take_over(
        self, output: float, reference: float, measured: float, feedforward: float = 0.0
    ) -> None:
        """Begin without a bump: at this reference and reading the next output is `output`."""
        self._output = min(max(output, self.limits.low), self.limits.high)
        error = reference - measured
        self._integral = self._output - feedforward - self.gains.proportional * error

    def step(
        self, reference: float, measured: float, dt: float, feedforward: float = 0.0
    ) -> float:
        """The output from now until `dt` s later.

        Raises:
            InputError: a number that is not finite, or dt not above 0.
        """
        if not 0.0 < dt < math.inf:
            raise InputError(f"PI: dt is {dt} s, expected positive and finite")
        error = reference - measured
        if not math.isfinite(error + feedforward):
            raise InputError(
                f"PI: reference {reference}, measured {measured}, feedforward {feedforward}, "
                "expected finite numbers"
            )
        gains = self.gains
        wanted = feedforward + gains.proportional * error + self._integral
        self._output = self.limits.applied(wanted, self._output, dt)
        self._integral += gains.proportional * error * dt / gains.integral_time
        self._integral += (self._output - wanted) * min(dt / gains.tracking_time, 1.0)
        return self._output


# --- Power of a wire as the controlled input: v = sqrt(P R) makes eq. (2) linear.
#
# Limits of the power: what voltage and current allow, and what keeps the wire below its highest
# temperature by the model, whatever a sensor says: an infrared spot wider than the wire reads low.

Array = NDArray[np.float64]

# Below the bench's limit, which switches off: room for a model that errs by some percent.
TEMPERATURE_MARGIN = 10.0
# Of the bench's largest current, which switches off: room for the noise of its sensor.
CURRENT_SHARE = 0.9


@dataclass(frozen=True)
class Heating:
    """Constants of one heated wire.

    Attributes:
        resistance: ohm, by which direct volts heat; supply: V of a duty, else 0; ambient: K;
            loss: h A_c [W/K]; time_constant: s.
        maximum_power: W; power_rate: W/s; maximum_temperature: K.
    """

    resistance: float
    ambient: float
    loss: float
    time_constant: float
    maximum_power: float
    power_rate: float
    maximum_temperature: float
    supply: float = 0.0

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
        ohm, drive = heated_resistance(parameters), parameters["bench.drive"]
        through = parameters["wire.resistance"] / parameters["wire.count"]  # of a channel
        if drive != "current":
            through += parameters["bench.lead_resistance"]
        ampere = CURRENT_SHARE * parameters["bench.maximum_current"]
        highest = heating_voltage(parameters["bench.maximum_voltage"], parameters)
        volt = min(float(highest), through * ampere)
        if drive == "duty":
            volt = min(volt, parameters["bench.supply_voltage"])
        return cls(
            resistance=ohm, ambient=parameters["environment.ambient_temperature"],
            loss=heat_loss(parameters), time_constant=time_constant(parameters),
            maximum_power=min(volt**2 / ohm, maximum_power or math.inf),
            power_rate=power_rate or math.inf,
            maximum_temperature=parameters["bench.maximum_temperature"] - TEMPERATURE_MARGIN,
            supply=parameters["bench.supply_voltage"] if drive == "duty" else 0.0,
        )

    def voltage(self, power: ArrayLike) -> Array:
        """V, commanded, that heat with P [W]."""
        square = np.asarray(power, float) * self.resistance
        return np.asarray(square / self.supply if self.supply else np.sqrt(square))

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
        limit = self._heating.power_toward(self._heating.maximum_temperature, self.temperature, dt)
        return np.clip(limit, 0.0, self._heating.maximum_power)

    def spend(self, power: ArrayLike, dt: float) -> None:
        """Powers (w,) [W] were applied for dt."""
        self.temperature = self._heating.after(self.temperature, power, dt)


# --- Temperature control of wires (experiment E8): one PI a wire, from temperature to power.

class TemperatureController:
    """Reference and measured temperatures in, voltages out.

    In power the wire is a lag, 1/(h A_c) over m c_p/(h A_c): the gains follow from the identified
    parameters by Skogestad's rule.
    """

    def __init__(
        self, parameters: Parameters, period: float, *, delay: float = 0.0,
        closed_loop_time: float = 0.0, maximum_power: float = 0.0, power_rate: float = 0.0,
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


def temperature_reference_fault(reference: Sequence[float], parameters: Parameters) -> str:
    """Why wire temperatures [K], one a channel, cannot be followed, or "".

    Ambient temperature or less only means that a wire is not heated.
    """
    channels = len(parameters["bench.channels"])
    if len(reference) != channels:
        return f"reference has {len(reference)} temperatures, expected {channels}"
    highest = Heating.of(parameters).maximum_temperature
    for kelvin in reference:
        if not math.isfinite(kelvin):
            return f"reference has {kelvin} K, expected finite temperatures"
        if not 0.0 < kelvin <= highest:
            return f"reference has {kelvin:g} K, expected above 0 and at most {highest:g} K"
    return ""
