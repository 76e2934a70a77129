"""Python interface of the compiled core: state of a bench, its rows from parameters, calls."""

from dataclasses import dataclass
from functools import lru_cache
from operator import itemgetter

import numpy as np
from numpy.typing import ArrayLike

from sma_bench.arrays import Array
from sma_bench.compiled import warn_if_plain
from sma_bench.errors import InputError
from sma_bench.parameters import Parameters
from sma_bench.parameters.parameter import EFFECTS, LAWS, SOURCES
from sma_bench.parameters.parameters import ORIENTING
from sma_bench.physics import columns as at
from sma_bench.physics import core, kinetics, material, orientation
from sma_bench.physics.boundary import Boundary, per_side, side_names, side_of_channels
from sma_bench.physics.laws import extended, normal, ramp_of
from sma_bench.physics.material import heat_loss, heated_resistance, heating_voltage, time_constant

# --- The state of a bench between two samples, and the state it starts from.

@dataclass(frozen=True, eq=False)
class State:
    """Complete state of a bench: a run that continues from it is the same to the last bit."""

    temperature: Array  # (w,) K
    martensite_fraction: Array  # (w,)
    stress: Array  # (w,) Pa
    contraction: Array  # (s,), sides in the order of `side_names`
    # the kernel's state columns (reversals, last changes); None without a history
    memory: tuple[Array, Array] | None = None

    @property
    def clock(self) -> float:
        """s since the bench's start."""
        return float(self.memory[0][0, at.CLOCK - at.WIRE_STATE]) if self.memory else 0.0


def initial_state(parameters: Parameters, *, temperature: ArrayLike | None = None,
                  martensite_fraction: ArrayLike = 1.0, boundary: Boundary | None = None) -> State:
    """State without history: at rest, or at `temperature` [K] and fractions (0 to 1), one or (w,).
    `boundary`: the rig's own when not given; it determines stress and contraction. Raises
    InputError: wrong shape, or a fraction that is impossible at that temperature and stress."""
    wires = len(parameters["bench.channels"])
    if temperature is None:
        temperature = parameters["environment.ambient_temperature"]
    kelvin = per_side("initial state: temperature", temperature, wires)
    xi = per_side("initial state: martensite_fraction", martensite_fraction, wires)
    if np.any(kelvin <= 0.0):
        raise InputError(f"initial state: temperature is {kelvin.min():g} K, expected above 0 K")
    if np.any((xi < 0.0) | (xi > 1.0)):
        raise InputError(f"initial state: martensite_fraction is {xi}, expected 0 to 1")
    state = _balanced(kelvin, xi, parameters, boundary or Boundary.of(parameters))
    require_possible(state, parameters)
    return state


def at_rest(parameters: Parameters, boundary: Boundary | None = None) -> State:
    """Martensite at ambient temperature; where that is impossible, the first step ends it."""
    boundary, xi = boundary or Boundary.of(parameters), np.ones(len(parameters["bench.channels"]))
    kelvin = np.full(xi.size, parameters["environment.ambient_temperature"])
    if boundary.load == 0.0 == boundary.prestretch and boundary.contraction in (None, 0.0):
        return State(kelvin, xi, np.zeros(kelvin.size), np.zeros(len(side_names(parameters))))
    return _balanced(kelvin, xi, parameters, boundary)


def _balanced(kelvin: Array, xi: Array, parameters: Parameters, boundary: Boundary) -> State:
    """The state with the contraction at which the stresses balance the load."""
    side, sides = side_of_channels(parameters), len(side_names(parameters))
    prestretch = boundary.stretch_of_wires(parameters)
    parameters = orientation.as_oriented(parameters, float(prestretch.mean()))
    pull = np.bincount(side, material.stress(kelvin, xi, -prestretch, parameters), sides)
    modulus = np.bincount(side, material.modulus(xi, parameters), sides)
    own, load = (boundary.per_side(name, sides) for name in ("stiffness", "load"))
    if boundary.contraction is not None:
        contraction = boundary.per_side("contraction", sides)
    elif boundary.coupled:
        front = (pull[0] - pull[1] - load[0]) / (modulus.sum() + own[0])
        contraction = np.array([front, -front])
    else:
        contraction = (pull - load) / (modulus + own)
    shorter = contraction[side] - prestretch
    return State(kelvin, xi, material.stress(kelvin, xi, shorter, parameters), contraction)


