"""What a record holds of a rig: its wires, what drives and holds them, and everything measured."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sma_bench.arrays import Array
from sma_bench.errors import InputError
from sma_bench.estimation.load_frame import Hold, find_holds
from sma_bench.estimation.noise_model import noise_floor
from sma_bench.estimation.unknowns import LOADS
from sma_bench.estimation.voltage import AppliedVoltage, applied_voltage, commands_of
from sma_bench.parameters import Parameters
from sma_bench.parameters.parameters import load_kind
from sma_bench.physics.boundary import moves_tip
from sma_bench.records.record import (
    Record,
    has_samples,
    imposed_elongation,
    require_channels,
    samples,
    with_commands,
)

_MOST_BINS = 1500  # a signal
_SAMPLES_A_BIN = 2.0
_FEWEST_SAMPLES = 20
_ZERO_STD = 1e-4  # m, of where a testing machine's elongation is 0, by a careful hand
DRIVEN = 0.02  # of the largest voltage
# What readings change by at 0 V before the first drive where a bench has not settled: in their unit
# and of their range, more than noise explains; and K that a wire is warmer than the room.
_SETTLES = {"temperature": (2.0, 0.0), "deflection": (0.0, 0.02)}
_CLEAR, _WARM, _SOME = 10.0, 15.0, 5  # times the noise; K; samples
_AFTER = 0.1  # s that the last voltage is held for
_MARGIN = 0.3  # s about a change of load, in which the wire follows a force known too roughly


@dataclass(frozen=True)
class Measured:
    """Samples of one signal that a model can be held to; `wire` is the column of its wire."""

    name: str
    quantity: str
    wire: int
    time: Array
    values: Array

    def where(self, keep: NDArray[np.bool_]) -> "Measured":
        """Some of its samples."""
        return replace(self, time=self.time[keep], values=self.values[keep])

    @property
    def bin(self) -> float:
        """Shortest bin, in s, that suits it."""
        apart = float(np.median(np.diff(self.time)))
        return max(float(np.ptp(self.time)) / _MOST_BINS, _SAMPLES_A_BIN * apart)


@dataclass(frozen=True)
class Rig:
    """What a record holds of a rig: its wires, what drives them, and everything measured."""

    record: Record
    channels: tuple[str, ...]
    sides: tuple[str, ...]
    voltage: AppliedVoltage
    start: float
    stop: float
    holds: tuple[Hold, ...]
    measured: tuple[Measured, ...]
    ohms: float
    moved: tuple[Array, Array] | None  # s and m, of a testing machine


def find_rig(record: Record, parameters: Parameters) -> Rig:
    """The rig that a record is of. Raises InputError: as `observe`."""
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
        if len(time) < _FEWEST_SAMPLES:
            raise InputError(f"{record.path}: {len(time)} samples of elongation, too few to impose")
        # Ramps and holds are freed of their noise as those of a voltage; in tenths of the stroke.
        unit = 0.1 * float(np.ptp(metres)) or 1.0
        course = applied_voltage([(time, metres / unit)]).channels[0]
        moved = course.time, unit * course.voltage
        holds: tuple[Hold, ...] = (Hold(start, stop, True, 0.0, _ZERO_STD),)
    else:
        holds = find_holds(record, start, stop) if len(channels) == 1 and not moves else ()

    # What is measured. Of a record with one wire of a beam, or a bare one of the same alloy, the
    # tip is not asked.
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
        signed = [signs[side] * np.interp(time, *samples(record, f"{side}.range"))
                  for side in looking]
        away: Array = np.asarray(np.mean(signed, axis=0), dtype=np.float64)
        found.append(Measured("deflection", "deflection", 0, time, away - away[0]))

    # What is read when no voltage is any more cannot be compared. A current read while the voltage
    # jumps says nothing, as only the jump's bounds are known; nor does an elongation while the load
    # changes, as the wire follows a force known too roughly.
    measured = []
    for one in found:
        if len(one.time) < _FEWEST_SAMPLES:
            continue
        known = one.time < stop + _AFTER
        if one.quantity == "current":
            known &= ~voltage.is_jumping(one.time)
        elif one.quantity == "elongation":
            for hold in holds:
                if not hold.steady:
                    begin, end = hold.start - _MARGIN, hold.stop + _MARGIN
                    known &= (one.time < begin) | (one.time > end)
        measured.append(one.where(known))
    if not measured:
        raise InputError(
            f"{record.path}: only voltages, expected currents, temperatures or a deflection too")
    return Rig(record, channels, sides, voltage, start, stop, holds, tuple(measured), ohms, moved)


def begins_warm(rig: Rig, parameters: Parameters) -> bool:
    """Whether wires cool, or what they move still moves, when the record begins without voltage."""
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
        limit = max(absolute, share * np.ptp(one.values), _CLEAR * noise_floor(one.values))
        above = first - parameters["environment.ambient_temperature"]
        if abs(first - last) > limit or (one.quantity == "temperature" and above > _WARM):
            return True
    return False


def pulls_a_load(record: Record, parameters: Parameters) -> bool:
    """Whether wires move a load of their own: no beam, no clamps, no frame that measures it."""
    kind = load_kind(parameters)
    held = kind == "force" and has_samples(record, "force")
    return kind in LOADS and not held
