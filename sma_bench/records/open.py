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
    columns = sheet.table.columns
    if len(columns) == 2 and not any(column.title for column in columns):
        return (
            "two columns without titles: of an isobaric test (temperature in degC, strain) state "
            "the stress, --state 'stress=200 MPa' or a first line 'Stress: 200 MPa'; of any other, "
            "write titles with units above them"
        )
    has = {role for role in ("temperature", "strain", "stress", "length", "force", "heat flow")
           if sheet.find(role)}  # fmt: skip
    if not sheet.is_driven():
        if "heat flow" in has:
            return "heat flow without a temperature: a DSC run has both, and time"
        if "temperature" in has and has & {"strain", "length"}:
            return (
                "no stress column: an isobaric test has temperature, strain and stress; --state "
                "'stress=200 MPa' or a line 'Stress: 200 MPa' above the titles states one"
            )
        if "stress" in has:
            return "no strain column: a tensile test has strain and stress"
        if "strain" in has:
            return "no stress column: a tensile test has strain and stress"
    name = file.path.name
    return (
        f"a table of another logger ({file.format}); make a record of it: sma-bench import {name} "
        f"--out {file.path.stem}"
    )
