"""The compiled core as Python sees it: state of a bench, rows filled from parameters, calls."""

import threading
from collections.abc import Mapping
from copy import copy
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sma_bench.compiled import warn_if_plain
from sma_bench.errors import InputError
from sma_bench.parameters import Parameters
from sma_bench.parameters.parameter import EFFECT_PREFIX, EFFECTS, Effect
from sma_bench.physics import columns as at
from sma_bench.physics import core, material
from sma_bench.physics.boundary import Boundary, per_side, side_names, side_of_channels
from sma_bench.physics.heat import heated_resistance, heating_voltage, time_constant
from sma_bench.physics.otherwise import see

# --- The state of a bench between two samples, and the state it starts from.

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
    parameters: Parameters, *, temperature: ArrayLike | None = None,
    martensite_fraction: ArrayLike = 1.0, boundary: Boundary | None = None,
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
    state = _balanced(kelvin, xi, parameters, boundary)
    require_possible(state, parameters)
    return state


def _balanced(kelvin: Array, xi: Array, parameters: Parameters, boundary: Boundary) -> State:
    contraction = _contraction(kelvin, xi, parameters, boundary)
    stretch = boundary.stretch_of_wires(parameters) - contraction[side_of_channels(parameters)]
    return State(kelvin, xi, material.stress(kelvin, xi, -stretch, parameters), contraction)


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
    prestretch = boundary.stretch_of_wires(parameters)
    pull = np.bincount(side, material.stress(kelvin, xi, -prestretch, parameters), sides)
    modulus = np.bincount(side, material.modulus(xi, parameters), sides)
    own, load = (per_side(n, getattr(boundary, n), sides) for n in ("stiffness", "load"))
    if boundary.coupled:
        front = (pull[0] - pull[1] - load[0]) / (modulus.sum() + own[0])
        return np.array([front, -front])
    return np.asarray((pull - load) / (modulus + own))


def require_possible(state: State, parameters: Parameters) -> None:
    """Raises InputError where a fraction cannot be at its temperature and stress."""
    kelvin, xi, sigma = state.temperature, state.martensite_fraction, state.stress
    finish = parameters["wire.austenite_finish_temperature"]
    if np.all((xi == 1.0) & (kelvin < finish) & (sigma >= 0.0)):
        return  # cold martensite, where most benches begin
    f = material.austenite_ramp(kelvin, sigma, parameters)
    g = material.martensite_ramp(kelvin, sigma, parameters)
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


# --- Parameters converted to the rows of columns.py.

_WIRE_NUMBERS = (
    "resistance", "heat_transfer_coefficient", "surface_area", "specific_heat", "mass",
    "austenite_start_temperature", "austenite_finish_temperature",
    "martensite_start_temperature", "martensite_finish_temperature",
    "stress_influence_austenite", "stress_influence_martensite",
    "austenite_modulus", "martensite_modulus", "maximum_recoverable_strain",
    "thermal_expansion_factor", "transition_spread", "transition_tail",
)


def _of_effects(
    row: str, names: Mapping[str, int]
) -> tuple[list[tuple[int, str]], list[tuple[Effect, int]]]:
    """Columns of the effects' numbers, and of the marks that each effect sets."""
    numbers = [
        (names[column], number) for effect in EFFECTS.values() if effect.row == row
        for number, column in effect.column_names.items()
    ]
    marks = [(e, names[mark]) for e in EFFECTS.values() for mark in e.marks if mark in names]
    return numbers, marks


_WIRE_EFFECT_NUMBERS, _WIRE_MARKS = _of_effects("wire", at.WIRE_NAMES)
_SIDE_EFFECT_NUMBERS, _SIDE_MARKS = _of_effects("side", at.SIDE_NAMES)
_WIRE_PARAMETERS = [f"wire.{name}" for name in _WIRE_NUMBERS]


def wire_rows(parameters: Parameters, boundary: Boundary) -> Array:
    """(w, WIRE_COLUMNS) constants of every wire; states are 0."""
    columns = {column: parameters[number] for column, number in _WIRE_EFFECT_NUMBERS}
    columns.update((mark, 1.0) for effect, mark in _WIRE_MARKS if effect.is_on(parameters))
    columns = {**columns, **_wire(parameters)}
    wire = np.zeros(at.WIRE_COLUMNS)
    wire[list(columns)] = list(columns.values())
    side = side_of_channels(parameters)
    wires = np.empty((side.size, at.WIRE_COLUMNS))
    wires[:], wires[:, at.SIDE] = wire, side
    # Between unequal numbers of wires: what one side gives, the other gets.
    if wire[at.ACROSS]:
        own = np.bincount(side)[side]
        wires[:, at.ACROSS] *= (side.size - own) / np.maximum(own, side.size - own)
    wires[:, at.PRESTRETCH] = boundary.stretch_of_wires(parameters)
    return wires


