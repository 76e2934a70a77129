"""Reads packed formats (Excel, MATLAB, HDF5, Parquet) in a process of its own: a small file may
unfold until memory is full, or crash a compiled reader.

python unfold.py KIND BYTES SECONDS < file > answer

It imports only numpy and what the format needs. The answer is msgpack: an error in one line, or "",
then path, value and attributes of each sheet or array."""

import datetime as dt
import os
import re
import resource
import sys
from collections.abc import Iterator
from io import BytesIO
from typing import Any

import numpy as np

LONGEST_TEXT = 500  # characters kept of a cell; titles and notes are shorter
MOST_LEAVES = 10_000  # arrays and texts of one file
Found = Iterator[tuple[tuple[str, ...], Any, dict[str, Any]]]  # path, value, attributes


def excel(file: BytesIO) -> Found:
    """Rows of every sheet: numbers, booleans and texts; dates and times as ISO 8601."""
    import openpyxl
    def plain(shown: Any) -> Any:
        cell, is_number = shown.value, isinstance(shown.value, (int, float))
        form = re.sub(r'"[^"]*"|\\.', "", shown.number_format or "")  # without quoted text
        if cell is None or isinstance(cell, bool):
            return "" if cell is None else cell
        if is_number and "%" in form:
            return f"{100.0 * cell:.15g}%"  # as Excel shows it: 4.2 % is stored as 0.042
        if is_number:
            return cell if abs(cell) < 1 << 53 else float(cell)
        if isinstance(cell, dt.timedelta):
            minutes, seconds = divmod(cell.total_seconds(), 60.0)
            return f"{minutes // 60:.0f}:{minutes % 60:02.0f}:{seconds:09.6f}"
        text = cell.isoformat() if isinstance(cell, (dt.date, dt.time)) else str(cell)
        return text[:LONGEST_TEXT].strip()

    for sheet in openpyxl.load_workbook(file, read_only=True, data_only=True).worksheets:
        sheet.reset_dimensions()  # the size that the file states may be wrong
        yield (sheet.title,), [list(map(plain, row)) for row in sheet.iter_rows()], {}


def matlab(file: BytesIO) -> Found:
    from scipy.io import loadmat
    def leaves(path: tuple[str, ...], value: Any) -> Found:
        is_cells = str(getattr(value, "dtype", "")) == "object" and hasattr(value, "flat")
        if hasattr(value, "_fieldnames"):
            for name in value._fieldnames:
                yield from leaves((*path, name), getattr(value, name))
        elif is_cells and not all(isinstance(v, str) for v in value.flat):
            for k, one in enumerate(value.flat, 1):
                yield from leaves((*path, str(k)), one)
        else:
            yield path, value, {}

    for name, value in loadmat(file, squeeze_me=True, struct_as_record=False).items():
        if not name.startswith("__"):
            yield from leaves((name,), value)


def hdf5(file: BytesIO) -> Found:
    """Arrays, also of MATLAB 7.3; a compound table gives one array per column."""
    import h5py
    names: list[str] = []
    with h5py.File(file, "r") as opened:
        opened.visit(names.append)  # follows no links to other files
        for name in names:
            item, path = opened[name], tuple(name.split("/"))
            if not isinstance(item, h5py.Dataset) or path[0] in ("#refs#", "#subsystem#"):
                continue
            if item.external or item.is_virtual:
                raise ValueError(f"{name} lies in another file, expected in this one")
            value = item[()] if item.shape is not None else np.zeros(0)
            if item.attrs.get("MATLAB_class") == b"char":
                value = "".join(map(chr, np.ravel(value)[:LONGEST_TEXT]))
            if item.dtype.names:
                value = np.atleast_1d(value).ravel()
                yield from (((*path, column), value[column], {}) for column in item.dtype.names)
            else:
                yield path, value, dict(item.attrs)


def parquet(file: BytesIO) -> Found:
    """Columns of numbers and timestamps; others are named but not read."""
    import pyarrow
    from pyarrow.parquet import ParquetFile
    opened = ParquetFile(file)
    for field in opened.schema_arrow:
        is_stamp = pyarrow.types.is_timestamp(field.type)
        if not is_stamp and not re.match("u?int|float|double|half|decimal", str(field.type)):
            yield (field.name,), None, {"unread": f"{field.type}, not numbers"}
            continue
        column = opened.read(columns=[field.name], use_threads=False).column(0)
        yield (field.name,), column.cast("timestamp[ns]" if is_stamp else "double").to_numpy(), {}


def portable(value: Any) -> Any:
    """A text, a list of texts, or type, shape (n, k) and bytes of numbers; None for others."""
    if isinstance(value, (str, bytes)):
        text = value.decode(errors="replace") if isinstance(value, bytes) else value
        return text[:LONGEST_TEXT].strip()
    if not isinstance(value, np.ndarray) or not value.size:
        return None
    if value.dtype.kind in "OSU":
        found = [portable(v if isinstance(v, bytes) else str(v)) for v in value.flat[:MOST_LEAVES]]
        return found if value.size > 1 else found[0]
    array = np.squeeze(value)
    if value.dtype.kind not in "fiubM" or array.ndim not in (1, 2):
        return None
    array = array.reshape(len(array), -1)
    array = array if array.shape[0] >= array.shape[1] else array.T
    kind = "<i8" if value.dtype.kind == "M" else "<f8"
    return kind, array.shape, array.astype(kind).tobytes()


def portable_leaves(found: Found) -> Found:
    """Leaves (no single numbers), attributes of one text or number, `unread`: why it was not."""
    for count, (path, value, attributes) in enumerate(found):
        if count > MOST_LEAVES:
            raise ValueError(f"more than {MOST_LEAVES} arrays")
        about: dict[str, Any] = {}
        for name, held in attributes.items():
            one = np.ravel(held)[0] if np.size(held) == 1 else ""
            about[name.lower()] = portable(one) if isinstance(one, (str, bytes)) else float(one)
        shown, kind = portable(value), np.asarray(value).dtype.kind
        is_lone = kind in "fiubc" and np.size(value) == 1 and not attributes
        if shown is None:
            why = "an object that only MATLAB can read" if kind == "V" else "no array of numbers"
            about.setdefault("unread", why)
        if shown is not None or not is_lone:
            yield path, shown, about


READERS = {"Excel": excel, "MATLAB": matlab, "HDF5": hdf5, "Parquet": parquet}


def main() -> None:
    kind, size, seconds = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
    resource.setrlimit(resource.RLIMIT_AS, (size, size))
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 1))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    import msgspec
    error, answer = "", b""
    try:
        found = READERS[kind](BytesIO(sys.stdin.buffer.read()))
        leaves = list(found if kind == "Excel" else portable_leaves(found))
        answer = msgspec.msgpack.encode((error, leaves))
    except ModuleNotFoundError as missing:
        error = f"reading it needs {missing.name}: pip install {missing.name}"
    except MemoryError:
        error = f"unfolds to more than {size >> 20} MB"
    except Exception as wrong:  # of the many types that the libraries raise
        why = " ".join(str(wrong).split())[:200] or type(wrong).__name__
        error = f"not a readable {kind} file: {why}"
    sys.stdout.buffer.write(answer or msgspec.msgpack.encode((error, [])))
    sys.stdout.buffer.flush()
    os._exit(0)  # a library's threads might crash at a normal exit, after a good answer


if __name__ == "__main__":
    main()
