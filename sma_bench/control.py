"""Controllers of the bench, without ROS: from readings and references to voltages."""

import math
from collections.abc import Sequence
from typing import NamedTuple, Self, get_args

import numpy as np
from numpy.typing import ArrayLike

from sma_bench.arrays import Array, Mask
from sma_bench.errors import InputError
from sma_bench.parameters import Parameters
from sma_bench.parameters.parameter import BY_NAME, EFFECT_TABLE
from sma_bench.parameters.parameters import SMOOTHER, load_kind
from sma_bench.physics import Bench, linearised, side_names
from sma_bench.physics.linearised import Branch, OperatingPoint, SideModel
from sma_bench.physics.material import heat_loss, heated_resistance, heating_voltage, time_constant

TEMPERATURE_MARGIN = 10.0  # K below the limit at which the bench switches off: errors of the model
CURRENT_SHARE = 0.9  # of the limit at which the bench switches off: sensor noise


# --- A PI controller with anti-windup, and its tuning rule. sat limits the output and its rate; I
# has the unit of the output, so that gains can change without a bump.
#
#     u = sat[u_ff + K (r - y) + I],   dI/dt = K/T_i (r - y) + (sat[u] - u)/T_i


class Gains(NamedTuple):
    """Gains of a PI controller: K (output per unit of error) and T_i [s]."""

    proportional: float
    integral_time: float

    @classmethod
    def simc(cls, gain: float, time_constant: float, delay: float,
             closed_loop_time: float = 0.0) -> Self:
        """Gains for the plant k e^(-theta s)/(tau s + 1) by Skogestad's rule (SIMC, 2003):
        K = tau/(k (tau_c + theta)), T_i = min(tau, 4 (tau_c + theta)). `gain`: k; times in s:
        `time_constant` tau, `delay` theta, `closed_loop_time` tau_c (0: half of tau, or theta if
        longer; slow enough for T_i = tau, without overshoot)."""
        wanted = (closed_loop_time or max(0.5 * time_constant, delay)) + delay
        return cls(time_constant / (gain * wanted), min(time_constant, 4.0 * wanted))


class OutputLimits(NamedTuple):
    """The output lies between 0 and `high`; largest change of it [1/s]."""

    high: float
    rate: float = math.inf

    def applied(self, output: float, last: float, dt: float) -> float:
        """The output limited in rate, then in range; the range takes precedence over the rate."""
        slowed = min(max(output, last - self.rate * dt), last + self.rate * dt)
        return min(max(slowed, 0.0), self.high)


class PI:
    """One control loop; time is passed in as dt."""

    def __init__(self, gains: Gains, limits: OutputLimits) -> None:
        self.gains, self.limits = gains, limits
        self.start(0.0)

    def start(self, output: float) -> None:
        """Start anew and without a bump: if the control error is 0, the next output is `output`."""
        self._integral = self._output = min(max(output, 0.0), self.limits.high)

    def step(self, reference: float, measured: float, dt: float, feedforward: float = 0.0) -> float:
        """The output for the next `dt` s."""
        error, gains = reference - measured, self.gains
        wanted = feedforward + gains.proportional * error + self._integral
        self._output = self.limits.applied(wanted, self._output, dt)
        self._integral += gains.proportional * error * dt / gains.integral_time
        self._integral += (self._output - wanted) * min(dt / gains.integral_time, 1.0)
        return self._output


class Heating:
    """Heating power of the wires as control input: v = sqrt(P R) makes eq. (2) linear. Limited by
    voltage, current and the model's temperature, because an infrared sensor may read too low."""

    def __init__(self, p: Parameters, period: float, maximum_power: float,
                 power_rate: float) -> None:
        """Wires start at ambient. `period`: s per step; `maximum_power` in W, besides the limits of
        voltage and current (0: only those); `power_rate` in W/s (0: no limit)."""
        drive, self._resistance = p["bench.drive"], heated_resistance(p)
        self._supply = p["bench.supply_voltage"] if drive == "duty" else 0.0
        through = p["wire.resistance"] / p["wire.count"]  # ohm, of a channel
        through += p["bench.lead_resistance"] if drive != "current" else 0.0
        volt = float(heating_voltage(p["bench.maximum_voltage"], p))
        volt = min(volt, through * (CURRENT_SHARE * p["bench.maximum_current"]))
        volt = min(volt, self._supply or math.inf)
        self.maximum_power = min(volt**2 / self._resistance, maximum_power or math.inf)
        self.power_rate = power_rate or math.inf
        self.loss, self.time_constant = heat_loss(p), time_constant(p)  # h A_c [W/K], s
        self.ambient = float(p["environment.ambient_temperature"])
        self.maximum_temperature = p["bench.maximum_temperature"] - TEMPERATURE_MARGIN
        self._decay = math.exp(-period / self.time_constant)
        # (w,) K, simulated with the powers applied.
        self.temperature = np.full(len(p["bench.channels"]), self.ambient)

    def voltage(self, power: ArrayLike) -> Array:
        """Commanded voltages for heating powers [W]."""
        square = np.asarray(power, float) * self._resistance
        return np.asarray(square / self._supply if self._supply else np.sqrt(square))

    def holding_power(self, temperature: ArrayLike) -> Array:
        """Powers [W] that hold temperatures [K]."""
        return self.loss * (np.asarray(temperature, float) - self.ambient)

    def power_toward(self, goal: ArrayLike, temperature: ArrayLike) -> Array:
        """Powers [W], of either sign, that lead to `goal` [K] in a period: eq. (2) inverted."""
        start, decay = np.asarray(temperature, float), self._decay
        return self.holding_power((np.asarray(goal, float) - start * decay) / (1.0 - decay))

    def highest_power(self) -> Array:
        """(w,) W, the limit for the next period by the supply and the highest temperature."""
        limit = self.power_toward(self.maximum_temperature, self.temperature)
        return np.clip(limit, 0.0, self.maximum_power)

    def spend(self, power: ArrayLike) -> None:
        """Advance the model's temperatures by a period with powers (w,) [W]: eq. (2)."""
        steady = self.ambient + np.asarray(power, float) / self.loss
        self.temperature = steady + (self.temperature - steady) * self._decay


