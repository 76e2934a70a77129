"""Steady states on the heating or cooling branch: a side's inverse; where a rig is linearised."""

import math
from dataclasses import dataclass
from functools import partial
from typing import Literal, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import brentq

from sma_bench.errors import InputError
from sma_bench.parameters import Parameters
from sma_bench.physics import material
from sma_bench.physics.boundary import (
    Boundary,
    moves_tip,
    per_side,
    side_names,
    side_of_channels,
)
from sma_bench.physics.heat import (
    commanded_voltage,
    heat_loss,
    heated_resistance,
    heating_voltage,
    steady_temperature,
)
from sma_bench.physics.kernel import State, initial_state

# --- The model of one side turned round: the temperature at which its wires bend as wanted.
#
# Along a branch xi = s f (heating) or 1 - xi = s g (cooling), with the ramps f, g of material.py
# and a share s that is constant between two reversals: xi_r/f_r or (1 - xi_r)/g_r, and 1 on a
# full loop. A wanted contraction e fixes the stress, sigma = (load + K e)/n, the constitutive
# law then fixes xi up to the small thermal stress, and the branch fixes the temperature.

Branch = Literal["heating", "cooling"]

_TEMPERATURE_TOLERANCE = 1e-11  # K


@dataclass(frozen=True)
class SideModel:
    """Constants of n equal wires that pull together against a boundary that gives.

    Attributes:
        wires: n; stiffness: K [Pa]; load: [Pa]; lever: m, signed deflection per contraction;
            prestretch: strain at zero contraction.
        start, finish, influence: by branch, where the ramp leaves 0 (M_f) or 1 (A_s), where it
            ends, and C [Pa/K].
        modulus: E_A; modulus_change: E_M - E_A [Pa]; recoverable_strain: eps_L.
        expansion: Theta_T [Pa/K]; ambient: T_inf [K].
    """

    wires: int
    stiffness: float
    load: float
    lever: float
    ranges: dict[Branch, tuple[float, float, float]]
    modulus: float
    modulus_change: float
    recoverable_strain: float
    expansion: float
    ambient: float
    prestretch: float = 0.0

    @classmethod
    def of(
        cls, parameters: Parameters, side: str, boundary: Boundary | None = None,
        state: State | None = None,
    ) -> Self:
        """The wires of `side` against the rig's own load unless another boundary is given.

        Args:
            state: of the bench; of antagonists the other side pulls back as it is there, else as
                cold martensite.

        Raises:
            InputError: no wire on that side, or ends that do not give.
        """
        names = side_names(parameters)
        if side not in names:
            raise InputError(f"no wire on the {side}, expected {' or '.join(names)}")
        boundary = boundary or Boundary.of(parameters)
        if boundary.contraction is not None:
            raise InputError(f"the wires of the {side} are clamped, they do not contract")
        number = names.index(side)
        wire = {key.removeprefix("wire."): parameters[key] for key in parameters if "wire." in key}
        stiffness, load, lever, prestretch = (
            float(per_side(name, getattr(boundary, name), len(names))[number])
            for name in ("stiffness", "load", "lever", "prestretch")
        )
        if boundary.coupled:
            # Stiffness and load [Pa] of the antagonists of a side: what it contracts
            # stretches them.
            others = side_of_channels(parameters) != number
            xi = np.ones(others.sum()) if state is None else state.martensite_fraction[others]
            kelvin = parameters["environment.ambient_temperature"]
            kelvin = kelvin if state is None else state.temperature[others]
            stretch = boundary.stretch_of_wires(parameters)[others]
            pull = material.stress(kelvin, xi, -stretch, parameters)
            back = float(material.modulus(xi, parameters).sum()), float(np.sum(pull))
            stiffness, load = stiffness + back[0], (load if number == 0 else -load) + back[1]
            lever *= 2.0  # both sides move
        return cls(
            wires=int((side_of_channels(parameters) == number).sum()),
            stiffness=stiffness, load=load, lever=lever, prestretch=prestretch,
            ranges={
                "heating": (
                    wire["austenite_start_temperature"], wire["austenite_finish_temperature"],
                    wire["stress_influence_austenite"],
                ),
                "cooling": (
                    wire["martensite_finish_temperature"], wire["martensite_start_temperature"],
                    wire["stress_influence_martensite"],
                ),
            },
            modulus=wire["austenite_modulus"],
            modulus_change=wire["martensite_modulus"] - wire["austenite_modulus"],
            recoverable_strain=wire["maximum_recoverable_strain"],
            expansion=wire["thermal_expansion_factor"],
            ambient=parameters["environment.ambient_temperature"],
        )

    def wire_stress(self, contraction: float) -> float:
        """sigma [Pa] of one wire that the boundary asks for at a contraction."""
        return (self.load + self.stiffness * contraction) / self.wires

    def fraction(self, contraction: float, temperature: float) -> float:
        """xi that gives a wire that stress, eq. (6); outside 0 to 1 where none does."""
        thermal = self.expansion * (temperature - self.ambient)
        stretch = self.recoverable_strain + self.prestretch - contraction
        square = -self.modulus_change * self.recoverable_strain
        slope = self.modulus_change * stretch - self.modulus * self.recoverable_strain
        constant = self.modulus * stretch + thermal - self.wire_stress(contraction)
        root = math.sqrt(max(slope**2 - 4.0 * square * constant, 0.0))
        return 2.0 * constant / (root - slope)

    def ramp(self, temperature: float, sigma: float, branch: Branch) -> float:
        """f(T, sigma) on heating, g(T, sigma) on cooling."""
        start, finish, influence = self.ranges[branch]
        position = (temperature - start - sigma / influence) / (finish - start)
        if branch == "heating":
            position = 1.0 - position
        return math.sin(0.5 * math.pi * min(max(position, 0.0), 1.0)) ** 2

    def share(self, temperature: float, sigma: float, xi: float, branch: Branch) -> float:
        """s of the branch that leaves from a state; 1 where the ramp is 0 and any would do."""
        ramp = self.ramp(temperature, sigma, branch)
        left = xi if branch == "heating" else 1.0 - xi
        return left / ramp if ramp > 0.0 else 1.0

    def temperature(self, contraction: float, branch: Branch, share: float = 1.0) -> float:
        """T [K] at a contraction along a branch; the end of the transformation beyond it.

        Where the thermal stress alone gives the contraction, before the transformation begins,
        that temperature.
        """
        sigma = self.wire_stress(contraction)
        start, finish, influence = self.ranges[branch]
        low, high = start + sigma / influence, finish + sigma / influence

        def excess(temperature: float) -> float:
            wanted = self.fraction(contraction, temperature)
            left = wanted if branch == "heating" else 1.0 - wanted
            ahead = left - min(share * self.ramp(temperature, sigma, branch), 1.0)
            return ahead if branch == "heating" else -ahead

        if excess(high) < 0.0:
            return high
        if excess(low) > 0.0:
            xi = share if branch == "heating" else 1.0
            stretch = self.recoverable_strain * (1.0 - xi) + self.prestretch - contraction
            elastic = (self.modulus + xi * self.modulus_change) * stretch
            if self.expansion == 0.0:
                return low
            return min(max(self.ambient + (sigma - elastic) / self.expansion, self.ambient), low)
        return float(brentq(excess, low, high, xtol=_TEMPERATURE_TOLERANCE))

    def largest_contraction(self) -> float:
        """e at which the wires, heated, have just become austenite: T = A_f + sigma/C_A."""
        _, finish, influence = self.ranges["heating"]
        thermal = self.expansion * (finish - self.ambient)
        # sigma = E_A (eps_L + eps_0 - e) + Theta_T (A_f + sigma/C_A - T_inf) = (load + K e)/n
        pull = self.modulus * (self.recoverable_strain + self.prestretch) + thermal
        kept = 1.0 - self.expansion / influence
        stiffness = kept * self.stiffness / self.wires + self.modulus
        return (pull - kept * self.load / self.wires) / stiffness