def require_possible(state: State, parameters: Parameters) -> None:
    """Raises InputError where a fraction is impossible at its temperature and stress."""
    kelvin, xi, sigma = state.temperature, state.martensite_fraction, state.stress
    finish = parameters["wire.austenite_finish_temperature"]
    if np.all((xi == 1.0) & (kelvin < finish) & (sigma >= 0.0)):
        return  # cold martensite, where most benches begin
    f, g = ramps(kelvin, sigma, parameters)
    least = ramp_of(parameters)(0.0)[0]  # left at A_f and M_f
    for impossible, expected in (
        ((f <= least) & (g >= 1.0 - least) & (xi > least), "0 above A_f"),
        ((f >= 1.0 - least) & (g <= least) & (xi < 1.0 - least), "1 below M_f"),
    ):
        if np.any(impossible):
            i = int(np.argmax(impossible))
            there = f"{xi[i]:g} at {kelvin[i]:g} K and {sigma[i] / 1e6:.4g} MPa"
            expected = f"expected {expected} (shifted by stress)"
            raise InputError(f"initial state: martensite fraction {there}, {expected}")


# --- Parameters converted to the rows of columns.py.

_OF_WIRE = {
    "environment.ambient_temperature": [at.AMBIENT], "wire.resistance": [at.RESISTANCE],
    "wire.austenite_finish_temperature": [at.AUSTENITE_FINISH, at.AUSTENITE_FINISH_FRESH],
    "wire.martensite_finish_temperature": [at.MARTENSITE_FINISH, at.MARTENSITE_FINISH_FRESH],
    "wire.transition_tail": [at.TAIL], "wire.transition_skew": [at.SKEW],
    "wire.austenite_modulus": [at.AUSTENITE_MODULUS, at.AUSTENITE_STIFF],
    "wire.martensite_modulus": [at.MARTENSITE_STIFF],
    "wire.maximum_recoverable_strain": [at.RECOVERABLE_STRAIN, at.FULL_STRAIN],
    "wire.thermal_expansion_factor": [at.EXPANSION, at.EXPANDS],
    "wire.r_phase_strain": [at.R_STRAIN], "wire.r_phase_range": [at.R_RANGE],
}  # fmt: skip
# By kind of row: (column, parameter whose value it holds), and the marks that effects set.
_NUMBERS: dict[str, list[tuple[int, str]]] = {
    "wire": [(column, n) for n, columns in _OF_WIRE.items() for column in columns], "side": [],
}  # fmt: skip
_READ = [at.READING, at.SEEN, at.FAST, at.SLOW, at.EXPOSED, at.EXPOSED_TWICE]
# (column, parameter that sets it when not 0, whether the effect is of this kind of row)
_MARKS: dict[str, list[tuple[int, str, bool]]] = {"wire": [], "side": []}
for _row, _names in (("wire", at.WIRE_NAMES), ("side", at.SIDE_NAMES)):
    for _effect in EFFECTS.values():
        if _effect.row == _row:
            _own = _effect.columns.items()
            _NUMBERS[_row] += [(_names[column], _effect.named(n).name) for n, column in _own]
        for _mark in filter(_names.__contains__, _effect.marks):
            _MARKS[_row] += [(_names[_mark], p.name, _effect.row == _row) for p in _effect.switches]
# A fit makes thousands of rows: all of a row's numbers and switches are looked up in one go.
_PLACES = {row: [column for column, _ in pairs] for row, pairs in _NUMBERS.items()}
_VALUES = {row: itemgetter(*(name for _, name in pairs)) for row, pairs in _NUMBERS.items()}
_SWITCHES = {row: itemgetter(*(name for _, name, _ in marks)) for row, marks in _MARKS.items()}
_MARKED = {row: np.array([mark for mark, _, _ in marks]) for row, marks in _MARKS.items()}
_OWN = {row: np.array([own for _, _, own in marks]) for row, marks in _MARKS.items()}