class TemperatureController:
    """From reference and measured temperatures to voltages: one PI controller per wire, with power
    as output. For power, the wire is a first-order lag with gain 1/(h A_c) and time constant
    m c_p/(h A_c); the gains follow by Skogestad's rule."""

    def __init__(self, parameters: Parameters, period: float, *, delay: float = 0.0,
                 closed_loop_time: float = 0.0, maximum_power: float = 0.0,
                 power_rate: float = 0.0) -> None:
        """`period`: s per step. `delay`: s from a temperature to the power that reacts to it; half
        a period is added. Others: see `Gains.simc`, `Heating`."""
        self._period, self.heating = period, Heating(parameters, period, maximum_power, power_rate)
        gain, late = 1.0 / self.heating.loss, 0.5 * period + delay
        self.gains = Gains.simc(gain, self.heating.time_constant, late, closed_loop_time)
        self._loops: list[PI | None] = [None] * len(parameters["bench.channels"])  # all off

    def step(self, reference: Sequence[float] | Array, measured: Sequence[float] | Array) -> Array:
        """Voltages (w,) [V] for the next period. `reference`, `measured`: (w,) K; NaN, or a
        reference at or below ambient, switches a wire off."""
        power = np.zeros(len(self._loops))
        for i, highest in enumerate(self.heating.highest_power().tolist()):
            goal, now, loop = float(reference[i]), float(measured[i]), self._loops[i]
            if not math.isfinite(goal + now) or goal <= self.heating.ambient:
                self._loops[i] = None
                continue
            limits = OutputLimits(highest, self.heating.power_rate)
            if loop is None:  # bumpless start of a wire that is warm already
                loop = self._loops[i] = PI(self.gains, limits)
                loop.start(float(self.heating.holding_power(now)))
            loop.limits = limits
            power[i] = loop.step(goal, now, self._period)
        self.heating.spend(power)
        return self.heating.voltage(power)

    @staticmethod
    def reference_fault(reference: Sequence[float], parameters: Parameters) -> str:
        """Why wire temperatures [K], one per channel, cannot be followed, or "" if they can."""
        channels = len(parameters["bench.channels"])
        highest = parameters["bench.maximum_temperature"] - TEMPERATURE_MARGIN
        if len(reference) != channels:
            return f"reference has {len(reference)} temperatures, expected {channels}"
        for kelvin in reference:
            if not 0.0 < kelvin <= highest:
                return f"reference has {kelvin:g} K, expected above 0 and at most {highest:g} K"
        return ""


# --- Deflection control: feed-forward by the inverse model, feedback by the linear one.
#
# Feed-forward: a nominal bench is simulated alongside. For the reference deflection of the active
# side (plus what remains of the other side's), the inverse model on the present branch of the
# hysteresis gives the temperature of the wires, and eq. (2) inverted the power that brings the
# nominal wires there within one period, as far as possible: wires can be heated, not cooled.
# Feedback: a PI controller on nominal minus measured deflection adds to that power. Its gains
# follow by Skogestad's rule from the linearised model, interpolated between operating points of the
# branch. The front wires are active at positive references, the back wires at negative ones, none
# at zero.

# Operating points of the gain schedule, as shares of the largest deflection. At both ends the plant
# gain tends to 0; a floor of _LOWEST_PART of its middle value keeps the controller gain finite.
_SCHEDULE, _LOWEST_PART, _LAST_REACHABLE = np.linspace(0.02, 0.98, 13), 0.5, 0.999


