"""The compiled core as Python sees it: parameters converted once, its rows filled and read."""

from types import ModuleType

import numpy as np
from numpy.typing import NDArray

from sma_bench.errors import InputError
from sma_bench.parameters import Parameters
from sma_bench.physics.boundary import Boundary, per_side, side_names, side_of_channels
from sma_bench.physics.heat import time_constant
from sma_bench.physics.state import State, initial_state

Array = NDArray[np.float64]

_WIRE_NUMBERS = (
    "resistance", "heat_transfer_coefficient", "surface_area", "specific_heat",
    "austenite_start_temperature", "austenite_finish_temperature",
    "martensite_start_temperature", "martensite_finish_temperature",
    "stress_influence_austenite", "stress_influence_martensite",
    "austenite_modulus", "martensite_modulus", "maximum_recoverable_strain",
    "thermal_expansion_factor",
)


class Kernel:
    """Parameters converted once for the compiled core, and the core's calls."""

    def __init__(
        self, parameters: Parameters, boundary: Boundary | None, latent_heat: float
    ) -> None:
        if not np.isfinite(latent_heat):
            raise InputError(f"latent_heat is {latent_heat} J/kg, expected a finite number")
        self.parameters = parameters
        self.boundary = boundary or Boundary.of(parameters)
        self.wires = len(parameters["bench.channels"])
        self.core = _core()
        self.rows = (
            _wires(self.core, parameters, latent_heat),
            _sides(self.core, parameters, self.boundary),
        )

    def memory(self, initial: State | None) -> tuple[Array, Array]:
        """Fresh rows of the kernel: constants of this bench, state of `initial`."""
        state = initial or initial_state(self.parameters, boundary=self.boundary)
        core = self.core
        wires, sides = self.rows[0].copy(), self.rows[1].copy()
        if state.temperature.shape != (len(wires),) or state.contraction.shape != (len(sides),):
            raise InputError(
                f"initial state: {state.temperature.size} wires on {state.contraction.size} sides, "
                f"expected {len(wires)} on {len(sides)}"
            )
        if state.memory is not None:
            wires[:, core.WIRE_STATE :], sides[:, core.SIDE_STATE :] = state.memory
        else:
            wires[:, core.TEMPERATURE] = state.temperature
            wires[:, core.FRACTION] = state.martensite_fraction
            wires[:, core.STRESS] = state.stress
            sides[:, core.CONTRACTION] = state.contraction
        if self.boundary.contraction is not None:
            given = per_side("contraction", self.boundary.contraction, len(sides))
            sides[:, core.CONTRACTION], sides[:, core.CONTRACTION_CHANGE] = given, 0.0
        return wires, sides

    def run(self, time: Array, voltage: Array, memory: tuple[Array, Array]) -> tuple[Array, Array]:
        """Advance `memory` in place; history (3, n, w) and contraction (n, s)."""
        history = np.empty((3, time.size, self.wires))
        strain = np.empty((time.size, len(memory[1])))
        self.core.run(time, voltage, *memory, history, strain)
        return history, strain

    def state(self, memory: tuple[Array, Array]) -> State:
        """Snapshot of the kernel's state."""
        core = self.core
        wires, sides = memory[0].copy(), memory[1].copy()
        return State(
            wires[:, core.TEMPERATURE],
            wires[:, core.FRACTION],
            wires[:, core.STRESS],
            sides[:, core.CONTRACTION],
            (wires[:, core.WIRE_STATE :], sides[:, core.SIDE_STATE :]),
        )


def _core() -> ModuleType:
    # Importing numba takes most of a second, which commands that simulate nothing are spared.
    from sma_bench.physics import core

    return core


def _wires(core: ModuleType, parameters: Parameters, latent_heat: float) -> Array:
    wire = {name: float(parameters[f"wire.{name}"]) for name in _WIRE_NUMBERS}
    loss = wire["heat_transfer_coefficient"] * wire["surface_area"]
    a_s, a_f = wire["austenite_start_temperature"], wire["austenite_finish_temperature"]
    m_s, m_f = wire["martensite_start_temperature"], wire["martensite_finish_temperature"]
    numbers = {
        "AMBIENT": parameters["environment.ambient_temperature"],
        "HEATING": 1.0 / (wire["resistance"] * loss),
        "TIME_CONSTANT": time_constant(parameters),
        "LATENT_RISE": latent_heat / wire["specific_heat"],
        "AUSTENITE_FINISH": a_f,
        "AUSTENITE_SLOPE": 1.0 / (a_f - a_s),
        "AUSTENITE_SHIFT": 1.0 / wire["stress_influence_austenite"],
        "MARTENSITE_FINISH": m_f,
        "MARTENSITE_SLOPE": 1.0 / (m_s - m_f),
        "MARTENSITE_SHIFT": 1.0 / wire["stress_influence_martensite"],
        "AUSTENITE_MODULUS": wire["austenite_modulus"],
        "MODULUS_CHANGE": wire["martensite_modulus"] - wire["austenite_modulus"],
        "RECOVERABLE_STRAIN": wire["maximum_recoverable_strain"],
        "EXPANSION": wire["thermal_expansion_factor"],
    }
    wires = np.zeros((len(parameters["bench.channels"]), core.WIRE_COLUMNS))
    for name, number in numbers.items():
        wires[:, getattr(core, name)] = number
    wires[:, core.SIDE] = side_of_channels(parameters)
    return wires


def _sides(core: ModuleType, parameters: Parameters, boundary: Boundary) -> Array:
    count = len(side_names(parameters))
    sides = np.zeros((count, core.SIDE_COLUMNS))
    sides[:, core.PRESCRIBED] = boundary.contraction is not None
    sides[:, core.STIFFNESS] = per_side("stiffness", boundary.stiffness, count)
    sides[:, core.LOAD] = per_side("load", boundary.load, count)
    return sides
