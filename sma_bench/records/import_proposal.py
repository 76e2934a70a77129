"""Proposes the map of another logger's table: from titles, units and ranges, with a question
wherever these leave room."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from sma_bench.errors import InputError
from sma_bench.records.import_map import (
    ASK,
    DUTY_SLACK,
    NAME,
    NONE,
    POSITIONS,
    REST,
    Entry,
    ImportMap,
    convert,
    in_si,
)
from sma_bench.records.record import FloatArray, Signal
from sma_bench.records.table_cells import Column, parse_unit
from sma_bench.records.tables import TableFile

_CLEAR = 3.0  # times as far one way as the other
_LONGEST_TIME = 30 * 86_400.0
# (lowest, highest) that a bench's reading in SI may be; the length is that of a movement.
_BELIEVABLE = {"voltage": (-60.0, 60.0), "current": (-30.0, 30.0), "temperature": (200.0, 900.0),
               "force": (-5e3, 5e3), "length": (-1.0, 1.0), "duty": (-DUTY_SLACK, 1.0 + DUTY_SLACK),
               "angle": (-100.0, 100.0), "ambient": (230.0, 330.0)}  # fmt: skip
_UNIT_OF = {"duty": "ratio", "ambient": "temperature"}  # quantity of its unit, where it differs

# What a title means: parts of words, whole words, in this order (English, German, French).
_MEANINGS: tuple[tuple[str, tuple[str, ...], frozenset[str]], ...] = (
    ("skip", ("setpoint", "soll", "target", "desired", "reference", "index"),
     frozenset({"sample", "samples", "nr", "no", "row", "step", "cycle", "zyklus"})),
    ("time", ("timestamp", "zeit", "elapsed"), frozenset({"t", "time", "temps", "clock"})),
    ("supply", ("supply", "versorg", "psu", "battery", "akku"), frozenset({"vcc"})),
    ("duty", ("duty", "pwm", "tastverh", "tastgrad"), frozenset({"dc"})),
    ("ambient", ("room", "raum", "ambient", "umgebung", "environment"), frozenset({"air"})),
    ("temperature", ("temp", "thermo"), frozenset()),
    ("current", ("current", "strom", "courant", "amps"), frozenset({"i"})),
    ("voltage", ("volt", "spannung"), frozenset({"u", "v"})),
    ("force", ("force", "kraft"), frozenset({"f", "load", "loadcell"})),
    ("angle", ("angle", "winkel", "theta", "rotation"), frozenset({"encoder"})),
    ("length", ("positi", "displac", "elong", "extens", "stroke", "weg", "auslenk", "slider",
                "deflect", "durchbieg", "laser", "contraction"),
     frozenset({"x", "y", "z", "pos", "disp", "tip", "hub"})),
)  # fmt: skip


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


def propose(table: TableFile, bench: BenchHints) -> tuple[ImportMap, list[str], dict[str, str]]:
    """A map of a table, what is unsure about it, and remarks by column.

    Raises:
        InputError: no column can be time.
    """
    proposal = _Proposal(table, bench)
    meanings = {column.name: _meaning(column) for column in table.columns}
    clocks = [column for column in table.columns if meanings[column.name] == "time"]
    if not clocks:
        titles = ", ".join(column.name for column in table.columns[:12])
        raise InputError(
            f"{table.path}: no time column among {titles}: its title should say time, or its unit s"
        )
    entries: list[Entry] = []
    ignored = [c.name for c in table.columns if meanings[c.name] in (None, "skip", "supply")]
    for column in table.columns:
        meaning = meanings[column.name]
        if meaning in (None, "skip", "supply", "time"):
            continue
        clock = _clock_of(column, clocks)
        entry = None if clock is None else _entry(proposal, column, str(meaning), clock.name)
        if entry is None or column.name in ignored:
            ignored.append(column.name)
        else:
            entries.append(entry)
    entries, doubled = _without_doubles(proposal, entries)
    supply = _supply(proposal, meanings, entries)
    lever = bench.lever if _has_angle(table, entries) else None
    if _has_angle(table, entries) and lever is None:
        lever = ASK  # type: ignore[assignment]
        proposal.ask("lever", "m of movement for a radian? load.lever of --params says it")
    used = {entry.clock for entry in entries}
    units = {c.name: _unit(proposal, c, "time") for c in clocks if c.name in used}
    unknown = [name for name in ignored if meanings[name] is None]
    made = ImportMap(units, tuple(entries), supply, lever, (*ignored, *doubled))
    _ask_for_missing(proposal, made, unknown)
    if not proposal.questions:
        made = _signed(proposal, made)
    return made, proposal.questions, proposal.remarks


def _meaning(column: Column) -> str | None:
    """What a column is by its title, and by its unit where the title says nothing."""
    unit = parse_unit(column.unit)
    named = _word_meaning(column.title) or _word_meaning(column.name)
    if unit is None or named in ("skip", "supply"):
        return named
    by_unit = {"ratio": "duty", "stress": None, "power": None, "resistance": None}
    meant = by_unit.get(unit.quantity, unit.quantity)
    if named and _UNIT_OF.get(named, named) == unit.quantity:
        return named
    return meant if named is None or meant != "duty" else named


def _word_meaning(title: str) -> str | None:
    lower = title.lower()
    words = set(re.findall(r"[^\W\d_]+", lower))
    for meaning, parts, whole in _MEANINGS:
        if words & whole or any(part in word for part in parts for word in words):
            return meaning
    return None


def _clock_of(column: Column, clocks: Sequence[Column]) -> Column | None:
    """The time column of as many rows whose place in the file is nearest."""
    fitting = [c for c in clocks if len(c.values) == len(column.values)]

    def nearness(clock: Column) -> int:
        pairs = zip(re.split(r"[./]", clock.name), re.split(r"[./]", column.name), strict=False)
        shared = 0
        for a, b in pairs:
            if a != b:
                break
            shared += 1
        return shared + 100 * (clock.group == column.group)

    return max(fitting, key=nearness, default=None)


def _entry(proposal: _Proposal, column: Column, meaning: str, clock: str) -> Entry | None:
    bench, quantity = proposal.bench, _UNIT_OF.get(meaning, meaning)
    if not np.isfinite(column.values).any():
        return None
    unit = _unit(proposal, column, meaning)
    if quantity in ("length", "angle"):
        signal = "deflection" if bench.is_beam else "elongation"
    elif meaning == "ambient":
        signal = "ambient.temperature"
    elif meaning == "force":
        signal = "force"
    else:
        channel = _channel(proposal, column)
        signal = f"{channel}.{'voltage' if meaning == 'duty' else meaning}"
    entry = Entry(signal, column.name, unit, clock)
    if meaning == "duty":
        return replace(entry, form="duty")
    if meaning == "voltage":
        return replace(entry, form=_form(proposal, column))
    return replace(entry, reference=REST) if signal in POSITIONS else entry


def _channel(proposal: _Proposal, column: Column) -> str:
    channels = proposal.bench.channels
    if len(channels) == 1:
        return channels[0]
    plain = re.sub(r"\W+", "_", column.name.lower())
    named = [channel for channel in channels if channel.lower() in plain]
    if len(named) == 1:
        return named[0]
    proposal.ask(column.name, f"which channel: {', '.join(channels)}?")
    return ASK


def _form(proposal: _Proposal, column: Column) -> str:
    """Whether volts are effective ones: on a switched supply a meter may show their mean."""
    said = f"{column.name} {column.title} {column.unit}".lower()
    if any(word in said for word in ("rms", "eff", "trms")):
        return "rms"
    if any(word in said for word in ("mean", "average", "mittel")):
        return "mean"
    if proposal.bench.drive == "duty":
        proposal.ask(column.name, "bench.drive is duty: are these volts rms or mean?")
        return ASK
    return "rms"


def _unit(proposal: _Proposal, column: Column, meaning: str) -> str:
    """The column's own unit where its values are believable in it, a guess where one is sure."""
    quantity = _UNIT_OF.get(meaning, meaning)
    known = parse_unit(column.unit)
    finite = column.values[np.isfinite(column.values)]
    span = f"{finite.min():.6g} to {finite.max():.6g}" if len(finite) else "nothing"
    if known is not None and known.quantity == quantity:
        if _is_believable(proposal, meaning, in_si(finite, known)):
            return column.unit
        guess = _guess(proposal, meaning, finite)
        hint = f", or in {guess}" if guess else ""
        proposal.ask(column.name, f"{span} in {column.unit!r} is beyond belief{hint}; which unit?")
        return ASK
    if column.unit and known is not None:
        proposal.ask(
            column.name, f"{column.unit!r} is a unit of {known.quantity}, the title says {meaning}"
        )
        return ASK
    guess = _guess(proposal, meaning, finite)
    if column.unit or guess is None:
        said = f"unit {column.unit!r} is not known" if column.unit else "no unit is given"
        proposal.ask(column.name, f"{said}, values are {span}; which unit?")
        return ASK
    proposal.remarks[column.name] = f"no unit is given; {span} is taken as {guess!r}"
    return guess


