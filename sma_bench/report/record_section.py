"""The part of a report that shows one record as it was measured."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from sma_bench.records import describe
from sma_bench.records.dsc import DscRecord
from sma_bench.records.isobaric import IsobaricRecord
from sma_bench.records.open import AnyRecord
from sma_bench.records.record import Record
from sma_bench.report.page import Picture, Section, Table
from sma_bench.report.record_pictures import (
    bag_picture,
    dsc_picture,
    isobaric_picture,
    tensile_picture,
)

_Columns = Sequence[tuple[str, str, str]]

# Heading with its unit, key of `describe`, format.
_SIGNALS: _Columns = (
    ("signal", "name", ""), ("unit", "unit", ""), ("samples", "samples", "d"),
    ("rate [Hz]", "rate", ".4g"), ("jitter [s]", "jitter", ".2g"),
    ("longest gap [s]", "longest_gap", ".3g"), ("delay [s]", "delay", ".3g"),
    ("min", "min", ".5g"), ("mean", "mean", ".5g"), ("max", "max", ".5g"),
)  # fmt: skip
_SEGMENTS: _Columns = (
    ("segment", "number", "d"), ("kind", "kind", ""), ("rate [K/s]", "rate", ".4f"),
    ("samples", "samples", "d"), ("from [K]", "from", ".2f"), ("to [K]", "to", ".2f"),
)  # fmt: skip
_BRANCHES: _Columns = (
    ("cycle", "cycle", "d"), ("kind", "kind", ""), ("samples", "samples", "d"),
    ("from [K]", "from", ".2f"), ("to [K]", "to", ".2f"),
    ("strain from", "strain_from", ".5f"), ("strain to", "strain_to", ".5f"),
)  # fmt: skip
_ROWS: dict[str, tuple[str, _Columns]] = {
    "bag": ("signals", _SIGNALS), "dsc": ("segments", _SEGMENTS),
    "isobaric": ("branches", _BRANCHES),
}  # fmt: skip
_SAID: dict[str, Callable[[Mapping[str, Any]], str]] = {
    "bag": lambda d: (
        f"{d['duration']:.1f} s from {d['start']}, channels: {', '.join(d['channels']) or 'none'}, "
        f"{len(d['signals'])} signals, {len(d['markers'])} markers"
    ),
    "dsc": lambda d: f"{d['instrument']}, {d['sample']}, {d['mass'] * 1e6:.3f} mg",
    "isobaric": lambda d: f"isobaric test at {d['stress'] / 1e6:.1f} MPa",
    "tensile": lambda d: (
        f"tensile test, {d['samples']} samples, to {d['largest_strain']:.4f} strain and "
        f"{d['largest_stress'] / 1e6:.1f} MPa"
    ),
}


def record_section(record: AnyRecord, name: str) -> tuple[Section, str, list[str]]:
    """Heading, tables and figure of a record.

    Args:
        record: already read.
        name: that its files begin with.

    Returns:
        The section, a sentence for the summary, and what should be known before it is trusted.
    """
    described = describe(record)
    kind = described["kind"]
    said = _SAID[kind](described)
    tables = []
    if kind in _ROWS:
        key, columns = _ROWS[kind]
        tables.append(_table(described[key], columns, f"{name}_{key}", key.capitalize()))
    findings = described["findings"]
    lines = [f"{f['severity']}: {f['subject']}: {f['text']}" for f in findings]
    worth = [
        f"{record.path}: {f['subject']}: {f['text']}" for f in findings if f["severity"] != "info"
    ]
    picture = _picture(record, name)
    section = Section(
        f"Record {record.path}", [f"{said}."], lines, tables, [picture] if picture else []
    )
    return section, said, worth


def _picture(record: AnyRecord, name: str) -> Picture | None:
    if isinstance(record, Record):
        return bag_picture(record, f"{name}_signals_over_time")
    if isinstance(record, DscRecord):
        return dsc_picture(record, f"{name}_heat_flow")
    if isinstance(record, IsobaricRecord):
        return isobaric_picture(record, f"{name}_strain")
    return tensile_picture(record, f"{name}_stress")


def _table(rows: Sequence[Mapping[str, Any]], columns: _Columns, name: str, title: str) -> Table:
    cells = [[_cell(row[key], form) for _, key, form in columns] for row in rows]
    numeric = frozenset(k for k, (_, _, form) in enumerate(columns) if form)
    return Table([heading for heading, _, _ in columns], cells, numeric, name, title)


def _cell(value: Any, form: str) -> str:
    return "" if value is None else format(value, form)
