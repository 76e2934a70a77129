"""Tables of loggers and instruments: text, Excel, MATLAB, HDF5 and Parquet files as named columns.

Cells are taken as they are written and understood here, once for all: no library infers anything.
"""

import hashlib
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from sma_bench.border import MEGABYTE, Budget, printable, read_bytes, reading_budget
from sma_bench.errors import InputError
from sma_bench.records.arrays_in_files import read_hdf5, read_matlab
from sma_bench.records.sheets import decoded_lines, excel_sheets, missing_package, text_rows, why
from sma_bench.records.structure import LONGEST_NAME, MOST_COLUMNS, Column, Table, tables_of
from sma_bench.records.units import split_title

LARGEST_FILE = 200 * MEGABYTE
_Found = tuple[list[Table], list[str]]  # tables, and lines that are in none


@dataclass(frozen=True)
class TableFile:
    """A file's tables, whose columns have names that are unique in the file, and the lines that are
    in none of them."""

    path: Path
    format: str
    sha256: str
    tables: tuple[Table, ...]
    outside: tuple[str, ...] = ()

    @property
    def columns(self) -> tuple[Column, ...]:
        """Of all tables."""
        return tuple(column for table in self.tables for column in table.columns)

    @property
    def ignored(self) -> dict[str, str]:
        """Columns of all tables that hold no numbers, with the reason."""
        return {name: reason for table in self.tables for name, reason in table.ignored.items()}

    @property
    def notes(self) -> tuple[str, ...]:
        """What was decided or left out while reading."""
        return tuple(note for t in self.tables for note in (*t.notes, *t.left_out))

    def with_tables(self, tables: Sequence[Table], outside: Sequence[str]) -> "TableFile":
        """The same file with tables whose columns are named and counted anew."""
        seen: Counter[str] = Counter()
        named = []
        for k, table in enumerate(tables):
            columns = []
            for column in table.columns:
                name = printable(column.name)[:LONGEST_NAME]
                seen[name] += 1
                name += f" ({seen[name]})" if seen[name] > 1 else ""
                title, unit = printable(column.title)[:LONGEST_NAME], printable(column.unit)[:40]
                columns.append(replace(column, table=k, name=name, title=title, unit=unit))
            ignored = {printable(n)[:LONGEST_NAME]: reason for n, reason in table.ignored.items()}
            named.append(replace(table, columns=tuple(columns), ignored=ignored))
        return replace(self, tables=tuple(named), outside=tuple(outside))


@dataclass(frozen=True)
class Account:
    """What became of a file: its rows, columns used (and as what), ignored (and why), asked."""

    rows: int
    rows_used: int
    used: dict[str, str]
    ignored: dict[str, str]
    asked: tuple[str, ...] = ()
    left_out: tuple[str, ...] = ()
    sheet: str = ""

    def __str__(self) -> str:
        used = ", ".join(f"{name} ({what})" for name, what in self.used.items()) or "none"
        ignored = ", ".join(f"{name} ({reason})" for name, reason in self.ignored.items()) or "none"
        where = f"sheet {self.sheet}: " if self.sheet else ""
        more = f" and {len(self.left_out) - 8} more" if len(self.left_out) > 8 else ""
        rest = f"; outside the table: {', '.join(self.left_out[:8])}{more}" * bool(self.left_out)
        return printable(
            f"{where}{self.rows} rows read, {self.rows_used} used; columns used: {used}; "
            f"ignored: {ignored}; asked about: {', '.join(self.asked) or 'none'}{rest}"
        )

    def to_json(self) -> dict[str, Any]:
        """Plain data."""
        return {key: value for key, value in asdict(self).items() if key != "sheet"}


@lru_cache(maxsize=2)  # several readers look at one file in turn
def _read(kind: str, content: bytes) -> TableFile:
    tables, outside = _READERS[kind](content, reading_budget(len(content)))
    digest = hashlib.sha256(content).hexdigest()
    return TableFile(Path(), kind, digest, ()).with_tables(tables, outside)


def read_table_file(path: str | Path) -> TableFile:
    """Read a table whatever its format, which its content decides; raises InputError where it is
    unreadable, too large to unfold, damaged, no table, or the package that reads it is absent."""
    path = Path(path)
    content = read_bytes(path, LARGEST_FILE)
    kind = format_of(content[:512])
    try:
        file = _read(kind, content)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    except (MemoryError, RecursionError):
        raise InputError(f"{path}: asks for more memory than there is") from None
    if not file.columns:
        raise InputError(f"{path}: no columns of numbers found in this {kind} file")
    return replace(file, path=path)