def side_rows(parameters: Parameters, boundary: Boundary) -> Array:
    """(s, SIDE_COLUMNS) constants of every side; states are 0."""
    count = len(side_names(parameters))
    sides = np.zeros((count, at.SIDE_COLUMNS))
    sides[:, at.PRESCRIBED] = boundary.contraction is not None
    sides[:, at.COUPLED] = boundary.coupled
    stiffness = per_side("stiffness", boundary.stiffness, count)
    load = per_side("load", boundary.load, count)
    sides[:, at.STIFFNESS] = sides[:, at.OWN_STIFFNESS] = stiffness
    sides[:, at.LOAD] = sides[:, at.OWN_LOAD] = load
    # A side that is held, or pulls against nothing elastic, has nothing to relax or hang.
    elastic = boundary.contraction is None and not boundary.coupled
    bends = (sides[:, at.OWN_STIFFNESS] > 0.0) & elastic
    for column, number in _SIDE_EFFECT_NUMBERS:
        if parameters[number]:
            sides[bends, column] = parameters[number]
    for effect, mark in _SIDE_MARKS:
        if effect.is_on(parameters):
            sides[bends if effect.row == "side" else slice(None), mark] = 1.0
    sides[sides[:, at.OWN_LOAD] > 0.0, at.SLACK] = 0.0  # the load draws the wires straight
    return sides


def _wire(parameters: Parameters) -> Mapping[int, float]:
    numbers = [parameters[name] for name in _WIRE_PARAMETERS]
    wire = dict(zip(_WIRE_NUMBERS, numbers, strict=True))
    loss = wire["heat_transfer_coefficient"] * wire["surface_area"]
    a_s, a_f = wire["austenite_start_temperature"], wire["austenite_finish_temperature"]
    m_s, m_f = wire["martensite_start_temperature"], wire["martensite_finish_temperature"]
    shift = f"{EFFECT_PREFIX}stress_dependent_transition."
    return {
        at.AMBIENT: parameters["environment.ambient_temperature"],
        at.HEATING: 1.0 / (heated_resistance(parameters) * loss),
        at.CURRENT_DRIVEN: float(parameters["bench.drive"] == "current"),
        at.TIME_CONSTANT: time_constant(parameters),
        at.LATENT_RISE: parameters["effect.latent_heat.heat"] / wire["specific_heat"],
        at.CAPACITY: wire["mass"] * wire["specific_heat"],
        at.LOSS: loss,
        at.RESISTANCE: wire["resistance"],
        at.WIRE_NAMES["SUPPLY_RESISTANCE"]: parameters["wire.count"]
        * (parameters["bench.lead_resistance"] + parameters["effect.supply_drop.resistance"]),
        at.AUSTENITE_FINISH: a_f,
        at.AUSTENITE_FINISH_FRESH: a_f,
        at.AUSTENITE_SLOPE: 1.0 / (a_f - a_s),
        at.AUSTENITE_SHIFT: max(
            1.0 / wire["stress_influence_austenite"] + parameters[shift + "austenite"], 0.0
        ),
        at.AUSTENITE_SPREAD: wire["transition_spread"] / (a_f - a_s),
        at.MARTENSITE_SPREAD: wire["transition_spread"] / (m_s - m_f),
        at.TAIL: wire["transition_tail"],
        at.MARTENSITE_FINISH: m_f,
        at.MARTENSITE_FINISH_FRESH: m_f,
        at.MARTENSITE_SLOPE: 1.0 / (m_s - m_f),
        at.MARTENSITE_SHIFT: max(
            1.0 / wire["stress_influence_martensite"] + parameters[shift + "martensite"], 0.0
        ),
        at.AUSTENITE_MODULUS: wire["austenite_modulus"],
        at.MODULUS_CHANGE: wire["martensite_modulus"] - wire["austenite_modulus"],
        at.RECOVERABLE_STRAIN: wire["maximum_recoverable_strain"],
        at.FULL_STRAIN: wire["maximum_recoverable_strain"],
        at.EXPANSION: wire["thermal_expansion_factor"],
    }


# --- The compiled core as Python sees it: parameters converted once, its rows filled and read.

