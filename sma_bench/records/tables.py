"""Tables of loggers and instruments: text, Excel, MATLAB, HDF5 and Parquet files as named columns.

Cells are taken as they are written and understood here, once for all: no library infers anything.
"""

import hashlib
import re
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from sma_bench.border import MEGABYTE, Budget, printable, read_bytes, reading_budget
from sma_bench.errors import InputError
from sma_bench.records.arrays_in_files import read_hdf5, read_matlab
from sma_bench.records.cells import (
    LONGEST_NAME,
    MOST_COLUMNS,
    Column,
    Table,
    decoded_lines,
    excel_sheets,
    missing_package,
    text_rows,
    why,
)
from sma_bench.records.structure import tables_of
from sma_bench.records.units import split_title

LARGEST_FILE = 200 * MEGABYTE


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
        return {name: why for table in self.tables for name, why in table.ignored.items()}

    @property
    def notes(self) -> tuple[str, ...]:
        """What was decided or left out while reading."""
        return tuple(note for t in self.tables for note in (*t.notes, *t.left_out))


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
        said = (
            f"{where}{self.rows} rows read, {self.rows_used} used; columns used: {used}; "
            f"ignored: {ignored}; asked about: {', '.join(self.asked) or 'none'}"
        )
        more = f" and {len(self.left_out) - 8} more" if len(self.left_out) > 8 else ""
        rest = f"; outside the table: {', '.join(self.left_out[:8])}{more}" * bool(self.left_out)
        return printable(said + rest)


    def to_json(self) -> dict[str, Any]:
        """Plain data."""
        return {
            "rows": self.rows, "rows_used": self.rows_used, "used": self.used,
            "ignored": self.ignored, "asked": list(self.asked), "left_out": list(self.left_out),
        }


@lru_cache(maxsize=2)  # several readers look at one file in turn
def _tables(kind: str, content: bytes) -> tuple[tuple[Table, ...], tuple[str, ...]]:
    budget = reading_budget(len(content))
    tables, outside = _READERS[kind](content, budget)
    # Names that are unique in the file, and printable.
    seen: Counter[str] = Counter()
    named = []
    for k, table in enumerate(tables):
        columns = []
        for column in table.columns:
            name = printable(column.name)[:LONGEST_NAME]
            seen[name] += 1
            columns.append(replace(
                column, table=k, title=printable(column.title)[:LONGEST_NAME],
                unit=printable(column.unit)[:40],
                name=name if seen[name] == 1 else f"{name} ({seen[name]})",
            ))  # fmt: skip
        ignored = {printable(n)[:LONGEST_NAME]: reason for n, reason in table.ignored.items()}
        named.append(replace(table, columns=tuple(columns), ignored=ignored))
    return tuple(named), tuple(outside)


def read_table_file(path: str | Path) -> TableFile:
    """Read a table whatever its format, which its content decides.

    Raises:
        InputError: unreadable, too large to unfold, damaged, no table in it, or the package that
            reads it is not installed (its name is said).
    """
    path = Path(path)
    content = read_bytes(path, LARGEST_FILE)
    kind = format_of(content[:512])
    try:
        tables, outside = _tables(kind, content)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    except (MemoryError, RecursionError):
        raise InputError(f"{path}: asks for more memory than there is") from None
    if not any(table.columns for table in tables):
        raise InputError(f"{path}: no columns of numbers found in this {kind} file")
    return TableFile(path, kind, hashlib.sha256(content).hexdigest(), tables, outside)


def runs_of(file: TableFile) -> list[tuple[str, TableFile]]:
    """Name and tables of the runs in a file: sheets of the same titles are a run each, all others
    belong together."""
    shapes = Counter(tuple((c.title, c.unit) for c in table.columns) for table in file.tables)
    alike = [k for k, t in enumerate(file.tables)
             if shapes[tuple((c.title, c.unit) for c in t.columns)] > 1]  # fmt: skip
    if len(alike) < 2:
        return [("", file)]
    runs = []
    rest = tuple(f"sheet {t.name}" for k, t in enumerate(file.tables) if k not in alike)
    for place, k in enumerate(alike):
        table = file.tables[k]
        own = tuple(replace(c, table=0, name=re.sub(r" \(\d+\)\Z", "", c.name) if place else c.name)
                    for c in table.columns)  # fmt: skip
        outside = (*file.outside, *rest) if not place else ()
        alone = replace(file, tables=(replace(table, columns=own),), outside=outside)
        runs.append((table.name or str(place + 1), alone))
    return runs


