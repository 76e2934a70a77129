"""From columns of another logger to signals of the contract: the map, proposed, read and applied.

A map says for each signal which column it is, in which unit, on which clock, and how its zero and
sign are to be read. `propose` makes one from titles, units and ranges, with a question wherever
these leave room; `convert` follows it.
"""

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from sma_bench.border import printable, read_yaml
from sma_bench.errors import InputError
from sma_bench.records import contract
from sma_bench.records.record import FloatArray, Signal
from sma_bench.records.table_cells import Column, Unit, parse_unit
from sma_bench.records.tables import TableFile

ASK = "ask"
FORMS = ("rms", "duty", "mean")
REST, NONE = "rest", "none"
POSITIONS = ("elongation", "deflection")
_OF_UNIT = {"V": "voltage", "A": "current", "K": "temperature", "m": "length", "N": "force"}
NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,40}(\.[a-z]+)?\Z")
_DRIVEN = 0.02  # of the largest voltage: below it nothing is driven
DUTY_SLACK = 0.02  # beyond 0 to 1 that a duty may be read


@dataclass(frozen=True)
class Entry:
    """How one signal comes from a column: sign * (scale * column in its unit + offset) - reference.

    Attributes:
        signal: of the contract; column: as the file has it; unit: of the column.
        clock: the column of its time.
        scale, offset: before and after the unit; the offset is in SI. sign: 1 or -1.
        reference: "rest" (the median before the first drive is 0), "none", or a number in SI.
        form: of a voltage: "rms" (or direct), "duty" or "mean" of a switched supply.
    """

    signal: str
    column: str
    unit: str
    clock: str
    scale: float = 1.0
    offset: float = 0.0
    sign: int | str = 1
    reference: str | float = NONE
    form: str = "rms"


@dataclass(frozen=True)
class ImportMap:
    """Clocks (column -> unit), signals, and what the bench supplies."""

    clocks: dict[str, str]
    entries: tuple[Entry, ...]
    supply_voltage: float | str | None = None
    lever: float | str | None = None
    ignored: tuple[str, ...] = ()


# --- the map as a file ----------------------------------------------------------------------------


def map_text(made: ImportMap, table: TableFile, remarks: Mapping[str, str]) -> str:
    """The map as commented YAML."""
    name = printable(table.path.name)
    lines = [
        f"# Map of {name} ({table.format}), for sma-bench import --map; `ask` is to be filled in.",
        "# SI value = sign * (scale * column in its unit + offset) - reference",
        "# reference: rest (0 before the first drive), none, or a number; form of a voltage: rms",
        "# (or direct), duty or mean of the switched supply.",
        "time:",
    ]
    for column, unit in made.clocks.items():
        lines.append(f"  {_yaml(column)}: {_yaml(unit)}{_comment(remarks.get(column))}")
    for key in ("supply_voltage", "lever"):
        if (value := getattr(made, key)) is not None:
            lines.append(f"{key}: {_yaml(value)}{_comment(remarks.get(key))}")
    lines.append(f"signals:{_comment(remarks.get('signals'))}")
    columns = {column.name: column for column in table.columns}
    for entry in made.entries:
        values = columns[entry.column].values
        span = f"{np.nanmin(values):.6g} to {np.nanmax(values):.6g}"
        remark = f"{span}; {remarks[entry.column]}" if entry.column in remarks else span
        lines += [f"  - signal: {_yaml(entry.signal)}", f"    {_comment(remark).strip()}"]
        for option in fields(Entry)[1:]:
            value = getattr(entry, option.name)
            if option.name == "form" and not entry.signal.endswith("voltage"):
                continue
            lines.append(f"    {option.name}: {_yaml(value)}")
    lines.append("ignored:")
    lines += [f"  - {_yaml(c)}{_comment(remarks.get(c))}" for c in made.ignored]
    if not made.ignored:
        lines[-1] += " []"
    return "\n".join(lines) + "\n"


def _yaml(value: Any) -> str:
    return json.dumps(value, ensure_ascii=False) if isinstance(value, str) else f"{value!r}"


def _comment(text: str | None) -> str:
    return f"  # {printable(text)}" if text else ""


