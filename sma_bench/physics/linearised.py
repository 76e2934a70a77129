"""The linearised model, eqs. (18) to (23) corrected, about any steady state of a rig; and the
inverse model of one side: the temperature at which its wires reach a given contraction.

The states are the wires' temperatures; everything else follows from them without delay. Its change
per kelvin is measured on the simulated bench, driven through temperatures along the branch:

    m c_p dT_i/dt = -h A_c T_i + (2 V_i*/R) v_i + m Delta_h dxi_i/dt                      (1), (19)

The printed coefficients, and the corrected ones next to them, are in paper/printed.py."""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, Self

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq
from scipy.signal import StateSpace

from sma_bench.arrays import Array
from sma_bench.errors import InputError
from sma_bench.parameters import Parameters
from sma_bench.parameters.parameter import BY_NAME, TRANSITIONS
from sma_bench.parameters.parameters import SMOOTHER
from sma_bench.physics import kinetics, material
from sma_bench.physics.boundary import Boundary, moves_tip, side_names, side_of_channels
from sma_bench.physics.effects import active_effects
from sma_bench.physics.kernel import State, at_rest, initial_state, ramps, wire_rows
from sma_bench.physics.laws import law_of, ramp_of
from sma_bench.physics.orientation import as_oriented
from sma_bench.physics.simulate import TemperatureDriven, warmed_from_rest

Branch = Literal["heating", "cooling"]
BEYOND = (*SMOOTHER, "wire.law", "wire.convection", "wire.r_phase_strain", "load.friction",
          "load.stiffening")
_AUSTENITE = 1000.0  # K, at which a wire is austenite under any stress that it can have
# By branch: temperatures between which its ramp changes (lower, upper), and C [Pa/K].
_RANGES: dict[Branch, tuple[str, str, str]] = {
    "heating": (TRANSITIONS["A_s"], TRANSITIONS["A_f"], "wire.stress_influence_austenite"),
    "cooling": (TRANSITIONS["M_f"], TRANSITIONS["M_s"], "wire.stress_influence_martensite"),
}
_STEP = 0.02  # K of the finite differences; halved twice to cancel the curvature
_NO_TANGENT = 0.3  # relative change of a slope when the step is halved: more is a jump