def wire_rows(p: Parameters, boundary: Boundary) -> Array:
    """(w, WIRE_COLUMNS) constants of every wire; the states are 0, except ORIENTED."""
    side, row = side_of_channels(p), np.zeros(at.WIRE_COLUMNS)
    row[_PLACES["wire"]] = _VALUES["wire"](p.plain)
    row[_MARKED["wire"][np.not_equal(_SWITCHES["wire"](p.plain), 0.0)]] = 1.0
    row[at.LAW] = LAWS.index(p["wire.law"])  # 0 is the contract's cosine
    if p["wire.law"] == "normal":
        plays, deviation = normal.plays(p)
        row[at.GROUPS], row[at.SHARPNESS] = plays.shape[1], 1.0 / deviation
        for first, numbers in zip(normal.OF_PLAYS, plays, strict=True):
            row[first : first + len(numbers)] = numbers
    elif p["wire.law"] in ORIENTING:
        row[at.ORIENTS_FROM], row[at.ORIENTS_WITHIN] = (p[n] for n in ORIENTING[p["wire.law"]])
        row[at.MISMATCH], row[at.EVOLVES] = extended.mismatch(p), 1.0
    if p["wire.r_phase_strain"] != 0.0:
        row[at.EVOLVES] = 1.0
        row[at.R_END] = p["wire.r_phase_temperature"] + 0.5 * p["wire.r_phase_range"]
    if p["wire.convection"] == "free":
        material.note_free(row, p)
    row[at.HEATING] = 1.0 / (heated_resistance(p) * heat_loss(p))
    row[at.SOURCE] = SOURCES.get(p["bench.drive"], 0.0)
    leads = p["bench.lead_resistance"] + p["effect.supply_drop.resistance"]
    row[at.SUPPLY_RESISTANCE] = p["wire.count"] * leads
    row[[at.OVERLOAD, at.BATTERY]] *= p["wire.count"]
    row[at.KNEE] /= p["wire.count"]
    row[at.TIME_CONSTANT], row[at.LOSS] = time_constant(p), heat_loss(p)
    heat = p["effect.latent_heat.heat"]
    row[at.LATENT_RISE] = heat / p["wire.specific_heat"]
    if tilt := min(max(p["effect.latent_heat.tilt"], -heat), heat):
        row[at.LATENT_TILT], row[at.HEATED_OTHERWISE] = tilt / p["wire.specific_heat"], 1.0
    row[at.CAPACITY] = p["wire.mass"] * p["wire.specific_heat"]
    row[at.MODULUS_CHANGE] = p["wire.martensite_modulus"] - p["wire.austenite_modulus"]
    for phase, hot, cold in (("austenite", "finish", "start"), ("martensite", "start", "finish")):
        spread, slope, shift = (at.WIRE_NAMES[f"{phase.upper()}_{of}"]
                                for of in ("SPREAD", "SLOPE", "SHIFT"))
        width = p[f"wire.{phase}_{hot}_temperature"] - p[f"wire.{phase}_{cold}_temperature"]
        row[slope], row[spread] = 1.0 / width, p["wire.transition_spread"] / width
        added = p[f"effect.stress_dependent_transition.{phase}"]
        row[shift] = max(1.0 / p[f"wire.stress_influence_{phase}"] + added, 0.0)
    wires = np.tile(row, (side.size, 1))
    wires[:, at.SIDE], wires[:, at.PRESTRETCH] = side, boundary.stretch_of_wires(p)
    wires[:, at.ORIENTED] = orientation.at_rest(p, wires[:, at.PRESTRETCH])
    wires[:, at.PRESTRETCH] -= row[at.FULL_STRAIN] * (1.0 - wires[:, at.ORIENTED])
    if row[at.ACROSS]:  # unequal numbers of wires: the heat that one side gives, the other gets
        own = np.bincount(side)[side]
        wires[:, at.ACROSS] *= (side.size - own) / np.maximum(own, side.size - own)
    return wires


