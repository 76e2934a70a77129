"""A record as the diagnosis sees it: the drive on a uniform grid, every signal in bins of time."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from sma_bench.errors import InputError
from sma_bench.identify.whole_model.applied_voltage import AppliedVoltage
from sma_bench.identify.whole_model.record_noise import noise_floor
from sma_bench.identify.whole_model.rig_record import Measured, RigRecord, rig_record
from sma_bench.parameters import Parameters
from sma_bench.physics import simulate
from sma_bench.physics.electrical import current
from sma_bench.physics.heat import time_constant
from sma_bench.physics.simulate import Simulation
from sma_bench.records.record import Record

Array = NDArray[np.float64]

_CELL = 0.02  # s of the simulation; the voltages' energy over it is exact
_LONG_CELL = 0.1
# After a jump a wire is fast: what is read turns within a few hundredths of a second.
_FINE_CELL, _FINE_SPAN = 0.0075, 0.45
_CELLS = 80  # a time constant at least, then: latent heat acts at the end of a cell
_FORGOTTEN = 5.0  # time constants after which a wire does not tell how it was heated before
_NARROW = 1e-3  # s
_HELD = 2e-4  # of the largest voltage, from cell to cell
_SETTLED = 3.0  # s without a change after which the long cell will do
_BIN = 0.2  # s, shorter than any time constant of a wire in air
_MOST_BINS = 1500  # a signal
_FULL = 0.5  # of the usual number of samples
_MOST_CELLS = 12_000
_SAMPLES_A_BIN = 2.0
QUANTITIES = ("current", "temperature", "deflection")
_DRIVEN = 0.02  # of the largest voltage
_ZERO_STD = {"current": 0.005, "temperature": 0.2, "deflection": 5e-4}
# Of a bin: no bench is simulated, and no voltage known, to less.
_LEAST = {"current": 5e-4, "temperature": 0.02, "deflection": 5e-6}
# Slow drift of a good instrument; one of the size of a sample's scatter is usual in any case.
_DRIFT = {"current": 0.01, "temperature": 0.5, "deflection": 5e-5}
_CLOCK_STD = 0.02  # s, of one instrument's stamps behind the voltages'


@dataclass(frozen=True, eq=False)
class Binned:
    """One measured signal, averaged over bins of time.

    Attributes:
        name, quantity, wire: of `Measured`; the wire is the column it belongs to.
        time: (b,) s, mean stamp; value: (b,) mean in the signal's unit; count: (b,) samples.
        period: s between bins.
        noise: white noise of a bin of the usual count, from sample to sample.
        average: (b, n) from a course on the simulation's grid to bins; for a current from
            conductance to current.
    """

    name: str
    quantity: str
    wire: int
    time: Array
    value: Array
    count: Array
    period: float
    noise: float
    average: csr_array

    @property
    def zero_std(self) -> float:
        """Standard deviation of the sensor's unknown zero."""
        return _ZERO_STD[self.quantity]

    @property
    def usual_drift(self) -> float:
        """Slow drift that a good instrument may have."""
        return max(_DRIFT[self.quantity], self.noise * float(np.sqrt(np.median(self.count))))

    @property
    def clock_std(self) -> float:
        """Standard deviation of the delay of its stamps [s]; 0 for the driver's own."""
        return 0.0 if self.quantity == "current" else _CLOCK_STD


