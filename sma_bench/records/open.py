"""Opens a record whatever it is: a bag or an instrument's file."""

from collections.abc import Callable
from pathlib import Path

from sma_bench.errors import InputError
from sma_bench.records.bag import read_record
from sma_bench.records.bag_files import is_bag
from sma_bench.records.dsc import DscRecord, is_dsc, read_dsc
from sma_bench.records.dsc_ta import is_ta_dsc, read_ta_dsc
from sma_bench.records.isobaric import IsobaricRecord, is_isobaric, read_isobaric
from sma_bench.records.record import Record
from sma_bench.records.tables import read_table_file
from sma_bench.records.tensile import TensileRecord, is_tensile, read_tensile
from sma_bench.records.text_table import near_miss, read_text_table

AnyRecord = Record | DscRecord | IsobaricRecord | TensileRecord

_INSTRUMENTS: tuple[tuple[Callable[[Path], bool], Callable[[Path], AnyRecord]], ...] = (
    (is_dsc, read_dsc),
    (is_ta_dsc, read_ta_dsc),
    (is_isobaric, read_isobaric),
    (is_tensile, read_tensile),
)


def open_record(path: str | Path, namespace: str | None = None) -> AnyRecord:
    """Read a bag or an instrument file; which one is decided by its content.

    Raises:
        InputError: neither, or nothing readable in it.
    """
    path = Path(path)
    if is_bag(path):
        return read_record(path, namespace)
    for recognises, read in _INSTRUMENTS:
        if recognises(path):
            return read(path)
    _refuse_table(path)
    raise InputError(
        f"{path}: neither a bag (folder, .mcap, .db3) nor an instrument file known here (DSC "
        "export of PerkinElmer or TA, isobaric test, tensile test)"
    )


def _refuse_table(path: Path) -> None:
    """InputError that says what a table lacks, or how the table of a logger becomes a record."""
    try:
        table = read_table_file(path)
    except InputError:
        return
    if missing := _missing(path):
        raise InputError(f"{path}: {missing}")
    if len(table.columns) > 1:
        raise InputError(
            f"{path}: a table of another logger ({table.format}); make a record of it: sma-bench "
            f"import {path.name} --out {path.stem}"
        )


def _missing(path: Path) -> str:
    try:
        return near_miss(read_text_table(path))
    except InputError:
        return ""