def _is_believable(proposal: _Proposal, meaning: str, values: FloatArray) -> bool:
    if not len(values):
        return True
    low, high = float(values.min()), float(values.max())
    if meaning == "time":
        return high - low < _LONGEST_TIME
    least, most = _BELIEVABLE[meaning]
    if meaning == "length":
        length = proposal.bench.wire_length
        return high - low < (0.2 * length if length and not proposal.bench.is_beam else most)
    return least <= low and high <= most


def _guess(proposal: _Proposal, meaning: str, values: FloatArray) -> str | None:
    """The one unit in which values without any make sense; None where it is open."""
    if not len(values):
        return None
    low, high = float(values.min()), float(values.max())
    largest = max(abs(low), abs(high))
    if meaning == "time":
        broken = bool(np.any(values != np.rint(values)))
        return "s" if broken and high - low < 1e5 else None
    if meaning == "duty":
        return "1" if 0.005 < largest <= 1.0 else "%" if 1.0 < largest <= 100.0 else None
    if meaning in ("temperature", "ambient"):
        rest = float(np.median(values[: max(3, len(values) // 100)]))
        return "degC" if 10.0 <= rest <= 45.0 else "K" if 283.0 <= rest <= 318.0 else None
    if meaning == "voltage":
        return "V" if 0.3 <= largest <= 60.0 else None
    if meaning == "current":
        return "A" if 0.02 <= largest <= 20.0 else None
    length = proposal.bench.wire_length
    if meaning == "length" and length:
        strains = {unit: (high - low) * factor / length for unit, factor in _LENGTHS.items()}
        fitting = [unit for unit, strain in strains.items() if 0.003 < strain < 0.12]
        return fitting[0] if len(fitting) == 1 else None
    return None


_LENGTHS = {"m": 1.0, "mm": 1e-3, "um": 1e-6}


def _without_doubles(
    proposal: _Proposal, entries: list[Entry]
) -> tuple[list[Entry], list[str]]:
    """One column a signal; that there are two is asked."""
    first: dict[str, Entry] = {}
    doubled: list[str] = []
    for entry in entries:
        other = first.setdefault(entry.signal, entry)
        if other is not entry and entry.signal.partition(".")[0] != ASK:
            doubled.append(entry.column)
            proposal.ask(
                entry.column, f"{other.column!r} could be {entry.signal} as well; which one?"
            )
    return [entry for entry in entries if entry.column not in doubled], doubled


def _supply(
    proposal: _Proposal, meanings: Mapping[str, str | None], entries: list[Entry]
) -> float | str | None:
    if not any(entry.form in ("duty", "mean") for entry in entries):
        return None
    if proposal.bench.supply_voltage is not None:
        return proposal.bench.supply_voltage
    for column in proposal.table.columns:
        unit = parse_unit(column.unit or "V")
        if meanings[column.name] == "supply" and unit and unit.quantity == "voltage":
            volts = float(np.nanmedian(in_si(column.values, unit)))
            proposal.remarks["supply_voltage"] = f"median of {column.name}"
            return volts
    proposal.ask("supply_voltage", "volts of the switched supply? bench.supply_voltage says it")
    return ASK


def _has_angle(table: TableFile, entries: Sequence[Entry]) -> bool:
    units = [parse_unit(entry.unit) for entry in entries if entry.signal in POSITIONS]
    return any(unit is not None and unit.quantity == "angle" for unit in units)


def _ask_for_missing(proposal: _Proposal, made: ImportMap, unknown: list[str]) -> None:
    names = {entry.signal.rpartition(".")[2] for entry in made.entries}
    moves, drives = bool(names & {*POSITIONS, "force"}), bool(names & {"voltage", "current"})
    rest = ", ".join(map(repr, unknown[:8])) or "no others"
    # A clamped wire moves nothing, and shows its heat and its resistance.
    clamped = "temperature" in names or {"voltage", "current"} <= names
    if not moves and (unknown or not clamped):
        proposal.ask("signals", f"no position or force recognised; the other columns: {rest}")
    if not drives and not {"elongation", "force"} <= names:
        proposal.ask("signals", f"no voltage, duty or current recognised; others: {rest}")


def _signed(proposal: _Proposal, made: ImportMap) -> ImportMap:
    """Signs from what is known of a wire: heat shortens it, and it cannot push."""
    signals = {signal.name: signal for signal in convert(proposal.table, made)[0]}
    drives = [s for n, s in signals.items() if n.endswith((".voltage", ".current"))]
    entries = []
    for entry in made.entries:
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
