"""A record as the model sees it: the rig, what drives it, and every signal it can be held to."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sma_bench.errors import InputError
from sma_bench.identify.estimate import Array
from sma_bench.identify.signals import has_samples, samples
from sma_bench.identify.whole_model.applied_voltage import (
    AppliedVoltage,
    CourseError,
    applied_voltage,
)
from sma_bench.identify.whole_model.load_frame_drive import Hold, find_holds, wire_length
from sma_bench.parameters import Parameters
from sma_bench.physics import Boundary, Simulation, simulate
from sma_bench.physics.bending import wire_section
from sma_bench.records.record import Record

_CELL = (0.01, 0.05)
_MOST_CELLS = 4_000_000
_FEWEST_SAMPLES = 20
_MOST_SAMPLES = 25_000  # of one signal
_MARGIN = 0.3
_NARROWEST = 1e-6
# What a sensor may read at zero: a Hall sensor's offset, the zero of a distance or of a traverse.
_OFFSET_STD = {"current": 0.05, "deflection": 1e-3, "elongation": 1e-3}


@dataclass(frozen=True)
class Measured:
    """One signal to be explained.

    `quantity` is what it measures, `wire` the column of that wire; `offset_std` is how far its
    zero may be off, 0 where the sensor is taken at its word.
    """

    name: str
    quantity: str
    wire: int
    time: Array
    values: Array

    @property
    def offset_std(self) -> float:
        """Standard deviation of the unknown zero, in the signal's unit."""
        return _OFFSET_STD.get(self.quantity, 0.0)


@dataclass(frozen=True)
class InputErrors:
    """Possible errors of the voltages, and of what the load frame held (m or N, one a hold)."""

    voltage: tuple[CourseError, ...] | None
    holds: Array


@dataclass(frozen=True)
class RigRecord:
    """A record ready to be simulated.

    Attributes:
        record: where it comes from.
        channels, sides: the rig's.
        voltage: what was applied; grid: (n,) s of the simulation.
        holds: what the load frame did, empty for the composite and a bare wire.
        measured: signals to compare with.
    """

    record: Record
    channels: tuple[str, ...]
    sides: tuple[str, ...]
    voltage: AppliedVoltage
    grid: Array
    holds: tuple[Hold, ...]
    measured: tuple[Measured, ...]

    @property
    def bends(self) -> bool:
        """Whether it is a composite."""
        return len(self.channels) > 1

    @property
    def quantities(self) -> tuple[str, ...]:
        """What it measures, each once."""
        return tuple(dict.fromkeys(m.quantity for m in self.measured))

    @property
    def delayed(self) -> dict[str, float]:
        """Quantities that answer later than the voltage, with their sampling period [s]."""
        return {
            m.quantity: float(np.median(np.diff(m.time)))
            for m in self.measured
            if m.quantity != "current"
        }

    def predict(
        self,
        parameters: Parameters,
        place: Array,
        delays: Mapping[str, float],
        errors: InputErrors | None = None,
    ) -> list[Array]:
        """The model's reading of every measured signal, each on its own clock, without offsets.

        Args:
            parameters: of the model; the channels are this record's own.
            place: (e,) moments of the jumps between their samples.
            delays: s, by quantity, how far a sensor's stamps lie behind the voltage's.
            errors: of the inputs, added to what was measured.
        """
        own = parameters.replace(
            {"bench.channels": self.channels, "bench.channel_sides": self.sides}
        )
        volts = None if errors is None else errors.voltage
        grid = self._grid_with_jumps(place)
        parts = self._parts(own, grid, self.voltage.on_grid(grid, place, volts), errors)
        courses = {"temperature": np.concatenate([p.temperature for p in parts])}
        if self.bends:
            courses["deflection"] = parts[0].deflection[:, np.newaxis]
        elif self.holds:
            length = wire_length(own)
            courses["elongation"] = -length * np.concatenate([p.contraction for p in parts])
            courses["force"] = wire_section(own) * np.concatenate([p.stress for p in parts])
        resistance = float(own["wire.resistance"])
        return [
            self.voltage.at(m.wire, m.time, volts) / resistance
            if m.quantity == "current"
            else np.interp(m.time - delays[m.quantity], grid, courses[m.quantity][:, m.wire])
            for m in self.measured
        ]

    def draw_errors(self, random: np.random.Generator) -> InputErrors:
        """One possible error of the voltages."""
        return InputErrors(self.voltage.draw_errors(random), np.zeros(len(self.holds)))

    def hold_errors(self) -> list[InputErrors]:
        """One standard error of each held load in turn."""
        held = np.diag([hold.std for hold in self.holds])
        return [InputErrors(None, row) for row in held if row.any()]

    def _grid_with_jumps(self, place: Array) -> Array:
        """The courses turn at the jumps: straight lines between cells would miss that."""
        moments = self.voltage.moments(place)
        after = self.grid[np.searchsorted(self.grid, moments).clip(max=len(self.grid) - 1)]
        before = self.grid[np.searchsorted(self.grid, moments).clip(1) - 1]
        apart = (after - moments > _NARROWEST) & (moments - before > _NARROWEST)
        return np.sort(np.concatenate([self.grid, moments[apart]]))

    def _parts(
        self, parameters: Parameters, grid: Array, voltage: Array, errors: InputErrors | None
    ) -> list[Simulation]:
        if not self.holds:
            return [simulate(parameters, grid, voltage)]
        firsts = np.searchsorted(grid, [self.grid[hold.first] for hold in self.holds])
        lasts = [*firsts[1:].tolist(), len(grid)]
        values = np.array([hold.value for hold in self.holds])
        values = values if errors is None else values + errors.holds
        parts: list[Simulation] = []
        for hold, value, begin, end in zip(
            self.holds, values.tolist(), firsts.tolist(), lasts, strict=True
        ):
            # Each part begins where the last one ended, whose last sample is this one's first.
            span = slice(max(begin - 1, 0), end)
            part = simulate(
                parameters, grid[span], voltage[span],
                initial=parts[-1].final if parts else None,
                boundary=self._boundary(hold.clamped, value, parameters),
            )
            parts.append(part if not parts else _without_first(part))
        return parts

    def _boundary(self, clamped: bool, value: float, parameters: Parameters) -> Boundary:
        if clamped:
            return Boundary.clamped(-value / wire_length(parameters))
        return Boundary.held_stress(value / wire_section(parameters))


