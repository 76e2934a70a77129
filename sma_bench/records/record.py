"""The record of one experiment: named signals with units, each on its own clock, and its drive."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from sma_bench.arrays import Array
from sma_bench.drawn import Drawn
from sma_bench.errors import InputError
from sma_bench.findings import Finding
from sma_bench.parameters import Parameters
from sma_bench.parameters.parameter import BY_NAME, SOURCES
from sma_bench.parameters.parameters import as_recorded, load_kind
from sma_bench.records.contract import CELSIUS_ZERO, unit_of

_LONGEST_LIST = 400  # characters, of names in one line
_SHORTEST_LAG = 0.1  # s; a shorter lag of a thermometer does not show
_LARGEST = 1e9  # in SI units; beyond any sensor, and the squares of much larger numbers overflow


@dataclass(frozen=True, repr=False)
class Signal:
    """One measured or commanded quantity."""

    name: str  # of the contract, for instance `wire.voltage`
    unit: str  # SI
    # (n,) s since the start of the record, strictly increasing when read from a bag
    time: Array
    values: Array  # (n,) or (n, k); a bag's missing values (NaN) are left out, not kept
    received: Array | None = None  # (n,) s, when the recorder got the message; same zero as `time`
    topic: str = ""  # where it came from, empty for a computed signal
    std: Array | None = None  # (n,) standard deviation stated with each reading

    def __post_init__(self) -> None:
        if self.time.ndim != 1 or len(self.values) != len(self.time):
            shapes = f"values of shape {self.values.shape} on times of shape {self.time.shape}"
            raise InputError(f"signal {self.name}: {shapes}, expected one value for each time")

    def __len__(self) -> int:
        return len(self.time)

    def __repr__(self) -> str:
        span = f", {self.time[0]:.4g} to {self.time[-1]:.4g} s" if len(self) else ""
        return f"<Signal {self.name} [{self.unit}]: {len(self)} samples{span}>"

    @property
    def period(self) -> float:
        """Median time between samples in s; NaN for fewer than two samples."""
        return float(np.median(np.diff(self.time))) if len(self) > 1 else float("nan")


@dataclass(frozen=True)
class Topic:
    """One topic of a bag, and the names of the signals made from it."""

    type: str
    count: int
    signals: tuple[str, ...] = ()


@dataclass(frozen=True, repr=False)
class Record(Drawn):
    """Everything read from one bag or table, or a simulation of it."""

    path: Path  # where it was read from
    start_ns: int  # ns since the epoch of t = 0, the first stamp
    signals: dict[str, Signal]  # by name; only those that were measured
    markers: tuple[tuple[float, str], ...] = ()  # (time in s, text) of the protocol steps, in order
    topics: dict[str, Topic] = field(default_factory=dict)  # every topic of the bag, decoded or not
    findings: tuple[Finding, ...] = ()  # what the reader noticed: losses, disorder, values left out

    def __repr__(self) -> str:
        names = ", ".join(sorted(self.signals)) or "no signals"
        return f"<Record {self.path}: {self.duration:.4g} s; {names[:_LONGEST_LIST]}>"

    def __getitem__(self, name: str) -> Signal:
        """The signal called `name`. Raises InputError: the record has no such signal."""
        if name not in self.signals:
            held = ", ".join(sorted(self.signals)) or "no signals"
            raise InputError(f"{self.path}: no signal {name!r}, the record has {held}")
        return self.signals[name]

    def get(self, name: str) -> Signal | None:
        return self.signals.get(name)

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the wires with a voltage, current or temperature, in alphabetical order."""
        split = (name.rpartition(".") for name in self.signals)
        found = {head for head, _, tail in split if tail in ("voltage", "current", "temperature")}
        return tuple(sorted(found - {"ambient"}))

    @property
    def duration(self) -> float:
        """Time of the last sample in s; 0 for a record without signals."""
        return max((float(s.time[-1]) for s in self.signals.values() if len(s)), default=0.0)


