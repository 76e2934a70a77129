"""Records as the rivals use them, and least squares with a few simulations."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
from numpy.typing import ArrayLike
from scipy.sparse import csr_array

from examination.blind.rigs import simulated_reading
from sma_bench.errors import InputError
from sma_bench.parameters import Parameters
from sma_bench.parameters.table import BY_NAME
from sma_bench.physics.effects import EFFECTS
from sma_bench.physics.simulate import simulate
from sma_bench.records import Record
from sma_bench.records.samples import held_voltages

# --- A record as the rivals use it: means over a tenth of a second, and noise taken as white.

Array = npt.NDArray[np.float64]

PERIOD = 0.1
_GRID = PERIOD / 2.0
QUANTITIES = ("current", "temperature", "deflection")
_FEWEST = 20
_SMALLEST_NOISE = 1e-12


@dataclass(frozen=True, eq=False)
class BinnedSignal:
    """One signal in bins.

    Attributes:
        at: (m,) bins that have samples; mean: (m,) of the samples.
        noise: standard deviation of such a mean if the noise from sample to sample is white.
        operator: (m, grid) what a simulation on the grid says to these very samples.
    """

    name: str
    at: npt.NDArray[np.intp]
    mean: Array
    noise: float
    operator: csr_array

    @property
    def quantity(self) -> str:
        """`temperature` of `front_1.temperature`."""
        return self.name.rpartition(".")[2]


@dataclass(frozen=True, eq=False)
class Observed:
    """One record on a grid of bins.

    Attributes:
        channels, sides: of the wires; time: (2 n + 1,) s, edges and middles of n bins.
        voltage: (2 n + 1, w) V, held over half a bin: root mean square, so the heat is right.
        readings: of every signal that the model has.
    """

    channels: tuple[str, ...]
    sides: tuple[str, ...]
    time: Array
    voltage: Array
    readings: tuple[BinnedSignal, ...]

    def residuals(self, parameters: Parameters) -> list[Array]:
        """Measured less simulated of every reading, in its unit."""
        simulation = simulate(parameters, self.time, self.voltage)
        return [
            reading.mean - reading.operator @ simulated_reading(simulation, reading.name)
            for reading in self.readings
        ]

    def whitened(self, parameters: Parameters) -> Array:
        """All residuals in a row, each over its noise."""
        rows = self.residuals(parameters)
        return np.concatenate(
            [row / reading.noise for row, reading in zip(rows, self.readings, strict=True)]
        )

    @property
    def _bin_voltage(self) -> Array:
        return np.maximum(self.voltage[:-1:2], self.voltage[1::2])

    @cached_property
    def phase(self) -> npt.NDArray[np.str_]:
        """(n,) drive, rest or initial of every bin."""
        driven = (self._bin_voltage > 0.0).any(axis=1)
        phase = np.where(driven, "drive", "rest").astype("<U7")
        phase[~np.maximum.accumulate(driven)] = "initial"
        return phase

    @cached_property
    def driven_side(self) -> npt.NDArray[np.str_]:
        """(n,) the side driven now or last, "" before."""
        side, last = [], ""
        for volts in self._bin_voltage:
            last = self.sides[int(np.argmax(volts))] if volts.any() else last
            side.append(last)
        return np.array(side)


def observe(record: Record, parameters: Parameters) -> Observed:
    """Bin a record.

    Raises:
        InputError: no voltages, or no signal that the model has.
    """
    channels = tuple(parameters["bench.channels"])
    time, volts = held_voltages(record, channels)
    count = int(record.duration / PERIOD)
    edges = np.arange(2 * count + 1, dtype=np.float64) * np.float64(_GRID)
    voltage = _held_over_bins(time, volts, edges)
    readings = []
    for column, channel in enumerate(channels):
        held = _Held(time, volts[:, column], voltage[:, column])
        readings += _reading(record, f"{channel}.current", edges, held)
        readings += _reading(record, f"{channel}.temperature", edges)
    readings += _reading(record, "deflection", edges)
    if not readings:
        raise InputError(f"{record.path}: nothing measured besides the voltages")
    sides = tuple(parameters["bench.channel_sides"])
    return Observed(channels, sides, edges, voltage, tuple(readings))


@dataclass(frozen=True, eq=False)
class _Held:
    """Voltage of one wire: as commanded in steps, and on the simulation's grid."""

    time: Array
    volts: Array
    on_grid: Array