@dataclass(frozen=True, eq=False)
class View:
    """One record ready to be compared with simulations.

    Attributes:
        path: of the record; signals: what it measures, bin by bin.
        grid: (n,) s; voltage: (n, w) V held over each cell.
        drive: the voltages as read; sides: side name of each wire.
        channels: names of the wires; left_out: what the record holds that is not compared.
    """

    path: str
    channels: tuple[str, ...]
    sides: tuple[str, ...]
    grid: Array
    voltage: Array
    drive: AppliedVoltage
    signals: tuple[Binned, ...]
    left_out: tuple[str, ...]

    @property
    def quantities(self) -> tuple[str, ...]:
        """What is measured, each once."""
        return tuple(dict.fromkeys(s.quantity for s in self.signals))

    def simulate(self, parameters: Parameters, voltage: Array | None = None) -> Simulation:
        """The model on this record's drive."""
        return simulate(parameters, self.grid, self.voltage if voltage is None else voltage)

    def readings(self, simulation: Simulation) -> list[Array]:
        """What the model's sensors read, one (b,) array a signal."""
        return [s.average @ self.course(s, simulation) for s in self.signals]

    def course(self, signal: Binned, simulation: Simulation) -> Array:
        """(n,) on the grid: what the signal averages; the conductance for a current."""
        if signal.quantity == "deflection":
            return simulation.deflection_reading
        if signal.quantity == "temperature":
            return simulation.temperature_reading[:, signal.wire]
        i = signal.wire
        return current(
            simulation.parameters, 1.0, simulation.temperature[:, i],
            simulation.martensite_fraction[:, i],
        )

    def rates(self, simulation: Simulation) -> list[Array]:
        """d/dt of each signal, bin by bin."""
        return [
            s.average @ np.gradient(self.course(s, simulation), self.grid) for s in self.signals
        ]

    def phase_of(self, time: Array) -> NDArray[np.str_]:
        """`initial`, `drive` or `rest` at each time: before, during, and after driving."""
        driven = self.voltage.max(axis=1) > _DRIVEN * max(float(self.voltage.max()), 1e-9)
        first = self.grid[np.argmax(driven)] if driven.any() else np.inf
        at = np.clip(np.searchsorted(self.grid, time, side="right") - 1, 0, len(self.grid) - 1)
        return np.where(time < first, "initial", np.where(driven[at], "drive", "rest"))

    @cached_property
    def jumps(self) -> list[Array]:
        """Voltages (n, w) with one jump's moment moved by a standard deviation, one a jump."""
        count = len(self.drive.early)
        moved = np.eye(count) / np.sqrt(12.0)
        return [self.drive.on_grid(self.grid, place) for place in moved]

    @cached_property
    def levels(self) -> list[Array]:
        """Voltages (n, w) with one held level moved by a standard deviation, one a level of which
        the converter's steps hide something."""
        place = np.zeros(len(self.drive.early))
        return [
            self.drive.on_grid(self.grid, place, error) for error in self.drive.level_errors()
        ]


def shared_bin(records: Sequence[Record], parameters: Parameters) -> float:
    """Shortest bin [s] that suits every signal of all records: noise is that of a bin."""
    measured = [m for record in records for m in rig_record(record, parameters).measured]
    return max([_BIN, *(_own_bin(m) for m in measured)])


def view_record(
    record: Record,
    parameters: Parameters,
    shortest_bin: float = _BIN,
    quantities: Collection[str] = QUANTITIES,
) -> View:
    """Prepare a record.

    Args:
        record: the bag; parameters: as believed, for the channels.
        shortest_bin: s, of `shared_bin`; quantities: to compare, all that are there.

    Raises:
        InputError: no voltage of some channel, or nothing to compare with.
    """
    rig = rig_record(record, parameters)
    grid = _grid(rig, time_constant(parameters) / _CELLS)
    known = [m for m in _known_history(rig, parameters) if m.quantity in quantities]
    if not known:
        held = ", ".join(m.name for m in rig.measured)
        raise InputError(f"{record.path}: only {held}, expected {' or '.join(quantities)}")
    left_out = tuple(m.name for m in rig.measured if m.quantity not in quantities)
    place = np.zeros(len(rig.voltage.early))
    return View(
        str(record.path), rig.channels, rig.sides, grid, rig.voltage.on_grid(grid, place),
        rig.voltage, tuple(_binned(m, rig, grid, shortest_bin) for m in known), left_out,
    )


def _known_history(rig: RigRecord, parameters: Parameters) -> list[Measured]:
    """What was measured; of a record that begins under voltage, after that has been forgotten."""
    first = np.array([c.voltage[0] for c in rig.voltage.courses])
    if np.max(np.abs(first)) <= _DRIVEN * max(np.max(c.voltage) for c in rig.voltage.courses):
        return list(rig.measured)
    begin = float(rig.grid[0]) + _FORGOTTEN * time_constant(parameters)
    return [
        replace(m, time=m.time[m.time >= begin], values=m.values[m.time >= begin])
        for m in rig.measured if np.sum(m.time >= begin) > 1
    ]


