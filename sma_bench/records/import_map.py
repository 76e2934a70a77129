"""Imports tables of other loggers: a map gives column, unit, clock, zero and sign of each signal;
`propose` makes a map of a table, with questions."""

import contextlib
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import msgspec
import numpy as np
import yaml

from sma_bench.arrays import Array
from sma_bench.border import printable, read_yaml
from sma_bench.errors import InputError
from sma_bench.findings import Finding
from sma_bench.parameters import Parameters
from sma_bench.parameters.parameters import load_kind
from sma_bench.records import cells, clocks, contract
from sma_bench.records.cells import PATTERNS, QUANTITIES, WORDS, Unit, message, parse_unit
from sma_bench.records.instrument_files import Sheet
from sma_bench.records.record import Record, Signal, ohms_of_source
from sma_bench.records.tables import Account, Column, TableFile, read_table_file

ASK, ROWS = "ask", "row number"  # the latter: clock of a table without time, its period as unit
_MOVES, _DRIVES = {"elongation", "deflection", "force"}, {"voltage", "current"}
_LITTLE = 0.02  # tolerance of a duty beyond 0 to 1; drives below this share of the largest are off
_BEAMS = "beam", "antagonist"  # loads whose motion is a deflection
_FORMS = {"voltage": ("rms", "mean", "duty", "power"), "current": ("rms", "mean", "peak")}
_DIRECT = ("rms", "power")  # forms that need no supply voltage
_CLEAR = 3.0  # motion one way over the other way, from which heat decides its sign
_AT_REST = 0.1  # of the whole motion: a larger scatter before the first drive is no rest
_DOUBTFUL = {*WORDS["doubtful"], *WORDS["supplies"]}  # devices whose readings may be the wire's
_UNKNOWN = "title and unit not known"
_MOST = 1e9  # largest number in a map, in its unit
_Number = Annotated[float, msgspec.Meta(ge=-_MOST, le=_MOST)]
_Positive = Annotated[float, msgspec.Meta(gt=0.0, le=_MOST)]


