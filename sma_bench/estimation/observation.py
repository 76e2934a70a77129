"""A record prepared for fitting: its voltages on a grid of cells, its signals averaged over bins.

Each bin of a signal is a row of an averaging matrix that acts on the simulation on the grid. Loads
or clamps are boundaries of the simulation; an elongation by a testing machine is an input."""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import block_diag, csr_array

from sma_bench.arrays import Array
from sma_bench.errors import InputError
from sma_bench.estimation.noise_model import noise_floor
from sma_bench.estimation.rig import DRIVEN, LOAD_FRAME, Hold, Measured, Rig, begins_warm, find_rig
from sma_bench.estimation.voltage import AppliedVoltage, alike_by_side
from sma_bench.parameters import Parameters
from sma_bench.parameters.parameter import BY_NAME
from sma_bench.parameters.parameters import as_recorded, wire_length
from sma_bench.physics import Boundary, simulate
from sma_bench.physics.boundary import moves_tip
from sma_bench.physics.effects.residual_strain import carried_over, carries_over
from sma_bench.physics.kernel import at_rest
from sma_bench.physics.material import time_constant
from sma_bench.physics.simulate import Bench, Simulation, simulate_from_rest
from sma_bench.records.record import Record, has_samples, ohms_of_source

QUANTITIES = ("current", "temperature", "deflection")
EVERYTHING = (*QUANTITIES, *LOAD_FRAME)

_CELL = 0.02  # s of the simulation; the energy of the voltages in it is exact
_LONG_CELL = 0.1  # s, while voltages are held
_FINE_CELL, _FINE_SPAN = 0.0075, 0.45  # s: cell after a jump, where readings turn fast; how long
_CELLS = 80  # per time constant at least after a jump: latent heat acts at the end of a cell
_HEATED, _COOLED = 5.0, 7.0  # time constants left out of a record that begins driven; warm
_FAR_APART = 0.03, 1.0  # s between the samples about a jump: it needs more than one cell there
_NARROW = 1e-3  # s between times of the grid, at least
_HELD = 2e-4  # of the largest voltage: it changes less between two cells while it is held
_SETTLED = 3.0  # s after a change, from which long cells suffice
_BIN = 0.2  # s, shorter than any time constant of a wire in air
_FULL = 0.5  # of the usual number of samples
_MOST_CELLS = 12_000  # of _CELL; a longer record has longer cells
_CELLS_A_SAMPLE = 50  # of a sparse record: details between its readings do not show
_CELLS_LIMIT = 4_000_000  # for any record, whatever its timestamps
_WORTHWHILE = 0.7  # of the cells: a coarse grid with more is not used
MOVED = ("deflection", "elongation")
_FEW = 3  # bins, too few to find where a motion rests
RETURNS = 0.012  # of a stroke, to which a bench returns from run to run
JUMP_STD = 1.0 / np.sqrt(12.0)  # of the time between the two samples
_CLOCK_STD = 0.02  # s, delay of an instrument's timestamps behind those of the voltages
_NOISE_FLOOR = 1e-3  # of a signal's range, of a sample: no model of a bench is more exact
_AVERAGED = 10  # samples of a bin at most: that error is the same in neighbouring ones
# What differs between runs of one bench, one standard deviation: K, or share of the value.
STATES = {"environment.ambient_temperature": 1.5, "wire.heat_transfer_coefficient": 0.07,
          "wire.maximum_recoverable_strain": 0.025}
_REMARKS = ("room", 1.0, "K"), ("heat transfer", 100.0, "%"), ("stroke", 100.0, "%")
_UNSET = 5.0  # times the error of a zero: a motion that rests farther off was not set to 0
_WORTH_REPORTING = 0.5  # standard deviations of a run's state
_HISTORIES = ("time", "voltage", "temperature", "martensite_fraction", "stress", "contraction",
              "bending", "temperature_reading", "mount", "sag")


def in_state(parameters: Parameters, away: Mapping[str, float]) -> Parameters:
    """The bench in a run whose `STATES` are so many standard deviations away."""
    there = {}
    for name, far in away.items():
        unit = 1.0 if BY_NAME[name].unit == "K" else parameters[name]
        value = parameters[name] + far * STATES[name] * unit
        there[name] = min(max(value, BY_NAME[name].low), BY_NAME[name].high)
    return parameters.replace(there)


