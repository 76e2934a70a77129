"""What the wires of each side pull against: a clamp, a held stress, or the bending composite."""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from sma_bench.errors import InputError
from sma_bench.parameters import Parameters
from sma_bench.physics.bending import bending_coefficients

SIDE_SIGNS = {"front": 1.0, "back": -1.0}  # of the deflection, contract section 4

PerSide = float | tuple[float, ...]


@dataclass(frozen=True)
class Boundary:
    """sum sigma_i = load + stiffness e over the wires of a side, or e prescribed.

    e = -(eps - eps_0) is the contraction shared by the wires of a side. Each field is one number
    for all sides, or one a side in the order of `side_names`.

    Attributes:
        stiffness: Pa, sum of stresses per contraction.
        load: Pa, sum of stresses at zero contraction.
        contraction: prescribed e, or None.
        lever: m, deflection per contraction, positive toward the front.
    """

    stiffness: PerSide = 0.0
    load: PerSide = 0.0
    contraction: PerSide | None = None
    lever: PerSide = 0.0

    @classmethod
    def clamped(cls, contraction: PerSide = 0.0) -> Self:
        """Ends that do not give: the wire rig."""
        return cls(contraction=contraction)

    @classmethod
    def held_stress(cls, stress: PerSide) -> Self:
        """A weight or a force controller: sum of stresses of a side [Pa] (isobaric)."""
        return cls(load=stress)

    @classmethod
    def bending(cls, parameters: Parameters) -> Self:
        """The composite: sum sigma_i = beta delta, delta = alpha e (eqs. 22, 23), each side."""
        alpha, front, back = bending_coefficients(parameters)
        ratio = parameters["effect.side_asymmetry.ratio"]
        betas = {"front": front * (1.0 + ratio), "back": back * (1.0 - ratio)}
        names = side_names(parameters)
        return cls(
            stiffness=tuple(betas[name] * alpha for name in names),
            lever=tuple(SIDE_SIGNS[name] * alpha for name in names),
        )

    @classmethod
    def of(cls, parameters: Parameters) -> Self:
        """The rig's own: one wire is clamped, several bend the composite."""
        if len(parameters["bench.channels"]) == 1:
            return cls.clamped()
        return cls.bending(parameters)


def side_names(parameters: Parameters) -> tuple[str, ...]:
    """Sides that have wires, front first."""
    sides = parameters["bench.channel_sides"]
    return tuple(name for name in SIDE_SIGNS if name in sides)


def side_of_channels(parameters: Parameters) -> NDArray[np.int64]:
    """(w,) number of the side of each channel, in the order of `side_names`."""
    names = side_names(parameters)
    return np.array([names.index(side) for side in parameters["bench.channel_sides"]], np.int64)


def per_side(name: str, value: PerSide, sides: int) -> NDArray[np.float64]:
    """(s,) array of a field of Boundary.

    Raises:
        InputError: wrong number of sides, or not finite.
    """
    array = np.asarray(value, dtype=float)
    if array.shape not in ((), (sides,)):
        raise InputError(
            f"boundary: {name} has shape {array.shape}, expected one or {sides} values"
        )
    if not np.all(np.isfinite(array)):
        raise InputError(f"boundary: {name} is {value}, expected finite numbers")
    return np.array(np.broadcast_to(array, (sides,)))