def runs_of(file: TableFile) -> list[tuple[str, TableFile]]:
    """Name and tables of the runs in a file: sheets of the same titles are a run each, all others
    belong together."""
    shapes = [tuple((c.title, c.unit) for c in table.columns) for table in file.tables]
    alike = [
        table for table, shape in zip(file.tables, shapes, strict=True) if shapes.count(shape) > 1
    ]
    if not alike:
        return [("", file)]
    rest = [f"sheet {table.name}" for table in file.tables if table not in alike]
    runs = []
    for place, table in enumerate(alike):
        own = tuple(
            replace(c, name=re.sub(r" \(\d+\)\Z", "", c.name) if place else c.name)
            for c in table.columns
        )
        outside = (*file.outside, *rest) if not place else ()
        alone = file.with_tables([replace(table, columns=own)], outside)
        runs.append((table.name or str(place + 1), alone))
    return runs


def together(files: Sequence[TableFile]) -> TableFile:
    """Files that are one run as one, the columns of each under its stem; numbers on their clocks
    count from one zero."""
    tables = []
    for file in files:
        stem = file.path.stem
        for table in file.tables:
            columns = tuple(replace(c, name=f"{stem}: {c.name}", group=stem) for c in table.columns)
            ignored = {f"{stem}: {name}": reason for name, reason in table.ignored.items()}
            tables.append(replace(table, columns=columns, ignored=ignored))
    digest = hashlib.sha256("".join(file.sha256 for file in files).encode()).hexdigest()
    outside = [f"{file.path.name}: {line}" for file in files for line in file.outside]
    return replace(files[0], sha256=digest).with_tables(tables, outside)


def format_of(head: bytes) -> str:
    """The format of a file by its first bytes; text where nothing else is known."""
    return next((kind for start, kind in _MAGIC.items() if head.startswith(start)), "text")


_MAGIC = {
    b"PK\x03\x04": "Excel",
    b"\xd0\xcf\x11\xe0": "old Excel",
    b"\x89HDF\r\n\x1a\n": "HDF5",
    b"MATLAB 7.3": "MATLAB 7.3",
    b"MATLAB 5": "MATLAB",
    b"PAR1": "Parquet",
}


def _read_text(content: bytes, budget: Budget) -> _Found:
    lines = decoded_lines(content)
    budget.take(len(content) * 4)
    rows, separator = text_rows(lines)
    return tables_of(rows, separator, "", budget, lines)


def _read_excel(content: bytes, budget: Budget) -> _Found:
    tables: list[Table] = []
    outside: list[str] = []
    for name, rows in excel_sheets(content, budget):
        try:
            found, lost = tables_of(rows, "", name, budget)
        except InputError as error:
            raise InputError(f"sheet {name}: {error}") from None
        tables += found
        outside += [f"sheet {name}, {line}" for line in lost]
        if not found and rows:
            outside.append(f"sheet {name} (no table of numbers)")
    return tables, outside


def _refuse_old_excel(content: bytes, budget: Budget) -> _Found:
    raise InputError("an Excel file of before 2007 (.xls), expected .xlsx: save it as that")


def _read_parquet(content: bytes, budget: Budget) -> _Found:
    try:
        from pyarrow import parquet
    except ImportError:
        raise missing_package("pyarrow") from None
    columns: list[Column] = []
    ignored: dict[str, str] = {}
    try:
        file = parquet.ParquetFile(BytesIO(content))
        budget.take(file.metadata.num_rows * file.metadata.num_columns * 8)
        if file.metadata.num_columns > MOST_COLUMNS:
            raise InputError(f"{file.metadata.num_columns} columns, at most {MOST_COLUMNS}")
        table = file.read(use_threads=False)
        for name, column in zip(table.column_names, table.columns, strict=True):
            kind = str(column.type)
            if len(column) and kind.startswith("timestamp"):
                ticks = np.asarray(column.cast("timestamp[ns]").to_numpy(), dtype=np.int64)
                seconds, start = (ticks - ticks[0]) / 1e9, float(ticks[0]) / 1e9
                columns.append(Column(name, name, "s", seconds, start=start, fields=3))
            elif len(column) and re.match("u?int|float|double|half|decimal", kind):
                values = np.asarray(column.cast("double").to_numpy(), dtype=np.float64)
                columns.append(Column(name, *split_title(name), values))
            else:
                ignored[name] = f"holds {kind}, no numbers"
    except InputError:
        raise
    except Exception as error:  # pyarrow's own errors, which only it can name
        raise InputError(f"not a readable Parquet file: {why(error)}") from None
    lines = np.arange(1, table.num_rows + 1)
    return [Table("", tuple(columns), lines, len(lines), ignored)], []


_READERS = {
    "text": _read_text,
    "Excel": _read_excel,
    "old Excel": _refuse_old_excel,
    "MATLAB": read_matlab,
    "MATLAB 7.3": read_hdf5,
    "HDF5": read_hdf5,
    "Parquet": _read_parquet,
}