@dataclass(frozen=True)
class Sensor:
    """What is known of the sensor of a quantity, in the quantity's unit."""

    zero_std: float  # of its unknown zero, 0: known
    least: float  # noise of a bin: neither simulations nor voltages are more exact
    drift: float  # slow, of a good instrument; as much as a sample scatters is always usual
    clock_std: float = _CLOCK_STD  # s, of the delay of its stamps; 0 for the driver's own


SENSORS = {"current": Sensor(0.005, 5e-4, 0.01, 0.0), "temperature": Sensor(0.2, 0.02, 0.5),
           "deflection": Sensor(5e-4, 5e-6, 5e-5), "elongation": Sensor(1e-3, 1e-6, 1e-5),
           "force": Sensor(0.0, 1e-3, 0.02)}


@dataclass(frozen=True, eq=False)
class BinnedSignal:
    """One measured signal, averaged over bins of time."""

    name: str
    quantity: str
    wire: int  # column of its wire
    time: Array  # (b,) s, mean timestamp
    value: Array  # (b,) mean in the signal's unit
    count: Array  # (b,) samples
    period: float  # s between bins
    noise: float  # white, of a bin of the usual count; at least the error of any model
    scatter: float  # the same of a sample
    average: csr_array  # (b, n) from values on the grid to bins; from conductance to current
    sensor: Sensor

    @cached_property
    def usual_count(self) -> float:
        return float(np.median(self.count))

    @property
    def usual_drift(self) -> float:
        """Slow drift that a good instrument may have."""
        return max(self.sensor.drift, self.scatter)


