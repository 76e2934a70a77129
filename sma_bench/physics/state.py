"""The state of a bench between two samples, and the state it starts from."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sma_bench.errors import InputError
from sma_bench.parameters import Parameters
from sma_bench.physics import columns as at
from sma_bench.physics import phase, stress
from sma_bench.physics.boundary import Boundary, per_side, side_names, side_of_channels

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class State:
    """All that the future of a bench depends on, apart from the voltages to come.

    Carried from one simulation into the next, it continues to the last bit.

    Attributes:
        temperature: (w,) K; martensite_fraction: (w,); stress: (w,) Pa.
        contraction: (s,), sides in the order of `side_names`.
        memory: what the kernel keeps of the history (reversals, last changes), or None at rest.
    """

    temperature: Array
    martensite_fraction: Array
    stress: Array
    contraction: Array
    memory: tuple[Array, Array] | None = None

    @property
    def bending(self) -> Array:
        """(s,) what of the contraction bends the beam."""
        if self.memory is None:
            return self.contraction
        return self.memory[1][:, at.BENDING - at.SIDE_STATE]

    @property
    def temperature_reading(self) -> Array:
        """(w,) K, what a sensor reads."""
        if self.memory is None:
            return self.temperature
        return self.memory[0][:, at.READING - at.WIRE_STATE]

    @property
    def clock(self) -> float:
        """s since the bench's start."""
        if self.memory is None:
            return 0.0
        return float(self.memory[0][0, at.CLOCK - at.WIRE_STATE])


def initial_state(
    parameters: Parameters,
    *,
    temperature: ArrayLike | None = None,
    martensite_fraction: ArrayLike = 1.0,
    boundary: Boundary | None = None,
) -> State:
    """State without history: at rest, or at a given temperature and martensite fraction.

    Args:
        temperature: one or (w,) K; ambient when not given.
        martensite_fraction: one or (w,), 0 to 1.
        boundary: the rig's own when not given; it decides stress and contraction.

    Raises:
        InputError: wrong shape, or a fraction that cannot be at that temperature and stress.
    """
    boundary = boundary or Boundary.of(parameters)
    if temperature is None:
        temperature = parameters["environment.ambient_temperature"]
    kelvin = _per_wire("temperature", temperature, parameters)
    xi = _per_wire("martensite_fraction", martensite_fraction, parameters)
    if np.any(kelvin <= 0.0):
        raise InputError(f"initial state: temperature is {kelvin.min():g} K, expected above 0 K")
    if np.any((xi < 0.0) | (xi > 1.0)):
        raise InputError(f"initial state: martensite_fraction is {xi}, expected 0 to 1")
    contraction = _contraction(kelvin, xi, parameters, boundary)
    sigma = stress.stress(kelvin, xi, contraction[side_of_channels(parameters)], parameters)
    _require_possible(kelvin, xi, sigma, parameters)
    return State(kelvin, xi, sigma, contraction)


def _per_wire(name: str, value: ArrayLike, parameters: Parameters) -> Array:
    wires = len(parameters["bench.channels"])
    array = np.asarray(value, dtype=float)
    if array.shape not in ((), (wires,)):
        raise InputError(
            f"initial state: {name} has shape {array.shape}, expected one or {wires} values"
        )
    if not np.all(np.isfinite(array)):
        raise InputError(f"initial state: {name} is {array}, expected finite numbers")
    return np.array(np.broadcast_to(array, (wires,)))


def _contraction(kelvin: Array, xi: Array, parameters: Parameters, boundary: Boundary) -> Array:
    sides = len(side_names(parameters))
    if boundary.contraction is not None:
        return per_side("contraction", boundary.contraction, sides)
    side = side_of_channels(parameters)
    pull = np.bincount(side, stress.stress(kelvin, xi, 0.0, parameters), sides)
    modulus = np.bincount(side, stress.modulus(xi, parameters), sides)
    stiffness = modulus + per_side("stiffness", boundary.stiffness, sides)
    return np.asarray((pull - per_side("load", boundary.load, sides)) / stiffness)


def _require_possible(kelvin: Array, xi: Array, sigma: Array, parameters: Parameters) -> None:
    f = phase.austenite_ramp(kelvin, sigma, parameters)
    g = phase.martensite_ramp(kelvin, sigma, parameters)
    checks = (
        ((f == 0.0) & (g == 1.0) & (xi > 0.0), "0 above A_f"),
        ((f == 1.0) & (g == 0.0) & (xi < 1.0), "1 below M_f"),
    )
    for impossible, expected in checks:
        if np.any(impossible):
            i = int(np.argmax(impossible))
            raise InputError(
                f"initial state: martensite fraction {xi[i]:g} at {kelvin[i]:g} K and "
                f"{sigma[i] / 1e6:.4g} MPa, expected {expected} (shifted by stress)"
            )