def _grid(rig: RigRecord, finest: float) -> Array:
    start, stop = float(rig.grid[0]), float(rig.grid[-1])
    cell = min(max(_CELL, (stop - start) / _MOST_CELLS), _LONG_CELL)
    even = start + cell * np.arange(int(np.ceil((stop - start) / cell)) + 1.0)
    even = _thinned(even, rig.voltage, max(1, round(_LONG_CELL / cell)))
    fine = np.arange(0.0, _FINE_SPAN, min(_FINE_CELL, max(finest, 2.0 * _NARROW)))
    jumps = np.unique(np.concatenate([rig.voltage.early, rig.voltage.late]))
    jumps = jumps[(jumps > start) & (jumps < even[-1])]
    after = np.add.outer(rig.voltage.late, fine).ravel()
    others = np.concatenate([even, after[(after > start) & (after < even[-1])]])
    near = _to_the_nearest(jumps, others)
    near[others <= start] = np.inf
    grid = np.unique(np.concatenate([others[near > _NARROW], jumps]))
    return grid[np.insert(np.diff(grid) > _NARROW, 0, True) | np.isin(grid, jumps)]


def _to_the_nearest(jumps: Array, points: Array) -> Array:
    """(n,) how far each point is from the nearest jump; jumps are in order."""
    around = np.concatenate([[-np.inf], jumps, [np.inf]])
    k = np.searchsorted(around, points)
    return np.asarray(np.minimum(around[k] - points, points - around[k - 1]))


def _thinned(even: Array, voltage: AppliedVoltage, stride: int) -> Array:
    """An even grid (n,) with only every so many points where voltages have been held for long."""
    volts = np.column_stack([voltage.at(k, even) for k in range(len(voltage.courses))])
    changes = np.abs(np.diff(volts, axis=0, prepend=volts[:1])).max(axis=1)
    changed = changes > _HELD * max(float(volts.max()), 1e-9)
    last = np.maximum.accumulate(np.where(changed, even, -np.inf))
    first = np.minimum.accumulate(np.where(changed, even, np.inf)[::-1])[::-1]
    moving = (even - last < _SETTLED) | (first - even < _LONG_CELL)
    return even[moving | (np.arange(len(even)) % stride == 0) | (even == even[-1])]


def _own_bin(measured: Measured) -> float:
    time = measured.time
    duration = float(time[-1] - time[0])
    return max(duration / _MOST_BINS, _SAMPLES_A_BIN * float(np.median(np.diff(time))))


def _binned(measured: Measured, rig: RigRecord, grid: Array, shortest: float) -> Binned:
    period = max(shortest, _own_bin(measured))
    which = np.floor((measured.time - measured.time[0]) / period).astype(np.intp)
    _, which, count = np.unique(which, return_inverse=True, return_counts=True)
    # The mean of far fewer samples than usual would scatter like no other.
    full = (count >= _FULL * np.median(count))[which]
    measured = replace(measured, time=measured.time[full], values=measured.values[full])
    time, value = measured.time, measured.values
    kept, which, count = np.unique(which[full], return_inverse=True, return_counts=True)
    bins = len(kept)
    noise = max(_LEAST[measured.quantity], noise_floor(value) / float(np.sqrt(np.median(count))))
    return Binned(
        measured.name, measured.quantity, measured.wire,
        np.bincount(which, time, bins) / count, np.bincount(which, value, bins) / count,
        count.astype(np.float64), period, noise, _averaging(measured, rig, grid, which, count),
    )


def _averaging(
    measured: Measured, rig: RigRecord, grid: Array,
    which: NDArray[np.intp], count: NDArray[np.intp],
) -> csr_array:
    """Interpolation at the samples' times, then the mean over each bin."""
    time = measured.time
    right = np.clip(np.searchsorted(grid, time), 1, len(grid) - 1)
    share = np.clip((time - grid[right - 1]) / (grid[right] - grid[right - 1]), 0.0, 1.0)
    weight = 1.0 / count[which]
    if measured.quantity == "current":
        weight = weight * rig.voltage.at(measured.wire, time)
    rows = np.concatenate([which, which])
    columns = np.concatenate([right - 1, right])
    entries = np.concatenate([weight * (1.0 - share), weight * share])
    return csr_array((entries, (rows, columns)), shape=(len(count), len(grid)))