@dataclass(frozen=True)
class SideModel:
    """n equal wires that pull together against a load that moves. Along a branch xi = s f
    (heating) or 1 - xi = s g (cooling), f, g of kinetics.py, s constant between reversals."""

    parameters: Parameters  # of the wires
    wires: int  # n
    stiffness: float  # K [Pa]
    load: float  # Pa
    lever: float  # m, signed deflection per contraction
    prestretch: float = 0.0  # strain at zero contraction

    @classmethod
    def of(cls, parameters: Parameters, side: str, state: State | None = None) -> Self:
        """The wires of `side` against the rig's own load; an antagonist pulls back as in `state`,
        or as cold martensite if None. InputError: no wire on that side, or fixed ends."""
        names = side_names(parameters)
        if side not in names:
            raise InputError(f"no wire on the {side}, expected {' or '.join(names)}")
        boundary, number = Boundary.of(parameters), names.index(side)
        if boundary.contraction is not None:
            raise InputError(f"the wires of the {side} are clamped, they do not contract")
        stiffness, load, lever, prestretch = (
            float(boundary.per_side(name, len(names))[number])
            for name in ("stiffness", "load", "lever", "prestretch"))
        own = side_of_channels(parameters) == number
        if boundary.coupled:  # its contraction stretches the other side: add its stiffness and load
            now = state or at_rest(parameters, boundary)
            xi, kelvin = now.martensite_fraction[~own], now.temperature[~own]
            stretch = boundary.stretch_of_wires(parameters)[~own]
            stiffness += float(material.modulus(xi, parameters).sum())
            load = load if number == 0 else -load
            load += float(np.sum(material.stress(kelvin, xi, -stretch, parameters)))
            lever *= 2.0  # both sides move
        oriented = as_oriented(parameters, prestretch)
        return cls(oriented, int(own.sum()), stiffness, load, lever, prestretch)

    @cached_property
    def _wire(self) -> Array:
        return wire_rows(self.parameters, Boundary())[:1]

    def wire_stress(self, contraction: float) -> float:
        """sigma [Pa] of one wire that balances the load at a contraction."""
        return (self.load + self.stiffness * contraction) / self.wires

    def excess(self, contraction: float, temperature: float, xi: float) -> float:
        """Stress [Pa] of a wire minus the stress that balances the load."""
        shorter = contraction - self.prestretch
        pull = float(material.stress(temperature, xi, shorter, self.parameters))
        return pull - self.wire_stress(contraction)

    def share(self, temperature: float, sigma: float, xi: float, branch: Branch) -> float:
        """s of the branch that starts at a state; 1 where the ramp is 0, so that any s fits."""
        ramp = float(ramps(temperature, sigma, self.parameters)[branch == "cooling"])
        return (xi if branch == "heating" else 1.0 - xi) / ramp if ramp > 0.0 else 1.0

    def at_contraction(self, contraction: float, branch: Branch,
                       share: float = 1.0) -> tuple[float, float]:
        """T [K] and xi at a contraction along a branch, or its hot or cold end if out of reach."""
        start, finish, influence = (self.parameters[name] for name in _RANGES[branch])
        heating, stress = branch == "heating", self.wire_stress(contraction)
        shift = float(kinetics.any_shifting(self._wire, 0, stress)[0 if heating else 2]) / influence
        ramp, ends = ramp_of(self.parameters), law_of(self.parameters).ENDS
        hot, cold = ends if heating else ends[::-1]

        def state(position: float) -> tuple[float, float]:
            left = min(share * ramp(position)[0], 1.0)
            way = position * (finish - start)
            return (shift + finish - way, left) if heating else (shift + start + way, 1.0 - left)

        def excess(position: float) -> float:
            return self.excess(contraction, *state(position))

        if excess(hot) < 0.0:
            return finish + shift, state(hot)[1]
        if excess(cold) <= 0.0:
            return state(float(brentq(excess, hot, cold, xtol=1e-15)))
        ambient, xi = self.parameters["environment.ambient_temperature"], state(cold)[1]
        if expansion := self.parameters["wire.thermal_expansion_factor"]:
            warm = ambient - self.excess(contraction, ambient, xi) / expansion
            return float(min(max(warm, ambient), start + shift)), xi
        return start + shift, xi

    def largest_contraction(self) -> float:
        """e at which the wires, heated, have just become austenite: T = A_f + sigma/C_A."""
        _, finish, influence = (self.parameters[name] for name in _RANGES["heating"])
        none, whole = (self.excess(e, finish + self.wire_stress(e) / influence, 0.0)
                       for e in (0.0, 1.0))  # the excess is linear in e
        return none / (none - whole)