@dataclass(frozen=True, eq=False)
class Observation:
    """One record ready to be compared with simulations."""

    path: str
    channels: tuple[str, ...]  # names of the wires
    sides: tuple[str, ...]  # side name of each wire
    grid: Array  # (n,) s
    voltage: Array  # (n, w) V held over each cell
    drive: AppliedVoltage  # the voltages as read
    signals: tuple[BinnedSignal, ...]
    left_out: tuple[str, ...]  # signals of the record that are not compared
    holds: tuple[Hold, ...] = ()  # of a load frame; none for a composite or a bare wire
    # (n,) m, elongation by a testing machine; the only hold is then its zero
    imposed: Array | None = None
    place: Array | float = 0.0  # (e,) of the jumps between their samples, -0.5 to 0.5
    delays: Mapping[str, float] = field(default_factory=dict)  # s, of timestamps, by quantity
    ohms: float = 0.0  # by which a source's readings were turned into volts; 0: volts were read
    epoch: float = 0.0  # s, wall clock at 0 of the grid
    before: "Observation | None" = None  # the last one of the same bench that ended before
    # State of its run, standard deviations of `STATES` from the parameters; and its errors.
    away: Mapping[str, float] = field(default_factory=dict)
    within: Mapping[str, float] = field(default_factory=dict)
    zeros: Mapping[str, float] = field(default_factory=dict)  # subtracted from each signal
    skipped: float = 0.0  # s at its beginning that are not compared: the bench had not settled

    @property
    def quantities(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(s.quantity for s in self.signals))

    @property
    def remarks(self) -> list[str]:
        """Zeros subtracted, time left out, state of the run."""
        found = [f"{signal} is {off:+.3g} m at rest, taken as 0"
                 for signal, off in self.zeros.items()]
        if self.skipped:
            text = f"its first {self.skipped:.3g} s are left out"
            found.insert(0, f"begins before the bench has settled: {text}")
        far = [f"{what} {self.away[name] * std * factor:+.2g} {unit}"
               for (name, std), (what, factor, unit) in zip(STATES.items(), _REMARKS, strict=True)
               if abs(self.away.get(name, 0.0)) > max(_WORTH_REPORTING,
                                                      2.0 * self.within.get(name, 0.0))]
        if far:
            found.append(f"its run differs from the first record's: {', '.join(far)}")
        return [f"{Path(self.path).name}: {text}" for text in found]

    @cached_property
    def coarse(self) -> "Observation":
        """On cells of a quarter of a bin, for differences; itself where that gains little."""
        return self._on_cells(0.25)

    @cached_property
    def rough(self) -> "Observation":
        """On cells of a bin, for the direction of a step from afar."""
        return self._on_cells(1.0)

    def _on_cells(self, share: float) -> "Observation":
        cell = share * min((signal.period for signal in self.signals), default=0.0)
        wanted = np.arange(self.grid[0], self.grid[-1], cell) if cell > 0.0 else self.grid
        nearest = np.searchsorted(0.5 * (self.grid[1:] + self.grid[:-1]), wanted)
        grid = self.grid[np.unique(np.append(nearest, len(self.grid) - 1))]
        stepwise = bool(self.holds) and self.imposed is None
        if stepwise or len(grid) > _WORTHWHILE * len(self.grid):
            return self
        onto = _interpolation(grid, self.grid)
        volts = self.drive.on_grid(grid, self.place + np.zeros(len(self.drive.early)))
        signals = tuple(replace(s, average=s.average @ onto) for s in self.signals)
        imposed = None if self.imposed is None else np.interp(grid, self.grid, self.imposed)
        alike = alike_by_side(volts, self.sides)
        before = self.before and self.before._on_cells(share)
        return replace(self, grid=grid, voltage=alike, signals=signals, imposed=imposed,
                       before=before)

    def simulate(self, parameters: Parameters, voltage: Array | None = None,
                 loads: Array | None = None) -> Simulation:
        """Simulate this drive with its own channels, from martensite (gone after one step if the
        room is too warm); `voltage`: (n, w) V instead; `loads`: (h,) m or N, errors of holds."""
        if tuple(parameters["bench.channels"]) != self.channels:
            own = {"bench.channels": self.channels, "bench.channel_sides": self.sides}
            parameters = parameters.replace(own)
        parameters = in_state(parameters, self.away) if self.away else parameters
        parameters = parameters if self.ohms else as_recorded(parameters)
        volts = self.voltage if voltage is None else voltage
        if self.ohms:
            ratio = ohms_of_source(parameters) / self.ohms
            volts = volts * (ratio if parameters["bench.drive"] == "current" else math.sqrt(ratio))
        if not self.holds:
            load, most = Boundary.of(parameters), None
            if self.before is not None and carries_over(parameters):
                pause = self.epoch + self.grid[0] - self.before.epoch - self.before.grid[-1]
                most = carried_over(parameters, self.before.simulate(parameters).most_austenite,
                                    float(pause))
            return simulate_from_rest(parameters, self.grid, volts, load, most)
        if self.imposed is not None:
            moved = self.imposed + (0.0 if loads is None else float(loads[0]))
            load = Boundary.imposed(parameters, float(moved[0]))
            return simulate(parameters, self.grid, volts, initial=at_rest(parameters, load),
                            boundary=load, elongation=moved)
        # One hold after the other, each from the last sample of the one before.
        errors = np.zeros(len(self.holds)) if loads is None else loads
        begins = np.searchsorted(self.grid, [hold.start for hold in self.holds])
        ends = [*begins[1:].tolist(), len(self.grid)]
        parts = list[Simulation]()
        bench: Bench | None = None
        for hold, error, begin, end in zip(self.holds, errors.tolist(), begins.tolist(), ends,
                                           strict=True):
            span = slice(begin - 1 if parts else 0, end)
            if end <= span.start + bool(parts):
                continue
            load = hold.boundary(error, parameters)
            if bench is None:
                bench = Bench(parameters, initial=at_rest(parameters, load), boundary=load)
            else:
                bench.pull_against(load)
            parts.append(bench.follow(self.grid[span], volts[span]))
        joined: dict[str, Any] = {
            name: np.concatenate([getattr(p, name)[min(k, 1):] for k, p in enumerate(parts)])
            for name in _HISTORIES}
        return replace(parts[0], final=parts[-1].final, **joined)

    def readings(self, simulation: Simulation) -> Array:
        """(b,) readings of the model's sensors, signal after signal."""
        of = {quantity: _history(quantity, simulation) for quantity in self.quantities}
        which = [(of[s.quantity], s.wire) for s in self.signals]
        return self._averages @ np.concatenate([own[:, wire % own.shape[1]] for own, wire in which])

    def predict(self, benches: Sequence[Parameters]) -> Array:
        """(b, p) readings of p benches."""
        return np.column_stack([self.readings(self.simulate(bench)) for bench in benches])

    def by_signal(self, readings: Array) -> list[Array]:
        """Readings (b,) in parts, one a signal."""
        return np.split(readings, np.cumsum([len(s.time) for s in self.signals])[:-1])

    @cached_property
    def _averages(self) -> csr_array:
        """(rows, signals n) from all signals on the grid to all bins, with delayed timestamps."""
        late = {q: _interpolation(self.grid, self.grid - s) for q, s in self.delays.items() if s}
        own = [s.average @ late[s.quantity] if s.quantity in late else s.average
               for s in self.signals]
        return csr_array(block_diag(own, "csr"))

    def history(self, signal: BinnedSignal, simulation: Simulation) -> Array:
        """(n,) of a signal on the grid; the conductance for a current."""
        histories = _history(signal.quantity, simulation)
        history = histories[:, signal.wire % histories.shape[1]]
        delay = self.delays.get(signal.quantity, 0.0)
        return np.interp(self.grid - delay, self.grid, history) if delay else history

    def rates(self, simulation: Simulation) -> list[Array]:
        """d/dt of each signal, bin by bin."""
        return [s.average @ np.gradient(self.history(s, simulation), self.grid)
                for s in self.signals]

    def phase_of(self, time: Array) -> NDArray[np.str_]:
        """`initial`, `drive` or `rest` at each time: before, during, and after driving."""
        driven = self.voltage.max(axis=1) > DRIVEN * max(float(self.voltage.max()), 1e-9)
        first = self.grid[np.argmax(driven)] if driven.any() else np.inf
        at = np.clip(np.searchsorted(self.grid, time, side="right") - 1, 0, len(self.grid) - 1)
        return np.where(time < first, "initial", np.where(driven[at], "drive", "rest"))

    def zeroed(self) -> "Observation":
        """Motions from their rest before the drive, to which a bench returns within 1.2 %."""
        signals = {s.name: s for s in self.signals}
        for name, zero in self.rests().items():
            value, sensor = signals[name].value, signals[name].sensor
            std = min(sensor.zero_std, RETURNS * float(np.ptp(value)))
            sensor = replace(sensor, zero_std=std)
            signals[name] = replace(signals[name], value=value - zero, sensor=sensor)
        return replace(self, signals=tuple(signals.values()))

    def rests(self) -> dict[str, float]:
        """Mean of each motion before the drive, by signal."""
        befores = {s.name: s.value[self.phase_of(s.time) == "initial"]
                   for s in self.signals if s.quantity in MOVED}
        return {name: float(np.mean(own)) for name, own in befores.items() if len(own) > _FEW}

    def less(self, zeros: Mapping[str, float]) -> "Observation":
        """With these zeros subtracted from its signals."""
        less = tuple(replace(s, value=s.value - zeros.get(s.name, 0.0)) for s in self.signals)
        return replace(self, signals=less, zeros=zeros) if zeros else self

    @property
    def strokes(self) -> int:
        driven = np.append(False, self.phase_of(self.grid) == "drive")
        return int(np.sum(driven[1:] & ~driven[:-1]))

    def between(self, start: float, stop: float) -> "Observation":
        """The same drive with signals from `start` to `stop` s only."""
        kept = ((s, np.flatnonzero((s.time >= start) & (s.time < stop))) for s in self.signals)
        return replace(self, signals=tuple(
            replace(s, time=s.time[k], value=s.value[k], count=s.count[k], average=s.average[k])
            for s, k in kept if len(k) > 1))