# --- Where the model is linearised: wires at steady temperatures on one branch.

Array = NDArray[np.float64]

_TOLERANCE = 1e-16
_LARGEST_CONTRACTION = 1.0


@dataclass(frozen=True, eq=False)
class OperatingPoint:
    """A steady state and the direction of the change to come.

    Attributes:
        parameters, boundary: the rig.
        branch: heating if temperatures are about to rise, cooling if they are about to fall.
        voltage: (w,) V, commands that hold the temperatures.
        temperature: (w,) K; martensite_fraction: (w,); stress: (w,) Pa.
        contraction: (s,), -(eps - eps_0) of each side, in the order of `side_names`.
    """

    parameters: Parameters
    boundary: Boundary
    branch: Branch
    voltage: Array
    temperature: Array
    martensite_fraction: Array
    stress: Array
    contraction: Array

    @property
    def deflection(self) -> float:
        """Deflection [m], as `Simulation.deflection`."""
        levers = per_side("lever", self.boundary.lever, self.contraction.size)
        return float(self.contraction @ levers)

    @property
    def state(self) -> State:
        """The state without its history; what follows runs on `branch` from here."""
        return State(self.temperature, self.martensite_fraction, self.stress, self.contraction)

    @classmethod
    def of_state(
        cls, parameters: Parameters, temperature: ArrayLike, martensite_fraction: ArrayLike,
        branch: Branch, boundary: Boundary | None = None,
    ) -> Self:
        """Any state, within a partial loop too.

        Args:
            temperature: one or (w,) K, not below ambient.
            martensite_fraction: one or (w,), 0 to 1.

        Raises:
            InputError: as `initial_state`, or a temperature that no voltage holds.
        """
        boundary = boundary or Boundary.of(parameters)
        state = initial_state(
            parameters, temperature=temperature, martensite_fraction=martensite_fraction,
            boundary=boundary,
        )
        rise = state.temperature - parameters["environment.ambient_temperature"]
        if np.any(rise < 0.0):
            raise InputError(
                f"operating point: temperature {state.temperature.min():g} K lies below ambient "
                f"{parameters['environment.ambient_temperature']:g} K, no voltage holds it"
            )
        direct = np.sqrt(rise * heat_loss(parameters) * heated_resistance(parameters))
        voltage = commanded_voltage(direct, parameters)
        return cls(
            parameters, boundary, branch, voltage, state.temperature,
            state.martensite_fraction, state.stress, state.contraction,
        )

    @classmethod
    def at_temperature(
        cls, parameters: Parameters, temperature: ArrayLike, branch: Branch,
        boundary: Boundary | None = None,
    ) -> Self:
        """On the full loop, eq. (10) or (11), at one or (w,) temperatures [K].

        Raises:
            InputError: wrong shape, or a temperature below ambient.
        """
        boundary = boundary or Boundary.of(parameters)
        wires = len(parameters["bench.channels"])
        kelvin = np.array(np.broadcast_to(np.asarray(temperature, dtype=float), (wires,)))
        # (w,) martensite fractions, the stresses of each side or of both on a slider in
        # balance.
        side, sides = side_of_channels(parameters), len(side_names(parameters))
        contraction = np.zeros(sides)
        if boundary.contraction is not None:
            contraction = per_side("contraction", boundary.contraction, sides)
        stretch = boundary.stretch_of_wires(parameters)
        stiffness, load = (per_side(n, getattr(boundary, n), sides) for n in ("stiffness", "load"))

        def fractions(shared: Array) -> Array:
            shorter = shared[side] - stretch
            pairs = zip(kelvin.tolist(), shorter.tolist(), strict=True)
            return np.array([_fraction(t, e, branch, parameters) for t, e in pairs])

        def imbalance(own: float, number: int) -> float:
            shared = np.zeros(sides)
            shared[number] = own
            if boundary.coupled:
                shared[1 - number] = -own
            sigma = material.stress(kelvin, fractions(shared), shared[side] - stretch, parameters)
            pull = np.bincount(side, sigma, sides)
            against = pull[1 - number] if boundary.coupled else 0.0
            return float(pull[number] - against - load[number] - stiffness[number] * own)

        if boundary.contraction is None:
            for number in range(1 if boundary.coupled else sides):
                # Root of a falling function, looked for ever farther from 0.
                function = partial(imbalance, number=number)
                outward = 1.0 if function(0.0) > 0.0 else -1.0
                near, far = 0.0, outward * 0.01
                while function(far) * outward > 0.0:
                    if abs(far) > _LARGEST_CONTRACTION:
                        raise InputError(
                            "operating point: no contraction balances the stresses of a side"
                        )
                    near, far = far, 2.0 * far
                contraction[number] = brentq(function, near, far, xtol=_TOLERANCE, rtol=1e-15)
            if boundary.coupled:
                contraction[1] = -contraction[0]
        fraction = fractions(contraction)
        return cls.of_state(parameters, kelvin, fraction, branch, boundary)

    @classmethod
    def at_voltage(
        cls, parameters: Parameters, voltage: ArrayLike, branch: Branch,
        boundary: Boundary | None = None,
    ) -> Self:
        """On the full loop where one or (w,) held voltages [V] lead to.

        Raises:
            InputError: wrong shape.
        """
        return cls.at_temperature(
            parameters, steady_temperature(heating_voltage(voltage, parameters), parameters),
            branch, boundary,
        )

    @classmethod
    def at_deflection(cls, parameters: Parameters, deflection: float, branch: Branch) -> Self:
        """On the full loop at a deflection [m]: its side driven evenly, the other at rest.

        Raises:
            InputError: the rig does not bend, has no wires on that side, or not that far.
        """
        name = side_toward(parameters, deflection)
        side = SideModel.of(parameters, name)
        largest = maximum_deflection(parameters, name)
        if not abs(deflection) <= largest:
            raise InputError(
                f"operating point: deflection is {deflection:g} m, expected at most "
                f"{largest:.4g} m to the {name}"
            )
        contraction = deflection / side.lever
        kelvin = side.temperature(contraction, branch)
        xi = min(max(side.fraction(contraction, kelvin), 0.0), 1.0)
        driven = np.array(parameters["bench.channel_sides"]) == name
        ambient = parameters["environment.ambient_temperature"]
        return cls.of_state(
            parameters, np.where(driven, kelvin, ambient), np.where(driven, xi, 1.0), branch
        )


