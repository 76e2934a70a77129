"""Proposes the map of another logger's table: from titles, units and ranges, with a question
wherever these leave room."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from sma_bench.errors import InputError
from sma_bench.findings import Finding
from sma_bench.records.import_map import (
    ASK,
    DRIVEN,
    NAME,
    NONE,
    POSITIONS,
    REST,
    ROWS,
    Entry,
    ImportMap,
    account_of,
    convert,
)
from sma_bench.records.record import Record, Signal
from sma_bench.records.structure import Column
from sma_bench.records.tables import TableFile, read_table_file
from sma_bench.records.units import (
    QUANTITIES,
    WORDS,
    in_si,
    meanings,
    parse_unit,
    title_meanings,
    words_of,
)

_CLEAR = 3.0  # times as far one way as the other
_AT_REST = 0.1  # of all its way, what a position scatters before the first drive
_LONGEST_TIME = 30 * 86_400.0
_ROOMS = {"degC": (10.0, 45.0), "K": (283.0, 318.0)}  # at rest
_WHICH_SIGN = "sign: does it grow (1) or shrink (-1) as the wire lengthens?"


@dataclass(frozen=True)
class BenchHints:
    """What a rig file says that helps to understand a table; None where it says nothing."""

    channels: tuple[str, ...] = ("wire",)
    is_beam: bool = False
    drive: str | None = None
    supply_voltage: float | None = None
    lever: float | None = None
    wire_length: float | None = None


def bench_of(named: Mapping[str, Any], where: str) -> BenchHints:
    """The bench of a rig file's raw names (`read_parameter_names`); raises InputError for a value
    of another type than its own."""
    channels = named.get("bench.channels", ["wire"])
    are_names = isinstance(channels, (list, tuple)) and channels
    if not are_names or not all(isinstance(c, str) and NAME.match(c) for c in channels):
        raise InputError(f"{where}: bench.channels is {channels!r}, expected a list of names")
    numbers = {}
    for name in ("bench.supply_voltage", "load.lever", "wire.length"):
        value = named.get(name) or None  # 0, the default of a length, says nothing
        is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
        if value is not None and not (is_number and 0 <= value < np.inf):
            raise InputError(f"{where}: {name} is {value!r}, expected a number, 0 or more")
        numbers[name] = None if value is None else float(value)
    kind = named.get("load.kind") or ("beam" if len(channels) > 1 else "clamped")
    drive = named.get("bench.drive")
    is_beam, drive = kind in ("beam", "antagonist"), None if drive is None else str(drive)
    return BenchHints(tuple(channels), is_beam, drive, *numbers.values())


def propose(
    table: TableFile, bench: BenchHints, units: Mapping[str, str] | None = None
) -> tuple[ImportMap, list[str], dict[str, str]]:
    """A map of a table, what is unsure about it, and remarks by column. `units` of columns by name
    go before what titles say; raises InputError for a column that is not there."""
    units = units or {}
    held = [column.name for column in table.columns]
    if wrong := next((name for name in units if name not in held), None):
        raise InputError(f"{table.path}: no column {wrong!r}, it has {', '.join(held[:12])}")

    def stated(column: Column) -> Column:
        known = units.get(column.name)
        return replace(column, unit=known, fields=0) if known else column

    tables = [replace(t, columns=tuple(map(stated, t.columns))) for t in table.tables]
    proposal = _Proposal(replace(table, tables=tuple(tables)), bench)
    made = proposal.made()
    return made, proposal.questions, proposal.remarks


def record_of_table(path: str | Path, bench: BenchHints, units: Mapping[str, str]) -> Record:
    """The record of a logger's table, without a map in between; raises InputError as
    `read_table_file`, or where the table leaves a question."""
    table = read_table_file(path)
    made, questions, remarks = propose(table, bench, units)
    if questions:
        raise InputError(f"{path}: unsure of {questions[0]}; units= or params= may tell")
    signals, _, start_ns = convert(table, made)
    account = Finding("info", "account", str(account_of(table, made, remarks)))
    return Record(Path(path), start_ns, {s.name: s for s in signals}, findings=(account,))


def _is_running(column: Column) -> bool:
    """Whether a column goes on and never back."""
    values = column.values[np.isfinite(column.values)]
    return len(values) > 1 and bool(np.all(np.diff(values) >= 0.0)) and values[-1] > values[0]


def _agree(one: Column, other: Column) -> bool:
    """Whether two clocks count the same time, each in its unit; of one without unit, any."""
    first, second = (parse_unit(c.unit) for c in (one, other))
    if not np.array_equal(np.isfinite(one.values), there := np.isfinite(other.values)):
        return False
    a, b = one.values[there], other.values[there]
    if first is None or second is None:
        a, b = ((v - v[0]) / (np.ptp(v) or 1.0) for v in (a, b))
    else:
        a, b = a * first.factor, b * second.factor
        if one.fields or other.fields:  # a moment of the day, the other from its start
            a, b = a - a[0], b - b[0]
    coarse = max(float(np.diff(np.unique(v)).min(initial=np.inf)) for v in (a, b))
    return bool(np.max(np.abs(a - b)) <= 1.01 * coarse + 1e-3 * abs(a[-1]))


@dataclass
class _Proposal:
    """A map in the making, its questions and remarks (by column, or by key of the map)."""

    table: TableFile
    bench: BenchHints
    questions: list[str] = field(default_factory=list)
    remarks: dict[str, str] = field(default_factory=dict)

    def ask(self, where: str, question: str) -> str:
        """What stands in the map for an answer."""
        self.questions.append(f"{where!r}: {question}")
        self.remarks[where] = f"{self.remarks.get(where, '')} ASK: {question}".strip()
        return ASK

    def made(self) -> ImportMap:
        columns = self.table.columns
        meant = {column.name: self.meaning(column) for column in columns}
        unused = {c.name for c in columns if meant[c.name] is None}
        clocks = [c for c in columns if meant[c.name] == "time"]
        running = [c for c in clocks if _is_running(c)]
        for column in clocks:
            if column not in running:
                self.remarks[column.name] = "no clock: it stands still or goes back"
        entries: dict[str, Entry] = {}
        for column in columns:
            if column in clocks or column.name in unused:
                continue
            clock = self.clock_of(column, running or clocks)
            if clock is None and any(c.table != column.table for c in clocks):
                self.remarks[column.name] = "no clock in its table"
                unused.add(column.name)
                continue
            entry = self.entry(column, str(meant[column.name]), clock or ROWS)
            # One column a signal; that there are two is asked.
            other = entries.setdefault(entry.signal + column.name * (ASK in entry.signal), entry)
            if other is not entry:
                which = f"{other.column!r} could be {entry.signal} as well; which one?"
                self.ask(column.name, which)
                unused.add(column.name)
        found = tuple(entries.values())
        names = {entry.clock for entry in found} - {ASK}
        used = [c for c in clocks if c.name in names]
        ticking = {column.name: self.tick_unit(column) for column in used}
        if ROWS in names:
            titles = ", ".join(column.name for column in columns[:12])
            question = f"no time column among {titles}; which period, such as 0.1 s?"
            ticking[ROWS] = self.ask(ROWS, question)
        if len({column.start is None for column in used}) > 1:
            self.ask("time", "one clock has dates, another has none: which is before which?")
        for column in clocks:
            if column.name not in ticking:
                self.remarks.setdefault(column.name, "a clock that no signal uses")
                unused.add(column.name)
        in_order = tuple(c.name for c in columns if c.name in unused)
        made = ImportMap(ticking, found, self.supply(found), self.lever(found), in_order)

        # What is missing. A clamped wire moves nothing, and shows its heat and its resistance.
        kinds = {entry.kind for entry in found}
        unknown = [n for n in in_order if self.remarks.get(n) == _UNKNOWN]
        rest = ", ".join(map(repr, unknown[:8])) or "no others"
        clamped = "temperature" in kinds or {"voltage", "current"} <= kinds
        if not kinds & {*POSITIONS, "force"} and (unknown or not clamped):
            self.ask("signals", f"no position or force recognised; the other columns: {rest}")
        if not kinds & {"voltage", "current"} and not {"elongation", "force"} <= kinds:
            self.ask("signals", f"no voltage, duty or current recognised; others: {rest}")
        return self.signed(made)

    def meaning(self, column: Column) -> str | None:
        """What a column is, None where it makes no signal; where title and unit contradict, it is
        asked later."""
        if column.fields:
            return "time"
        meant = title_meanings(column.title) or title_meanings(column.name)
        found = meanings(column.title, column.unit) or meanings(column.name, column.unit) or meant
        named = found[0] if found else None
        words = set(words_of(column.title))
        unused = _UNKNOWN if named is None else QUANTITIES[named].get("unused")
        channel = any(c.lower() in column.name.lower() for c in self.bench.channels)
        if not (meant or unused or channel or named == "time" or words & set(WORDS["wire"])):
            self.ask(column.name, f"its title says nothing known: is it a {named}?")
        if named in ("voltage", "current") and words & set(WORDS["supplies"]):
            self.ask(column.name, "what the supply gives, or what the wire gets?")
        if named == "temperature" and re.fullmatch(r"[tT][cC]?[\s_]?0*([2-9]|1\d)", column.title):
            self.ask(column.name, "of the wire or of the room (ambient.temperature)?")
        if named == "temperature" and not column.unit and len(column.title) < 4:
            steps = np.diff(column.values)
            if _is_running(column) and np.ptp(steps) < 0.01 * abs(steps[0]):
                self.ask(column.name, "a temperature or a time?")
        if unused or not np.isfinite(column.values).any():
            self.remarks[column.name] = unused or "empty"
            return None
        return named

    def clock_of(self, column: Column, clocks: Sequence[Column]) -> str | None:
        """The clock of a column, None where its table has none: the only one, the nearest by path,
        the finest of several that agree, the nearest to the left in a table that begins with one;
        else "ask"."""
        size = len(column.values)
        fitting = [c for c in clocks if c.table == column.table and len(c.values) == size]

        def nearness(clock: Column) -> int:
            pairs = zip(*(re.split(r"[./]", c.name) for c in (clock, column)), strict=False)
            shared = [a == b for a, b in pairs]
            return [*shared, False].index(False) + 100 * (clock.group == column.group)

        if len({c.group for c in fitting}) > 1:
            best = max(map(nearness, fitting))
            fitting = [c for c in fitting if nearness(c) == best]
        if len(fitting) < 2:
            return fitting[0].name if fitting else None
        finest = max(fitting, key=lambda c: (c.unit != "", len(set(c.values)), c.start or 0.0))
        others = [c for c in fitting if c is not finest]
        agreeing = [c for c in others if _agree(finest, c)]
        for other in agreeing:
            self.remarks[other.name] = f"the same clock as {finest.name}, no better"
        if len(agreeing) == len(others):
            return finest.name
        # A clock a column: each speaks for the columns to its right.
        beside = self.table.tables[column.table].columns
        order = [c.name for c in beside if title_meanings(c.title) != ("counter",)]
        places = [order.index(c.name) for c in fitting]
        alike = len({re.sub(r"[\d\s()]+", "", c.title.lower()) for c in fitting}) == 1
        apart = places[0] == 0 and min(np.diff(places)) > 1
        if apart and (alike or len(fitting) * 2 == len(order)):
            return order[max(k for k in places if k < order.index(column.name))]
        names = " or ".join(repr(c.name) for c in fitting)
        return self.ask(column.name, f"which clock, {names}? they disagree")

    def tick_unit(self, column: Column) -> str:
        """The unit of a clock; asked where nothing states it."""
        values = column.values[np.isfinite(column.values)]
        span = f"{values.min():.6g} to {values.max():.6g}"
        known = parse_unit(column.unit)
        if column.fields == 2:
            return self.ask(column.name, "which unit: s if it shows mm:ss, min if hh:mm?")
        if known is not None and known.quantity == "time":
            if float(np.ptp(values)) * known.factor < _LONGEST_TIME:
                return column.unit
            return self.ask(column.name, f"{span} in {column.unit!r} is beyond belief; which unit?")
        for unit, scale in (("s", 1.0), ("ms", 1e3), ("us", 1e6), ("ns", 1e9)):
            if not column.unit and 1e9 * scale < values.min() and values.max() < 4e9 * scale:
                self.remarks[column.name] = f"no unit is given; {span} is {unit} since 1970"
                return unit
        said = f"unit {column.unit!r} is none of time" if column.unit else "no unit is given"
        return self.ask(column.name, f"{said}, values are {span}; which unit?")

    def entry(self, column: Column, meaning: str, clock: str) -> Entry:
        """The signal that a column is: its name, unit, form and reference."""
        bench, name = self.bench, column.name
        unit = self.unit(column, meaning)
        if meaning in ("length", "angle"):
            signal = "deflection" if bench.is_beam else "elongation"
            return Entry(signal, name, unit, clock, reference=REST)
        if meaning in ("ambient", "force"):
            signal = "force" if meaning == "force" else "ambient.temperature"
            return Entry(signal, name, unit, clock)
        plain, alone = re.sub(r"\W+", "_", name.lower()), len(bench.channels) == 1
        channels = [c for c in bench.channels if alone or c.lower() in plain]
        if len(channels) != 1:
            channels = [self.ask(name, f"which channel: {', '.join(bench.channels)}?")]
        if meaning == "duty":
            return Entry(f"{channels[0]}.voltage", name, unit, clock, form="duty")
        entry = Entry(f"{channels[0]}.{meaning}", name, unit, clock)
        if meaning == "temperature":
            return entry
        # Whether volts or amperes are effective ones: of a switched supply a meter may show their
        # mean, and an oscilloscope the peak of a current.
        said = " ".join(words_of(f"{name} {column.title} {column.unit}"))
        for form, words in WORDS["forms"].items():
            if any(word in said for word in words) and (form, meaning) != ("peak", "voltage"):
                return replace(entry, form=form)
        if bench.drive == "duty":
            what, peak = ("volts", "") if meaning == "voltage" else ("amperes", " or peak")
            question = f"bench.drive is duty: are these {what} rms or mean{peak}?"
            return replace(entry, form=self.ask(name, question))
        return entry

    def unit(self, column: Column, meaning: str) -> str:
        """The column's own unit where its values are believable in it, the one unit in which values
        without any make sense; else it is asked."""
        row, bench, known = QUANTITIES[meaning], self.bench, parse_unit(column.unit)
        if known is not None and known.quantity not in row["units"]:
            said = f"{column.unit!r} is a unit of {known.quantity}, the title says {meaning}"
            return self.ask(column.name, said)
        finite = column.values[np.isfinite(column.values)]
        low, high = float(finite.min()), float(finite.max())
        span = f"{low:.6g} to {high:.6g}"
        fitting: list[str] = []
        if meaning in ("temperature", "ambient"):
            rest = float(np.median(finite[: max(3, len(finite) // 100)]))
            fitting = [u for u, (least, most) in _ROOMS.items() if least <= rest <= most]
        elif meaning == "length" and bench.wire_length:
            share = (high - low) / bench.wire_length
            steps = {"m": 1.0, "mm": 1e-3, "um": 1e-6}
            fitting = [unit for unit, step in steps.items() if 0.003 < share * step < 0.12]
        elif "guess" in row:
            unit, least, most = row["guess"]
            fitting = [unit] if least <= max(abs(low), abs(high)) <= most else []
        guess = fitting[0] if len(fitting) == 1 else ""
        if known is None:
            if guess and not column.unit:
                self.remarks[column.name] = f"no unit is given; {span} is taken as {guess!r}"
                return guess
            said = f"unit {column.unit!r} is not known" if column.unit else "no unit is given"
            return self.ask(column.name, f"{said}, values are {span}; which unit?")
        least, most = row["believable"]
        si = in_si(np.array([low, high]), known)
        if meaning == "length" and known.quantity == "length":  # of a movement
            longest = 0.2 * bench.wire_length if bench.wire_length and not bench.is_beam else most
            si = np.array([0.0, (si[1] - si[0]) * most / longest])
        if least <= si[0] and si[1] <= most:
            return column.unit
        hint = f", or in {guess}" if guess else ""
        return self.ask(
            column.name, f"{span} in {column.unit!r} is beyond belief{hint}; which unit?"
        )

    def supply(self, entries: Sequence[Entry]) -> float | str | None:
        """Volts of a switched supply."""
        if not any(e.form == "duty" or (e.form == "mean" and e.kind == "voltage") for e in entries):
            return None
        if self.bench.supply_voltage is not None:
            return self.bench.supply_voltage
        for column in self.table.columns:
            unit = parse_unit(column.unit or "V")
            is_supply = self.remarks.get(column.name) == QUANTITIES["supply"]["unused"]
            if is_supply and unit and unit.quantity == "voltage":
                self.remarks["supply_voltage"] = f"median of {column.name}"
                return float(np.nanmedian(in_si(column.values, unit)))
        question = "volts of the switched supply? bench.supply_voltage says it"
        return self.ask("supply_voltage", question)

    def lever(self, entries: Sequence[Entry]) -> float | str | None:
        """How an angle moves the wire."""
        units = [parse_unit(entry.unit) for entry in entries if entry.signal in POSITIONS]
        if not any(unit is not None and unit.quantity == "angle" for unit in units):
            return None
        question = "m of movement for a radian? load.lever of --params says it"
        return self.bench.lever or self.ask("lever", question)

    def signed(self, made: ImportMap) -> ImportMap:
        """Signs from what is known of a wire: heat shortens it, and it cannot push. They are the
        same whatever is answered to the questions so far."""
        si = {"voltage": "V", "current": "A", "temperature": "K", "force": "N"}
        known = [
            replace(e, unit=si.get(e.kind, "m") if e.unit == ASK else e.unit, form="rms")
            for e in made.entries
            if e.clock != ASK
        ]
        ticks = {c: u if u != ASK else "1 s" if c == ROWS else "s" for c, u in made.clocks.items()}
        lever = 1.0 if made.lever == ASK else made.lever
        trial = replace(made, clocks=ticks, entries=tuple(known), lever=lever)
        signals: dict[str, Signal] = {}
        try:
            signals = {s.name: s for s in convert(self.table, trial)[0]} if known else {}
        except InputError:
            if not self.questions:
                raise
        entries = []
        for entry in made.entries:
            own = signals.get(entry.signal)
            volts = signals.get(f"{entry.signal.rpartition('.')[0]}.voltage")
            if entry.signal in POSITIONS:
                entry = self.signed_position(entry, signals)
            elif own is None:
                pass
            elif entry.kind == "current" and volts and own.values.sum() * volts.values.sum() < 0.0:
                how = "against the voltage, as a battery counts a discharge"
                sign = self.ask(entry.column, f"{how}: sign -1, or is the wire fed back (1)?")
                entry = replace(entry, sign=sign)
            elif entry.signal == "force" and float(np.median(own.values)) < 0.0:
                entry = replace(entry, sign=-1)
                self.remarks[entry.column] = "mostly negative: counted as compression"
            entries.append(entry)
        return replace(made, entries=tuple(entries))

    def signed_position(self, entry: Entry, signals: Mapping[str, Signal]) -> Entry:
        if entry.signal == "deflection":
            question = "sign: does it grow toward the front (1) or the back (-1)?"
            return replace(entry, sign=self.ask(entry.column, question))
        moved, force = signals.get(entry.signal), signals.get("force")
        drives = [s for name, s in signals.items() if name.endswith((".voltage", ".current"))]
        if moved is None or (force is None and not drives):
            return replace(entry, sign=self.ask(entry.column, _WHICH_SIGN))
        if force is None or drives:
            sets_in = min(
                s.time[np.argmax(np.abs(s.values) > DRIVEN * np.abs(s.values).max())]
                for s in drives
            )
            before, span = moved.values[moved.time <= sets_in], float(np.ptp(moved.values))
            if len(before) and np.subtract(*np.percentile(before, (90, 10))) > _AT_REST * span:
                question = "it moves before the first drive: which reference, a number or none?"
                entry = replace(entry, reference=self.ask(entry.column, question))
            up, down = (max(float(v.max()), 0.0) for v in (moved.values, -moved.values))
            if max(up, down) <= _CLEAR * min(up, down):
                return replace(entry, sign=self.ask(entry.column, _WHICH_SIGN))
            way = f"moves {'up' if up > down else 'down'} when driven, and heat shortens a wire"
            said = f"{self.remarks.get(entry.column, '')} {way}; zero: rest before the first drive"
            self.remarks[entry.column] = said.strip()
            return replace(entry, sign=-1 if up > down else 1)
        pull = np.interp(moved.time, force.time, force.values)
        pull = -pull if float(np.median(force.values)) < 0.0 else pull  # as its own sign is chosen
        with np.errstate(invalid="ignore"):
            along = float(np.corrcoef(moved.values, pull)[0, 1])
        if not abs(along) > 0.3:
            return replace(entry, sign=self.ask(entry.column, _WHICH_SIGN))
        near_zero = abs(float(moved.values[0])) <= 0.05 * float(np.ptp(moved.values))
        reference = NONE if near_zero else REST
        return replace(entry, sign=1 if along > 0 else -1, reference=reference)


_UNKNOWN = "its title and unit say nothing of a bench"
