"""Tables of other loggers: text, Excel, MATLAB, HDF5 and Parquet files as named columns.

The formats are read by openpyxl, scipy.io, h5py and pyarrow, each loaded when its file comes.
Text is read here: what its readers elsewhere do not find (title and unit rows, header lines,
decimal commas, encodings) is most of the work.
"""

import hashlib
import struct
import zipfile
import zlib
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import date, time
from functools import lru_cache
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from sma_bench.border import MEGABYTE, Budget, OverBudget, printable, read_bytes, reading_budget
from sma_bench.errors import InputError
from sma_bench.records.table_cells import (
    LONGEST_NAME,
    MOST_COLUMNS,
    Column,
    Found,
    columns_of_rows,
    is_filled,
    number_in,
    split_title,
)

LARGEST_FILE = 200 * MEGABYTE
_MOST_AS_TEXT = 1_000_000  # numbers of a file that may be an instrument's
_CELL = 100  # bytes that one of a spreadsheet takes while it is read
_MOST_LEAVES = 10_000
_DEEPEST = 16
_LOOK_AT = 400  # rows, for the dialect
CANDIDATES: tuple[tuple[str | None, str], ...] = (
    ("\t", "."),
    (";", "."),
    (",", "."),
    (None, "."),
    (";", ","),
    ("\t", ","),
    (None, ","),
)  # separator (None: blanks) and decimal sign
_TEXT_KEYS = {"unit": "unit", "units": "unit", "label": "title", "name": "title",
              "long_name": "title", "title": "title"}  # fmt: skip


@dataclass(frozen=True)
class TableFile:
    """A file's columns, the lines above them, and what the reader noticed."""

    path: Path
    format: str
    sha256: str
    columns: tuple[Column, ...]
    preamble: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()


def read_table_file(path: str | Path) -> TableFile:
    """Read a table whatever its format, which its content decides.

    Raises:
        InputError: unreadable, too large to unfold, damaged, no table in it, or the package that
            reads it is not installed (its name is said).
    """
    path = Path(path)
    content = read_bytes(path, LARGEST_FILE)
    budget = reading_budget(len(content))
    kind = format_of(content[:512])
    try:
        columns, preamble, notes = _READERS[kind](content, budget)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    except (MemoryError, RecursionError):
        raise InputError(f"{path}: asks for more memory than there is") from None
    if not columns:
        raise InputError(f"{path}: no columns of numbers found in this {kind} file")
    digest = hashlib.sha256(content).hexdigest()
    named = _unique(columns)
    return TableFile(path, kind, digest, named, tuple(preamble), tuple(notes))


def read_lines(path: Path) -> list[str]:
    """Lines of a text file in UTF-8, UTF-16 or Latin-1; of another kind of table its rows, cells
    parted by tabs, so that whatever reads an instrument's text reads its Excel or MATLAB file too.

    Raises:
        InputError: the file is absent, unreadable, larger than any such file, or no table.
    """
    path = Path(path)
    content = read_bytes(path, LARGEST_FILE)
    kind = format_of(content[:512])
    try:
        return decoded_lines(content) if kind == "text" else list(_rows_as_lines(kind, content))
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


@lru_cache(maxsize=2)  # several readers look at one file in turn
def _rows_as_lines(kind: str, content: bytes) -> tuple[str, ...]:
    budget = reading_budget(len(content))
    if kind == "Excel":
        sheets = _excel_sheets(content, budget)
        rows = max((rows for _, rows in sheets), key=len, default=[])
        return tuple("\t".join("" if c is None else str(c) for c in row) for row in rows)
    columns, _, _ = _READERS[kind](content, budget)
    size = max((len(column.values) for column in columns), default=0)
    whole = [column for column in columns if len(column.values) == size]
    if not whole:
        raise InputError(f"no columns of numbers found in this {kind} file")
    if len(whole) * size > _MOST_AS_TEXT:
        raise InputError(
            f"{len(whole) * size} numbers, more than any instrument's file; sma-bench import makes "
            "a record of a logger's table"
        )
    values = np.column_stack([column.values for column in whole])
    titles = [f"{c.title} ({c.unit})" if c.unit else c.title for c in whole]
    finite = values[np.isfinite(values).all(axis=1)].tolist()
    return ("\t".join(titles), *("\t".join(map(repr, row)) for row in finite))