def together(files: Sequence[TableFile]) -> TableFile:
    """Files that are one run as one, the columns of each under its stem; numbers on their clocks
    count from one zero."""
    tables: list[Table] = []
    for file in files:
        for table in file.tables:
            named = tuple(replace(c, name=f"{file.path.stem}: {c.name}", group=file.path.stem,
                                  table=len(tables)) for c in table.columns)  # fmt: skip
            ignored = {f"{file.path.stem}: {n}": reason for n, reason in table.ignored.items()}
            tables.append(replace(table, columns=named, ignored=ignored))
    digest = hashlib.sha256("".join(file.sha256 for file in files).encode()).hexdigest()
    outside = tuple(f"{file.path.name}: {line}" for file in files for line in file.outside)
    return TableFile(files[0].path, files[0].format, digest, tuple(tables), outside)


def read_lines(path: Path) -> list[str]:
    """Lines of a text file.

    Raises:
        InputError: the file is absent, unreadable, larger than any such file, or no text.
    """
    content = read_bytes(path, LARGEST_FILE)
    try:
        if format_of(content[:512]) != "text":
            raise InputError("not a text file")
        return decoded_lines(content)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def format_of(head: bytes) -> str:
    """The format of a file by its first bytes; text where nothing else is known."""
    for start, kind in _MAGIC:
        if head.startswith(start):
            return kind
    return "text"


_MAGIC = ((b"PK\x03\x04", "Excel"), (b"\x89HDF\r\n\x1a\n", "HDF5"), (b"MATLAB 7.3", "MATLAB 7.3"),
          (b"MATLAB 5", "MATLAB"), (b"PAR1", "Parquet"),
          (b"\xd0\xcf\x11\xe0", "old Excel"))  # fmt: skip


def _read_text(content: bytes, budget: Budget) -> tuple[list[Table], list[str]]:
    lines = decoded_lines(content)
    budget.take(len(content) * 4)
    rows, separator = text_rows(lines)
    return tables_of(rows, separator, "", budget)


def _read_excel(content: bytes, budget: Budget) -> tuple[list[Table], list[str]]:
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


def _refuse_old_excel(content: bytes, budget: Budget) -> tuple[list[Table], list[str]]:
    raise InputError("an Excel file of before 2007 (.xls), expected .xlsx: save it as that")


def _read_parquet(content: bytes, budget: Budget) -> tuple[list[Table], list[str]]:
    try:
        from pyarrow import parquet
    except ImportError:
        raise missing_package("pyarrow") from None
    try:
        file = parquet.ParquetFile(BytesIO(content))
        budget.take(file.metadata.num_rows * file.metadata.num_columns * 8)
        if file.metadata.num_columns > MOST_COLUMNS:
            raise InputError(f"{file.metadata.num_columns} columns, at most {MOST_COLUMNS}")
        table = file.read(use_threads=False)
        columns: list[Column] = []
        ignored: dict[str, str] = {}
        for name, column in zip(table.column_names, table.columns, strict=True):
            made = _parquet_column(name, column) if len(column) else None
            if made is None:
                ignored[name] = f"holds {column.type}, no numbers"
            else:
                columns.append(made)
    except InputError:
        raise
    except Exception as error:  # pyarrow's own errors, which only it can name
        raise InputError(f"not a readable Parquet file: {why(error)}") from None
    rows = int(table.num_rows)
    return [Table("", tuple(columns), rows=rows, ignored=ignored,
                  lines=np.arange(1, rows + 1))], []  # fmt: skip


def _parquet_column(name: str, column: Any) -> Column | None:
    """A column of numbers or moments; None for another kind."""
    kind = str(column.type)
    if kind.startswith("timestamp"):
        nanoseconds = np.asarray(column.cast("timestamp[ns]").to_numpy(), dtype=np.int64)
        start = float(nanoseconds[0]) / 1e9
        seconds = (nanoseconds - nanoseconds[0]) / 1e9
        return Column(name, name, "s", seconds, start=start, fields=3)
    if kind.startswith(("int", "uint", "float", "double", "half", "decimal")):
        title, unit = split_title(name)
        values = np.asarray(column.cast("double").to_numpy(), dtype=np.float64)
        return Column(name, title, unit, values)
    return None


_READERS: dict[str, Callable[[bytes, Budget], tuple[list[Table], list[str]]]] = {
    "text": _read_text,
    "Excel": _read_excel,
    "old Excel": _refuse_old_excel,
    "MATLAB": read_matlab,
    "MATLAB 7.3": read_hdf5,
    "HDF5": read_hdf5,
    "Parquet": _read_parquet,
}