def _reading(
    record: Record, name: str, edges: Array, held: _Held | None = None
) -> list[BinnedSignal]:
    """The signal in bins; none where the record hardly has it."""
    signal = record.get(name)
    if signal is None or len(signal) < _FEWEST:
        return []
    inside = (signal.time >= edges[0]) & (signal.time < edges[-1])
    time, values = signal.time[inside], signal.values[inside]
    at, row, number = np.unique(
        np.floor(time / PERIOD).astype(np.intp), return_inverse=True, return_counts=True
    )
    # Second differences: the signal's own slope does not count as noise.
    scatter = float(np.sqrt(np.mean(np.diff(values, 2) ** 2) / 6.0))
    noise = max(scatter / float(np.sqrt(number.mean())), _SMALLEST_NOISE)
    grid, weight = _interpolation(time, len(edges)) if held is None else _share(time, held)
    rows = np.broadcast_to(row[:, None], grid.shape)
    scaled = weight / number[row][:, None]
    shape = (len(at), len(edges))
    operator = csr_array((scaled.ravel(), (rows.ravel(), grid.ravel())), shape=shape)
    return [BinnedSignal(name, at, np.bincount(row, values) / number, noise, operator)]


def _interpolation(time: Array, length: int) -> tuple[npt.NDArray[np.intp], Array]:
    """(m, 4) grid points around each time and their weights in the cubic through them."""
    place = time / _GRID
    first = np.clip(np.floor(place).astype(np.intp) - 1, 0, length - 4)
    u = place - first
    weight = np.column_stack([
        -(u - 1.0) * (u - 2.0) * (u - 3.0) / 6.0,
        u * (u - 2.0) * (u - 3.0) / 2.0,
        -u * (u - 1.0) * (u - 3.0) / 2.0,
        u * (u - 1.0) * (u - 2.0) / 6.0,
    ])  # fmt: skip
    return first[:, None] + np.arange(4), weight


def _share(time: Array, held: _Held) -> tuple[npt.NDArray[np.intp], Array]:
    """(m, 1) grid point that holds each time, and the voltage then over that of the grid: a
    current follows its voltage at once."""
    k = np.minimum((time / _GRID).astype(np.intp), len(held.on_grid) - 1)
    now = held.volts[np.maximum(np.searchsorted(held.time, time, side="right") - 1, 0)]
    grid = held.on_grid[k]
    weight = np.divide(now, grid, out=np.zeros_like(now), where=grid > 0.0)
    return k[:, None], weight[:, None]


def _held_over_bins(time: Array, volts: Array, edges: Array) -> Array:
    """(n, w) root mean square of held voltages from each edge to the next, the last twice."""
    corners = np.unique(np.concatenate([edges, time[(time > edges[0]) & (time < edges[-1])]]))
    held = volts[np.maximum(np.searchsorted(time, corners[:-1], side="right") - 1, 0)]
    energy = held**2 * np.diff(corners)[:, None]
    first = np.searchsorted(corners, edges[:-1])
    mean = np.sqrt(np.add.reduceat(energy, first, axis=0) / np.diff(edges)[:, None])
    return np.asarray(np.vstack([mean, mean[-1:]]), dtype=np.float64)


# --- Least squares (scipy's) over some numbers, with finite differences and few simulations.

_STEP = 0.05  # of a finite difference, in scales
_ROUNDS = 5
_TRIALS = 2  # a round
_ENOUGH = 1e-4  # relative gain below which a fit is done
_BACK, _FRONT = "composite.stress_per_deflection_back", "composite.stress_per_deflection_front"

# The numbers of the baseline that may be off. The area acts only together with h, the mass only
# together with c_p; both sides share one beta.
_BASELINE = (
    ("environment.ambient_temperature",),
    ("wire.resistance",),
    ("wire.heat_transfer_coefficient",),
    ("wire.specific_heat",),
    ("wire.austenite_start_temperature",),
    ("wire.austenite_finish_temperature",),
    ("wire.martensite_start_temperature",),
    ("wire.martensite_finish_temperature",),
    ("wire.stress_influence_austenite",),
    ("wire.stress_influence_martensite",),
    ("wire.martensite_modulus",),
    ("wire.austenite_modulus",),
    ("wire.maximum_recoverable_strain",),
    ("wire.thermal_expansion_factor",),
    ("composite.deflection_per_strain",),
    (_FRONT, _BACK),
)


@dataclass(frozen=True)
class Knob:
    """Parameters that share one value, and the scale on which it moves."""

    names: tuple[str, ...]
    scale: float

    @property
    def limits(self) -> tuple[float, float]:
        """Range of the parameter table."""
        low, high = BY_NAME[self.names[0]].low, BY_NAME[self.names[0]].high
        return -np.inf if low is None else low, np.inf if high is None else high