def decoded_lines(content: bytes) -> list[str]:
    """Lines of a text in UTF-8, UTF-16 or Latin-1.

    Raises:
        InputError: it is binary.
    """
    if content[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return content.decode("utf-16", errors="replace").splitlines()
    if b"\0" in content:
        raise InputError("holds zero bytes, expected a text file")
    try:
        return content.decode("utf-8-sig").splitlines()
    except UnicodeDecodeError:
        return content.decode("latin-1").splitlines()


def is_text(path: Path) -> bool:
    """Whether a file's beginning is that of no other format known here.

    Raises:
        InputError: it cannot be read.
    """
    try:
        with path.open("rb") as file:
            return format_of(file.read(512)) == "text"
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None


def format_of(head: bytes) -> str:
    """The format of a file by its first bytes; text where nothing else is known."""
    if head.startswith(b"PK\x03\x04"):
        return "Excel"
    if head.startswith(b"\x89HDF\r\n\x1a\n"):
        return "HDF5"
    if head.startswith(b"MATLAB 7.3"):  # HDF5 behind 512 bytes of MATLAB's own
        return "MATLAB 7.3"
    if head.startswith(b"MATLAB 5"):
        return "MATLAB"
    if head.startswith(b"PAR1"):
        return "Parquet"
    if head.startswith(b"\xd0\xcf\x11\xe0"):
        return "old Excel"
    return "text"




def _unique(columns: Iterable[Column]) -> tuple[Column, ...]:
    """Columns with printable names, each once."""
    seen: Counter[str] = Counter()
    found = []
    for column in columns:
        name = printable(column.name)[:LONGEST_NAME]
        seen[name] += 1
        if seen[name] > 1:
            name = f"{name} #{seen[name]}"
            seen[name] += 1
        title, unit = printable(column.title)[:LONGEST_NAME], printable(column.unit)[:40]
        found.append(replace(column, name=name, title=title, unit=unit))
    return tuple(found)


def _missing(package: str, apt: str = "") -> InputError:
    """The one line for a reader whose package is not installed."""
    how = f"pip install {package}" + (f", or apt install {apt}" if apt else "")
    return InputError(f"reading it needs {package}: {how}")


# --- text -----------------------------------------------------------------------------------------


def _read_text(content: bytes, budget: Budget) -> Found:
    lines = decoded_lines(content)
    budget.take(len(content) * 4)
    separator, decimal = _dialect([line for line in lines if line.strip()][:_LOOK_AT])
    rows = [_cells(line, separator) for line in lines]
    return columns_of_rows(rows, lambda cell: number_in(cell, decimal), budget)


def _cells(line: str, separator: str | None) -> list[str]:
    cells = [cell.strip().strip('"').strip() for cell in line.split(separator)]
    return cells[:-1] if separator and len(cells) > 2 and not cells[-1] else cells


def _dialect(lines: Sequence[str]) -> tuple[str | None, str]:
    """Separator and decimal sign: those that make most numbers and least text of the lines."""

    def score(candidate: tuple[str | None, str]) -> int:
        total = 0
        for line in lines:
            cells = _cells(line, candidate[0])
            filled = [cell for cell in cells if cell]
            count = sum(number_in(cell, candidate[1]) is not None for cell in filled)
            if count > 1 and 2 * count > len(filled):
                total += 2 * count - len(filled)
        return total

    return max(CANDIDATES, key=score)


# --- Excel ----------------------------------------------------------------------------------------


def _read_excel(content: bytes, budget: Budget) -> Found:
    columns: list[Column] = []
    preamble: list[str] = []
    notes: list[str] = []
    for title, rows in _excel_sheets(content, budget):
        found, above, remarks = columns_of_rows(rows, _excel_number, budget, title)
        columns += found
        preamble += above
        notes += [f"sheet {printable(title)}: {remark}" for remark in remarks]
    return columns, preamble, notes


def _excel_sheets(content: bytes, budget: Budget) -> list[tuple[str, list[list[Any]]]]:
    """Title and rows of every sheet."""
    try:
        import openpyxl
    except ImportError:
        raise _missing("openpyxl", "python3-openpyxl") from None
    try:
        with zipfile.ZipFile(BytesIO(content)) as archive:
            for member in archive.infolist():
                budget.take(member.file_size)
        book = openpyxl.load_workbook(_Watched(content, budget), read_only=True, data_only=True)
        sheets = []
        for sheet in book.worksheets:
            rows = []
            sheet.reset_dimensions()  # what a file claims of its size is not believed
            for row in sheet.iter_rows(values_only=True):
                budget.take(_CELL * len(row))
                rows.append(_trimmed(row))
            sheets.append((str(sheet.title), rows))
    except InputError:
        raise
    except Exception as error:  # openpyxl passes on whatever its parsers stumble over
        budget.check()
        raise InputError(f"not a readable Excel file: {_why(error)}") from None
    return sheets


class _Watched(BytesIO):
    """A file that is read no longer than its budget lasts: openpyxl takes all texts at once."""

    def __init__(self, content: bytes, budget: Budget) -> None:
        super().__init__(content)
        self._budget = budget

    def read(self, size: int | None = -1, /) -> bytes:
        self._budget.check()
        return super().read(size)


def _trimmed(row: tuple[Any, ...]) -> list[Any]:
    cells = [cell.strip() if isinstance(cell, str) else cell for cell in row]
    while cells and not is_filled(cells[-1]):
        cells.pop()
    return cells


def _excel_number(cell: Any) -> float | None:
    if isinstance(cell, (bool, date, time)):
        return None
    if isinstance(cell, (int, float)):
        return float(cell)
    return number_in(cell, ".") if isinstance(cell, str) else None


def _why(error: Exception) -> str:
    return printable(" ".join(str(error).split()))[:200] or type(error).__name__


def _refuse_old_excel(content: bytes, budget: Budget) -> Found:
    raise InputError("an Excel file of before 2007 (.xls), expected .xlsx: save it as that")


# --- MATLAB and HDF5: named arrays in a tree ------------------------------------------------------


@dataclass(frozen=True)
class _Leaf:
    """An array or a text somewhere in a file, with what its attributes say."""

    path: tuple[str, ...]
    value: Any
    said: dict[str, str]


def _read_matlab(content: bytes, budget: Budget) -> Found:
    from scipy.io import loadmat

    try:
        _measure_matlab(content, budget)
        tree = loadmat(BytesIO(content), squeeze_me=True, struct_as_record=False)
    except InputError:
        raise
    except Exception as error:  # scipy passes on whatever its parser stumbles over
        raise InputError(_NOT_MATLAB.format(_why(error))) from None
    top = {name: value for name, value in tree.items() if not name.startswith("__")}
    leaves = [leaf for name, value in top.items() for leaf in _matlab_leaves((name,), value)]
    return _from_leaves(leaves, ".", budget)


# Data types of MAT 5 elements; scipy's compiled reader ends the process at any other.
_NUMBERS_AND_TEXTS = frozenset({1, 2, 3, 4, 5, 6, 7, 9, 12, 13, 16, 17, 18})
_MATRIX, _COMPRESSED = 14, 15
_FLAGS, _COMPLEX, _SPARSE = 16, 0x800, 5
_NOT_MATLAB = "not a readable MATLAB file: {}"
# Of matrices: cells, structures, objects, functions and opaque ones hold matrices, all others none.
_HOLD_MATRICES = frozenset({1, 2, 3, 16, 17})


def _measure_matlab(content: bytes, budget: Budget) -> None:
    """Unfold the compressed elements piece by piece, to know that they are neither too large, nor
    too many, nor of a kind that nobody knows."""
    if 0 in content[:4] or content[124:126] not in (b"\0\1", b"\1\0"):
        return  # MAT 4, which has neither
    order = "<" if content[126:128] == b"IM" else ">"
    for kind, body in _elements(content[128:], order):
        if kind == _COMPRESSED:
            kind, body = next(_elements(b"".join(_inflated(body, budget)), order), (0, b""))
        else:
            budget.take(len(body))
        if kind != _MATRIX:
            raise InputError(_NOT_MATLAB.format(f"a variable of type {kind}"))
        _check_matrix(body, order, 0, budget)


def _inflated(body: bytes, budget: Budget) -> Iterator[bytes]:
    inflate = zlib.decompressobj()
    while body and not inflate.eof:
        yield (piece := inflate.decompress(body, MEGABYTE))
        budget.take(len(piece))
        body = inflate.unconsumed_tail


def _elements(content: bytes, order: str) -> Iterator[tuple[int, bytes]]:
    """Type and bytes of the elements one after the other; short ones lie within their tag."""
    position = 0
    while position + 8 <= len(content):
        kind, size = struct.unpack_from(order + "II", content, position)
        if kind >> 16:
            kind, size, start, step = kind & 0xFFFF, min(kind >> 16, 4), position + 4, 8
        else:
            start, step = position + 8, 8 + size + (0 if kind == _COMPRESSED else -size % 8)
        yield kind, content[start : start + size]
        position += step


def _check_matrix(content: bytes, order: str, depth: int, budget: Budget) -> None:
    """What scipy's reader takes for granted: sixteen bytes of flags, then as many elements as these
    promise, each of a type that it knows."""
    if depth > _DEEPEST:
        raise OverBudget(f"nested deeper than {_DEEPEST} levels")
    if len(content) < _FLAGS:
        if content:
            raise InputError(_NOT_MATLAB.format("a variable without flags"))
        return
    flags = int(struct.unpack_from(order + "I", content, 8)[0])
    shape, parts = flags & 0xFF, 0
    for kind, body in _elements(content[_FLAGS:], order):
        budget.check()
        parts += 1
        if kind == _MATRIX and shape in _HOLD_MATRICES:
            _check_matrix(body, order, depth + 1, budget)
        elif kind not in _NUMBERS_AND_TEXTS:
            raise InputError(_NOT_MATLAB.format(f"an element of type {kind}"))
    # Shape, name and numbers; those of a sparse matrix have places; complex ones a second half.
    expected = 3 + 2 * (shape == _SPARSE) + bool(flags & _COMPLEX)
    if shape not in _HOLD_MATRICES and parts < expected:
        raise InputError(_NOT_MATLAB.format(f"{parts} parts of a variable, expected {expected}"))


def _matlab_leaves(path: tuple[str, ...], value: Any) -> Iterator[_Leaf]:
    if len(path) > _DEEPEST:
        raise OverBudget(f"nested deeper than {_DEEPEST} levels")
    if hasattr(value, "_fieldnames"):
        for name in value._fieldnames:
            yield from _matlab_leaves((*path, name), getattr(value, name))
    elif isinstance(value, np.ndarray) and value.dtype == object:
        for k, item in enumerate(value.ravel()[:MOST_COLUMNS]):
            yield from _matlab_leaves((*path, str(k + 1)), item)
    elif type(value).__name__ in ("MatlabOpaque", "MatlabFunction"):
        return  # timeseries and table objects: MATLAB alone knows what is in them
    else:
        yield _Leaf(path, value, {})


def _read_hdf5(content: bytes, budget: Budget) -> Found:
    try:
        import h5py
    except ImportError:
        raise _missing("h5py", "python3-h5py") from None
    leaves: list[_Leaf] = []

    def visit(name: str, item: Any) -> None:
        if len(leaves) >= _MOST_LEAVES:
            raise OverBudget(f"more than {_MOST_LEAVES} arrays")
        path = tuple(str(name).split("/"))
        if not isinstance(item, h5py.Dataset) or path[0] in ("#refs#", "#subsystem#"):
            return
        if item.external or item.is_virtual:
            raise InputError(f"{printable(name)} lies in another file, expected all in this one")
        budget.take(int(item.size or 0) * max(item.dtype.itemsize, 1))
        value = item[()] if item.shape is not None else None
        if item.attrs.get("MATLAB_class") == b"char":
            value = "".join(chr(letter) for letter in np.asarray(value).ravel()[:LONGEST_NAME])
        said = {key: _text(item.attrs[key]) for key in item.attrs if key.lower() in _TEXT_KEYS}
        leaves.append(_Leaf(path, value, said))

    try:
        with h5py.File(BytesIO(content), "r") as file:
            file.visititems(visit)  # follows no links to other files
    except InputError:
        raise
    except Exception as error:  # h5py raises what its C library says, in many types
        raise InputError(f"not a readable HDF5 file: {_why(error)}") from None
    return _from_leaves(leaves, "/", budget)


def _text(value: Any) -> str:
    if isinstance(value, np.ndarray):
        value = value.ravel()[0] if value.size == 1 else ""
    return value.decode(errors="replace") if isinstance(value, bytes) else str(value)


def _from_leaves(leaves: list[_Leaf], mark: str, budget: Budget) -> Found:
    """Columns of all arrays of numbers; texts called unit, label or name speak for those beside
    them."""
    said: dict[tuple[str, ...], dict[str, str]] = {}
    for leaf in leaves:
        key = _TEXT_KEYS.get(leaf.path[-1].lower())
        if key and isinstance(leaf.value, (str, bytes)):
            said.setdefault(leaf.path[:-1], {})[key] = _text(leaf.value)
    columns = []
    for leaf in leaves:
        array = _rows_of(leaf.value)
        if array is None:
            continue
        own = {_TEXT_KEYS[k.lower()]: v for k, v in leaf.said.items()}
        beside = {} if leaf.path[-1].lower() in ("time", "t") else said.get(leaf.path[:-1], {})
        named = {**beside, **own}
        title, unit = split_title(named.get("title") or leaf.path[-1])
        group = mark.join(leaf.path[:-1])
        for k in range(array.shape[1]):
            number = f" {k + 1}" if array.shape[1] > 1 else ""
            budget.take(8 * len(array))
            columns.append(Column(
                mark.join(leaf.path) + number, title + number, named.get("unit", unit),
                np.array(array[:, k], dtype=np.float64), group,
            ))  # fmt: skip
    if len(columns) > MOST_COLUMNS:
        raise InputError(f"{len(columns)} columns, expected at most {MOST_COLUMNS}")
    return columns, [], []


def _rows_of(value: Any) -> Any:
    """An array of numbers as (n, k) with n the longer side; None for anything else."""
    array = np.asarray(value) if isinstance(value, (np.ndarray, list)) else None
    if array is None or array.dtype.kind not in "fiub" or array.size < 2:
        return None
    array = np.squeeze(array)
    if array.ndim == 1:
        return array[:, None]
    if array.ndim != 2:
        return None
    return array if array.shape[0] >= array.shape[1] else array.T


# --- Parquet --------------------------------------------------------------------------------------


def _read_parquet(content: bytes, budget: Budget) -> Found:
    try:
        from pyarrow import parquet
    except ImportError:
        raise _missing("pyarrow") from None
    try:
        file = parquet.ParquetFile(BytesIO(content))
        budget.take(file.metadata.num_rows * file.metadata.num_columns * 8)
        if file.metadata.num_columns > MOST_COLUMNS:
            raise InputError(f"{file.metadata.num_columns} columns, at most {MOST_COLUMNS}")
        table = file.read(use_threads=False)
        pairs = zip(table.column_names, table.columns, strict=True)
        columns = [_parquet_column(name, column) for name, column in pairs if len(column)]
    except InputError:
        raise
    except Exception as error:  # pyarrow's own errors, which only it can name
        raise InputError(f"not a readable Parquet file: {_why(error)}") from None
    return [column for column in columns if column is not None], [], []


def _parquet_column(name: str, column: Any) -> Column | None:
    """A column of numbers or moments; None for another kind."""
    kind = str(column.type)
    if kind.startswith("timestamp"):
        nanoseconds = np.asarray(column.cast("timestamp[ns]").to_numpy(), dtype=np.int64)
        start = float(nanoseconds[0]) / 1e9
        return Column(name, name, "s", (nanoseconds - nanoseconds[0]) / 1e9, start=start)
    if kind.startswith(("int", "uint", "float", "double", "half", "decimal")):
        title, unit = split_title(name)
        values = np.asarray(column.cast("double").to_numpy(), dtype=np.float64)
        return Column(name, title, unit, values)
    return None


_READERS: dict[str, Callable[[bytes, Budget], Found]] = {
    "text": _read_text,
    "Excel": _read_excel,
    "old Excel": _refuse_old_excel,
    "MATLAB": _read_matlab,
    "MATLAB 7.3": _read_hdf5,
    "HDF5": _read_hdf5,
    "Parquet": _read_parquet,
}
