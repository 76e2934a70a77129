"""The rig in a record: its wires, their voltages and loads, and all measured signals."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sma_bench.arrays import Array
from sma_bench.errors import InputError
from sma_bench.estimation import noise_model
from sma_bench.estimation.unknowns import LOADS
from sma_bench.estimation.voltage import (
    FEWEST_SAMPLES,
    AppliedVoltage,
    VoltageSegment,
    applied_voltage,
    commands_of,
    find_segments,
)
from sma_bench.parameters import Parameters
from sma_bench.parameters.parameters import load_kind, wire_length
from sma_bench.physics import Boundary
from sma_bench.physics.bending import channel_section
from sma_bench.physics.boundary import moves_tip
from sma_bench.records.record import (
    Record,
    has_samples,
    imposed_elongation,
    require_channels,
    samples,
    with_commands,
)

_MOST_BINS = 1500  # per signal
_SAMPLES_A_BIN = 2.0  # at least
_ZERO_STD = 1e-4  # m, of a testing machine's zero that was set with care
DRIVEN = 0.02  # of the largest voltage: a wire with less is not driven
# Changes of readings at 0 V before the first drive that show that a bench has not settled: in their
# unit, and as a share of their range; they must exceed _CLEAR times the noise.
_SETTLES = {"temperature": (2.0, 0.0), "deflection": (0.0, 0.02)}
_CLEAR, _WARM, _SOME = 10.0, 15.0, 5  # times; K above the room; samples of a median
_AFTER = 0.1  # s that the last voltage is held for
_MARGIN = 0.3  # s about a change of load, where the force is known too roughly
# Signals of a load frame, which holds a load or clamps the wire.
LOAD_FRAME = ("elongation", "force")
_MOSTLY = 0.7  # of a record, for which loads are held
_PULL, _SHORTEST_PULL = 0.5, 5.0  # of the range of the force; s
_SHORTEST_HOLD, _RAMP_PIECE = 2.0, 0.25  # s, of a held load; of the pieces of a changing one
_NARROW = 1e-3  # s
_STILL = 1.5  # times its noise: a constant elongation scatters less


@dataclass(frozen=True)
class Hold:
    """A boundary of a load frame, from `start` s to the next one: `value` is the force [N] held, or
    the elongation [m] where `clamped`, `std` its error; `steady` is False for the short pieces by
    which a changing load is followed."""

    start: float
    stop: float
    clamped: bool
    value: float
    std: float
    steady: bool = True

    def boundary(self, error: float, parameters: Parameters) -> Boundary:
        """What the wire pulls against, `error` (m or N) off."""
        if self.clamped:
            return Boundary.clamped(-(self.value + error) / wire_length(parameters))
        return Boundary.held_stress((self.value + error) / channel_section(parameters))


@dataclass(frozen=True)
class Measured:
    """Samples of one signal to compare with a model; `wire` is the column of its wire."""

    name: str
    quantity: str
    wire: int
    time: Array
    values: Array

    def where(self, keep: NDArray[np.bool_]) -> "Measured":
        return replace(self, time=self.time[keep], values=self.values[keep])

    @property
    def bin(self) -> float:
        """Shortest bin, in s, that suits it."""
        apart = float(np.median(np.diff(self.time)))
        return max(float(np.ptp(self.time)) / _MOST_BINS, _SAMPLES_A_BIN * apart)


@dataclass(frozen=True)
class Rig:
    """Wires, their voltages and loads, and all measured signals."""

    channels: tuple[str, ...]
    sides: tuple[str, ...]
    voltage: AppliedVoltage
    start: float
    stop: float
    holds: tuple[Hold, ...]
    measured: tuple[Measured, ...]
    ohms: float
    moved: tuple[Array, Array] | None  # s and m, elongation by a testing machine


def find_rig(record: Record, parameters: Parameters) -> Rig:
    """Find the rig in a record. Raises InputError: as `observe`."""
    # Its wires: those of the bench, or the only one that the record has.
    record, ohms = with_commands(record, parameters)
    driven = [c for c in record.channels if has_samples(record, f"{c}.voltage")]
    channels, sides = tuple(parameters["bench.channels"]), tuple(parameters["bench.channel_sides"])
    if set(channels).difference(driven) and len(driven) == len(record.channels) == 1:
        channels, sides = (driven[0],), ("front",)
    else:
        require_channels(record, channels, driven)
    voltages = [samples(record, f"{channel}.voltage") for channel in channels]
    commands = commands_of(record, channels, tuple(parameters["bench.channels"]))
    voltage = applied_voltage(voltages, commands)
    start = min(float(time[0]) for time, _ in voltages)
    stop = max(float(time[-1]) for time, _ in voltages)
    moves, moved = pulls_a_load(record, parameters), None
    if load_kind(parameters) == "displacement":
        time, metres = imposed_elongation(record)
        if len(time) < FEWEST_SAMPLES:
            raise InputError(f"{record.path}: {len(time)} samples of elongation, too few to impose")
        # Noise is removed from ramps and holds as from those of a voltage; in tenths of the stroke.
        unit = 0.1 * float(np.ptp(metres)) or 1.0
        polygon = applied_voltage([(time, metres / unit)]).channels[0]
        moved = polygon.time, unit * polygon.voltage
        holds: tuple[Hold, ...] = (Hold(start, stop, True, 0.0, _ZERO_STD),)
    else:
        holds = find_holds(record, start, stop) if len(channels) == 1 and not moves else ()
    # Measured signals; the tip of a beam only if the record has all its wires.
    wanted = [(f"{channel}.{quantity}", quantity, wire)
              for wire, channel in enumerate(channels) for quantity in ("current", "temperature")]
    tip = moves_tip(parameters) and channels == tuple(parameters["bench.channels"])
    if tip:
        wanted.append(("deflection", "deflection", 0))
    elif moves:
        wanted += [("elongation", "deflection", 0), ("force", "force", 0)]
    elif holds:
        response = "force" if holds[0].clamped else "elongation"
        wanted.append((response, response, 0))
    found = [Measured("deflection" if quantity == "deflection" else signal, quantity, wire,
                      *samples(record, signal))
             for signal, quantity, wire in wanted if has_samples(record, signal)]
    looking = [s for s in ("front", "back") if has_samples(record, f"{s}.range")]
    if tip and looking and not has_samples(record, "deflection"):
        # The tip's position from the range sensors that look at it from both sides.
        time = samples(record, f"{looking[0]}.range")[0]
        signs = {"front": -1.0, "back": 1.0}
        away: Array = np.mean([signs[side] * np.interp(time, *samples(record, f"{side}.range"))
                               for side in looking], axis=0)
        found.append(Measured("deflection", "deflection", 0, time, away - away[0]))
    # Left out: readings after the last voltage, currents while the voltage jumps (the moment is
    # known only within bounds), and elongations while the load changes (`_MARGIN`).
    measured = []
    for one in found:
        if len(one.time) < FEWEST_SAMPLES:
            continue
        known = one.time < stop + _AFTER
        if one.quantity == "current":
            known &= ~voltage.is_jumping(one.time)
        elif one.quantity == "elongation":
            for hold in (hold for hold in holds if not hold.steady):
                begin, end = hold.start - _MARGIN, hold.stop + _MARGIN
                known &= (one.time < begin) | (one.time > end)
        measured.append(one.where(known))
    if not measured:
        raise InputError(
            f"{record.path}: only voltages, expected currents, temperatures or a deflection too")
    return Rig(channels, sides, voltage, start, stop, holds, tuple(measured), ohms, moved)


def begins_warm(rig: Rig, parameters: Parameters) -> bool:
    """True if wires still cool, or their load still moves, before the first voltage of a record."""
    channels = rig.voltage.channels
    least = DRIVEN * max(float(np.max(np.abs(c.voltage))) for c in channels)
    # Until the last reading without voltage, of which a slow logger has few.
    driven = [(c.time, np.abs(c.voltage) > least) for c in channels]
    begins = [float(time[max(int(np.argmax(on)) - 1, 0)]) for time, on in driven if on.any()]
    first_drive = min(begins, default=rig.stop)
    for one in rig.measured:
        rest = one.values[one.time < first_drive]
        some = min(_SOME, len(rest) // 2)
        if one.quantity not in _SETTLES or some == 0:
            continue
        first, last = float(np.median(rest[:some])), float(np.median(rest[-some:]))
        absolute, share = _SETTLES[one.quantity]
        clear = _CLEAR * noise_model.noise_floor(one.values)
        limit = max(absolute, share * np.ptp(one.values), clear)
        above = first - parameters["environment.ambient_temperature"]
        if abs(first - last) > limit or (one.quantity == "temperature" and above > _WARM):
            return True
    return False


def pulls_a_load(record: Record, parameters: Parameters) -> bool:
    """True if wires move a load: no beam, no clamps, no weight whose force is measured."""
    kind = load_kind(parameters)
    return kind in LOADS and not (kind == "force" and has_samples(record, "force"))


def has_load_frame(record: Record) -> bool:
    return any(has_samples(record, name) for name in LOAD_FRAME)


def is_clamped(record: Record) -> bool:
    """True if the length is held: the elongation is constant, or was not measured."""
    if not has_samples(record, "elongation"):
        return True
    elongation = samples(record, "elongation")[1]
    noise = noise_model.white_noise_level(elongation)
    return float(np.std(elongation)) <= max(_STILL * noise, 1e-9)


def find_holds(record: Record, start: float, stop: float) -> tuple[Hold, ...]:
    """The clamped length, or held loads, from `start` to `stop` s: plateaus of force, between which
    the force is followed in short pieces. Raises InputError: neither."""
    if not has_load_frame(record):
        return ()
    if is_clamped(record):
        held = has_samples(record, "elongation")
        mean = _mean(samples(record, "elongation")[1]) if held else (0.0, 0.0)
        return (Hold(start, stop, True, *mean),)
    if not has_samples(record, "force"):
        raise InputError(f"{record.path}: elongation without force, expected one, or load.kind")
    time, force = samples(record, "force")
    plateaus, held_for = _plateaus(record)
    if held_for < _MOSTLY * (time[-1] - time[0]):
        raise InputError(f"{record.path}: the force is held for {held_for:.0f} of "
                         f"{time[-1] - time[0]:.0f} s and the elongation not at all, expected held "
                         "loads or a clamped wire")
    holds, here = list[Hold](), start
    for plateau in plateaus:
        first, last = max(plateau.start, here), min(plateau.stop, stop)
        inside = (time >= plateau.start) & (time <= plateau.stop)
        holds += _short_holds(time, force, here, first)
        holds.append(Hold(first, last, False, *_mean(force[inside])))
        here = last
    return (*holds, *_short_holds(time, force, here, stop))


def _plateaus(record: Record) -> tuple[list[VoltageSegment], float]:
    """Where the force is held, and for how long in all (s)."""
    every = find_segments(*samples(record, "force")).plateaus
    found = [plateau for plateau in every if plateau.duration >= _SHORTEST_HOLD]
    return found, sum(plateau.duration for plateau in found)


def find_pulls(record: Record) -> tuple[tuple[float, float], ...]:
    """Start and stop [s] of even pulls of a load frame; none if it mostly holds load or length."""
    if is_clamped(record) or not has_samples(record, "force"):
        return ()
    time, force = samples(record, "force")
    if len(time) < FEWEST_SAMPLES or _plateaus(record)[1] >= _MOSTLY * (time[-1] - time[0]):
        return ()
    least = _PULL * float(np.ptp(force))
    return tuple((ramp.start, ramp.stop) for ramp in find_segments(time, force).ramps
                 if ramp.voltage_stop - ramp.voltage_start > least
                 and ramp.duration >= _SHORTEST_PULL)


def _mean(values: Array) -> tuple[float, float]:
    """Mean and its standard error, which counts autocorrelated noise."""
    centred = values - values.mean()
    factor = noise_model.inflation([centred])
    return float(values.mean()), float(np.std(centred) * np.sqrt(factor / len(values)))


def _short_holds(time: Array, force: Array, start: float, stop: float) -> list[Hold]:
    """Holds so short that each has one force; a single one where the force was not measured."""
    if stop - start < _NARROW:
        return []
    edges = np.linspace(start, stop, int(np.ceil((stop - start) / _RAMP_PIECE)) + 1)
    measured = np.diff(np.searchsorted(time, edges)) > 0
    edges = edges[np.append(True, measured) | np.append(measured, True)]
    pieces = []
    for first, last in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        middle = 0.5 * (first + last)
        near = np.abs(time - middle) <= 0.5 * _RAMP_PIECE
        value = float(np.mean(force[near])) if near.any() else float(np.interp(middle, time, force))
        pieces.append(Hold(first, last, False, value, 0.0, steady=False))
    return pieces