def require_distinct(records: Sequence[Record], hold_out: Sequence[Record] = ()) -> None:
    """InputError if two records have the same samples: a run counts once, no hold-out is fitted."""
    paths: dict[bytes, Path] = {}
    for index, record in enumerate((*records, *hold_out)):
        held = sha256()
        for name, signal in sorted(record.signals.items()):
            held.update(name.encode() + signal.time.tobytes() + signal.values.tobytes())
        if path := paths.get(held.digest()):
            text = "; give the run once"
            if index >= len(records):
                text = ", which is fitted too; a hold-out must be of a run that is not fitted"
            raise InputError(f"{record.path}: holds the samples of {path}{text}")
        if index < len(records):
            paths[held.digest()] = record.path


def samples(record: Record, name: str) -> tuple[Array, Array]:
    """Time (n,) s and values (n,) of a signal, sorted by time, without NaN, Inf and values beyond
    1e9. InputError: it is absent or has no finite value."""
    signal = record.get(name)
    if signal is None:
        raise InputError(f"{record.path}: no signal {name}")
    values = np.asarray(signal.values, dtype=np.float64)
    good = (np.abs(values) < _LARGEST) & np.isfinite(signal.time)
    if not good.any():
        raise InputError(f"{record.path}: {name} holds no finite value ({len(values)} samples)")
    time, values = np.asarray(signal.time, dtype=np.float64)[good], values[good]
    order = np.argsort(time, kind="stable")
    return time[order], values[order]


def has_samples(record: Record, name: str) -> bool:
    """True if the record has the signal, with at least one finite value."""
    signal = record.get(name)
    return signal is not None and bool((np.abs(signal.values) < _LARGEST).any())


def first_order_lag(values: Array, memory: float, start: float = 0.0) -> Array:
    """(n,) y[k] = memory * y[k-1] + (1 - memory) * values[k], from y[-1] = `start`."""
    from scipy.linalg import solve_banded
    forcing = (1.0 - memory) * values
    forcing[0] += memory * start
    bands = np.vstack([np.ones_like(values), np.full_like(values, -memory)])
    return np.asarray(solve_banded((1, 0), bands, forcing))


TIME, _COMMAND = "time", "voltage_command"
_COMMAND_COLUMN = re.compile(rf"{_COMMAND}\.(\d+)\Z")
SIGNALS = ("<channel>.voltage, .current, .temperature, ambient.temperature, front.range, "
          "back.range, deflection, elongation, force or voltage_command")
_COLDEST_MAXIMUM, _FARTHEST = 253.0, 1.0  # K, m: no bench stays colder, or moves farther


def record_from_arrays(columns: Mapping[str, Any], where: str = "arrays") -> Record:
    """A record from arrays by contract name (`wire.voltage`), in SI units: (n,) at the times of the
    column `time`, (n,) s, or a pair (time, values); `voltage_command` is (n, k). NaN is left out,
    as from a bag. `where`: the record's name. Raises InputError: a name outside the contract,
    shapes that do not match, times that do not increase, or no signal."""
    def floats(name: str, values: Any) -> Any:
        try:
            return np.array(values, dtype=np.float64)
        except (TypeError, ValueError):
            raise InputError(f"{where}: {name} does not hold numbers only") from None
    named = {name: given for name, given in columns.items() if name != TIME}
    found = [(int(n[1]), name) for name in named if (n := _COMMAND_COLUMN.match(str(name)))]
    if parts := [floats(name, named.pop(name)) for _, name in sorted(found)]:
        named[_COMMAND] = np.column_stack(parts)
    signals, findings = dict[str, Signal](), []
    for name, given in named.items():
        unit = unit_of(name)
        if unit is None:
            raise InputError(f"{where}: no signal is called {name!r}, expected {SIGNALS}")
        own = isinstance(given, tuple) and len(given) == 2
        if not own and columns.get(TIME) is None:
            raise InputError(f"{where}: {name} without times, expected {TIME!r} or a pair")
        time, values = given if own else (columns[TIME], given)
        seconds, numbers = floats(TIME, time), floats(name, values)
        flat = 1 if name != _COMMAND else numbers.ndim
        if seconds.ndim != 1 or numbers.ndim != flat or len(numbers) != len(seconds):
            raise InputError(f"{where}: {name} has shape {numbers.shape} on times of shape "
                             f"{seconds.shape}, expected one value for each time")
        missing = np.isnan(numbers if numbers.ndim == 1 else numbers[:, 0])
        seconds, numbers = seconds[~missing], numbers[~missing]
        backward = np.flatnonzero(~(np.diff(seconds) > 0.0))
        if backward.size or not np.isfinite(seconds).all():
            k = int(backward[0]) if backward.size else 0
            around = ", ".join(f"{t:g}" for t in seconds[k : k + 2])
            raise InputError(f"{where}: {name}: times {around} s, expected finite and increasing")
        if not len(numbers):
            findings.append(Finding("info", name, "NaN throughout: it was not measured"))
            continue
        span = f"{where}: {name} is {numbers.min():.4g} to {numbers.max():.4g}"
        if unit == "K" and numbers.max() < _COLDEST_MAXIMUM:
            raise InputError(f"{span}, expected kelvin; add 273.15 to Celsius")
        if unit == "m" and numbers.ndim == 1 and np.ptp(numbers) > _FARTHEST:
            raise InputError(f"{span}, expected m; divide mm by 1000")
        signals[name] = Signal(name, unit, seconds, numbers)
    if not signals:
        raise InputError(f"{where}: no signals, expected {SIGNALS}")
    return Record(Path(where), 0, signals, findings=tuple(findings))