class _Side(NamedTuple):
    """A side at rest: its wires (w,); gain schedule: deflections [m] and gains [m/W], by branch."""

    name: str
    sign: float
    model: SideModel
    wires: Mask
    schedule: dict[Branch, tuple[Array, Array]]

    @classmethod
    def of(cls, parameters: Parameters, name: str, loss: float) -> Self:
        # The schedule uses the paper's model; effects act in the nominal bench only, other laws in
        # the inverse model, too.
        beyond = (*EFFECT_TABLE, *(BY_NAME[name] for name in SMOOTHER))
        parameters = parameters.replace({p.name: p.default for p in beyond})
        model = SideModel.of(parameters, name)
        largest = linearised.maximum_deflection(parameters, name)
        parameters = parameters.replace({name: BY_NAME[name].default for name in linearised.BEYOND})
        wires = np.array(parameters["bench.channel_sides"]) == name
        sign = math.copysign(1.0, model.lever)
        schedule: dict[Branch, tuple[Array, Array]] = {}
        for branch in get_args(Branch):
            gains = np.empty(len(_SCHEDULE))
            for k, part in enumerate(_SCHEDULE):
                point = OperatingPoint.at_deflection(parameters, sign * part * largest, branch)
                gains[k] = np.abs(linearised.linearise(point).deflection_per_kelvin[wires]).sum()
            floor = np.maximum(gains, _LOWEST_PART * gains[len(gains) // 2])
            schedule[branch] = (_SCHEDULE * largest, floor / loss)
        return cls(name, sign, model, wires, schedule)


class DeflectionController:
    """From reference and measured deflection to voltages."""

    def __init__(self, parameters: Parameters, period: float, *, delay: float = 0.0,
                 closed_loop_time: float = 0.0, maximum_power: float = 0.0,
                 power_rate: float = 0.0) -> None:
        """Arguments as `TemperatureController`. Raises InputError: the rig does not move."""
        self.parameters, self._period = parameters, period
        self.heating = Heating(parameters, period, maximum_power, power_rate)
        loss, late = self.heating.loss, 0.5 * period + delay
        self._sides = [_Side.of(parameters, name, loss) for name in side_names(parameters)]
        self.gains = Gains.simc(1.0, self.heating.time_constant, late, closed_loop_time)
        self._coupled = load_kind(parameters) == "antagonist"
        self._nominal = Bench(parameters)  # assumed to start at rest
        self._active: _Side | None = None
        self._ahead = 0.0
        self._loop = PI(self.gains, OutputLimits(self.heating.maximum_power))

    def step(self, goal: float, measured: float) -> Array:
        """Voltages (w,) [V] for the next period. `goal`: the reference [m] at its end, positive to
        the front; `measured`: m, NaN: feed-forward only."""
        dt = self._period
        side = next((side for side in self._sides if side.sign * goal > 0.0), None)
        if side is not self._active:
            self._active, self._ahead = side, 0.0
            self._loop.start(0.0)
        nominal = np.zeros(len(self.parameters["bench.channels"]))
        applied = nominal.copy()
        if side is not None:
            # Contraction wanted from this side, and the branch that leads there.
            model, others = side.model, 0.0
            now = dict(zip([s.name for s in self._sides], self._nominal.contraction, strict=True))
            if self._coupled:
                model = SideModel.of(self.parameters, side.name, state=self._nominal.state)
            else:
                others = float(sum(now[name] for name in now if name != side.name))
            wanted = abs(goal) / abs(model.lever) + max(others, 0.0)
            wanted = min(wanted, _LAST_REACHABLE * model.largest_contraction())
            branch: Branch = "heating" if wanted >= now[side.name] else "cooling"
            # Power [W] of each of its wires toward it, within the limits.
            state, wire = self._nominal.state, int(np.argmax(side.wires))
            kelvin, sigma = float(state.temperature[wire]), float(state.stress[wire])
            share = model.share(kelvin, sigma, float(state.martensite_fraction[wire]), branch)
            warm, _ = model.at_contraction(wanted, branch, share)
            toward = float(self.heating.power_toward(warm, kelvin))
            highest = float(self.heating.highest_power()[side.wires].min())
            limits = OutputLimits(highest, self.heating.power_rate)
            # Limit the feed-forward first: what it lacks must not wind up the feedback.
            self._ahead = limits.applied(toward, self._ahead, dt)
            nominal[side.wires] = applied[side.wires] = self._ahead
            if math.isfinite(measured):
                followed = side.sign * self._nominal.deflection
                gain = float(np.interp(followed, *side.schedule[branch]))
                self._loop.limits = limits
                self._loop.gains = Gains(self.gains.proportional / gain, self.gains.integral_time)
                seen = side.sign * measured
                applied[side.wires] = self._loop.step(followed, seen, dt, self._ahead)
        self._nominal.advance(self.heating.voltage(nominal), dt)
        self.heating.spend(applied)
        return self.heating.voltage(applied)

    @staticmethod
    def reference_fault(reference: Sequence[float], parameters: Parameters) -> str:
        """Why a deflection [m], the only element, cannot be followed, or "" if it can."""
        (metres,) = reference
        if not math.isfinite(metres):
            return f"reference is {metres} m, expected a finite deflection"
        if metres == 0.0:
            return ""
        try:
            side = linearised.side_toward(parameters, metres)
        except InputError as error:
            return f"reference: {error}"
        message = f"reference is {metres:g} m"
        if side not in parameters["bench.channel_sides"]:
            return f"{message}, but there is no wire on the {side}"
        largest = linearised.maximum_deflection(parameters, side)
        far = abs(metres) > largest
        return f"{message}, expected at most {largest:.4g} m to the {side}" if far else ""