def read_map(path: str | Path) -> ImportMap:
    """The map of a file, checked.

    Raises:
        InputError: unreadable, or with a key or value that a map does not have; what is still to
            be filled in is named.
    """
    document = read_yaml(path)
    known = {"time", "supply_voltage", "lever", "signals", "ignored"}
    if not isinstance(document, dict) or set(document) - known:
        raise InputError(f"{path}: not a map: expected {', '.join(sorted(known))}")
    clocks, rows = document.get("time"), document.get("signals")
    if not isinstance(clocks, dict) or not all(
        isinstance(text, str) for pair in clocks.items() for text in pair
    ):
        raise InputError(f"{path}: time: expected columns and their units")
    if not isinstance(rows, list) or not rows:
        raise InputError(f"{path}: signals: expected a list with one or more")
    for column, unit in clocks.items():
        _require_unit(unit, "time", f"{path}: time: {column}")
    entries = tuple(_read_entry(row, f"{path}: signals: {k + 1}") for k, row in enumerate(rows))
    numbers = {key: _read_number(document.get(key), f"{path}: {key}")
               for key in ("supply_voltage", "lever")}  # fmt: skip
    for entry in entries:
        if entry.clock not in clocks:
            raise InputError(f"{path}: {entry.signal}: clock {entry.clock!r} is not under time")
        if entry.form != "rms" and numbers["supply_voltage"] is None:
            raise InputError(f"{path}: supply_voltage is missing, {entry.signal} is a {entry.form}")
    return ImportMap(clocks, entries, numbers["supply_voltage"], numbers["lever"])


def _read_number(value: Any, where: str) -> float | None:
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0 < value < np.inf:
        raise InputError(f"{where} is {printable(str(value))[:40]!r}, expected a number > 0")
    return float(value)


def _read_entry(row: Any, where: str) -> Entry:
    names = [key.name for key in fields(Entry)]
    if not isinstance(row, dict) or set(row) - set(names) or not set(names[:4]) <= set(row):
        raise InputError(f"{where}: expected {', '.join(names[:4])} and of {', '.join(names[4:])}")
    for key in names[:4]:
        if not isinstance(row[key], str):
            raise InputError(f"{where}: {key}: expected a text")
    for key in ("scale", "offset"):
        value = row.get(key, 0.0)
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not np.isfinite(value):
            raise InputError(f"{where}: {key}: expected a number")
    entry = Entry(**row)
    where = f"{where} ({printable(entry.signal)})"
    unit = contract.unit_of(entry.signal) if NAME.match(entry.signal) else None
    if unit not in _OF_UNIT or entry.signal == "voltage_command":
        raise InputError(
            f"{where}: signal is {printable(entry.signal)!r}, expected a name such as wire.voltage"
        )
    if entry.sign not in (1, -1) or isinstance(entry.sign, bool):
        raise InputError(f"{where}: sign is {entry.sign!r}, expected 1 or -1")
    if entry.form not in FORMS:
        raise InputError(f"{where}: form is {entry.form!r}, expected one of {', '.join(FORMS)}")
    is_number = isinstance(entry.reference, (int, float)) and np.isfinite(entry.reference)
    if entry.reference not in (REST, NONE) and not is_number:
        found = printable(str(entry.reference))[:40]
        raise InputError(f"{where}: reference is {found!r}, expected rest, none or a number")
    wanted = "ratio" if entry.form == "duty" else _OF_UNIT[unit]
    _require_unit(entry.unit, wanted, where)
    return entry


def _require_unit(text: str, quantity: str, where: str) -> None:
    unit = parse_unit(text)
    fits = unit is not None and (
        unit.quantity == quantity or (unit.quantity == "angle" and quantity == "length")
    )
    if not fits:
        raise InputError(f"{where}: unit is {printable(text)!r}, expected a unit of {quantity}")


# --- applying it ----------------------------------------------------------------------------------


def convert(table: TableFile, made: ImportMap) -> tuple[list[Signal], list[str], int]:
    """Signals in SI from a table by its map, a sentence on each, and the epoch time of 0 in ns.

    Clocks keep their offsets to each other; the first sample of all is at 0.

    Raises:
        InputError: a column that the file does not have, a clock that goes back, a duty that is
            none, or no value at all.
    """
    columns = {column.name: column for column in table.columns}
    for name in (*made.clocks, *(entry.column for entry in made.entries)):
        if name not in columns:
            have = ", ".join(list(columns)[:12])
            raise InputError(f"{table.path}: no column {name!r}, it has {have}")
    raw = [_samples(table, made, columns, entry) for entry in made.entries]
    first = min(float(time[0]) for time, _ in raw)
    drive = _drive_start(made, raw)
    signals, sentences = [], []
    for entry, (time, values) in zip(made.entries, raw, strict=True):
        values, said = _referred(entry, time, values, drive)
        signals.append(Signal(entry.signal, contract.unit_of(entry.signal) or "", time - first,
                              values))  # fmt: skip
        sentences.append(_sentence(entry, made, said))
    start = next((columns[n].start for n in made.clocks if columns[n].start is not None), None)
    return signals, sentences, 0 if start is None else round(start * 1e9)


