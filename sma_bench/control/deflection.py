"""Deflection control: feed-forward by the inverse model, feedback by the linear one.

Feed-forward. A nominal bench runs along in software. For the wanted deflection of the side in
charge (the other side's remaining deflection added), the inverse of the model on the present
branch of the hysteresis gives the wires' temperature, and eq. (2) inverted the power that brings
the nominal wires there within one period, as far as power can: wires only heat, V >= 0.

Feedback. A PI on nominal minus measured deflection adds to that power. Where the nominal bench
cannot follow, the feedback does not ask for it. Gains are Skogestad's for the linearised model,
its gain interpolated along the branch between operating points.

Positive deflections are the front wires' work, negative ones the back wires'; at zero both rest. A
wire with a load only shortens: its deflection is its elongation, 0 or less. Antagonists pull
against each other as they are at the moment.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from sma_bench.control.temperature import PI, Gains, HeatBudget, Heating, OutputLimits
from sma_bench.errors import InputError
from sma_bench.parameters import Parameters
from sma_bench.parameters.parameter import EFFECT_TABLE
from sma_bench.parameters.parameters import load_kind
from sma_bench.parameters.table import BY_NAME
from sma_bench.physics import Bench, side_names
from sma_bench.physics.linearised import SMOOTHER, linearise
from sma_bench.physics.operating_point import (
    Branch,
    OperatingPoint,
    SideModel,
    maximum_deflection,
    side_toward,
)

Array = NDArray[np.float64]

BEYOND = (*EFFECT_TABLE, *(BY_NAME[name] for name in SMOOTHER))

# Operating points of the gain schedule, as parts of the largest deflection.
_SCHEDULE = np.linspace(0.02, 0.98, 13)
# Near both ends of the transformation the gain goes to zero: there the loop is let slow down
# rather than asked for as much more power.
_LOWEST_PART = 0.5
_LAST_REACHABLE = 0.999


@dataclass(frozen=True)
class _Side:
    """What is known of a side before it moves; gain in m/W of each wire, by branch."""

    name: str
    sign: float
    model: SideModel
    wires: Array
    schedule: dict[Branch, tuple[Array, Array]]

    @classmethod
    def of(cls, parameters: Parameters, name: str, loss: float) -> Self:
        # The linear model is the paper's; effects that were identified are the nominal bench's.
        parameters = parameters.replace({p.name: p.default for p in BEYOND})
        model = SideModel.of(parameters, name)
        largest = maximum_deflection(parameters, name)
        sign = math.copysign(1.0, model.lever)
        schedule: dict[Branch, tuple[Array, Array]] = {}
        branches: tuple[Branch, ...] = ("heating", "cooling")
        for branch in branches:
            gains = [
                _gain(OperatingPoint.at_deflection(parameters, sign * part * largest, branch), name)
                for part in _SCHEDULE
            ]
            middle = gains[len(gains) // 2]
            floor = np.maximum(np.array(gains), _LOWEST_PART * middle)
            schedule[branch] = (_SCHEDULE * largest, floor / loss)
        wires = np.array(parameters["bench.channel_sides"]) == name
        return cls(name, sign, model, wires, schedule)

    def gain(self, deflection: float, branch: Branch) -> float:
        """m of this side per W of each of its wires."""
        return float(np.interp(deflection, *self.schedule[branch]))


def _gain(point: OperatingPoint, side: str) -> float:
    own = np.array(point.parameters["bench.channel_sides"]) == side
    return float(np.abs(linearise(point).deflection_per_kelvin[own]).sum())


class DeflectionController:
    """Reference and measured deflection in, voltages out."""

    def __init__(
        self, parameters: Parameters, period: float, *, delay: float = 0.0,
        closed_loop_time: float = 0.0, maximum_power: float = 0.0, power_rate: float = 0.0,
        feedback: bool = True,
    ) -> None:
        """Designed for steps of `period` s.

        Args:
            delay, closed_loop_time, maximum_power, power_rate: as `TemperatureController`.
            feedback: False leaves the feed-forward alone, an open loop.

        Raises:
            InputError: the rig does not move, or a number out of range.
        """
        if not 0.0 < period < math.inf:
            raise InputError(f"deflection control: period is {period} s, expected above 0")
        self.parameters = parameters
        self.heating = Heating.of(parameters, maximum_power, power_rate)
        self._sides = {
            name: _Side.of(parameters, name, self.heating.loss)
            for name in side_names(parameters)
        }
        self.gains = Gains.simc(
            1.0, self.heating.time_constant, 0.5 * period + delay, closed_loop_time
        )
        self._coupled = load_kind(parameters) == "antagonist"
        self._feedback = feedback
        self.reset()

    def reset(self) -> None:
        """Forget everything; the bench is taken to be at rest."""
        self._nominal = Bench(self.parameters)
        self._wires = len(self.parameters["bench.channels"])
        self._budget = HeatBudget(self.heating, self._wires)
        self._active: _Side | None = None
        self._ahead = 0.0
        self._loop = PI(self.gains, OutputLimits(0.0, self.heating.maximum_power))

    @property
    def nominal_deflection(self) -> float:
        """Deflection [m] of the nominal bench, which the feedback follows."""
        return self._nominal.deflection

    def step(
        self, reference: float, measured: float, dt: float, upcoming: float | None = None
    ) -> Array:
        """Voltages (w,) [V] from now until `dt` s later.

        Args:
            reference: m, positive toward the front, wanted now.
            measured: m; NaN leaves the feed-forward alone.
            upcoming: m, wanted dt later; the reference when not known.

        Raises:
            InputError: a reference that is not finite, or dt not above 0.
        """
        goal = reference if upcoming is None else upcoming
        if not math.isfinite(reference + goal):
            raise InputError(f"deflection control: reference is {reference} m, expected finite")
        if not 0.0 < dt < math.inf:
            raise InputError(f"deflection control: dt is {dt} s, expected above 0")
        side = self._side_of(goal)
        if side is not self._active:
            self._active = side
            self._loop.reset()
            self._ahead = 0.0
        nominal, applied = np.zeros(self._wires), np.zeros(self._wires)
        if side is not None:
            # Power [W] of each wire toward a deflection [m] of this side, and the
            # branch taken.
            model, wire, others = side.model, int(np.argmax(side.wires)), 0.0
            names = list(self._sides)
            now = self._nominal.contraction
            if self._coupled:
                model = SideModel.of(self.parameters, side.name, state=self._nominal.state)
            else:
                others = float(sum(now[k] for k, name in enumerate(names) if name != side.name))
            wanted = abs(goal) / abs(model.lever) + max(others, 0.0)
            wanted = min(wanted, _LAST_REACHABLE * model.largest_contraction())
            branch: Branch = "heating" if wanted >= now[names.index(side.name)] else "cooling"
            state = self._nominal.state
            kelvin, sigma = float(state.temperature[wire]), float(state.stress[wire])
            share = model.share(kelvin, sigma, float(state.martensite_fraction[wire]), branch)
            wanted, branch = float(
                self.heating.power_toward(model.temperature(wanted, branch, share), kelvin, dt)
            ), branch
            highest = float(self._budget.highest_power(dt)[side.wires].min())
            limits = OutputLimits(0.0, highest, self.heating.power_rate)
            # What the feed-forward cannot have must not wind up the feedback.
            self._ahead = limits.applied(wanted, self._ahead, dt)
            nominal[side.wires] = self._ahead
            applied[side.wires] = self._power(side, branch, limits, measured, dt)
        self._nominal.advance(self.heating.voltage(nominal), dt)
        self._budget.spend(applied, dt)
        return self.heating.voltage(applied)

    def _side_of(self, goal: float) -> _Side | None:
        if goal == 0.0:
            return None
        toward = [side for side in self._sides.values() if side.sign * goal > 0.0]
        return toward[0] if toward else None

    def _power(
        self, side: _Side, branch: Branch, limits: OutputLimits, measured: float, dt: float
    ) -> float:
        if not self._feedback or not math.isfinite(measured):
            return self._ahead
        followed = side.sign * self.nominal_deflection
        self._loop.limits = limits
        self._loop.gains = replace(
            self.gains, proportional=self.gains.proportional / side.gain(followed, branch)
        )
        return self._loop.step(followed, side.sign * measured, dt, self._ahead)


def deflection_reference_fault(reference: Sequence[float], parameters: Parameters) -> str:
    """Why a deflection [m], the only element, cannot be followed, or ""."""
    (metres,) = reference
    if not math.isfinite(metres):
        return f"reference is {metres} m, expected a finite deflection"
    if metres == 0.0:
        return ""
    try:
        side = side_toward(parameters, metres)
    except InputError as error:
        return f"reference: {error}"
    if side not in parameters["bench.channel_sides"]:
        return f"reference is {metres:g} m, but there is no wire on the {side}"
    largest = maximum_deflection(parameters, side)
    if abs(metres) > largest:
        return f"reference is {metres:g} m, expected at most {largest:.4g} m to the {side}"
    return ""