_LAST = threading.local()


class Kernel:
    """Parameters converted once for the compiled core, and the core's calls."""

    def __init__(self, parameters: Parameters, boundary: Boundary | None) -> None:
        warn_if_plain()
        self.parameters = parameters
        self.boundary = boundary or Boundary.of(parameters)
        self.wires = len(parameters["bench.channels"])
        self.rows = wire_rows(parameters, self.boundary), side_rows(parameters, self.boundary)

    @classmethod
    def of(cls, parameters: Parameters, boundary: Boundary | None) -> "Kernel":
        """A kernel that is not changed; this thread's last one where it is of the same bench, for
        a fit simulates one bench on record after record."""
        if boundary is not None:
            return cls(parameters, boundary)
        last = getattr(_LAST, "kernel", None)
        if last is None or last.parameters is not parameters:
            last = _LAST.kernel = cls(parameters, None)
        return last

    @cached_property
    def rest(self) -> State:
        """Martensite at ambient temperature, possible or not: if not, it ends with the first step.
        A fit begins each of its simulations so."""
        kelvin = np.full(self.wires, self.parameters["environment.ambient_temperature"])
        if self.boundary.idle:
            none = np.zeros(self.wires), np.zeros(len(self.rows[1]))
            return State(kelvin, np.ones(self.wires), *none)
        return _balanced(kelvin, np.ones(self.wires), self.parameters, self.boundary)

    def against(self, boundary: Boundary) -> "Kernel":
        """The same wires pulling against something else."""
        other = copy(self)
        other.boundary = boundary
        other.__dict__.pop("rest", None)
        wires = self.rows[0].copy()
        wires[:, at.PRESTRETCH] = boundary.stretch_of_wires(self.parameters)
        other.rows = wires, side_rows(self.parameters, boundary)
        return other

    def memory(self, initial: State | None) -> tuple[Array, Array]:
        """Fresh rows of the kernel: constants of this bench, state of `initial`."""
        state = initial or self.rest
        wires, sides = self.rows[0].copy(), self.rows[1].copy()
        if state.temperature.shape != (len(wires),) or state.contraction.shape != (len(sides),):
            raise InputError(
                f"initial state: {state.temperature.size} wires on {state.contraction.size} sides, "
                f"expected {len(wires)} on {len(sides)}"
            )
        if state.memory is not None:
            wires[:, at.WIRE_STATE :], sides[:, at.SIDE_STATE :] = state.memory
        else:
            wires[:, at.TEMPERATURE] = state.temperature
            wires[:, at.FRACTION] = state.martensite_fraction
            wires[:, at.MOST_AUSTENITE] = 1.0 - state.martensite_fraction
            wires[:, at.STRESS] = state.stress
            sides[:, at.PASSIVE_FRACTION] = 1.0
            for column in (at.CONTRACTION, at.BENDING, at.RELAXED):
                sides[:, column] = state.contraction
            for column in (at.READING, at.SEEN):
                wires[:, column] = state.temperature
            for i in np.flatnonzero(wires[:, at.READ_OTHERWISE]):
                wires[i, [at.READING, at.SEEN]] = see(wires, i)
        # Of effects that may be off by now:
        wires[:, at.OFFSET] = wires[:, at.PRESTRETCH]
        sides[sides[:, at.ENGAGEMENT] == 0.0, at.PASSIVE_BENDING] = 0.0
        if self.boundary.contraction is not None:
            given = per_side("contraction", self.boundary.contraction, len(sides))
            sides[:, at.CONTRACTION], sides[:, at.CONTRACTION_CHANGE] = given, 0.0
        return wires, sides

    def run(self, time: Array, voltage: Array, memory: tuple[Array, Array]) -> tuple[Array, Array]:
        """Advance `memory` in place; history (4, n, w) and strain (2, n, s) as of core.run."""
        history = np.empty((4, time.size, self.wires))
        strain = np.empty((2, time.size, len(memory[1])))
        core.run(time, heating_voltage(voltage, self.parameters), *memory, history, strain)
        return history, strain

    def state(self, memory: tuple[Array, Array]) -> State:
        """Snapshot of the kernel's state."""
        wires, sides = memory[0].copy(), memory[1].copy()
        return State(
            wires[:, at.TEMPERATURE], wires[:, at.FRACTION], wires[:, at.STRESS],
            sides[:, at.CONTRACTION], (wires[:, at.WIRE_STATE :], sides[:, at.SIDE_STATE :]),
        )