def side_rows(parameters: Parameters, boundary: Boundary) -> Array:
    """(s, SIDE_COLUMNS) constants of every side; states are 0."""
    row, count = np.zeros(at.SIDE_COLUMNS), len(side_names(parameters))
    row[_PLACES["side"]] = _VALUES["side"](parameters.plain)
    on = np.not_equal(_SWITCHES["side"](parameters.plain), 0.0)
    row[_MARKED["side"][on]] = 1.0
    row[at.ENGAGEMENT] = min(row[at.ENGAGEMENT] + row[at.BUCKLED], 1.0)
    row[at.GAP] *= row[at.BUCKLED] > 0.0
    row[at.SLACK] += row[at.RUBBING_SLACK]
    row[at.RUBBING] *= row[at.RUBBING_SLACK] > 0.0
    stiffness, load, friction = (boundary.per_side(name, count)
                                 for name in ("stiffness", "load", "friction"))
    # Only a side that pulls against something elastic can relax or be slack.
    elastic = boundary.contraction is None and not boundary.coupled
    sides = np.outer((stiffness > 0.0) & elastic, row)
    sides[:, _MARKED["side"][on & ~_OWN["side"]]] = 1.0
    for column in (at.SLACK, at.RUBBING_SLACK, at.SOFT_SLACK, at.RUBBING):
        sides[load > 0.0, column] = 0.0  # the load pulls the wires straight
    sides[:, at.PRESCRIBED] = boundary.contraction is not None
    sides[:, at.COUPLED], sides[:, at.STIFFENING] = boundary.coupled, boundary.stiffening
    sides[:, at.STIFFNESS] = sides[:, at.OWN_STIFFNESS] = stiffness
    sides[:, at.LOAD] = sides[:, at.OWN_LOAD] = load
    sides[:, at.FRICTION] += friction  # or that of slack
    return sides


def ramps(temperature: ArrayLike, stress: ArrayLike, parameters: Parameters) -> tuple[Array, Array]:
    """f and g of the full loop (kinetics.py) at T [K] and sigma [Pa], which broadcast."""
    given = (np.asarray(a, float) for a in (temperature, stress))
    kelvin, sigma = np.broadcast_arrays(*given)
    f, g = np.empty(kelvin.shape), np.empty(kelvin.shape)
    wire = wire_rows(parameters, Boundary())[:1]
    kinetics.full_loop(wire, kelvin.ravel(), sigma.ravel(), f.reshape(-1), g.reshape(-1))
    return f, g


def heated_fraction(temperature: ArrayLike, stress: ArrayLike, parameters: Parameters) -> Array:
    """Martensite fraction on heating from martensite, eq. (10)."""
    return ramps(temperature, stress, parameters)[0]


def cooled_fraction(temperature: ArrayLike, stress: ArrayLike, parameters: Parameters) -> Array:
    """Martensite fraction on cooling from austenite, eq. (11)."""
    return 1.0 - ramps(temperature, stress, parameters)[1]


_AT_ONCE = 1e-6  # s, a step in which only the balance of stresses changes
_SUMS_OF_STRESSES = [at.STIFFNESS, at.LOAD, at.OWN_STIFFNESS, at.OWN_LOAD, at.FRICTION, at.RUBBING]


@lru_cache(maxsize=64)
def _first_of_sides(of_channels: tuple[str, ...]) -> list[int]:
    """(w,) first wire on each wire's side; empty if sides have one wire or unequal numbers."""
    first = [of_channels.index(side) for side in of_channels]
    counts = {first.count(k) for k in first}
    return first if len(counts) == 1 and counts != {1} else []