@dataclass(frozen=True, eq=False, kw_only=True)
class OperatingPoint(State):
    """A steady state, without history, and the direction of the next change."""

    parameters: Parameters
    boundary: Boundary
    branch: Branch  # heating if temperatures are about to rise, cooling if to fall
    voltage: Array  # (w,) V, commands that hold the temperatures

    @property
    def deflection(self) -> float:
        """Deflection [m], as `Simulation.deflection`."""
        return float(self.contraction @ self.boundary.levers(self.parameters))

    @classmethod
    def of_state(cls, parameters: Parameters, temperature: ArrayLike,
                 martensite_fraction: ArrayLike, branch: Branch,
                 boundary: Boundary | None = None) -> Self:
        """Any state, within a partial loop too: one or (w,) K and fractions; InputError: as
        `initial_state`, or a temperature that no voltage holds."""
        p, boundary = parameters, boundary or Boundary.of(parameters)
        state = initial_state(p, temperature=temperature, martensite_fraction=martensite_fraction,
                              boundary=boundary)
        ambient = p["environment.ambient_temperature"]
        if np.any(state.temperature < ambient):
            below = f"{state.temperature.min():g} K lies below ambient {ambient:g} K"
            raise InputError(f"operating point: temperature {below}, no voltage holds it")
        loss = material.heat_loss(p) * (state.temperature - ambient)
        heating = np.sqrt(loss * material.heated_resistance(p))
        voltage = material.commanded_voltage(heating, p)
        return cls(parameters=p, boundary=boundary, branch=branch, voltage=voltage, **vars(state))

    @classmethod
    def at_temperature(cls, parameters: Parameters, temperature: ArrayLike,
                       branch: Branch) -> Self:
        """On the full loop, eq. (10) or (11), at one or (w,) K; InputError: as `of_state`."""
        wires = len(parameters["bench.channels"])
        kelvin = np.full(wires, temperature, dtype=float)
        hot = _AUSTENITE if branch == "cooling" else None
        state = warmed_from_rest(parameters, kelvin, hot)
        return cls.of_state(parameters, kelvin, state.martensite_fraction, branch)

    @classmethod
    def at_voltage(cls, parameters: Parameters, voltage: ArrayLike, branch: Branch) -> Self:
        """On the full loop where one or (w,) held voltages [V] lead to."""
        heating = material.heating_voltage(voltage, parameters)
        kelvin = material.steady_temperature(heating, parameters)
        return cls.at_temperature(parameters, kelvin, branch)

    @classmethod
    def at_deflection(cls, parameters: Parameters, deflection: float | None,
                      branch: Branch) -> Self:
        """On the full loop at a deflection [m] (None: half of the first side's largest), one side
        heated evenly, the other at rest; InputError: fixed ends, no wires there, too far."""
        first = side_names(parameters)[0]
        name = first if deflection is None else side_toward(parameters, deflection)
        side = SideModel.of(parameters, name)
        largest = abs(side.lever) * side.largest_contraction()
        if deflection is None:
            deflection = math.copysign(0.5 * largest, side.lever)
        if not abs(deflection) <= largest:
            expected = f"expected at most {largest:.4g} m to the {name}"
            raise InputError(f"operating point: deflection is {deflection:g} m, {expected}")
        kelvin, xi = side.at_contraction(deflection / side.lever, branch)
        driven = np.array(parameters["bench.channel_sides"]) == name
        warm = np.where(driven, kelvin, parameters["environment.ambient_temperature"])
        return cls.of_state(parameters, warm, np.where(driven, xi, 1.0), branch)


def side_toward(parameters: Parameters, deflection: float) -> str:
    """The side whose wires deflect the bench this way [m], of a tip even if it has no wires;
    InputError: a wire with a load would have to become longer."""
    names, boundary = side_names(parameters), Boundary.of(parameters)
    levers = boundary.levers(parameters) * deflection
    if np.any(levers > 0.0):
        return names[int(np.argmax(levers > 0.0))]
    if moves_tip(parameters):
        return "front" if deflection >= 0.0 else "back"
    if deflection != 0.0 and boundary.contraction is None:
        expected = "expected 0 or less: a wire with a load only shortens"
        raise InputError(f"deflection is {deflection:g} m, {expected}")
    return names[0]


def maximum_deflection(parameters: Parameters, side: str = "front") -> float:
    """Deflection [m] (positive) at which one side, heated, has just become austenite; InputError:
    the rig does not bend or has no wires on that side."""
    model = SideModel.of(parameters, side)
    return abs(model.lever) * model.largest_contraction()


