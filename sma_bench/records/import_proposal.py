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
from sma_bench.records.cells import Column
from sma_bench.records.import_map import (
    ASK,
    DUTY_SLACK,
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
from sma_bench.records.tables import TableFile, read_table_file
from sma_bench.records.units import fits, in_si, parse_unit, plain_title, title_meanings

_CLEAR = 3.0  # times as far one way as the other
_LONGEST_TIME = 30 * 86_400.0
# (lowest, highest) that a bench's reading in SI may be; the length is that of a movement.
_BELIEVABLE = {"voltage": (-60.0, 60.0), "current": (-30.0, 30.0), "temperature": (230.0, 900.0),
               "force": (-5e3, 5e3), "length": (-1.0, 1.0), "duty": (-DUTY_SLACK, 1.0 + DUTY_SLACK),
               "angle": (-100.0, 100.0), "ambient": (230.0, 330.0)}  # fmt: skip
_UNIT_OF = {"duty": "ratio", "ambient": "temperature"}  # quantity of its unit, where it differs
# Unit of values without one, where their largest lies between these: no bench's do in another.
_GUESSES = {"duty": ("1", 0.005, 1.0), "voltage": ("V", 0.3, 60.0), "current": ("A", 0.02, 20.0)}
_FORM_WORDS = {"rms": ("rms", "eff"), "peak": ("peak", "spitze"),
               "mean": ("mean", "average", "mittel", "avg", "moyen", "medi")}  # fmt: skip


@dataclass(frozen=True)
class BenchHints:
    """What a rig file says that helps to understand a table; None where it says nothing."""

    channels: tuple[str, ...] = ("wire",)
    is_beam: bool = False
    drive: str | None = None
    supply_voltage: float | None = None
    lever: float | None = None
    wire_length: float | None = None


@dataclass
class _Proposal:
    """A map in the making, its questions and remarks (by column, or by key of the map)."""

    table: TableFile
    bench: BenchHints
    questions: list[str] = field(default_factory=list)
    remarks: dict[str, str] = field(default_factory=dict)

    def ask(self, where: str, question: str) -> None:
        self.questions.append(f"{where!r}: {question}")
        self.remarks[where] = f"{self.remarks.get(where, '')} ASK: {question}".strip()


def bench_of(named: Mapping[str, Any], where: str) -> BenchHints:
    """The bench of a rig file's raw names (`read_parameter_names`).

    Raises:
        InputError: a value of another type than its own.
    """
    def number(name: str) -> float | None:
        value = named.get(name)
        if value is not None and (isinstance(value, bool) or not isinstance(value, (int, float))
                                  or not 0 <= value < np.inf):
            raise InputError(f"{where}: {name} is {value!r}, expected a number, 0 or more")
        return float(value) if value else None  # 0, the default of a length, says nothing

    channels = named.get("bench.channels", ["wire"])
    if not isinstance(channels, (list, tuple)) or not channels or not all(
        isinstance(channel, str) and NAME.match(channel) for channel in channels
    ):
        raise InputError(f"{where}: bench.channels is {channels!r}, expected a list of names")
    kind = named.get("load.kind") or ("beam" if len(channels) > 1 else "clamped")
    drive = named.get("bench.drive")
    return BenchHints(
        tuple(channels), kind in ("beam", "antagonist"), None if drive is None else str(drive),
        number("bench.supply_voltage"), number("load.lever"), number("wire.length"),
    )


def propose(
    table: TableFile, bench: BenchHints, units: Mapping[str, str] | None = None
) -> tuple[ImportMap, list[str], dict[str, str]]:
    """A map of a table, what is unsure about it, and remarks by column.

    Args:
        table: as read; bench: what is known of the rig.
        units: of columns by name, before what their titles say.

    Raises:
        InputError: a unit for a column that is not there.
    """
    if units:
        held = [column.name for column in table.columns]
        if wrong := next((name for name in units if name not in held), None):
            raise InputError(f"{table.path}: no column {wrong!r}, it has {', '.join(held[:12])}")
        tables = tuple(replace(t, columns=tuple(
            replace(c, unit=units.get(c.name, c.unit), fields=0 if c.name in units else c.fields)
            for c in t.columns)) for t in table.tables)  # fmt: skip
        table = replace(table, tables=tables)
    proposal = _Proposal(table, bench)
    meanings = {column.name: _meaning(proposal, column) for column in table.columns}
    clocks = [column for column in table.columns if meanings[column.name] == "time"]
    running = [c for c in clocks if _is_running(c)]
    for column in clocks:
        if column not in running:
            proposal.remarks[column.name] = "no clock: it stands still or goes back"
    entries: list[Entry] = []
    used: dict[str, Column] = {}
    unused = [c.name for c in table.columns if meanings[c.name] in _UNUSED]
    for column in table.columns:
        meaning = meanings[column.name]
        if meaning in _UNUSED or meaning == "time":
            continue
        if not np.isfinite(column.values).any():
            proposal.remarks[column.name] = "empty"
            unused.append(column.name)
            continue
        ticks = _clock_of(proposal, column, running or clocks)
        if isinstance(ticks, Column):
            used[ticks.name] = ticks
        elif ticks is None and clocks and any(c.table != column.table for c in clocks):
            proposal.remarks[column.name] = "no clock in its table"
            unused.append(column.name)
            continue
        name = ROWS if ticks is None else ticks if isinstance(ticks, str) else ticks.name
        entries.append(_entry(proposal, column, str(meaning), name))

    # One column a signal; that there are two is asked.
    first: dict[str, Entry] = {}
    doubled: list[str] = []
    for entry in entries:
        other = first.setdefault(entry.signal, entry)
        if other is not entry and entry.signal.partition(".")[0] != ASK:
            doubled.append(entry.column)
            proposal.ask(
                entry.column, f"{other.column!r} could be {entry.signal} as well; which one?"
            )
    entries = [entry for entry in entries if entry.column not in doubled]

    # What a switched supply gives, and how an angle moves the wire.
    supply: float | str | None = None
    lever: float | str | None = None
    if any(e.form == "duty" or (e.form == "mean" and "voltage" in e.signal) for e in entries):
        supply = bench.supply_voltage
        for column in table.columns:
            unit = parse_unit(column.unit or "V")
            if supply is None and meanings[column.name] == "supply" and unit and (
                unit.quantity == "voltage"
            ):
                supply = float(np.nanmedian(in_si(column.values, unit)))
                proposal.remarks["supply_voltage"] = f"median of {column.name}"
        if supply is None:
            supply = ASK
            text = "volts of the switched supply? bench.supply_voltage says it"
            proposal.ask("supply_voltage", text)
    turned = [parse_unit(entry.unit) for entry in entries if entry.signal in POSITIONS]
    if any(unit is not None and unit.quantity == "angle" for unit in turned):
        lever = bench.lever if bench.lever is not None else ASK
        if lever == ASK:
            proposal.ask("lever", "m of movement for a radian? load.lever of --params says it")

    # The units of the clocks in use.
    named = {entry.clock for entry in entries}
    ticking = {name: _tick_unit(proposal, column) for name, column in used.items() if name in named}
    if ROWS in named:
        ticking[ROWS] = ASK
        titles = ", ".join(column.name for column in table.columns[:12])
        proposal.ask(ROWS, f"no time column among {titles}; which period, such as 0.1 s?")
    if len({column.start is None for column in used.values()}) > 1:
        proposal.ask("time", "one clock has dates, another has none: which is before which?")
    spare = [c.name for c in clocks if c.name not in ticking]
    for name in spare:
        proposal.remarks.setdefault(name, "a clock that no signal uses")
    made = ImportMap(ticking, tuple(entries), supply, lever, (*unused, *spare, *doubled))

    # What is missing. A clamped wire moves nothing, and shows its heat and its resistance.
    names = {entry.signal.rpartition(".")[2] for entry in entries}
    unknown = [name for name in unused if meanings[name] is None]
    rest = ", ".join(map(repr, unknown[:8])) or "no others"
    clamped = "temperature" in names or {"voltage", "current"} <= names
    if not names & {*POSITIONS, "force"} and (unknown or not clamped):
        proposal.ask("signals", f"no position or force recognised; the other columns: {rest}")
    if not names & {"voltage", "current"} and not {"elongation", "force"} <= names:
        proposal.ask("signals", f"no voltage, duty or current recognised; others: {rest}")
    if not proposal.questions:
        made = _signed(proposal, made)
    return made, proposal.questions, proposal.remarks


def record_of_table(path: str | Path, bench: BenchHints, units: Mapping[str, str]) -> Record:
    """The record of a logger's table, without a map in between.

    Raises:
        InputError: as `read_table_file`, or where the table leaves a question.
    """
    table = read_table_file(path)
    made, questions, remarks = propose(table, bench, units)
    if questions:
        raise InputError(f"{path}: unsure of {questions[0]}; units= or params= may tell")
    signals, _, start_ns = convert(table, made)
    account = Finding("info", "account", str(account_of(table, made, remarks)))
    return Record(Path(path), start_ns, {s.name: s for s in signals}, findings=(account,))


# Meanings that make no signal, and why.
_UNUSED: dict[str | None, str] = {
    None: "its title and unit say nothing of a bench", "counter": "a counter",
    "setpoint": "a set value, not a reading", "supply": "of the supply, not of a wire",
    "heat flow": "heat flow is no signal of a bench", "strain": "strain is no elongation",
    "stress": "stress is no force", "power": "power is not used",
    "resistance": "resistance is not used: voltage and current are",
}  # fmt: skip
_WIRE = frozenset({"wire", "draht", "fil", "filo", "hilo", "sma", "niti", "muscle"})


def _meaning(proposal: _Proposal, column: Column) -> str | None:
    """What a column is, by its title and its unit; where they contradict, it is asked later."""
    if column.fields:
        return "time"
    unit = parse_unit(column.unit)
    meant = title_meanings(column.title) or title_meanings(column.name)
    named: str | None = meant[0] if meant else None
    if unit is not None and named not in ("counter", "setpoint"):
        fitting = [m for m in meant if fits(m, unit.quantity)]
        if fitting:
            named = fitting[0]
        elif named is None or len(column.title) == 1 or named in ("ambient", "supply"):
            by_unit = unit.quantity if unit.quantity in _SIGNALS else None
            words = set(re.findall(r"[^\W\d_]+", plain_title(column.title)))
            channel = any(c.lower() in column.name.lower() for c in proposal.bench.channels)
            if by_unit not in (None, "time") and named is None and not (words & _WIRE or channel):
                proposal.ask(column.name, f"its title says nothing known: is it a {by_unit}?")
            named = by_unit
    if named == "temperature" and re.fullmatch(r"[tT][cC]?[\s_]?0*([2-9]|1\d)", column.title):
        proposal.ask(column.name, "of the wire or of the room (ambient.temperature)?")
    if named == "temperature" and not column.unit and len(column.title) < 4 and _is_running(column):
        steps = np.diff(column.values)
        if np.ptp(steps) < 0.01 * abs(steps[0]):
            proposal.ask(column.name, "a temperature or a time?")
    if named in _UNUSED:
        proposal.remarks[column.name] = _UNUSED[named]
    return named


_SIGNALS = frozenset({"time", "voltage", "current", "temperature", "length", "force", "angle"})


def _is_running(column: Column) -> bool:
    """Whether a column goes on and never back."""
    values = column.values[np.isfinite(column.values)]
    return len(values) > 1 and bool(np.all(np.diff(values) >= 0.0)) and values[-1] > values[0]


def _clock_of(
    proposal: _Proposal, column: Column, clocks: Sequence[Column]
) -> Column | str | None:
    """The clock of a column, None where its table has none: the only one, the nearest by path, the
    finest of several that agree, the nearest to the left in a table that begins with one; else
    "ask"."""
    fitting = [c for c in clocks if c.table == column.table and
               len(c.values) == len(column.values)]  # fmt: skip

    def nearness(clock: Column) -> int:
        pairs = zip(re.split(r"[./]", clock.name), re.split(r"[./]", column.name), strict=False)
        shared = 0
        for a, b in pairs:
            if a != b:
                break
            shared += 1
        return shared + 100 * (clock.group == column.group)

    if len(fitting) > 1 and len({c.group for c in fitting}) > 1:
        best = max(map(nearness, fitting))
        fitting = [c for c in fitting if nearness(c) == best]
    if len(fitting) < 2:
        return fitting[0] if fitting else None
    finest = max(fitting, key=lambda c: (c.unit != "", len(np.unique(c.values)), c.start or 0.0))
    agreeing = [c for c in fitting if _agree(finest, c)]
    for other in agreeing:
        if other is not finest:
            proposal.remarks[other.name] = f"the same clock as {finest.name}, no better"
    if len(agreeing) == len(fitting):
        return finest
    # A clock a column: each speaks for the columns to its right.
    order = list(proposal.table.tables[column.table].columns)
    places = [order.index(c) for c in fitting]
    alike = {re.sub(r"[\d\s(]+\)?", "", c.title.lower()) for c in fitting}
    if places[0] == 0 and all(b - a > 1 for a, b in zip(places, places[1:], strict=False)) and (
        len(alike) == 1 or len(fitting) * 2 == len(order)
    ):
        return [c for c, k in zip(fitting, places, strict=True) if k < order.index(column)][-1]
    names = " or ".join(repr(c.name) for c in fitting)
    proposal.ask(column.name, f"which clock, {names}? they disagree")
    return ASK


def _agree(one: Column, other: Column) -> bool:
    """Whether two clocks count the same time, each in its unit; of one without unit, any."""
    first, second = (parse_unit(c.unit) for c in (one, other))
    both = np.isfinite(one.values) & np.isfinite(other.values)
    if not both.any() or np.isfinite(one.values).sum() != np.isfinite(other.values).sum():
        return False
    a, b = one.values[both], other.values[both]
    if first is None or second is None:
        a, b = (a - a[0]) / (np.ptp(a) or 1.0), (b - b[0]) / (np.ptp(b) or 1.0)
    else:
        a, b = a * first.factor, b * second.factor
        if one.fields or other.fields:  # a moment of the day, the other from its start
            a, b = a - a[0], b - b[0]
    coarse = [float(np.diff(np.unique(v)).min()) if len(np.unique(v)) > 1 else 0.0 for v in (a, b)]
    return bool(np.max(np.abs(a - b)) <= 1.01 * max(coarse) + 1e-3 * abs(a[-1]))


def _tick_unit(proposal: _Proposal, column: Column) -> str:
    """The unit of a clock; asked where nothing states it."""
    values = column.values[np.isfinite(column.values)]
    span = f"{values.min():.6g} to {values.max():.6g}"
    known = parse_unit(column.unit)
    if column.fields == 2:
        proposal.ask(column.name, "which unit: s where the clock shows mm:ss, min where hh:mm?")
        return ASK
    if known is not None and known.quantity == "time":
        if float(np.ptp(values)) * known.factor < _LONGEST_TIME:
            return column.unit
        proposal.ask(column.name, f"{span} in {column.unit!r} is beyond belief; which unit?")
        return ASK
    for unit, scale in (("s", 1.0), ("ms", 1e3), ("us", 1e6), ("ns", 1e9)):
        if not column.unit and 1e9 * scale < values.min() and values.max() < 4e9 * scale:
            proposal.remarks[column.name] = f"no unit is given; {span} is {unit} since 1970"
            return unit
    said = f"unit {column.unit!r} is none of time" if column.unit else "no unit is given"
    proposal.ask(column.name, f"{said}, values are {span}; which unit?")
    return ASK


def _entry(proposal: _Proposal, column: Column, meaning: str, clock: str) -> Entry:
    """The signal that a column is: its name, unit, form and reference."""
    bench = proposal.bench
    unit = _unit(proposal, column, meaning)
    if meaning in ("length", "angle"):
        signal = "deflection" if bench.is_beam else "elongation"
        return Entry(signal, column.name, unit, clock, reference=REST)
    if meaning in ("ambient", "force"):
        signal = "force" if meaning == "force" else "ambient.temperature"
        return Entry(signal, column.name, unit, clock)
    plain = re.sub(r"\W+", "_", column.name.lower())
    channels = [c for c in bench.channels if len(bench.channels) == 1 or c.lower() in plain]
    if len(channels) != 1:
        proposal.ask(column.name, f"which channel: {', '.join(bench.channels)}?")
    channel = channels[0] if len(channels) == 1 else ASK
    entry = Entry(f"{channel}.{'voltage' if meaning == 'duty' else meaning}", column.name, unit,
                  clock, form="duty" if meaning == "duty" else "rms")  # fmt: skip
    if meaning not in ("voltage", "current"):
        return entry
    # Whether volts or amperes are effective ones: of a switched supply a meter may show their mean,
    # and an oscilloscope the peak of a current.
    said = plain_title(f"{column.name} {column.title} {column.unit}")
    for form, words in _FORM_WORDS.items():
        if any(word in said for word in words) and (form != "peak" or meaning == "current"):
            return replace(entry, form=form)
    if bench.drive == "duty":
        what, peak = ("volts", "") if meaning == "voltage" else ("amperes", " or peak")
        proposal.ask(column.name, f"bench.drive is duty: are these {what} rms or mean{peak}?")
        return replace(entry, form=ASK)
    return entry


def _unit(proposal: _Proposal, column: Column, meaning: str) -> str:
    """The column's own unit where its values are believable in it, a guess where one is sure."""
    quantity, bench = _UNIT_OF.get(meaning, meaning), proposal.bench
    known = parse_unit(column.unit)
    if known is not None and {known.quantity, quantity} == {"angle", "length"}:
        quantity = known.quantity
    if column.unit and known is not None and known.quantity != quantity:
        proposal.ask(
            column.name, f"{column.unit!r} is a unit of {known.quantity}, the title says {meaning}"
        )
        return ASK
    finite = column.values[np.isfinite(column.values)]
    low, high = float(finite.min()), float(finite.max())
    span = f"{low:.6g} to {high:.6g}"

    # The one unit in which values without any make sense; None where it is open.
    guess = None
    if meaning in ("temperature", "ambient"):
        rest = float(np.median(finite[: max(3, len(finite) // 100)]))
        guess = "degC" if 10.0 <= rest <= 45.0 else "K" if 283.0 <= rest <= 318.0 else None
    elif meaning == "length" and bench.wire_length:
        fitting = [unit for unit, factor in (("m", 1.0), ("mm", 1e-3), ("um", 1e-6))
                   if 0.003 < (high - low) * factor / bench.wire_length < 0.12]  # fmt: skip
        guess = fitting[0] if len(fitting) == 1 else None
    elif meaning in _GUESSES:
        unit, least, most = _GUESSES[meaning]
        guess = unit if least <= max(abs(low), abs(high)) <= most else None

    if known is not None:
        least, most = _BELIEVABLE[meaning]
        si = in_si(np.array([low, high]), known)
        if meaning == "length":  # of a movement
            is_wire = bench.wire_length and not bench.is_beam
            believed = si[1] - si[0] < (0.2 * (bench.wire_length or 0.0) if is_wire else most)
        else:
            believed = least <= si[0] and si[1] <= most
        if believed:
            return column.unit
        hint = f", or in {guess}" if guess else ""
        proposal.ask(column.name, f"{span} in {column.unit!r} is beyond belief{hint}; which unit?")
        return ASK
    if column.unit or guess is None:
        said = f"unit {column.unit!r} is not known" if column.unit else "no unit is given"
        proposal.ask(column.name, f"{said}, values are {span}; which unit?")
        return ASK
    proposal.remarks[column.name] = f"no unit is given; {span} is taken as {guess!r}"
    return guess


def _signed(proposal: _Proposal, made: ImportMap) -> ImportMap:
    """Signs from what is known of a wire: heat shortens it, and it cannot push."""
    signals = {signal.name: signal for signal in convert(proposal.table, made)[0]}
    drives = [s for n, s in signals.items() if n.endswith((".voltage", ".current"))]
    entries = []
    for entry in made.entries:
        channel, _, kind = entry.signal.rpartition(".")
        if kind == "current" and f"{channel}.voltage" in signals:
            amps, volts = signals[entry.signal], signals[f"{channel}.voltage"]
            if float(np.sum(amps.values)) * float(np.sum(volts.values)) < 0.0:
                proposal.ask(entry.column, "against the voltage, as a battery counts a discharge: "
                             "sign -1, or is the wire fed back (1)?")  # fmt: skip
                entry = replace(entry, sign=ASK)
        if entry.signal == "force" and float(np.median(signals["force"].values)) < 0.0:
            entry = replace(entry, sign=-1)
            proposal.remarks[entry.column] = "mostly negative: counted as compression"
        if entry.signal in POSITIONS:
            entry = _signed_position(proposal, entry, signals, drives)
        entries.append(entry)
    return replace(made, entries=tuple(entries))


def _signed_position(
    proposal: _Proposal, entry: Entry, signals: Mapping[str, Signal], drives: list[Signal]
) -> Entry:
    moved = signals[entry.signal]
    if entry.signal == "deflection":
        proposal.ask(entry.column, "sign: does it grow toward the front (1) or the back (-1)?")
        return replace(entry, sign=ASK)
    if drives:
        up, down = max(float(moved.values.max()), 0.0), max(-float(moved.values.min()), 0.0)
        way = "moves up" if up > down else "moves down"
        if max(up, down) > _CLEAR * min(up, down):
            proposal.remarks[entry.column] = (
                f"{proposal.remarks.get(entry.column, '')} {way} when driven, and heat shortens a "
                "wire; zero: rest before the first drive"
            ).strip()
            return replace(entry, sign=-1 if up > down else 1)
        proposal.ask(entry.column, "sign: does it grow (1) or shrink (-1) as the wire lengthens?")
        return replace(entry, sign=ASK)
    force = signals["force"]
    pull = np.interp(moved.time, force.time, force.values)
    pull = -pull if float(np.median(force.values)) < 0.0 else pull  # as its own sign is chosen
    with np.errstate(invalid="ignore"):
        together = float(np.corrcoef(moved.values, pull)[0, 1])
    if not abs(together) > 0.3:
        proposal.ask(entry.column, "sign: does it grow (1) or shrink (-1) as the wire lengthens?")
        return replace(entry, sign=ASK)
    near_zero = abs(float(moved.values[0])) <= 0.05 * float(np.ptp(moved.values))
    return replace(entry, sign=1 if together > 0 else -1, reference=NONE if near_zero else REST)
