"""Opens bags and instrument files as records, and describes what they hold."""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sma_bench.arrays import Array
from sma_bench.errors import InputError
from sma_bench.findings import Finding
from sma_bench.records.bag import read_record
from sma_bench.records.check import check_record
from sma_bench.records.instruments import DscRecord, IsobaricRecord, TensileRecord
from sma_bench.records.record import Record
from sma_bench.records.storage import is_bag

if TYPE_CHECKING:
    from sma_bench.records.tables import TableFile

AnyRecord = Record | DscRecord | IsobaricRecord | TensileRecord


def open_records(path: str | Path, namespace: str | None = None,
                 stated: Mapping[str, float] | None = None) -> list[AnyRecord]:
    """Read a bag (of the bench in `namespace`) or an instrument's file, each sheet of which may be
    a record. `stated`: numbers that the file lacks, in SI: `stress`, `force`, `mass`,
    `gauge_length`, `area`, `diameter`, `temperature`. InputError: it is neither, and why."""
    path = Path(path)
    if is_bag(path):
        return [read_record(path, namespace)]
    # The readers of tables are loaded for tables only.
    from sma_bench.records import instrument_files as files
    from sma_bench.records.tables import read_table_file
    file = read_table_file(path)
    sheets = [files.Sheet(file, table, stated or {}).with_signals() for table in file.tables]
    found = (files.isobaric_of(s) or files.tensile_of(s) or files.dsc_of(s) for s in sheets)
    if records := list[AnyRecord](filter(None, found)):
        return records
    raise InputError(f"{path}: {_why_no_record(file, stated or {})}")


def parse_stated(texts: Iterable[str]) -> dict[str, float]:
    """Values, in SI units, of texts such as `stress=200 MPa`. InputError: unknown name or unit."""
    from sma_bench.records.cells import WORDS, number_with_unit
    known: dict[str, Any] = WORDS["stated"]
    found: dict[str, float] = {}
    for text in texts:
        name = text.partition("=")[0].strip().replace("-", "_")
        if name not in known:
            raise InputError(f"{text!r}: expected one of {', '.join(known)}, e.g. mass=12 mg")
        quantity = known[name]["quantity"]
        value = number_with_unit(text, quantity)
        if value is None or not 0.0 < value < np.inf:
            raise InputError(f"{text!r}: expected a number like 1000.5 with a unit of {quantity}")
        found[name] = value
    return found


def open_record(path: str | Path, namespace: str | None = None,
                stated: Mapping[str, float] | None = None) -> AnyRecord:
    """As `open_records`, but one record: the first, with a warning if there are more."""
    first, *others = open_records(path, namespace, stated)
    if not others:
        return first
    names = ", ".join(getattr(record, "account").sheet for record in others)  # noqa: B009
    where = f"sheets ({names})" if names.strip(", ") else "tables"
    text = f"{path}: {len(others)} more records in its {where}, not read here"
    return replace(first, findings=(*first.findings, Finding("warning", "sheets", text)))


def _why_no_record(file: "TableFile", stated: Mapping[str, float]) -> str:
    """Why a table is no instrument's record, and what to do."""
    from sma_bench.records.cells import QUANTITIES, WORDS, message, parse_unit, title_meanings
    from sma_bench.records.instrument_files import Sheet
    sheet = Sheet(file, max(file.tables, key=lambda t: len(t.lines)), stated).with_signals()
    if not sheet.titles:
        return message("no_titles", columns=len(sheet.table.columns))
    kinds = WORDS["instruments"]
    lacks = {kind: sheet.lacks(kind) for kind in kinds}
    kind = min(lacks, key=lambda one: len(lacks[one]))
    is_named = kind == "isobaric" or any(map(sheet.find, ("heat flow", "strain", "stress")))
    if len(lacks[kind]) == 1 and is_named and not sheet.is_driven():
        what = lacks[kind][0]
        example = f"{what.capitalize()} ({QUANTITIES[what]['example']})"
        for c in sheet.table.columns:
            if c.unit and not parse_unit(c.unit) and what in title_meanings(c.title):
                return f"unit {c.unit!r} of {c.name} is not known: which is it, as in {example}?"
        how = message("or_stated") if (kind, what) == ("isobaric", "stress") else ""
        kinds_of = ", ".join(kinds[kind])
        return message("lacks", what=what, kind=kind, of=kinds_of, example=example) + how
    if sheet.find("resistance"):
        return message("resistance")
    return message("other", format=file.format, name=file.path.name, stem=file.path.stem)