@dataclass(frozen=True)
class Fit:
    """Fitted parameters; `square` is the sum of squares of the residuals over their noise."""

    parameters: Parameters
    square: float
    knobs: tuple[Knob, ...]


def baseline_knobs(parameters: Parameters) -> tuple[Knob, ...]:
    """The baseline's numbers on the scale of their uncertainty; a number that is derived from the
    geometry (0) stays derived."""
    return tuple(
        Knob(names, parameters.std(names[0]))
        for names in _BASELINE
        if parameters[names[0]] != 0.0 and parameters.std(names[0]) > 0.0
    )


@dataclass(frozen=True, eq=False)
class Slope:
    """(n, k) change of the whitened residuals a scale of each of k knobs."""

    knobs: tuple[Knob, ...]
    columns: Array


def effect_knobs(name: str, parameters: Parameters) -> tuple[Knob, ...]:
    """The numbers of an effect."""
    return tuple(Knob((p.name,), parameters.std(p.name)) for p in EFFECTS[name].parameters)


def whitened(observed: Sequence[Observed], parameters: Parameters) -> Array:
    """Residuals of all records over their noise."""
    return np.concatenate([one.whitened(parameters) for one in observed])


def moved(parameters: Parameters, knobs: Sequence[Knob], steps: ArrayLike) -> Parameters:
    """Parameters with every knob moved by so many scales, held within its range."""
    values: dict[str, float] = {}
    for knob, step in zip(knobs, np.asarray(steps, dtype=float).tolist(), strict=True):
        value = float(np.clip(parameters[knob.names[0]] + step * knob.scale, *knob.limits))
        values |= dict.fromkeys(knob.names, value)
    return _ordered(parameters, values)


def _ordered(parameters: Parameters, values: dict[str, float]) -> Parameters:
    """A transformation may not end before it begins; such a move keeps the temperatures."""
    pairs = (("austenite_start", "austenite_finish"), ("martensite_finish", "martensite_start"))
    for lower, upper in pairs:
        names = [f"wire.{which}_temperature" for which in (lower, upper)]
        low, high = (values.get(name, parameters[name]) for name in names)
        if high - low < 0.5:
            values = {name: value for name, value in values.items() if name not in names}
    return parameters.replace(values)


def jacobian(
    observed: Sequence[Observed], parameters: Parameters, knobs: Sequence[Knob], here: Array
) -> Array:
    """(n, k) change of the whitened residuals a scale of each knob.

    Args:
        here: the residuals at `parameters`.
    """
    columns = [np.zeros((len(here), 0))]
    for k, knob in enumerate(knobs):
        step = _STEP if parameters[knob.names[0]] + _STEP * knob.scale <= knob.limits[1] else -_STEP
        steps = np.zeros(len(knobs))
        steps[k] = step
        there = whitened(observed, moved(parameters, knobs, steps))
        columns.append(((there - here) / step)[:, np.newaxis])
    return np.hstack(columns)


def fit(
    observed: Sequence[Observed],
    start: Parameters,
    knobs: Sequence[Knob],
    rounds: int = _ROUNDS,
    slow: Slope | None = None,
) -> Fit:
    """Least squares over some knobs.

    Args:
        observed: records; start: where the knobs stand at first.
        slow: knobs that are fitted too, with their slope at the start, which is kept.
    """
    from scipy.optimize import least_squares  # half a second to load

    kept = slow or Slope((), np.zeros((sum(len(r.at) for o in observed for r in o.readings), 0)))
    every = (*knobs, *kept.knobs)
    def residual(steps: Array) -> Array:
        return whitened(observed, moved(start, every, steps))

    def slopes(steps: Array) -> Array:
        here = moved(start, every, steps)
        fast = jacobian(observed, here, knobs, residual(steps))
        return np.hstack([fast, kept.columns])

    # MINPACK's knows no bounds, but `moved` keeps to them.
    found = least_squares(
        residual, np.zeros(len(every)), slopes, method="lm", x_scale="jac", ftol=_ENOUGH,
        max_nfev=_TRIALS * rounds,
    )
    return Fit(moved(start, every, found.x), 2.0 * float(found.cost), every)


def slope_at(
    observed: Sequence[Observed], parameters: Parameters, knobs: Sequence[Knob], here: Array
) -> Slope:
    """Slope of some knobs at a point whose residuals are `here`."""
    return Slope(tuple(knobs), jacobian(observed, parameters, knobs, here))