def side_toward(parameters: Parameters, deflection: float) -> str:
    """The side whose wires deflect the bench that way [m]; of a beam whether they are there or not.

    Raises:
        InputError: a wire with a load was to become longer.
    """
    names, boundary = side_names(parameters), Boundary.of(parameters)
    levers = per_side("lever", boundary.lever, len(names)) * deflection
    if np.any(levers > 0.0):
        return names[int(np.argmax(levers > 0.0))]
    if moves_tip(parameters):
        return "front" if deflection >= 0.0 else "back"
    if deflection != 0.0 and boundary.contraction is None:
        raise InputError(
            f"deflection is {deflection:g} m, expected 0 or less: a wire with a load only shortens"
        )
    return names[0]


def maximum_deflection(parameters: Parameters, side: str = "front") -> float:
    """Deflection [m] (positive) at which one side, heated, has just become austenite.

    Raises:
        InputError: the rig does not bend or has no wires on that side.
    """
    model = SideModel.of(parameters, side)
    return abs(model.lever) * model.largest_contraction()


def full_stroke(parameters: Parameters) -> float:
    """Signed deflection [m] at which the first side, heated, has just become austenite."""
    model = SideModel.of(parameters, side_names(parameters)[0])
    return model.lever * model.largest_contraction()


def _fraction(
    temperature: float, contraction: float, branch: Branch, parameters: Parameters
) -> float:
    ramp = material.heated_fraction if branch == "heating" else material.cooled_fraction

    def error(xi: float) -> float:
        sigma = material.stress(temperature, xi, contraction, parameters)
        return xi - float(ramp(temperature, sigma, parameters))

    if error(0.0) >= 0.0:
        return 0.0
    if error(1.0) <= 0.0:
        return 1.0
    return float(brentq(error, 0.0, 1.0, xtol=_TOLERANCE, rtol=1e-15))