class Entry(msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """One signal = sign * (scale * column in its unit + offset) - reference, in SI; the reference
    "rest" is the value before the first drive. Unanswered questions of a proposal are "ask"."""

    signal: str  # of the contract
    column: str  # its name in the file
    unit: str  # of the column
    clock: str  # the column of its times
    scale: _Number = 1.0
    offset: _Number = 0.0  # in SI
    sign: Literal[1, -1, "ask"] = 1
    reference: _Number | Literal["rest", "none"] = "none"
    form: Literal["rms", "mean", "duty", "peak", "power"] = "rms"

    @property
    def kind(self) -> str:
        """Last part of the signal's name, such as voltage or elongation."""
        return self.signal.rpartition(".")[2]

    @property
    def measured(self) -> Unit:
        """The unit of its column; SI if not known yet."""
        return parse_unit(self.unit) or Unit("", 1.0)


class ImportMap(msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """How to make signals from a table: clocks, signals, and numbers of the bench."""

    time: dict[str, str]  # clocks: column and unit
    signals: Annotated[tuple[Entry, ...], msgspec.Meta(min_length=1)]
    supply_voltage: _Positive | None = None  # V, of a switched supply
    resistance: _Positive | None = None  # ohm, of a channel, to write watts as V and A
    lever: _Positive | None = None  # m/rad, to write angles as elongations
    ignored: tuple[str, ...] = ()

    def tick(self, clock: str) -> float:
        """Unit of a clock in s, or the period of rows; 0 if not known."""
        unit = parse_unit(self.time[clock])
        if clock == ROWS:
            return cells.number_with_unit(self.time[clock], "time") or 0.0
        return unit.factor if unit and unit.quantity == "time" else 0.0


def map_text(made: ImportMap, table: TableFile, remarks: Mapping[str, str]) -> str:
    """The map as YAML, with `remarks` by column as comments."""
    used = {entry.column for entry in made.signals}
    about = {c.name: [c.span if c.name in used else "not used"] for c in table.columns}
    for name, remark in remarks.items():
        about.setdefault(name, []).append(remark)
    lines = [message("map", source=f"{printable(table.path.name)} ({table.format})")]
    lines += [printable(f"# {name}: {'; '.join(texts)}") for name, texts in about.items()]
    keys = yaml.safe_dump(msgspec.to_builtins(made), sort_keys=False, allow_unicode=True, width=999)
    return "\n".join([*lines, keys])


def read_map(path: str | Path) -> ImportMap:
    """The map in a file. InputError: it is not a map, or not filled in."""
    try:
        made = msgspec.convert(read_yaml(path), ImportMap)
    except msgspec.ValidationError as error:
        raise InputError(f"{path}: not a map: {printable(str(error))}") from None
    rules: Any = [(f"time: {clock}: unit", unit, 0.0 < made.tick(clock) < _MOST, "a unit of time, "
                   "or for rows a period such as 0.1 s") for clock, unit in made.time.items()]
    names = [entry.signal for entry in made.signals]
    for k, entry in enumerate(made.signals, 1):
        where = f"signals: {k} ({printable(entry.signal)}): "
        in_si = contract.unit_of(entry.signal) if PATTERNS.signal.match(entry.signal) else None
        known, forms = parse_unit(in_si or ""), _FORMS.get(entry.kind, ("rms",))
        in_place = {"duty": "ratio", "power": "power"}.get(entry.form)
        quantity = in_place or (known.quantity if known else "")
        is_angle = (quantity, entry.measured.quantity) == ("length", "angle")
        is_strain = (entry.kind, entry.measured.quantity) == ("elongation", "ratio")
        is_strain &= entry.scale != 1.0  # m, the length
        is_unit = is_angle or is_strain or entry.measured.quantity == quantity
        rules += [
            (f"{where}signal", entry.signal, in_si, "a name such as wire.voltage"),
            (f"{where}signal", entry.signal, names.count(entry.signal) == 1, "one column"),
            (f"{where}sign", entry.sign, entry.sign != ASK, "1 or -1"),
            (f"{where}form", entry.form, entry.form in forms, f"one of {', '.join(forms)}"),
            (f"{where}unit", entry.unit, is_unit, f"a unit of {quantity}"),
            (f"{where}clock", entry.clock, entry.clock in made.time, "one of those under time"),
            ("supply_voltage", None, made.supply_voltage or entry.form in _DIRECT, "volts"),
            ("resistance", None, made.resistance or entry.form != "power", "ohm"),
            ("lever", None, made.lever or not is_angle, "m/rad"),
        ]
    for place, value, is_right, expected in rules:
        if not is_right:
            raise InputError(f"{path}: {place} is {str(value)[:40]!r}, expected {expected}")
    return made


class _Samples(NamedTuple):
    time: Array  # (n,) s
    values: Array  # (n,) in SI, without NaN
    how: str = ""  # they were made, for a sentence


def convert(table: TableFile, made: ImportMap, path: Path) -> tuple[Record, list[str]]:
    """The record (with that path) from a table by its map, and a sentence on each signal. Raises
    InputError: a column is missing or empty, a clock goes back or stops, a duty is beyond 1."""
    read, base, notes = _read(table, made)
    first = min(float(samples.time[0]) for samples in read.values())
    # For a switched supply the direct voltage of the same heat, supply * sqrt(duty), then currents.
    supply = made.supply_voltage or 1.0
    roots: dict[str, tuple[Array, Array]] = {}  # times and sqrt(duty), by channel
    signals, sentences = {}, []
    for entry in sorted((e for e in read if e.form != "rms"), key=lambda e: e.kind == "current"):
        (time, values, spread), where = read[entry], f"{table.path}: {entry.column}"
        channel, sign = entry.signal.partition(".")[0], float(entry.sign)
        if entry.form == "power":
            if values.min() < -_LITTLE * values.max():
                raise InputError(f"{where}: power of {values.min():.4g} W, expected 0 or more")
            ohms, how = made.resistance or 1.0, message("as_power")
            values = np.sqrt(np.maximum(values, 0.0) * ohms)
            name = f"{channel}.current"
            signals[name] = Signal(name, "A", time - first, values / ohms)
        elif entry.kind == "voltage":
            duty = sign * values / (supply if entry.form == "mean" else 1.0)
            low, high = float(duty.min()), float(duty.max())
            if low < -_LITTLE or high > 1.0 + _LITTLE:
                raise InputError(f"{where}: duty of {low:.4g} to {high:.4g}, expected 0 to 1")
            root = np.sqrt(np.clip(duty, 0.0, 1.0))
            roots[channel] = time, root
            how = message("as_duty" if entry.form == "duty" else "as_mean", supply=supply)
            values = sign * supply * root
        elif channel in roots:
            root, how = np.interp(time, *roots[channel]), message("as_current", form=entry.form)
            factor = root if entry.form == "peak" else 1.0 / np.where(root > _LITTLE, root, 1.0)
            values = values * factor
        else:
            raise InputError(f"{where}: {message('no_duty', form=entry.form)}")
        read[entry] = _Samples(time, values, how + spread)
    for entry, samples in read.items():
        zero, sentence = 0.0, f"{entry.signal} from {entry.column!r} in {entry.unit!r}"
        sentence += ", sign inverted" if entry.sign == -1 else ""
        if (entry.scale, entry.offset) != (1.0, 0.0):
            sentence += f", x {entry.scale:g} + {entry.offset:g}"
        if entry.reference == "rest":
            zero = float(np.median(_at_rest(read, samples)))
            sentence += f", zero at rest ({zero:.6g})"
        elif entry.reference != "none":
            zero = float(entry.reference)
            sentence += f", zero at {zero:.6g}"
        unit, time = contract.unit_of(entry.signal) or "", samples.time - first
        signals[entry.signal] = Signal(entry.signal, unit, time, samples.values - zero)
        sentences.append(sentence + samples.how)
    start_ns = round((base + first) * 1e9) if base > clocks.DAY else 0
    return Record(path, start_ns, signals), [*sentences, *notes]


def require_columns(table: TableFile, names: Iterable[str]) -> None:
    """InputError if a file has no column of one of these names."""
    held = [column.name for column in table.columns]
    if wrong := next((name for name in names if name not in (*held, ROWS)), None):
        raise InputError(f"{table.path}: no column {wrong!r}, it has {', '.join(held[:12])}")


def _read(table: TableFile, made: ImportMap) -> tuple[dict[Entry, _Samples], float, list[str]]:
    """Samples of each entry, sign applied; epoch (s) of time 0; assumptions."""
    require_columns(table, [*made.time, *(entry.column for entry in made.signals)])
    columns = {column.name: column for column in table.columns}
    ticks = {name: made.tick(name) or 1.0 for name in made.time}
    (times, base, notes), read = clocks.on_one_clock(table, ticks), dict[Entry, _Samples]()
    for entry in (entry for entry in made.signals if entry.clock != ASK):
        raw, where = columns[entry.column].values, f"{table.path}: {entry.column}"
        time = times.get(entry.clock, np.arange(float(len(raw))) * ticks[entry.clock])
        if len(time) != len(raw):
            raise InputError(f"{where}: {len(raw)} rows, its clock has {len(time)}")
        timed = np.isfinite(time)
        time = time[timed]
        values = entry.measured.si(entry.scale * raw[timed]) + entry.offset
        kept = np.isfinite(values)
        if not kept.any():
            raise InputError(f"{where}: no values, expected a column of numbers")
        steps, spread = np.diff(time[kept]), ""
        for row in np.flatnonzero(steps < 0)[:1]:
            a, b = time[kept][row : row + 2]
            raise InputError(f"{where}: {message('goes_back', a=a, b=b, row=row + 2)}")
        if np.any(steps == 0.0):
            # Columns with few gaps get the same spread stamps, so that none lags behind another.
            is_full = kept.mean() > 0.5 and np.all(np.diff(time) >= 0.0)
            rows = np.ones_like(kept) if is_full else kept
            time[rows], spread = cells.spread_stamps(time[rows], where)
        time = time[kept]
        lever = made.lever if entry.measured.quantity == "angle" else None
        values = values[kept] * float(entry.sign) * (lever if isinstance(lever, float) else 1.0)
        read[entry] = _Samples(time, values, spread)
    return read, base, notes


def _at_rest(read: Mapping[Entry, _Samples], samples: _Samples) -> Array:
    """The values before the first voltage or current sets in; at least one."""
    begins = []
    for entry, drive in read.items():
        driven = np.abs(drive.values) > _LITTLE * np.abs(drive.values).max()
        if entry.kind in _DRIVES and driven.any():
            begins.append(float(drive.time[int(np.argmax(driven))]))
    rows = np.searchsorted(samples.time, min(begins, default=-np.inf), side="right")
    return samples.values[: max(int(rows), 1)]


def account_of(table: TableFile, made: ImportMap, remarks: Mapping[str, str],
               asked: Sequence[str] = ()) -> Account:
    """What became of the rows and columns of a table."""
    columns = {column.name: column for column in table.columns}
    used = {name: "clock" for name in made.time if name in columns}
    kept = [np.zeros(max(len(t.lines), 1), dtype=bool) for t in table.tables]
    for entry in (entry for entry in made.signals if entry.column in columns):
        column, clock = columns[entry.column], columns.get(entry.clock)
        used[entry.column] = entry.signal
        kept[column.table] |= np.isfinite(column.values + (clock.values if clock else 0.0))
    count, reasons = int(sum(k.sum() for k in kept)), {"": "no signal uses it", **remarks}
    return table.account(table.tables, count, used, reasons, asked)


def record_of_table(path: str | Path, bench: Parameters, stated: Mapping[str, str]) -> Record:
    """The record in a logger's table. InputError: it is no table, or its map has a question."""
    table = read_table_file(path)
    made, questions, remarks = propose(table, bench, stated)
    if questions:
        raise InputError(f"{path}: unsure of {questions[0]}; units= or params= may answer")
    account = Finding("info", "account", str(account_of(table, made, remarks)))
    return replace(convert(table, made, Path(path))[0], findings=(account,))


def propose(table: TableFile, bench: Parameters,
            stated: Mapping[str, str]) -> tuple[ImportMap, list[str], dict[str, str]]:
    """A map of a table, questions, and remarks by column; `stated`: units by column. InputError: a
    column is missing."""
    require_columns(table, stated)
    columns = [replace(c, unit=stated[c.name], fields=0) if stated.get(c.name) else c
               for c in table.columns]
    # Titles that are or end in units: left_A next to left_V; ms, if there is no other clock.
    named = {c.title for c in columns}
    timed = {c.table for c in columns if c.fields or "time" in cells.meanings(c.title, c.unit)}
    for k, c in enumerate(columns):
        unit = parse_unit(c.title)
        is_clock = unit is not None and unit.quantity == "time" and c.table not in timed
        if not c.unit and (is_clock or (c.title[-1:] == "A" and f"{c.title[:-1]}V" in named)):
            columns[k] = replace(c, unit=c.title if is_clock else "A")
    proposal = _Proposal(bench)
    ask, remarks = proposal.ask, proposal.remarks
    proposal.of_wire = {m for c in columns if {*cells.words_of(c.title)} & {*WORDS["wire"]}
                        for m in cells.meanings(c.title, c.unit)[:1]}
    meant = {column.name: proposal.meaning(column) for column in columns}
    # Power drives only if the bench says so: volts and amperes show the resistance, watts do not.
    # A strain moves only if there is no length.
    drive, given = bench["bench.drive"], {*meant.values()}
    unused = {*_DRIVES, "duty"} if drive == "power" and drive in given else {"power"}
    unused |= {"strain"} if {"length", "angle"} & given else set()
    for name in [name for name, meaning in meant.items() if meaning in unused]:
        meaning, meant[name] = meant[name], ""
        remarks[name] = message("is_length" if meaning == "strain" else "not_driving", drive=drive)
    timers = [column for column in columns if meant[column.name] == "time"]
    entries: dict[str, Entry] = {}
    for column in columns:
        name, meaning = column.name, meant[column.name]
        if meaning and meaning != "time":
            entry = proposal.entry(column, meaning, proposal.clock_of(column, timers, columns))
            other = entries.setdefault(entry.signal + name * (ASK in entry.signal), entry)
            if other is not entry:
                ask(name, "which_one", other=other.column, signal=entry.signal)
                entries[name] = msgspec.structs.replace(entry, signal=ASK)
    # What is missing. A clamped wire needs no motion, but temperature, or voltage and current.
    found, kinds = tuple(entries.values()), {entry.kind for entry in entries.values()}
    unknown = [c for c in columns if remarks.get(c.name) == _UNKNOWN]
    rest = ", ".join(repr(c.name) for c in unknown[:8]) or "no others"
    asked = len(proposal.questions)
    if not kinds & _MOVES and (unknown or not ("temperature" in kinds or kinds >= _DRIVES)):
        ask("signals", "no_position", rest=rest)
    if not kinds & _DRIVES and not kinds >= {"elongation", "force"}:
        ask("signals", "no_drive", rest=rest)
    if len(proposal.questions) > asked:  # one of the unknown columns may be it
        found += tuple(Entry(ASK, c.name, c.unit or ASK, proposal.clock_of(c, timers, columns))
                       for c in unknown)
    ticking = {entry.clock for entry in found}
    time = {c.name: proposal.unit(c, "time") for c in timers if c.name in ticking}
    if ROWS in ticking:
        titles = [f"{name} ({why})" for t in table.tables for name, why in t.ignored.items()]
        titles += [column.name for column in columns]
        periods = {*_stated(table, "period"), *(1.0 / hz for hz in _stated(table, "rate"))}
        is_each = all(np.all(np.diff(c.values) == 1.0) for c in columns
                      if remarks.get(c.name) == QUANTITIES["counter"]["unused"])
        time[ROWS] = (f"{periods.pop():.9g} s" if len(periods) == 1 and is_each else
                      ask(ROWS, "no_clock", titles=", ".join(titles[:12])))
        remarks.setdefault(ROWS, f"period of the rows as stated above the titles: {time[ROWS]}")
    supply, lever, volts = None, None, "bench.supply_voltage"
    ohms = ohms_of_source(bench) if any(entry.form == "power" for entry in found) else None
    if any(entry.kind == "voltage" and entry.form not in _DIRECT for entry in found):
        known = _stated(table, "supply") | ({bench[volts]: volts} if volts in bench.given else {})
        said = " or ".join(f"{volt:g} V ({line})" for volt, line in known.items())
        is_sure = volts in bench.given and len(known) == 1
        supply = bench[volts] if is_sure else ask("supply_voltage", "which_supply", said=said)
    if any(entry.measured.quantity == "angle" for entry in found):
        lever = bench["load.lever"] or ask("lever", "which_lever")
    for count, line in (Sheet(table, t, {}).wires() for t in table.tables):
        if count not in (1, bench["wire.count"]):
            remarks["wire.count"] = message("other_count", line=line, count=bench["wire.count"])
    taken = {*time, *(entry.column for entry in found)}
    ignored = tuple(column.name for column in columns if column.name not in taken)
    # Signs do not depend on the answers to the questions so far.
    made = ImportMap(time, found, supply, ohms, lever, ignored)
    read: dict[Entry, _Samples] = {}
    with contextlib.suppress(*([InputError] if proposal.questions else [])):
        read = _read(table, made)[0]
    signed = [msgspec.structs.replace(e, **proposal.sign_and_zero(e, read)) for e in found]
    return msgspec.structs.replace(made, signals=tuple(signed)), proposal.questions, remarks


def _stated(file: TableFile, name: str) -> dict[float, str]:
    """Values that lines above the titles state for a number of `of_rows`, with these lines."""
    found = (Sheet(file, table, {}).statements(name) for table in file.tables)
    return {value: line for lines in found for value, line in lines.items()}


def _count_alike(one: Column, other: Column) -> bool:
    """True if two clocks count the same time, each in its unit; a missing unit may be any."""
    values = np.stack([one.values, other.values])
    is_there = np.isfinite(values)
    if not np.array_equal(*is_there):
        return False
    values, known = values[:, is_there[0]], [parse_unit(c.unit) for c in (one, other)]
    if None in known or one.fields or other.fields:  # one may count from another zero
        values -= values[:, :1]
    spans = [1.0 / (span or 1.0) for span in np.ptp(values, axis=1)]
    scales = spans if None in known else [unit.factor for unit in known if unit]
    a, b = values * np.reshape(scales, (2, 1))
    coarse = max(float(np.diff(np.unique(v)).min(initial=np.inf)) for v in (a, b))
    return bool(np.max(np.abs(a - b)) <= 1.01 * coarse + 1e-3 * abs(a[-1]))


@dataclass
class _Proposal:
    """A map in the making, with questions and remarks."""

    bench: Parameters
    questions: list[str] = field(default_factory=list)
    remarks: dict[str, str] = field(default_factory=dict)  # by column, or by key of the map
    of_wire: set[str] = field(default_factory=set)  # meanings of columns whose titles name a wire

    def ask(self, where: str, key: str, **values: Any) -> Any:
        """Add a question; returns what stands in the map until it is answered."""
        question = message(key, **values)
        self.questions.append(f"{where!r}: {question}")
        self.remarks[where] = f"{self.remarks.get(where, '')} ASK: {question}".strip()
        return ASK

    def channels_of(self, column: Column) -> list[str]:
        """Channels that a title names, as whole words (channel r is not in `current`)."""
        names, title = self.bench["bench.channels"], cells.split_title(column.name)[0]
        parted = map(PATTERNS.word.findall, (f"{column.title} {title}", *names))
        whole, *own = (f" {' '.join(words).lower()} " for words in parted)
        return [name for name, text in zip(names, own, strict=True) if text in whole]

    def meaning(self, column: Column) -> str:
        """The quantity of a column, "" if it makes no signal."""
        name, title = column.name, column.title
        if column.fields:
            return "time"
        texts = [title, name]
        for channel in self.channels_of(column):  # a channel `extensor` does not mean extension
            own = r"[\W_]*".join(map(re.escape, PATTERNS.word.findall(channel)))
            own = rf"(?<![^\W_]){own}(?![^\W_])"
            texts = [re.sub(own, "", t, flags=re.IGNORECASE).strip(" _-.:/") or t for t in texts]
        meant = cells.title_meanings(texts[0]) or cells.title_meanings(texts[1])
        found = next(filter(None, (cells.meanings(t, column.unit) for t in texts)), meant)
        named, words = found[0] if found else "", set(cells.words_of(title))
        words |= {PATTERNS.compound.sub("", word) for word in words}
        named = named or "counter" * bool(np.all(np.diff(column.values) == 1.0))
        unused = QUANTITIES[named].get("unused", "") if named else _UNKNOWN
        if named == "strain" and not words & {*QUANTITIES["strain"]["worse"]} and (
                "wire.length" in self.bench.given and load_kind(self.bench) not in _BEAMS):
            unused = ""  # of the wire's length
        if (unit := parse_unit(column.unit)) and unit.quantity in WORDS["foreign"]:
            unused = f"a unit of {unit.quantity}"
        is_wire = bool(self.channels_of(column) or words & set(WORDS["wire"]))
        last = re.split(r"[/.](?=\D)", texts[0])[-1]  # of a path
        parts = {PATTERNS.compound.sub("", word) for word in cells.words_of(last)}
        strange = {part for part in parts if named in (*_DRIVES, "temperature") and not
                   cells.is_neutral(part, named) and (cells.title_meanings(part) or not is_wire)}
        other = min(words & {*WORDS["devices"], *_DOUBTFUL} or strange, default="")
        other = other if named in (*_DRIVES, "duty", "power", "temperature", "strain") else ""
        if not (meant or unused or is_wire or other or named == "time"):
            self.ask(name, "is_it", named=named)
        if other and not unused:  # `IR camera [C]` may be of the wire, unlike `camera temperature`
            is_known = other in WORDS["devices"] or named in self.of_wire
            if meant and is_known and not is_wire:
                unused = f"of another device ({other}), not a wire"
            elif (named, other) != ("temperature", "sensor"):
                self.ask(name, "which_device", word=other)
        if named == "temperature" and re.fullmatch(r"[tT][cC]?[\s_]?0*([2-9]|1\d)", title):
            self.ask(name, "whose_temperature")
        if unused or not np.isfinite(column.values).any():
            self.remarks[name] = unused or "empty"
            return ""
        return named

    def clock_of(self, column: Column, clocks: list[Column], columns: list[Column]) -> str:
        """The clock of a column: nearest by path, finest of those that agree, next to the left."""
        fitting = [c for c in clocks if c.table == column.table]
        fitting = [c for c in fitting if np.nanmin(c.values) < np.nanmax(c.values)] or fitting
        if len({c.group for c in fitting}) > 1:
            near = {c: (c.group == column.group, len(os.path.commonprefix([c.name, column.name])))
                    for c in fitting}
            fitting = [c for c in fitting if near[c] == max(near.values())]
        if not fitting:
            return ROWS
        finest = max(fitting, key=lambda c: (c.unit != "", len(set(c.values)), c.start or 0.0))
        if all(c is finest or _count_alike(finest, c) for c in fitting):
            return finest.name
        # Several clocks: each is that of the columns to its right.
        order = [c.name for c in columns if c.table == column.table]
        names = [c.name for c in fitting]
        places = [order.index(name) for name in names]
        left = [place for place in places if place < order.index(column.name)]
        is_alike = len({re.sub(r"[\d\s()]+", "", c.title.lower()) for c in fitting}) == 1
        if is_alike and left and min(np.diff(places)) > 1:
            return order[left[-1]]
        return self.ask(column.name, "which_clock", names=" or ".join(map(repr, names)))

    def entry(self, column: Column, meaning: str, clock: str) -> Entry:
        """The signal that a column is: its name, unit, form and reference."""
        name, channels = column.name, self.bench["bench.channels"]
        unit, signal = self.unit(column, meaning), QUANTITIES[meaning].get("signal", "")
        load, zero = load_kind(self.bench), "none"
        scale = self.bench["wire.length"] if meaning == "strain" else 1.0
        if signal == "elongation" and load == "displacement":
            self.remarks[name] = "imposed: zero and sign as the machine has it, longer is positive"
        elif signal == "elongation":
            signal, zero = "deflection" if load in _BEAMS else signal, "rest"
        if signal:
            return Entry(signal, name, unit, clock, scale, reference=zero)  # type: ignore[arg-type]
        fitting = self.channels_of(column) if len(channels) > 1 else list(channels)
        if len(fitting) != 1:
            fitting = [self.ask(name, "which_channel", channels=", ".join(channels))]
        kind, form = ("voltage", meaning) if meaning in ("duty", "power") else (meaning, "rms")
        if meaning in _DRIVES:
            # With a switched supply a meter may show the mean, an oscilloscope the peak.
            text = " ".join(["", *cells.words_of(f"{name} {column.title} {column.unit}"), ""])
            forms = [f for f in _FORMS[meaning] if f not in ("duty", "power")]
            named = [f for f in forms if any(word in text for word in WORDS["forms"][f])]
            if named or self.bench["bench.drive"] == "duty":
                form = named[0] if named else self.ask(name, "which_form", what=" or ".join(forms))
        return Entry(f"{fitting[0]}.{kind}", name, unit, clock, form=form)  # type: ignore[arg-type]

    def unit(self, column: Column, meaning: str) -> str:
        """The column's unit, if its values are plausible in it; one that they suggest, if none."""
        row, length = QUANTITIES[meaning], self.bench["wire.length"]
        name, unit, span, known = column.name, column.unit, column.span, parse_unit(column.unit)
        if column.fields == 2:
            return self.ask(name, "fields")
        if known and known.quantity not in row["units"]:
            return self.ask(name, "other_unit", unit=unit, quantity=known.quantity, meaning=meaning)
        # A missing unit is guessed from the first time, the temperature at rest, the range of a
        # motion over the length of the wire, or else the largest value.
        finite = column.values[np.isfinite(column.values)]
        low, high = float(finite.min()), float(finite.max())
        rest = float(np.median(finite[: max(3, len(finite) // 100)]))
        seen = {"time": low, "temperature": rest, "ambient": rest,
                "length": (high - low) / (length or np.nan)}.get(meaning, max(abs(low), abs(high)))
        guess = next((str(u) for u, (a, b) in row.get("guess", {}).items() if a <= seen <= b), "")
        if known is None and (unit or not guess):
            return self.ask(name, "unknown_unit" if unit else "no_unit", span=span, unit=unit)
        if known is None:
            self.remarks[name] = f"no unit is given; {span} is taken as {guess!r}"
            return guess
        least, most = row["plausible"]
        low, high = known.si(np.array([low, high]))
        if known.quantity in ("time", "length"):  # their range counts
            low, high = 0.0, high - low
        if meaning == "length" and length:
            most = 0.2 * length
        if least <= low and high <= most and not 0.0 < high < row.get("least_peak", 0.0):
            return unit
        hint = f", or in {guess}" if guess else ""
        return self.ask(name, "implausible", span=span, unit=unit, hint=hint)

    def sign_and_zero(self, entry: Entry, read: Mapping[Entry, _Samples]) -> dict[str, Any]:
        """Sign and reference from physics: heat shortens a wire, and a wire cannot push."""
        of = {other.signal: samples for other, samples in read.items()}
        name, signal, nothing = entry.column, entry.signal, _Samples(np.zeros(0), np.zeros(0))
        own, force = of.get(signal, nothing), of.get("force", nothing)
        if signal == "deflection":
            return {"sign": self.ask(name, "which_side")}
        volts = of.get(signal.replace(".current", ".voltage"), nothing)
        if entry.kind == "current" and own.values.sum() * volts.values.sum() < 0.0:
            return {"sign": self.ask(name, "against")}
        if signal == "force" and len(own.values) and np.median(own.values) < 0.0:
            self.remarks[name] = "mostly negative: counted as compression"
            return {"sign": -1}
        if signal != "elongation" or load_kind(self.bench) == "displacement":
            return {}
        found: dict[str, Any] = {}
        if len(own.values) and any(other.kind in _DRIVES for other in read):
            before = _at_rest(read, own)
            if np.subtract(*np.percentile(before, (90, 10))) > _AT_REST * np.ptp(own.values):
                found["reference"] = self.ask(name, "moves_early")
            up, down = own.values.max() - np.median(before), np.median(before) - own.values.min()
            if max(up, down) > _CLEAR * min(up, down):
                self.remarks.setdefault(name, message("moves", way="up" if up > down else "down"))
                return {**found, "sign": -1 if up > down else 1}
        elif len(own.values) and len(force.values):
            with np.errstate(invalid="ignore"):
                pull = np.interp(own.time, force.time, force.values)
                along = np.sign(np.median(pull)) * float(np.corrcoef(own.values, pull)[0, 1])
            if abs(along) > 0.3:
                return {"sign": 1 if along > 0.0 else -1}
        return {**found, "sign": self.ask(name, "which_sign")}


def runs_of(file: TableFile) -> list[tuple[str, TableFile]]:
    """Runs of a file, with names: tables with equal titles are a run each, else all are one run."""
    shapes = [tuple((c.title, c.unit) for c in table.columns) for table in file.tables]
    alike = [t for t, shape in zip(file.tables, shapes, strict=True) if shapes.count(shape) > 1]
    outside = [*file.outside, *(f"sheet {t.name}" for t in file.tables if t not in alike)]
    runs = []
    for k, table in enumerate(alike):
        if k:  # `Voltage (2)`, unique in the file, is `Voltage` again
            own = (replace(c, name=re.sub(r" \(\d+\)\Z", "", c.name)) for c in table.columns)
            table = replace(table, columns=tuple(own))
        runs.append((table.name or f"{k + 1}", file.with_tables([table], () if k else outside)))
    return runs or [("", file)]


def together(files: Sequence[TableFile]) -> TableFile:
    """Files of one run as one, with the file in the names of its columns."""
    tables = []
    for stem, table in ((file.path.stem, table) for file in files for table in file.tables):
        columns = tuple(replace(c, name=f"{stem}: {c.name}", group=stem) for c in table.columns)
        ignored = {f"{stem}: {name}": reason for name, reason in table.ignored.items()}
        tables.append(replace(table, columns=columns, ignored=ignored))
    outside = [f"{file.path.name}: {line}" for file in files for line in file.outside]
    return replace(files[0], sha256=" ".join(f.sha256 for f in files)).with_tables(tables, outside)
