"""From columns of another logger to signals of the contract: the map, written, read and applied.

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
from sma_bench.records.tables import Account, TableFile
from sma_bench.records.units import Unit, in_si, parse_unit

ASK = "ask"
ROWS = "row number"  # the clock of a table without one; its unit is the period, "0.1 s"
REST, NONE = "rest", "none"
POSITIONS = ("elongation", "deflection")
NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,40}(\.[a-z]+)?\Z")
DUTY_SLACK = 0.02  # beyond 0 to 1 that a duty may be read
_FORMS = {"voltage": ("rms", "duty", "mean"), "current": ("rms", "mean", "peak")}
_OF_UNIT = {"V": "voltage", "A": "current", "K": "temperature", "m": "length", "N": "force"}
DRIVEN = 0.02  # of the largest voltage: below it nothing is driven


@dataclass(frozen=True)
class Entry:
    """How one signal comes from a column: sign * (scale * column in its unit + offset) - reference.
    Any text but the names of signal and column may be "ask"."""

    signal: str  # of the contract
    column: str  # as the file has it
    unit: str  # of the column
    clock: str  # the column of its time
    scale: float = 1.0
    offset: float = 0.0  # in SI
    sign: int | str = 1  # or -1
    reference: str | float = NONE  # "rest": 0 before the first drive; "none"; or a number in SI
    form: str = "rms"  # or direct; of a switched supply "mean", volts "duty", amperes "peak"

    @property
    def kind(self) -> str:
        """What the signal is of its channel: voltage, current, temperature."""
        return self.signal.rpartition(".")[2]


@dataclass(frozen=True)
class ImportMap:
    """Clocks (column -> unit), signals, and what the bench supplies."""

    clocks: dict[str, str]
    entries: tuple[Entry, ...]
    supply_voltage: float | str | None = None
    lever: float | str | None = None
    ignored: tuple[str, ...] = ()


def map_text(made: ImportMap, table: TableFile, remarks: Mapping[str, str]) -> str:
    """The map as commented YAML."""

    def shown(value: Any, subject: str = "") -> str:
        text = json.dumps(value, ensure_ascii=False) if isinstance(value, str) else repr(value)
        return f"{text}  # {printable(remarks[subject])}" if subject in remarks else text

    source = f"{printable(table.path.name)} ({table.format})"
    lines = [
        f"# Map of {source}, for sma-bench import --map; `ask` is to be filled in.",
        "# SI value = sign * (scale * column in its unit + offset) - reference",
        "# reference: rest (0 before the first drive), none, or a number; form of a voltage: rms",
        "# (or direct), duty or mean of the switched supply; of a current: rms, mean or peak.",
        f"# A table without a clock has one called {ROWS!r}, whose unit is the period: 0.1 s.",
        "time:",
    ]
    lines += [f"  {shown(name)}: {shown(unit, name)}" for name, unit in made.clocks.items()]
    for key in ("supply_voltage", "lever"):
        if (value := getattr(made, key)) is not None:
            lines.append(f"{key}: {shown(value, key)}")
    remark = printable(remarks.get("signals", ""))
    lines.append(f"signals:  # {remark}" if remark else "signals:")
    columns = {column.name: column.values for column in table.columns}
    for entry in made.entries:
        values = columns[entry.column]
        span = f"{np.nanmin(values):.6g} to {np.nanmax(values):.6g}"
        more = f"; {printable(remarks[entry.column])}" if entry.column in remarks else ""
        lines += [f"  - signal: {shown(entry.signal)}", f"    # {span}{more}"]
        for name, value in list(vars(entry).items())[1:]:
            if name != "form" or entry.kind in (*_FORMS, ASK):
                lines.append(f"    {name}: {shown(value)}")
    lines.append("ignored:" if made.ignored else "ignored: []")
    lines += [f"  - {shown(name, name)}" for name in made.ignored]
    return "\n".join(lines) + "\n"


def read_map(path: str | Path) -> ImportMap:
    """The map of a file; raises InputError where it is unreadable, or has a key or value that a map
    does not have. What is still to be filled in is named."""
    document = read_yaml(path)
    known = {"time", "supply_voltage", "lever", "signals", "ignored"}
    if not isinstance(document, dict) or set(document) - known:
        raise InputError(f"{path}: not a map: expected {', '.join(sorted(known))}")
    clocks, rows = document.get("time"), document.get("signals")
    texts = [*clocks, *clocks.values()] if isinstance(clocks, dict) else [None]
    if not isinstance(clocks, dict) or not all(isinstance(text, str) for text in texts):
        raise InputError(f"{path}: time: expected columns and their units")
    if not isinstance(rows, list) or not rows:
        raise InputError(f"{path}: signals: expected a list with one or more")
    for column, unit in clocks.items():
        if tick_of(column, unit) is None:
            wanted = "a period such as 0.1 s" if column == ROWS else "a unit of time"
            said = f"time: {column}: unit is {printable(unit)!r}"
            raise InputError(f"{path}: {said}, expected {wanted}")
    supply, lever = document.get("supply_voltage"), document.get("lever")
    for key, value in (("supply_voltage", supply), ("lever", lever)):
        if value is not None and not (_is_number(value) and value > 0):
            found = printable(str(value))[:40]
            raise InputError(f"{path}: {key} is {found!r}, expected a number > 0")
    entries = tuple(_read_entry(row, f"{path}: signals: {k}") for k, row in enumerate(rows, 1))
    for entry in entries:
        if entry.clock not in clocks:
            raise InputError(f"{path}: {entry.signal}: clock {entry.clock!r} is not under time")
        if entry.form != "rms" and entry.kind == "voltage" and supply is None:
            raise InputError(f"{path}: supply_voltage is missing, {entry.signal} is a {entry.form}")
    return ImportMap(clocks, entries, supply and float(supply), lever and float(lever))


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and np.isfinite(value)


def _read_entry(row: Any, where: str) -> Entry:
    names = [key.name for key in fields(Entry)]
    if not isinstance(row, dict) or set(row) - set(names) or not set(names[:4]) <= set(row):
        raise InputError(f"{where}: expected {', '.join(names[:4])} and of {', '.join(names[4:])}")
    for key in names[:4]:
        if not isinstance(row[key], str):
            raise InputError(f"{where}: {key}: expected a text")
    entry = Entry(**row)
    unit = contract.unit_of(entry.signal) if NAME.match(entry.signal) else None
    forms = _FORMS.get(entry.kind, ("rms",))
    quantity = "ratio" if entry.form == "duty" else _OF_UNIT.get(unit or "", "")
    known = parse_unit(entry.unit)
    is_named = quantity and entry.signal != "voltage_command"
    is_sign = entry.sign in (1, -1) and not isinstance(entry.sign, bool)
    is_reference = entry.reference in (REST, NONE) or _is_number(entry.reference)
    units = (quantity, "angle") if quantity == "length" else (quantity,)
    for key, is_right, expected in (
        ("signal", is_named, "a name such as wire.voltage"),
        ("scale", _is_number(entry.scale), "a number"),
        ("offset", _is_number(entry.offset), "a number"),
        ("sign", is_sign, "1 or -1"),
        ("form", entry.form in forms, f"one of {', '.join(forms)}"),
        ("reference", is_reference, "rest, none or a number"),
        ("unit", known is not None and known.quantity in units, f"a unit of {quantity}"),
    ):
        if not is_right:
            found = printable(str(getattr(entry, key)))[:40]
            name = printable(entry.signal)
            raise InputError(f"{where} ({name}): {key} is {found!r}, expected {expected}")
    return entry


def tick_of(column: str, text: str) -> Unit | None:
    """The unit of a clock: one of time, or of rows the period between them."""
    number, _, unit = text.strip().partition(" ") if column == ROWS else ("1", "", text)
    known = parse_unit(unit)
    try:
        period = known.factor * float(number) if known and known.quantity == "time" else 0.0
    except ValueError:
        return None
    return Unit("time", period) if period > 0.0 else None


def convert(table: TableFile, made: ImportMap) -> tuple[list[Signal], list[str], int]:
    """Signals in SI from a table by its map, a sentence on each, and the epoch time of 0 in ns.

    Clocks keep their offsets to each other; the first sample of all is at 0. Rows that share a
    stamp are spread over it, all signals of the clock alike. Raises InputError for a column that
    the file does not have, a clock that goes back or stands still, a duty that is none, no values.
    """
    columns = {column.name: column for column in table.columns}
    for name in (*made.clocks, *(entry.column for entry in made.entries)):
        if name not in columns and name != ROWS:
            have = ", ".join(list(columns)[:12])
            raise InputError(f"{table.path}: no column {name!r}, it has {have}")
    read = {entry: _samples(table, made, entry) for entry in made.entries}
    starts = [columns[e.clock].start if e.clock in columns else None for e in made.entries]
    dated = [start for start in starts if start is not None]
    offsets = dict.fromkeys(made.entries, 0.0)
    if len(dated) == len(starts):  # moments count from their own first one
        offsets = {e: s - min(dated) for e, s in zip(made.entries, dated, strict=True)}
    times = {entry: time + offsets[entry] for entry, (time, _, _) in read.items()}
    first = min(float(time[0]) for time in times.values())

    # When the first voltage or current sets in; inf where none does.
    drive = np.inf
    for entry, (_, values, _) in read.items():
        driven = np.abs(values) > DRIVEN * np.abs(values).max()
        if entry.signal.endswith((".voltage", ".current")) and driven.any():
            drive = min(drive, float(times[entry][int(np.argmax(driven))]))

    signals, sentences = [], []
    for entry, (_, values, spread) in read.items():
        zero, said = 0.0, ""
        if entry.reference == REST:
            before = values[times[entry] <= drive] if np.isfinite(drive) else values[:1]
            zero = float(np.median(before)) if len(before) else float(values[0])
            said = f", zero at rest ({zero:.6g})"
        elif entry.reference != NONE:
            zero = float(entry.reference)
            said = f", zero at {zero:.6g}"
        if entry.form != "rms" and entry.kind == "current":
            duty = next(
                (
                    e
                    for e in made.entries
                    if e.signal == f"{entry.signal[:-8]}.voltage" and e.form in ("duty", "mean")
                ),
                None,
            )
            if duty is None:
                raise InputError(
                    f"{table.path}: {entry.column}: the {entry.form} of a switched current needs "
                    f"the duty of {entry.signal[:-8]} in the table"
                )
            # The current of the same heat, by the share of time that the voltage is on.
            supply = float(made.supply_voltage or 1.0)
            root = np.interp(times[entry], times[duty], read[duty][1]) / supply
            share = np.where(root > 0.02, root, 1.0)  # below it nothing flows
            values = values / share if entry.form == "mean" else values * np.clip(root, 0.0, 1.0)
        unit = contract.unit_of(entry.signal) or ""
        signals.append(Signal(entry.signal, unit, times[entry] - first, values - zero))
        sentences.append(_sentence(entry, made) + said + spread)
    # Seconds since 1970, as PlotJuggler writes them, are an epoch too.
    epoch = min(dated) if dated else first if 1e9 < first < 4e9 else 0.0
    return signals, sentences, round(epoch * 1e9)


def _samples(table: TableFile, made: ImportMap, entry: Entry) -> tuple[FloatArray, FloatArray, str]:
    """Times in s and values in SI of one entry, without what is missing; the sign is in them. And
    what was done to its stamps."""
    columns = {column.name: column.values for column in table.columns}
    raw = columns[entry.column]
    ticked = columns.get(entry.clock, np.arange(float(len(raw))))
    where = f"{table.path}: {entry.column}"
    if len(ticked) != len(raw):
        raise InputError(f"{where}: {len(raw)} rows, its clock {entry.clock!r} has {len(ticked)}")
    ticks, unit = tick_of(entry.clock, made.clocks[entry.clock]), parse_unit(entry.unit)
    assert ticks and unit
    timed = np.isfinite(ticked)
    time = in_si(ticked[timed], ticks)
    values = in_si(entry.scale * raw[timed], unit) + entry.offset
    kept = np.isfinite(values)
    if not kept.any():
        raise InputError(f"{where}: no values, expected a column of numbers")
    steps, said = np.diff(time[kept]), ""
    if np.any(steps < 0):
        row = int(np.argmax(steps < 0)) + 1
        back = time[kept][row - 1 : row + 1]
        said = f"its time goes back from {back[0]:.9g} to {back[1]:.9g} s in row {row + 1}"
        raise InputError(f"{where}: {said} of the numbers, expected one run")
    if np.all(steps > 0.0):
        time = time[kept]
    elif kept.mean() > 0.5 and np.all(np.diff(time) >= 0.0):
        # Columns with few gaps share the stamps of all rows, so that none lags behind another.
        time, said = spread_stamps(time, where)
        time = time[kept]
    else:
        time, said = spread_stamps(time[kept], where)
    values = values[kept]
    if entry.kind == "voltage" and entry.form in ("duty", "mean"):
        # The direct voltage of the same heat: heat goes with duty * supply^2.
        if not isinstance(made.supply_voltage, float):
            raise InputError(f"{where}: a {entry.form} needs supply_voltage in the map")
        duty = values / made.supply_voltage if entry.form == "mean" else values
        low, high = float(duty.min()), float(duty.max())
        if low < -DUTY_SLACK or high > 1.0 + DUTY_SLACK:
            raise InputError(f"{where}: duty of {low:.4g} to {high:.4g}, expected 0 to 1")
        values = np.sqrt(np.clip(duty, 0.0, 1.0)) * made.supply_voltage
    if unit.quantity == "angle":
        if not isinstance(made.lever, float):
            raise InputError(f"{where}: an angle needs lever (load.lever, m/rad) in the map")
        values = values * made.lever
    return time, values * float(entry.sign), said


def spread_stamps(time: FloatArray, where: str) -> tuple[FloatArray, str]:
    """(n,) s that increase, of stamps (n,) coarser than the rows, and a remark: a line through all
    where rows came evenly, else even steps within each stamp; raises InputError where all rows have
    one stamp."""
    stamps, first, count = np.unique(time, return_index=True, return_counts=True)
    if len(stamps) < 2:
        raise InputError(f"{where}: all {len(time)} rows are at one time, expected a running clock")
    step = float(np.diff(stamps).min())
    said = (
        f"; {len(time) - len(stamps)} of {len(time)} rows repeat the stamp before: spread evenly "
        f"over its {step:.4g} s"
    )
    if np.median(count) > 1.0 and len(stamps) > 2:
        period = float(stamps[-1] - stamps[1]) / float(first[-1] - first[1])
        even = period * np.arange(len(time))
        even += float(np.max(time - even))
        if np.max(even - time) < step + 0.5 * period:
            return np.asarray(even), f"{said}, {1.0 / period:.4g} Hz"
    gaps = np.minimum(np.append(np.diff(stamps), step), step)
    within = np.arange(len(time)) - np.repeat(first, count)
    return np.asarray(time + within * np.repeat(gaps / count, count)), said


def account_of(
    table: TableFile,
    made: ImportMap,
    remarks: Mapping[str, str] | None = None,
    asked: Sequence[str] = (),
) -> Account:
    """What became of the rows and columns of a table."""
    columns = {column.name: column for column in table.columns}
    used = {name: "clock" for name in made.clocks if name in columns}
    kept = [np.zeros(max(len(t.lines), 1), dtype=bool) for t in table.tables]
    for entry in made.entries:
        if (column := columns.get(entry.column)) is not None:
            used[column.name] = entry.signal
            clock = columns.get(entry.clock, column)
            kept[column.table] |= np.isfinite(column.values) & np.isfinite(clock.values)
    reasons = remarks or {}
    rest = {name: reasons.get(name, "not in the map") for name in columns if name not in used}
    outside = (*table.outside, *(note for t in table.tables for note in t.unused_lines))
    rows, rows_used = sum(t.rows for t in table.tables), int(sum(k.sum() for k in kept))
    return Account(rows, rows_used, used, rest | table.ignored, tuple(asked), outside)


def _sentence(entry: Entry, made: ImportMap) -> str:
    how = f"{entry.signal} from {entry.column!r} in {entry.unit!r}"
    if entry.kind == "current" and entry.form != "rms":
        how += f", the {entry.form} of a switched current, as that of the same heat"
    elif entry.form != "rms":
        root = "sqrt(duty) x {:g} V" if entry.form == "duty" else "sqrt(mean x {:g} V)"
        how += f" as {root.format(made.supply_voltage)}, the direct voltage of the same heat"
    how += ", counted the other way" if entry.sign == -1 else ""
    scaled = (entry.scale, entry.offset) != (1.0, 0.0)
    return how + f", x {entry.scale:g} + {entry.offset:g}" * scaled