@dataclass(frozen=True, eq=False)
class Linearised:
    """First-order change of everything per kelvin of each wire, and the temperatures' dynamics."""

    point: OperatingPoint  # where
    latent_heat: float  # J/kg, used in the linearisation
    fraction_per_kelvin: Array  # (w, w) 1/K, row: wire that changes, column: wire that warms
    stress_per_kelvin: Array  # (w, w) Pa/K
    contraction_per_kelvin: Array  # (s, w) 1/K

    @cached_property
    def deflection_per_kelvin(self) -> Array:
        """(w,) m/K."""
        levers = self.point.boundary.levers(self.point.parameters)
        return np.asarray(levers @ self.contraction_per_kelvin)

    def state_space(self) -> StateSpace:
        """Deviations of wire temperatures [K] driven by those of the wires' voltages [V], eq. (19).
        Outputs, 1 + 2 w: deflection [m], temperatures [K], stresses [Pa]."""
        parameters, wires = self.point.parameters, self.point.temperature.size
        latent_rise = self.latent_heat / parameters["wire.specific_heat"]
        # Latent heat makes a transforming wire heavier: (1 - Delta_h/c_p dxi/dT) dT/dt = ...
        lightness = np.linalg.inv(np.eye(wires) - latent_rise * self.fraction_per_kelvin)
        capacity = parameters["wire.mass"] * parameters["wire.specific_heat"]
        b = lightness * material.power_per_volt(self.point.voltage, parameters) / capacity
        c = np.vstack([self.deflection_per_kelvin, np.eye(wires), self.stress_per_kelvin])
        d = np.zeros((c.shape[0], wires))
        return StateSpace(-lightness / material.time_constant(parameters), b, c, d)

    def deflection_per_volt(self) -> Array:
        """(w,) m/V: steady change of the deflection per change of each voltage."""
        parameters = self.point.parameters
        heating = material.power_per_volt(self.point.voltage, parameters)
        return self.deflection_per_kelvin * heating / material.heat_loss(parameters)


def linearise(point: OperatingPoint, latent_heat: float = 0.0) -> Linearised:
    """Linearised about a point, along its branch, with Delta_h of eq. (1) [J/kg]. InputError:
    a vertical tangent, an effect or a smoother ramp than eqs. (10), (11) is on."""
    parameters, start = point.parameters, point
    beyond = [f"{name} is on" for name in active_effects(parameters)]
    beyond += [f"{n} is {parameters[n]}" for n in BEYOND if parameters[n] != BY_NAME[n].default]
    if beyond:
        raise InputError(f"linearisation: {beyond[0]}, expected eqs. (4), (10), (11) as they are")
    # All wires move at once in the branch's direction, so that none counts as reversed; a wire at
    # the temperature of the air can only warm. In each row of `ways` one wire moves further.
    wires = start.temperature.size
    rise = start.temperature - parameters["environment.ambient_temperature"]
    way = np.where((point.branch == "cooling") & (rise > 2.0 * _STEP), -1.0, 1.0)
    ways = (np.eye(wires) + 0.2) * way
    bench = TemperatureDriven(parameters, start, point.boundary)

    def change(step: float) -> Array:
        """(w, 2 w + s) change of fractions, stresses, contractions over the step, per direction."""
        rows, changing = [], ("martensite_fraction", "stress", "contraction")
        for direction in ways:
            bench.begin(start)
            bench.run([0.0, 1.0], start.temperature[np.newaxis] + step * direction)
            now = bench.state
            rows.append(np.concatenate([getattr(now, n) - getattr(start, n) for n in changing]))
        return np.array(rows) / step

    coarse, middle, fine = (change(_STEP / k) for k in (1.0, 2.0, 4.0))
    if np.any(np.abs(fine - middle)[:, :wires] > _NO_TANGENT * np.abs(fine[:, :wires]) + 1e-6):
        unstable = f"at {point.temperature} K stress drives the transformation by itself"
        raise InputError(f"linearisation: {unstable}, expected a stable state")
    per_kelvin = np.linalg.solve(ways, (8.0 * fine - 6.0 * middle + coarse) / 3.0).T
    fraction, stress, contraction = np.split(per_kelvin, [wires, 2 * wires])
    return Linearised(point, latent_heat, fraction, stress, contraction)