def rig_record(record: Record, parameters: Parameters) -> RigRecord:
    """Prepare a record of the composite rig, or of one wire with or without a load frame.

    Raises:
        InputError: voltages of some channel are absent, nothing measured to compare with, or a
            load frame that neither holds a load nor the clamps.
    """
    channels, sides = _rig(record, parameters)
    voltages = [samples(record, f"{channel}.voltage") for channel in channels]
    voltage = applied_voltage(voltages)
    grid = _grid([time for time, _ in voltages])
    holds = find_holds(record, grid) if len(channels) == 1 else ()
    found = (_without_jumps(m, voltage) for m in _measured(record, channels, holds))
    measured = tuple(_without_load_changes(m, holds, grid) for m in found)
    if not measured:
        raise InputError(
            f"{record.path}: only voltages, expected currents, temperatures or a deflection too"
        )
    return RigRecord(record, channels, sides, voltage, grid, holds, measured)


def _rig(record: Record, parameters: Parameters) -> tuple[tuple[str, ...], tuple[str, ...]]:
    driven = [c for c in record.channels if has_samples(record, f"{c}.voltage")]
    channels = tuple(parameters["bench.channels"])
    missing = [c for c in channels if c not in driven]
    if not missing:
        return channels, tuple(parameters["bench.channel_sides"])
    if len(driven) == len(record.channels) == 1:
        return (driven[0],), ("front",)
    held = ", ".join(driven) or "none"
    raise InputError(
        f"{record.path}: no voltage of channel {missing[0]}, the record has {held}; "
        "expected those of bench.channels"
    )


def _grid(times: Sequence[Array]) -> Array:
    period = min(float(np.median(np.diff(time))) for time in times)
    cell = float(np.clip(period, *_CELL))
    start = min(float(time[0]) for time in times)
    stop = max(float(time[-1]) for time in times)
    cell = max(cell, (stop - start) / _MOST_CELLS)
    cells = int(np.ceil((stop - start) / cell)) + 1
    return np.asarray(start + cell * np.arange(cells), dtype=np.float64)


def _measured(
    record: Record, channels: tuple[str, ...], holds: tuple[Hold, ...]
) -> list[Measured]:
    found = []
    for wire, channel in enumerate(channels):
        for quantity in ("current", "temperature"):
            name = f"{channel}.{quantity}"
            if has_samples(record, name):
                found.append(Measured(name, quantity, wire, *samples(record, name)))
    if len(channels) > 1:
        deflection = _deflection(record)
        if deflection is not None:
            found.append(deflection)
    elif holds:
        response = "force" if holds[0].clamped else "elongation"
        if has_samples(record, response):
            found.append(Measured(response, response, 0, *samples(record, response)))
    return [_thinned(m) for m in found if len(m.time) >= _FEWEST_SAMPLES]


def _thinned(measured: Measured) -> Measured:
    """Every so many samples of a long record: the parameters are few, the memory is not endless."""
    stride = -(-len(measured.time) // _MOST_SAMPLES)
    return replace(measured, time=measured.time[::stride], values=measured.values[::stride])


def _without_jumps(measured: Measured, voltage: AppliedVoltage) -> Measured:
    """A current read while the voltage jumps says nothing: only the jump's bounds are known."""
    if measured.quantity != "current":
        return measured
    settled = ~voltage.is_jumping(measured.time)
    return replace(measured, time=measured.time[settled], values=measured.values[settled])


def _without_load_changes(measured: Measured, holds: tuple[Hold, ...], grid: Array) -> Measured:
    """While the load changes the wire follows a force that is known too roughly."""
    if measured.quantity != "elongation":
        return measured
    known = np.ones(len(measured.time), dtype=bool)
    for hold in holds:
        if not hold.steady:
            start, stop = grid[hold.first] - _MARGIN, grid[hold.last - 1] + _MARGIN
            known &= (measured.time < start) | (measured.time > stop)
    return replace(measured, time=measured.time[known], values=measured.values[known])


def _deflection(record: Record) -> Measured | None:
    """The tip's position; without it, from the range sensors that look at it from both sides."""
    if has_samples(record, "deflection"):
        return Measured("deflection", "deflection", 0, *samples(record, "deflection"))
    sides = [s for s in ("front", "back") if has_samples(record, f"{s}.range")]
    if not sides:
        return None
    time = samples(record, f"{sides[0]}.range")[0]
    readings = {s: np.interp(time, *samples(record, f"{s}.range")) for s in sides}
    signed = [(-1.0 if side == "front" else 1.0) * readings[side] for side in sides]
    away: Array = np.asarray(np.mean(signed, axis=0), dtype=np.float64)
    return Measured("deflection", "deflection", 0, time, away - away[0])


def _without_first(part: Simulation) -> Simulation:
    histories = (
        "time", "voltage", "temperature", "martensite_fraction", "stress", "contraction",
        "bending", "temperature_reading",
    )
    started = part.started + float(part.time[1] - part.time[0])
    return replace(
        part, started=started, **{name: getattr(part, name)[1:] for name in histories}
    )
