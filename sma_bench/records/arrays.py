"""Records from arrays and tables in memory, and tables of records: what notebooks work with."""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sma_bench.errors import InputError
from sma_bench.findings import Finding
from sma_bench.records.contract import unit_of
from sma_bench.records.record import FloatArray, Record, Signal

TIME = "time"
_COMMAND = "voltage_command"
_COMMAND_COLUMN = re.compile(rf"{_COMMAND}\.(\d+)\Z")
_NAMES = (
    "<channel>.voltage, .current, .temperature, ambient.temperature, front.range, back.range, "
    "deflection, elongation, force or voltage_command"
)


_COLDEST_FRAME = 253.0  # K; what never gets warmer is no bench of SMA wires
_FARTHEST = 1.0  # m that one moves


def is_frame(thing: object) -> bool:
    """Whether something is a pandas DataFrame, found without importing pandas."""
    return all(hasattr(thing, name) for name in ("columns", "index", "to_numpy", "attrs"))


def record_from_arrays(columns: Mapping[str, Any], where: str = "arrays") -> Record:
    """A record of signals that are arrays in memory.

    Args:
        columns: contract name (`wire.voltage`) to values in SI units: (n,) on the shared clock
            `time`, (n,) s, or a pair (time, values) on a clock of its own. NaN is what was not
            measured and is left out, as from a bag. `voltage_command` is (n, k).
        where: the record's name in messages.

    Raises:
        InputError: a name that is none of the contract's, arrays that do not fit each other, times
            that do not increase, or nothing at all.
    """
    # The numbered columns of the command, put side by side.
    named = {name: given for name, given in columns.items() if name != TIME}
    found = [(int(n[1]), name) for name in named if (n := _COMMAND_COLUMN.match(str(name)))]
    if found:
        parts = [_floats(where, name, named.pop(name)) for _, name in sorted(found)]
        named[_COMMAND] = np.column_stack(parts)

    signals: dict[str, Signal] = {}
    findings = []
    for name, given in named.items():
        unit = unit_of(name)
        if unit is None:
            raise InputError(f"{where}: no signal is called {name!r}, expected {_NAMES}")
        own = isinstance(given, tuple) and len(given) == 2
        if not own and columns.get(TIME) is None:
            raise InputError(f"{where}: {name} without times, expected {TIME!r} or a pair")
        time, values = given if own else (columns[TIME], given)
        seconds, numbers = _floats(where, TIME, time), _floats(where, name, values)
        flat = 1 if name != _COMMAND else numbers.ndim
        if seconds.ndim != 1 or numbers.ndim != flat or len(numbers) != len(seconds):
            raise InputError(
                f"{where}: {name} has shape {numbers.shape} on times of shape {seconds.shape}, "
                "expected one value for each time"
            )
        missing: NDArray[np.bool_] = np.isnan(numbers if numbers.ndim == 1 else numbers[:, 0])
        seconds, numbers = seconds[~missing], numbers[~missing]
        backward = np.flatnonzero(~(np.diff(seconds) > 0.0))
        if backward.size or not np.isfinite(seconds).all():
            k = int(backward[0]) if backward.size else 0
            around = ", ".join(f"{t:g}" for t in seconds[k : k + 2])
            raise InputError(f"{where}: {name}: times {around} s, expected finite and increasing")
        span = f"{where}: {name}"
        if len(numbers):
            span += f" is {numbers.min():.4g} to {numbers.max():.4g}"
        if unit == "K" and len(numbers) and numbers.max() < _COLDEST_FRAME:
            raise InputError(f"{span}, expected kelvin; of Celsius add 273.15")
        if unit == "m" and len(numbers) and numbers.ndim == 1 and np.ptp(numbers) > _FARTHEST:
            raise InputError(f"{span}, expected m; of mm divide by 1000")
        if len(numbers):
            signals[name] = Signal(name, unit, seconds, numbers)
        else:
            findings.append(Finding("info", name, "NaN throughout, that is not measured; absent"))
    if not signals:
        raise InputError(f"{where}: no signals, expected {_NAMES}")
    return Record(Path(where), 0, signals, findings=tuple(findings))


def record_from_frame(frame: Any, where: str = "frame") -> Record:
    """A record of the columns of a pandas DataFrame, named as in `record_from_arrays`.

    Args:
        frame: times are its column `time`, else its index: seconds, time spans, or dates (the
            record then starts at the first of them).
        where: the record's name in messages.

    Raises:
        InputError: as `record_from_arrays`.
    """
    times = (frame[TIME] if TIME in frame.columns else frame.index).to_numpy()
    start_ns = 0
    if times.dtype == object:  # dates of a time zone
        times = (frame[TIME].array if TIME in frame.columns else frame.index).to_numpy(
            dtype="datetime64[ns]"
        )
    if times.dtype.kind in "mM" and len(times):
        nanoseconds = times.astype(f"{times.dtype.kind}8[ns]").astype(np.int64)
        if times.dtype.kind == "M":
            start_ns = int(nanoseconds.min())
        times = (nanoseconds - start_ns) / 1e9
    columns = {str(name): frame[name].to_numpy() for name in frame.columns if name != TIME}
    record = record_from_arrays({**columns, TIME: times}, where)
    return Record(record.path, start_ns, record.signals, findings=record.findings)


def frame_from_record(record: Record) -> Any:
    """The signals as columns of a pandas DataFrame; `attrs["units"]` has their units.

    The index is the union of all clocks, s since the record's start; where a signal has no sample
    there is NaN, so `record_from_frame` gives the same signals back. The columns of
    `voltage_command` are numbered.

    Raises:
        InputError: pandas is not installed.
    """
    pandas = require_pandas()
    columns: dict[str, Any] = {}
    units = {}
    for name, signal in record.signals.items():
        values = signal.values if signal.values.ndim > 1 else signal.values[:, np.newaxis]
        for k, column in enumerate(values.T):
            title = f"{name}.{k}" if signal.values.ndim > 1 else name
            columns[title] = pandas.Series(column, index=signal.time)
            units[title] = signal.unit
    frame = pandas.DataFrame(columns)
    frame.index.name = TIME
    frame.attrs["units"] = units
    return frame


def require_pandas() -> Any:
    """The module pandas, which is optional.

    Raises:
        InputError: it is not installed.
    """
    try:
        import pandas
    except ModuleNotFoundError:
        raise InputError(
            "pandas is not installed: pip install pandas (Ubuntu: apt install python3-pandas)"
        ) from None
    return pandas


def _floats(where: str, name: str, values: Any) -> FloatArray:
    try:
        return np.array(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(f"{where}: {name} does not hold numbers only") from None
