"""Opens records whatever they are: a bag or an instrument's file."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from sma_bench.errors import InputError
from sma_bench.findings import Finding
from sma_bench.records.bag import read_record
from sma_bench.records.bag_files import is_bag
from sma_bench.records.dsc import DscRecord, dsc_of, is_dsc
from sma_bench.records.isobaric import IsobaricRecord, is_isobaric, isobaric_of
from sma_bench.records.record import Record
from sma_bench.records.roles import Sheet
from sma_bench.records.tables import TableFile, read_table_file
from sma_bench.records.tensile import TensileRecord, is_tensile, tensile_of
from sma_bench.records.units import QUANTITIES, WORDS

AnyRecord = Record | DscRecord | IsobaricRecord | TensileRecord

_INSTRUMENTS = ((is_dsc, dsc_of), (is_isobaric, isobaric_of), (is_tensile, tensile_of))


def open_records(
    path: str | Path, namespace: str | None = None, stated: Mapping[str, float] | None = None
) -> list[AnyRecord]:
    """Read a bag or an instrument's file, of whose sheets each may be a record; which one it is, is
    decided by its content.

    Args:
        path: of the record.
        namespace: where two benches are in one bag, the one to take.
        stated: what an instrument's file does not hold, in SI units: `stress`, `mass`,
            `gauge_length`, `area`, `diameter`, `temperature`.

    Raises:
        InputError: neither, or nothing readable in it, with the reader's own reason.
    """
    path = Path(path)
    if is_bag(path):
        return [read_record(path, namespace)]
    try:
        file = read_table_file(path)
    except InputError as error:
        if "no columns of numbers" not in str(error):
            raise
        raise InputError(
            f"{path}: neither a bag (folder, .mcap, .db3) nor an instrument file known here (DSC "
            "export, isobaric test, tensile test): no columns of numbers"
        ) from None
    records: list[AnyRecord] = []
    for table in file.tables:
        sheet = Sheet(file, table, stated or {})
        made = next((make for is_it, make in _INSTRUMENTS if is_it(sheet)), None)
        if made is not None:
            records.append(made(sheet))
    if records:
        return records
    raise InputError(f"{path}: {_what_it_lacks(file, stated or {})}")


def open_record(
    path: str | Path, namespace: str | None = None, stated: Mapping[str, float] | None = None
) -> AnyRecord:
    """The record of a file, the first one where several sheets hold one each, with a warning that
    names the others; raises as `open_records`."""
    first, *others = open_records(path, namespace, stated)
    if others:
        names = ", ".join(getattr(record, "account").sheet for record in others)  # noqa: B009
        text = f"{path}: {len(others)} more records in its sheets ({names}), not read here"
        warning = Finding("warning", "sheets", text)
        first = replace(first, findings=(*first.findings, warning))
    return first


def _what_it_lacks(file: TableFile, stated: Mapping[str, float]) -> str:
    """What keeps a table from being an instrument's, or how a logger's becomes a record."""
    sheet = Sheet(file, max(file.tables, key=lambda table: len(table.lines)), stated)
    if not sheet.titles:
        return (
            f"{len(sheet.table.columns)} columns without titles: write titles with units above "
            "them; of two, of an isobaric test (temperature in degC, strain), state the stress, "
            "--state 'stress=200 MPa' or a first line 'Stress: 200 MPa'"
        )
    kinds = WORDS["instruments"]
    lacks = {kind: [what for what, roles in needs.items() if not sheet.find(*roles)]
             for kind, needs in kinds.items()}  # fmt: skip
    kind = min(lacks, key=lambda one: len(lacks[one]))
    is_named = kind == "isobaric" or any(map(sheet.find, ("heat flow", "strain", "stress")))
    if len(lacks[kind]) == 1 and is_named and not sheet.is_driven():
        what = lacks[kind][0]
        how = f"write its title with a unit, {what.capitalize()} ({QUANTITIES[what]['example']})"
        if kind == "isobaric" and what == "stress":
            how += ", or state it: --state 'stress=200 MPa', a line 'Stress: 200 MPa' above"
        return f"no {what} column: a {kind} test has {', '.join(kinds[kind])}; {how}"
    name = file.path.name
    return (
        f"a table of another logger ({file.format}): write titles with units, or make a record of "
        f"it: sma-bench import {name} --out {file.path.stem}"
    )
