"""Where the model is linearised: wires at steady temperatures on the heating or cooling branch."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import brentq

from sma_bench.errors import InputError
from sma_bench.parameters import Parameters
from sma_bench.physics import phase, stress
from sma_bench.physics.boundary import Boundary, per_side, side_names, side_of_channels
from sma_bench.physics.heat import heat_loss, steady_temperature
from sma_bench.physics.inverse import Branch, SideModel
from sma_bench.physics.state import State, initial_state

Array = NDArray[np.float64]

_TOLERANCE = 1e-16
_LARGEST_CONTRACTION = 1.0


@dataclass(frozen=True, eq=False)
class OperatingPoint:
    """A steady state and the direction of the change to come.

    Attributes:
        parameters, boundary: the rig.
        branch: heating if temperatures are about to rise, cooling if they are about to fall.
        voltage: (w,) V that hold the temperatures.
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
        """Deflection [m], positive toward the front."""
        levers = per_side("lever", self.boundary.lever, self.contraction.size)
        return float(self.contraction @ levers)

    @property
    def state(self) -> State:
        """The state without its history; what follows runs on `branch` from here."""
        return State(
            self.temperature, self.martensite_fraction, self.stress, self.contraction
        )

    @classmethod
    def of_state(
        cls,
        parameters: Parameters,
        temperature: ArrayLike,
        martensite_fraction: ArrayLike,
        branch: Branch,
        boundary: Boundary | None = None,
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
            parameters,
            temperature=temperature,
            martensite_fraction=martensite_fraction,
            boundary=boundary,
        )
        rise = state.temperature - parameters["environment.ambient_temperature"]
        if np.any(rise < 0.0):
            raise InputError(
                f"operating point: temperature {state.temperature.min():g} K lies below ambient "
                f"{parameters['environment.ambient_temperature']:g} K, no voltage holds it"
            )
        voltage = np.sqrt(rise * heat_loss(parameters) * parameters["wire.resistance"])
        return cls(
            parameters, boundary, branch, voltage, state.temperature,
            state.martensite_fraction, state.stress, state.contraction,
        )

    @classmethod
    def at_temperature(
        cls,
        parameters: Parameters,
        temperature: ArrayLike,
        branch: Branch,
        boundary: Boundary | None = None,
    ) -> Self:
        """On the full loop, eq. (10) or (11), at one or (w,) temperatures [K].

        Raises:
            InputError: wrong shape, or a temperature below ambient.
        """
        boundary = boundary or Boundary.of(parameters)
        wires = len(parameters["bench.channels"])
        kelvin = np.array(np.broadcast_to(np.asarray(temperature, dtype=float), (wires,)))
        fraction = np.empty(wires)
        side = side_of_channels(parameters)
        for number in range(len(side_names(parameters))):
            members = np.flatnonzero(side == number)
            fraction[members] = _fractions(
                kelvin[members], number, branch, parameters, boundary
            )
        return cls.of_state(parameters, kelvin, fraction, branch, boundary)

    @classmethod
    def at_voltage(
        cls,
        parameters: Parameters,
        voltage: ArrayLike,
        branch: Branch,
        boundary: Boundary | None = None,
    ) -> Self:
        """On the full loop where one or (w,) held voltages [V] lead to.

        Raises:
            InputError: wrong shape.
        """
        return cls.at_temperature(
            parameters, steady_temperature(voltage, parameters), branch, boundary
        )

    @classmethod
    def at_deflection(cls, parameters: Parameters, deflection: float, branch: Branch) -> Self:
        """On the full loop at a deflection [m]: its side driven evenly, the other at rest.

        Raises:
            InputError: the rig does not bend, has no wires on that side, or not that far.
        """
        name = "front" if deflection >= 0.0 else "back"
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


def maximum_deflection(parameters: Parameters, side: str = "front") -> float:
    """Deflection [m] (positive) at which one side, heated, has just become austenite.

    Raises:
        InputError: the rig does not bend or has no wires on that side.
    """
    model = SideModel.of(parameters, side)
    return abs(model.lever) * model.largest_contraction()


def _fractions(
    temperature: Array, side: int, branch: Branch, parameters: Parameters, boundary: Boundary
) -> list[float]:
    """Martensite fractions of the wires of one side, their stresses in balance."""
    sides = len(side_names(parameters))

    def fractions(contraction: float) -> list[float]:
        return [_fraction(float(t), contraction, branch, parameters) for t in temperature]

    if boundary.contraction is not None:
        return fractions(per_side("contraction", boundary.contraction, sides)[side])
    stiffness = per_side("stiffness", boundary.stiffness, sides)[side]
    load = per_side("load", boundary.load, sides)[side]

    def imbalance(contraction: float) -> float:
        sigma = stress.stress(temperature, fractions(contraction), contraction, parameters)
        return float(sigma.sum() - load - stiffness * contraction)

    return fractions(_falling_root(imbalance, 0.01))


def _fraction(
    temperature: float, contraction: float, branch: Branch, parameters: Parameters
) -> float:
    ramp = phase.heated_fraction if branch == "heating" else phase.cooled_fraction

    def error(xi: float) -> float:
        sigma = stress.stress(temperature, xi, contraction, parameters)
        return xi - float(ramp(temperature, sigma, parameters))

    if error(0.0) >= 0.0:
        return 0.0
    if error(1.0) <= 0.0:
        return 1.0
    return float(brentq(error, 0.0, 1.0, xtol=_TOLERANCE, rtol=1e-15))


def _falling_root(function: Callable[[float], float], reach: float) -> float:
    """Root of a falling function, looked for ever farther from 0."""
    outward = 1.0 if function(0.0) > 0.0 else -1.0
    near, far = 0.0, outward * reach
    while function(far) * outward > 0.0:
        if abs(far) > _LARGEST_CONTRACTION:
            raise InputError("operating point: no contraction balances the stresses of a side")
        near, far = far, 2.0 * far
    return float(brentq(function, near, far, xtol=_TOLERANCE, rtol=1e-15))