def record_from_frame(frame: Any, where: str = "frame") -> Record:
    """A record from a pandas DataFrame, with the columns and errors of `record_from_arrays`. Times
    are its column `time`, else its index: s, time spans, or dates, the first of which becomes 0."""
    given = frame[TIME] if TIME in frame.columns else frame.index
    times, start_ns = given.to_numpy(), 0
    if times.dtype == object:  # dates with a time zone
        times = given.array.to_numpy(dtype="datetime64[ns]")
    if times.dtype.kind in "mM" and len(times):
        nanoseconds = times.astype(f"{times.dtype.kind}8[ns]").astype(np.int64)
        if times.dtype.kind == "M":
            start_ns = int(nanoseconds.min())
        times = (nanoseconds - start_ns) / 1e9
    columns = {str(name): frame[name].to_numpy() for name in frame.columns if name != TIME}
    return replace(record_from_arrays({**columns, TIME: times}, where), start_ns=start_ns)


def frame_from_record(record: Record) -> Any:
    """The signals as a DataFrame, `voltage_command` in numbered columns, units in `attrs["units"]`.
    Index: all times of all signals, s; NaN where one has no sample. InputError: no pandas."""
    pandas, columns, units = require_pandas(), dict[str, Any](), dict[str, str]()
    for name, signal in record.signals.items():
        is_wide = signal.values.ndim > 1
        for k, column in enumerate(signal.values.T if is_wide else [signal.values]):
            title = f"{name}.{k}" if is_wide else name
            columns[title] = pandas.Series(column, index=signal.time)
            units[title] = signal.unit
    frame = pandas.DataFrame(columns)
    frame.index.name, frame.attrs["units"] = TIME, units
    return frame


def require_pandas() -> Any:
    try:
        import pandas
    except ModuleNotFoundError:
        how = "pip install pandas (Ubuntu: apt install python3-pandas)"
        raise InputError(f"pandas is not installed: {how}") from None
    return pandas


def drive_of(record: Record,
             parameters: Parameters) -> tuple[Parameters, Array, Array, Array | None]:
    """What to simulate a record with: parameters of the bench, time (n,) s, volts (n, w) (for a
    source of current or power, see `with_commands`), and the imposed elongation (n,) m, None unless
    `load.kind` is displacement. InputError: the record lacks one of them."""
    record, ohms = with_commands(record, parameters)
    bench = parameters if ohms else as_recorded(parameters)
    time, volts = held_voltages(record, parameters["bench.channels"])
    if load_kind(parameters) != "displacement":
        return bench, time, volts, None
    moments, metres = imposed_elongation(record)
    both = np.union1d(time, moments[(moments > time[0]) & (moments < time[-1])])
    return bench, both, held_at(time, volts, both), np.interp(both, moments, metres)


def imposed_elongation(record: Record) -> tuple[Array, Array]:
    """Time (n,) s and elongation (n,) m of a testing machine. InputError: the record has none."""
    if not has_samples(record, "elongation"):
        text = "no elongation, expected the imposed one with load.kind displacement"
        raise InputError(f"{record.path}: {text}")
    return samples(record, "elongation")