def _samples(
    table: TableFile, made: ImportMap, columns: Mapping[str, Column], entry: Entry
) -> tuple[FloatArray, FloatArray]:
    """Times in s and values in SI of one entry, without what is missing; the sign is in them."""
    clock, column = columns[entry.clock], columns[entry.column]
    where = f"{table.path}: {entry.column}"
    if len(clock.values) != len(column.values):
        raise InputError(
            f"{where}: {len(column.values)} rows, its clock {entry.clock!r} has {len(clock.values)}"
        )
    ticks = parse_unit(made.clocks[entry.clock])
    unit = parse_unit(entry.unit)
    assert ticks and unit
    kept = np.isfinite(clock.values) & np.isfinite(column.values)
    time = in_si(clock.values[kept], ticks)
    values = in_si(entry.scale * column.values[kept], unit) + entry.offset
    if not len(time):
        raise InputError(f"{where}: no values, expected a column of numbers")
    steps = np.diff(time)
    if np.any(steps < 0):
        row = int(np.argmax(steps < 0)) + 1
        raise InputError(
            f"{where}: its time goes back from {time[row - 1]:.9g} to {time[row]:.9g} s in row "
            f"{row + 1} of the numbers, expected one run"
        )
    fresh = np.concatenate([[True], steps > 0])
    time, values = time[fresh], values[fresh]
    if entry.form in ("duty", "mean"):
        values = _equivalent(entry, values, made.supply_voltage, where)
    if unit.quantity == "angle":
        if not isinstance(made.lever, float):
            raise InputError(f"{where}: an angle needs lever (load.lever, m/rad) in the map")
        values = values * made.lever
    return time, values * float(entry.sign)


def in_si(values: FloatArray, unit: Unit) -> FloatArray:
    return values * unit.factor + unit.offset


def _equivalent(entry: Entry, values: FloatArray, supply: Any, where: str) -> FloatArray:
    """The direct voltage of the same heat: heat goes with duty * supply^2."""
    if not isinstance(supply, float):
        raise InputError(f"{where}: a {entry.form} needs supply_voltage in the map")
    duty = values / supply if entry.form == "mean" else values
    low, high = float(duty.min()), float(duty.max())
    if low < -DUTY_SLACK or high > 1.0 + DUTY_SLACK:
        raise InputError(f"{where}: duty of {low:.4g} to {high:.4g}, expected 0 to 1")
    return np.sqrt(np.clip(duty, 0.0, 1.0)) * supply


def _drive_start(made: ImportMap, raw: Sequence[tuple[FloatArray, FloatArray]]) -> float:
    """When the first voltage or current sets in; inf where none does."""
    starts = [np.inf]
    for entry, (time, values) in zip(made.entries, raw, strict=True):
        if entry.signal.endswith((".voltage", ".current")):
            driven = np.abs(values) > _DRIVEN * np.abs(values).max()
            if driven.any():
                starts.append(float(time[int(np.argmax(driven))]))
    return min(starts)


def _referred(
    entry: Entry, time: FloatArray, values: FloatArray, drive: float
) -> tuple[FloatArray, str]:
    """Values over their reference, and which one it was."""
    if entry.reference == NONE:
        return values, ""
    if entry.reference == REST:
        before = values[time <= drive] if np.isfinite(drive) else values[:1]
        zero = float(np.median(before)) if len(before) else float(values[0])
        return values - zero, f", zero at rest ({zero:.6g})"
    zero = float(entry.reference)
    return values - zero, f", zero at {zero:.6g}"


def _sentence(entry: Entry, made: ImportMap, reference: str) -> str:
    how = f"{entry.signal} from {entry.column!r} in {entry.unit!r}"
    if entry.form == "duty":
        how += f" as sqrt(duty) x {made.supply_voltage:g} V, the direct voltage of the same heat"
    if entry.form == "mean":
        how += f" as sqrt(mean x {made.supply_voltage:g} V), the direct voltage of the same heat"
    if entry.sign == -1:
        how += ", counted the other way"
    if (entry.scale, entry.offset) != (1.0, 0.0):
        how += f", x {entry.scale:g} + {entry.offset:g}"
    return how + reference