class Kernel:
    """Parameters converted once for the compiled core, and the core's calls."""

    def __init__(self, parameters: Parameters, boundary: Boundary | None) -> None:
        warn_if_plain()
        self.parameters = parameters
        self.boundary = boundary or Boundary.of(parameters)
        self.wires = len(parameters["bench.channels"])
        self.rows = wire_rows(parameters, self.boundary), side_rows(parameters, self.boundary)

    def memory(self, initial: State | None) -> tuple[Array, Array]:
        """Fresh rows of the kernel: constants of this bench, state of `initial`, or at rest."""
        state = initial or at_rest(self.parameters, self.boundary)
        wires, sides = self.rows[0].copy(), self.rows[1].copy()
        if state.temperature.shape != (len(wires),) or state.contraction.shape != (len(sides),):
            found = f"{state.temperature.size} wires on {state.contraction.size} sides"
            expected = f"expected {len(wires)} on {len(sides)}"
            raise InputError(f"initial state: {found}, {expected}")
        if state.memory is not None:
            wires[:, at.WIRE_STATE :], sides[:, at.SIDE_STATE :] = state.memory
        else:
            wires[:, at.FRACTION], wires[:, at.STRESS] = state.martensite_fraction, state.stress
            wires[:, at.ORIENTED] *= state.martensite_fraction
            wires[:, at.MOST_AUSTENITE] = 1.0 - state.martensite_fraction
            sides[:, at.PASSIVE_FRACTION] = 1.0
            for column in (at.CONTRACTION, at.BENDING, *range(at.RELAXED, at.RELAXED + 3)):
                sides[:, column] = state.contraction
            wires[:, at.TEMPERATURE] = wires[:, at.READING] = state.temperature
            for i in np.flatnonzero(wires[:, at.READ_OTHERWISE]):
                wires[i, _READ] = core.see(wires, sides, i)
        if self.parameters["wire.law"] == "normal":
            for i in np.flatnonzero(wires[:, at.PLAY] == 0.0):
                normal.begin(wires[i])
        # Effects that were on in the initial state may be off now:
        wires[:, at.OFFSET] = wires[:, at.PRESTRETCH]
        sides[sides[:, at.ENGAGEMENT] == 0.0, at.PASSIVE_BENDING] = 0.0
        if self.boundary.contraction is not None:
            sides[:, at.CONTRACTION] = self.boundary.per_side("contraction", len(sides))
            sides[:, at.CONTRACTION_CHANGE] = 0.0
        return wires, sides

    def carry_over(self, memory: tuple[Array, Array], most_austenite: Array) -> None:
        """Put `memory` at rest with the residual strain of an earlier `most_austenite` (w,)."""
        wires, sides = memory
        wires[:, at.MOST_AUSTENITE] = most_austenite
        self.run(np.array([0.0, _AT_ONCE]), np.zeros((2, self.wires)), memory)
        for column in range(at.RELAXED, at.RELAXED + 3):
            sides[:, column] = sides[:, at.CONTRACTION]

    def run(self, time: Array, voltage: Array, memory: tuple[Array, Array],
            contraction: Array | None = None) -> tuple[Array, Array]:
        """Advance `memory` in place; returns history (6, n, w) and strain (2, n, s) of core.run.
        Held sides stay where they are, or follow `contraction` (n,) from sample 1 on."""
        wires, sides = memory
        strain = np.empty((2, time.size, len(sides)))
        if self.boundary.contraction is not None:
            sides[:, at.PRESCRIBED], wires[:, at.STRETCHED] = 1.0, 0.0
            if contraction is not None:
                sides[:, at.PRESCRIBED], strain[0] = core.MOVED, contraction[:, np.newaxis]
        volts = heating_voltage(voltage, self.parameters)
        of_side = _first_of_sides(tuple(self.parameters["bench.channel_sides"]))
        if of_side and (volts == volts[:, of_side]).all() and (wires == wires[of_side]).all():
            # Equal wires of a side are simulated as one, sums of stresses divided by their number.
            first = sorted(set(of_side))
            which, share = [first.index(k) for k in of_side], len(first) / self.wires
            few, own = wires[first], np.empty((6, time.size, len(first)))
            sides[:, _SUMS_OF_STRESSES] *= share
            core.run(time, np.ascontiguousarray(volts[:, first]), few, sides, own, strain)
            sides[:, _SUMS_OF_STRESSES] /= share
            wires[:] = few[which]
            return own[:, :, which], strain
        history = np.empty((6, time.size, self.wires))
        core.run(time, volts, wires, sides, history, strain)
        return history, strain

    def currents(self, voltage: ArrayLike, *states: Array) -> Array:
        """(..., w) A through one wire of each channel at `voltage` (..., w) V, in these states:
        temperature K, martensite fraction, sag V."""
        columns = [np.ascontiguousarray(np.atleast_2d(of), float) for of in (voltage, *states)]
        found = np.empty_like(columns[0])
        core.currents(self.rows[0].copy(), *columns, found)
        return found.reshape(np.shape(voltage))

    def state(self, memory: tuple[Array, Array]) -> State:
        """Snapshot of the kernel's state."""
        wires, sides = memory[0].copy(), memory[1].copy()
        return State(wires[:, at.TEMPERATURE], wires[:, at.FRACTION], wires[:, at.STRESS],
                     sides[:, at.CONTRACTION],
                     (wires[:, at.WIRE_STATE :], sides[:, at.SIDE_STATE :]))