def with_commands(record: Record, parameters: Parameters) -> tuple[Record, float]:
    """The record and 0; or, for a power source, or a current source without measured voltages, the
    record with V = ohms * current or V = sqrt(ohms * power) as its voltages, and these ohms."""
    drive = parameters["bench.drive"]
    is_measured = any(has_samples(record, f"{c}.voltage") for c in record.channels)
    if drive not in SOURCES or (is_measured and drive == "current"):
        return record, 0.0
    signals, ohms = dict(record.signals), ohms_of_source(parameters)
    for channel in (c for c in record.channels if f"{c}.current" in record.signals):
        own, volts = signals.pop(f"{channel}.current"), f"{channel}.voltage"
        values = ohms * own.values
        if drive == "power":
            if not has_samples(record, volts):
                continue
            values = np.interp(own.time, *samples(record, volts)) * own.values
            values = np.sqrt(np.maximum(values, 0.0) * ohms)
        signals[volts] = replace(own, name=volts, unit="V", values=values)
    return replace(record, signals=signals), ohms


def as_driven(record: Record, parameters: Parameters) -> Record:
    """The record; for a power source, with the voltages that stand for its power."""
    return with_commands(record, parameters)[0] if parameters["bench.drive"] == "power" else record


def as_calibrated(record: Record, parameters: Parameters) -> Record:
    """The record with its readings corrected by the sensors' gains, offsets and spot share."""
    corrected = {}
    for name, signal in record.signals.items():
        quantity = name.rpartition(".")[2]
        if f"sensor.{quantity}.gain" not in BY_NAME or name.startswith("ambient."):
            continue
        gain, offset = (parameters[f"sensor.{quantity}.{k}"] for k in ("gain", "offset"))
        share, zero, room = 1.0, 0.0, 0.0
        if quantity == "temperature":
            share, zero = parameters["sensor.temperature.spot_share"], CELSIUS_ZERO
            room = parameters["environment.ambient_temperature"]
        if (gain, offset, share) != (1.0, 0.0, 1.0):
            values = gain * (signal.values - zero) + offset + zero
            corrected[name] = replace(signal, values=room + (values - room) / share)
    return replace(record, signals={**record.signals, **corrected}) if corrected else record


def with_stated_lag(parameters: Parameters) -> Parameters:
    """Parameters with a thermometer's stated lag, if it is long enough to show, as an effect."""
    stated, number = "sensor.temperature.lag", "effect.temperature_lag.time_constant"
    if parameters[stated] < _SHORTEST_LAG or parameters[number]:
        return parameters
    std = parameters.given_uncertainty.get(stated)
    return parameters.replace({number: parameters[stated]}, {} if std is None else {number: std})


def ohms_of_source(parameters: Parameters) -> float:
    """Resistance of a channel by which a source's commands become volts, see `with_commands`."""
    return float(parameters["wire.resistance"]) / float(parameters["wire.count"])


def held_voltages(record: Record, channels: Sequence[str]) -> tuple[Array, Array]:
    """Time (n,) s, all stamps of `channels`, and (n, w) V, each held until its next sample.
    InputError: the record lacks the voltage of a channel."""
    driven = [c for c in record.channels if f"{c}.voltage" in record.signals]
    require_channels(record, channels, driven)
    signals = [record[f"{channel}.voltage"] for channel in channels]
    time = np.unique(np.concatenate([signal.time for signal in signals]))
    return time, np.stack([held_at(s.time, s.values, time) for s in signals], axis=1)


def held_at(time: Array, values: Array, at: Array) -> Array:
    """Values, (n,) or (n, w) at times (n,) s, at other times (m,) s: each held until the next."""
    return values[np.maximum(np.searchsorted(time, at, side="right") - 1, 0)]


def require_channels(record: Record, channels: Sequence[str], driven: Sequence[str]) -> None:
    """InputError if a channel of the parameters is not among the record's `driven` channels."""
    for missing in (channel for channel in channels if channel not in driven):
        own, theirs = ", ".join(channels), ", ".join(driven) or "no channel"
        text = f"the parameters have the channels {own}, the record has voltages of {theirs}"
        fitting = {1: "wire", 4: "composite"}.get(len(driven))
        if fitting and len(driven) != len(channels):
            text += f"; expected parameters such as config/{fitting}_rig.yaml"
        raise InputError(f"{record.path}: no voltage of channel {missing}: {text}")
