"""The load that the wires of each side pull against: the rig's own, or an experiment's."""

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, Self

import numpy as np

from sma_bench.arrays import Array, IntArray
from sma_bench.errors import InputError
from sma_bench.parameters import Parameters
from sma_bench.parameters.parameters import load_kind, wire_length
from sma_bench.physics.bending import bending_coefficients, channel_section

SIDE_SIGNS = {"front": 1.0, "back": -1.0}  # of the deflection, contract section 4
PerSide = float | tuple[float, ...]


@dataclass(frozen=True)
class Boundary:
    """Over the wires of a side sum sigma_i = load + stiffness e, or their common contraction e =
    -(eps - eps_0) is prescribed. Fields: one number, or one per side as in `side_names`."""

    stiffness: PerSide = 0.0  # Pa, sum of stresses per contraction
    load: PerSide = 0.0  # Pa, sum of stresses at zero contraction
    contraction: PerSide | None = None  # prescribed e; of an imposed motion: its start
    # m, deflection per contraction, positive toward the front; minus the length for a single wire
    # with a moving load, whose deflection is its elongation
    lever: PerSide = 0.0
    # both sides pull on one slider: the front's sum of stresses minus the back's is load +
    # stiffness e_front, and e_back = -e_front
    coupled: bool = False
    prestretch: PerSide = 0.0  # strain of a side's wires at zero contraction (bench at rest)
    # Pa, dry friction: added to the load in contraction, subtracted in lengthening
    friction: PerSide = 0.0
    stiffening: float = 0.0  # s of a spring that stiffens: load + stiffness (exp(s e) - 1)/s

    @classmethod
    def clamped(cls, contraction: PerSide = 0.0) -> Self:
        """Fixed ends: the wire rig."""
        return cls(contraction=contraction)

    @classmethod
    def held_stress(cls, stress: PerSide) -> Self:
        """A weight or a force controller: sum of stresses of a side [Pa]."""
        return cls(load=stress)

    @classmethod
    def imposed(cls, parameters: Parameters, elongation: float) -> Self:
        """A testing machine (`load.kind` displacement), `elongation` [m] at a motion's start."""
        return replace(cls.of(parameters), contraction=-elongation / wire_length(parameters))

    @classmethod
    def of(cls, parameters: Parameters) -> Self:
        """The rig's own load, `load.kind`: by default one wire is clamped, several bend a beam."""
        kind = load_kind(parameters)
        if kind == "clamped":
            return cls.clamped()
        if kind == "displacement":  # fixed, unless a simulation imposes a motion
            return cls(contraction=0.0, lever=-wire_length(parameters))
        if kind == "beam":  # sum sigma_i = beta delta, delta = alpha e (eqs. 22, 23), each side
            alpha, front, back = bending_coefficients(parameters)
            ratio, lever = (parameters[f"effect.side_asymmetry.{n}"] for n in ("ratio", "lever"))
            names, betas = side_names(parameters), {"front": front, "back": back}
            longer = {name: 1.0 + SIDE_SIGNS[name] * lever for name in names}
            stiffer = {name: (1.0 + SIDE_SIGNS[name] * ratio) * longer[name] for name in names}
            pulls = tuple(betas[n] * stiffer[n] * (alpha * longer[n]) for n in names)
            return cls(pulls, lever=tuple(SIDE_SIGNS[n] * alpha * longer[n] for n in names))
        section, length = channel_section(parameters), wire_length(parameters)
        preload, held = parameters["load.preload"], parameters["load.force"]
        stiffness = parameters["load.stiffness"] * length / section
        modulus, rubs = parameters["wire.martensite_modulus"], parameters["load.friction"] / section
        # Two sides on a slider: A (sum_front sigma_i - sum_back sigma_i) = F + k x, x = l e_front.
        # At rest in the middle each pulls with the preload; spring and force pull it to the back.
        if kind == "antagonist":
            wires = np.bincount(side_of_channels(parameters))
            pulled = tuple((preload / (section * wires * modulus)).tolist())
            return cls(stiffness, held / section, lever=(0.5 * length, -0.5 * length), coupled=True,
                       prestretch=pulled, friction=rubs)
        # A weight, or a frame that holds a force; with a spring A sum sigma_i = F_0 + F + k l e, or
        # F_0 + F + k (exp(b l e) - 1)/b if it stiffens by b. Elongation is counted from the bench
        # at rest, where the martensite already bears the load.
        held, stiffness = (preload + held, stiffness) if kind == "spring" else (held, 0.0)
        stretch = held / section / (len(parameters["bench.channels"]) * modulus)
        stiffening = parameters["load.stiffening"] * length if stiffness else 0.0
        return cls(stiffness, held / section, lever=-length, prestretch=stretch, friction=rubs,
                   stiffening=stiffening)

    def per_side(self, name: str, sides: int) -> Array:
        """(s,) values of a field; InputError: wrong number of sides, or not finite."""
        return per_side(f"boundary: {name}", getattr(self, name), sides)

    def levers(self, parameters: Parameters) -> Array:
        """(s,) m, deflection per contraction of each side."""
        return self.per_side("lever", len(side_names(parameters)))

    def stretch_of_wires(self, parameters: Parameters) -> Array:
        """(w,) prestretch of each wire."""
        sides = self.per_side("prestretch", len(side_names(parameters)))
        return sides[side_of_channels(parameters)]


def moves_tip(parameters: Parameters) -> bool:
    """True if a tip deflects to both sides; else the deflection is one wire's elongation."""
    return load_kind(parameters) in ("beam", "antagonist")


def side_names(parameters: Parameters) -> tuple[str, ...]:
    """Sides that have wires, front first."""
    return _sides(tuple(parameters["bench.channel_sides"]))[0]


def side_of_channels(parameters: Parameters) -> IntArray:
    """(w,) index of each channel's side in `side_names`; read-only."""
    return _sides(tuple(parameters["bench.channel_sides"]))[1]


@lru_cache(maxsize=64)  # called several times per simulation of a fit
def _sides(of_channels: tuple[str, ...]) -> tuple[tuple[str, ...], IntArray]:
    names = tuple(name for name in SIDE_SIGNS if name in of_channels)
    numbers = np.array([names.index(side) for side in of_channels], np.int64)
    numbers.flags.writeable = False
    return names, numbers


def per_side(name: str, value: Any, sides: int) -> Array:
    """(s,) array from one value or s; InputError: another number of values, or one not finite."""
    if isinstance(value, float) and math.isfinite(value):
        return np.full(sides, value)
    array = np.array(value, dtype=np.float64)
    if array.shape not in ((), (sides,)):
        raise InputError(f"{name} has shape {array.shape}, expected one or {sides} values")
    if not np.isfinite(array).all():
        raise InputError(f"{name} is {value}, expected finite numbers")
    return np.full(sides, array)