def describe(record: AnyRecord) -> dict[str, Any]:
    """What a record holds, in SI units, as data for JSON."""
    def ends(first: str, last: str, values: Array) -> dict[str, float]:
        return {first: float(values[0]), last: float(values[-1])}

    about: dict[str, Any] = {"path": str(record.path)}
    parts: dict[str, list[dict[str, Any]]] = {}
    if isinstance(record, DscRecord):
        about |= {"kind": "dsc", "instrument": record.instrument, "sample": record.sample,
                  "mass": record.mass, "endothermic_up": record.endothermic_up}
        parts["segments"] = [
            {"number": s.number, "kind": s.kind, "rate": s.rate, "samples": len(s.time)}
            | ends("start", "end", s.time) | ends("from", "to", s.temperature)
            for s in record.segments]
    elif isinstance(record, IsobaricRecord):
        about |= {"kind": "isobaric", "stress": record.stress, "strain_unit": record.strain_unit}
        parts["branches"] = [
            {"cycle": cycle.number, "kind": b.direction, "samples": len(b.temperature),
             **ends("from", "to", b.temperature), **ends("strain_from", "strain_to", b.strain)}
            for cycle in record.cycles for b in cycle.branches]
    elif isinstance(record, TensileRecord):
        about |= {"kind": "tensile", "temperature": record.temperature,
                  "is_extension": record.is_extension, "is_force": record.is_force,
                  "samples": len(record.strain), "largest_strain": float(record.strain.max()),
                  "largest_stress": float(record.stress.max())}
    else:
        about |= {"kind": "bag", "start_ns": record.start_ns, "duration": record.duration,
                  "start": datetime.fromtimestamp(record.start_ns / 1e9, UTC).isoformat(),
                  "channels": list(record.channels)}
        parts["topics"] = [{"name": name, "type": t.type, "count": t.count,
                            "signals": list(t.signals)} for name, t in record.topics.items()]
        signals = parts["signals"] = []
        for s in record.signals.values():
            steps, finite, count = np.diff(s.time), s.values[np.isfinite(s.values)], len(s)
            # Commands are timed where they are received, often several at once: their mean period.
            period = s.period if s.name != "voltage_command" else np.ptp(s.time) / max(count - 1, 1)
            signals.append({
                "name": s.name, "unit": s.unit, "topic": s.topic, "samples": count,
                "rate": 1 / period if period > 0 else None,
                "jitter": float(np.ptp(np.percentile(steps, [5, 95]))) if len(steps) else None,
                "longest_gap": float(steps.max()) if len(steps) else None,
                "delay": None if s.received is None else float(np.median(s.received - s.time)),
                **(ends("start", "end", s.time) if count else {"start": None, "end": None}),
                **{name: float(getattr(finite, name)()) if len(finite) else None
                   for name in ("min", "max", "mean")}})
        parts["markers"] = [{"time": time, "text": text} for time, text in record.markers]
    found = check_record(record) if isinstance(record, Record) else record.findings
    parts["findings"] = [finding.to_json() for finding in found]
    return about | parts | {"account": account_line(record)}


def account_line(record: AnyRecord) -> str:
    """What became of the rows and columns of a file, or of the messages and topics of a bag."""
    name = Path(record.path).name
    if not isinstance(record, Record):
        return f"{name}: {record.account}" if record.account else ""
    topics = record.topics
    marker = "experiment/marker"
    gives = {n: t.signals or ("markers",) * n.endswith(marker) for n, t in topics.items()}
    taken = sum(topic.count for n, topic in topics.items() if gives[n])
    used = ", ".join(f"{n} ({', '.join(given)})" for n, given in gives.items() if given)
    rest = ", ".join(f"{n} ({t.type})" for n, t in topics.items() if not gives[n])
    return (f"{name}: {sum(topic.count for topic in topics.values())} messages read, {taken} used; "
            f"topics used: {used or 'none'}; ignored: {rest or 'none'}")