def _history(quantity: str, simulation: Simulation) -> Array:
    """(n, w) of every wire; (n, 1) of motions and forces."""
    if quantity == "deflection":
        return simulation.deflection_reading[:, np.newaxis]
    if quantity == "elongation":
        return -wire_length(simulation.parameters) * simulation.contraction[:, :1]
    if quantity == "force":
        return simulation.force.sum(axis=1)[:, np.newaxis]
    if quantity == "temperature":
        return simulation.temperature_reading
    return simulation.conductance


def shared_bin(records: Sequence[Record], parameters: Parameters, shortest: float = _BIN) -> float:
    """Shortest bin [s] that suits every signal of all records: a noise level holds for one bin."""
    measured = [m for record in records for m in find_rig(record, parameters).measured]
    return max([shortest, *(m.bin for m in measured)])


def observe(record: Record, parameters: Parameters, shortest_bin: float = _BIN,
            quantities: Collection[str] = QUANTITIES) -> Observation:
    """Prepare a record of the rig that the parameters describe, or of one wire with or without a
    load frame; `shortest_bin` [s]: from `shared_bin`. Raises InputError: no voltage of some
    channel, nothing to compare with, a load frame that holds neither a load nor the clamps."""
    rig = find_rig(record, parameters)
    # Times that are simulated: an even grid (n,), sparser where voltages have been held for long.
    start, stop = rig.start, rig.stop
    sampled = sum(len(measured.time) for measured in rig.measured)
    most = min(_MOST_CELLS + _CELLS_A_SAMPLE * sampled, _CELLS_LIMIT)
    cell = min(max(_CELL, (stop - start) / _MOST_CELLS), _LONG_CELL)
    cell = max(cell, (stop - start) / most)
    even = start + cell * np.arange(int(np.ceil((stop - start) / cell)) + 1.0)
    volts = np.column_stack([rig.voltage.at(k, even) for k in range(len(rig.voltage.channels))])
    changes = np.abs(np.diff(volts, axis=0, prepend=volts[:1])).max(axis=1)
    changed = changes > _HELD * max(float(volts.max()), 1e-9)
    last = np.maximum.accumulate(np.where(changed, even, -np.inf))
    first = np.minimum.accumulate(np.where(changed, even, np.inf)[::-1])[::-1]
    moving = (even - last < _SETTLED) | (first - even < _LONG_CELL)
    stride = max(1, round(_LONG_CELL / cell))
    even = even[moving | (np.arange(len(even)) % stride == 0) | (even == even[-1])]
    # Finer after a jump, exact at the samples about it, and finer between them if far apart.
    tau = time_constant(parameters)
    fine = np.arange(0.0, _FINE_SPAN, min(_FINE_CELL, max(tau / _CELLS, 2.0 * _NARROW)))
    loads = [hold.start for hold in rig.holds]
    early, late = rig.voltage.early, rig.voltage.late
    jumps = np.unique(np.concatenate([early, late, loads]))
    jumps = jumps[(jumps > start) & (jumps < even[-1])]
    after = np.add.outer(late, fine).ravel()
    within = [np.linspace(a, b, int((b - a) / _FINE_CELL) + 1)[1:-1]
              for a, b in zip(early, late, strict=True) if _FAR_APART[0] < b - a < _FAR_APART[1]]
    others = np.concatenate([even, after[(after > start) & (after < even[-1])], *within])
    around = np.concatenate([[-np.inf], jumps, [np.inf]])
    k = np.searchsorted(around, others)
    near = np.asarray(np.minimum(around[k] - others, others - around[k - 1]))
    near[others <= start] = np.inf
    grid = np.unique(np.concatenate([others[near > _NARROW], jumps]))
    grid = grid[np.insert(np.diff(grid) > _NARROW, 0, True) | np.isin(grid, jumps)]
    # Signals, from when a voltage or a warm wire at the beginning has no influence any more.
    known, skipped = list(rig.measured), 0.0
    level = np.array([c.voltage[0] for c in rig.voltage.channels])
    if np.max(np.abs(level)) > DRIVEN * max(np.max(c.voltage) for c in rig.voltage.channels):
        skipped = _HEATED * tau
    elif begins_warm(rig, parameters):
        skipped = _COOLED * tau
    if skipped:
        begin = start + skipped
        known = [m.where(m.time >= begin) for m in known if np.sum(m.time >= begin) > 1]
    if rig.moved is not None and "deflection" in quantities:  # an imposed motion shows in the force
        quantities = {*quantities, "force"}
    known = [m for m in known if m.quantity in quantities]
    signals = tuple(_binned(m, rig, grid, shortest_bin) for m in known)
    if not any(len(signal.value) for signal in signals):
        names = ", ".join(m.name for m in known or rig.measured)
        wrong = f"only {names}, expected {' or '.join(quantities)}"
        if known:
            wrong = f"too few samples of {names} to compare with a model"
        elif any(m.quantity in quantities for m in rig.measured):
            wrong = ("begins under voltage or warm, expected a rest first, or more than "
                     f"{skipped:.3g} s, after which a wire of the stated time constant has "
                     "forgotten its past")
        raise InputError(f"{record.path}: {wrong}")
    left_out = [m.name for m in rig.measured if m.quantity not in quantities]
    if moves_tip(parameters) and has_samples(record, "force"):  # of which wire is not known
        left_out.append("force")
    return Observation(str(record.path), rig.channels, rig.sides, grid,
                       rig.voltage.on_grid(grid, np.zeros(len(early))), rig.voltage, signals,
                       tuple(left_out), rig.holds,
                       None if rig.moved is None else np.interp(grid, *rig.moved),
                       ohms=rig.ohms, epoch=record.start_ns * 1e-9, skipped=skipped)


def observe_all(records: Sequence[Record], parameters: Parameters,
                quantities: Collection[str] = EVERYTHING) -> list[Observation]:
    """`observe` records of one bench in common bins; each is linked to the one before it."""
    shortest = shared_bin(records, parameters) if records else 0.0
    found = [observe(record, parameters, shortest, quantities) for record in records]
    ends = [one.epoch + one.grid[-1] for one in found]
    for k in np.argsort(ends).tolist():
        one = found[k]
        earlier = [i for i, end in enumerate(ends)
                   if one.epoch > 0.0 and end <= one.epoch + one.grid[0]
                   if found[i].channels == one.channels]
        if earlier:
            last = found[max(earlier, key=lambda i: ends[i])]
            found[k] = replace(one.less(last.zeros), before=replace(last, before=None))
        elif moves_tip(parameters):
            least = {s.name: _UNSET * s.sensor.zero_std for s in one.signals}  # if set to 0
            found[k] = one.less({n: off for n, off in one.rests().items() if abs(off) > least[n]})
    return found


def _binned(measured: Measured, rig: Rig, grid: Array, shortest: float) -> BinnedSignal:
    period = max(shortest, measured.bin)
    which = np.floor((measured.time - measured.time[0]) / period).astype(np.intp)
    _, which, count = np.unique(which, return_inverse=True, return_counts=True)
    # The mean of far fewer samples than usual scatters more than the others.
    full = (count >= _FULL * np.median(count))[which]
    measured = measured.where(full)
    time, value = measured.time, measured.values
    kept, which, count = np.unique(which[full], return_inverse=True, return_counts=True)
    bins, sensor = len(kept), SENSORS[measured.quantity]
    scatter, samples = noise_floor(value), float(np.median(count))
    root = math.sqrt(min(samples, _AVERAGED))
    error = max(sensor.least, _NOISE_FLOOR * float(np.ptp(value)) / root)
    noise = max(scatter / math.sqrt(samples), error)
    # Interpolation at the samples' times, then the mean over each bin.
    weight = 1.0 / count[which]
    if measured.quantity == "current":
        weight = weight * rig.voltage.at(measured.wire, time)
    mean = csr_array((weight, (which, np.arange(len(time)))), shape=(bins, len(time)))
    return BinnedSignal(measured.name, measured.quantity, measured.wire,
                        np.bincount(which, time, bins) / count,
                        np.bincount(which, value, bins) / count, count.astype(np.float64), period,
                        noise, max(scatter, error * root), mean @ _interpolation(grid, time),
                        sensor)


def _interpolation(grid: Array, time: Array) -> csr_array:
    """(m, n) from values on the grid (n,) to times (m,), as np.interp."""
    right = np.clip(np.searchsorted(grid, time), 1, len(grid) - 1)
    share = np.clip((time - grid[right - 1]) / (grid[right] - grid[right - 1]), 0.0, 1.0)
    rows = np.tile(np.arange(len(time)), 2)
    entries, columns = np.concatenate([1.0 - share, share]), np.concatenate([right - 1, right])
    return csr_array((entries, (rows, columns)), shape=(len(time), len(grid)))
