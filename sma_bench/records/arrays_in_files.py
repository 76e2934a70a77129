"""Named arrays of MATLAB and HDF5 files: numbers with the titles and units that lie beside them.

What a file claims of its own size and types is checked before scipy's compiled reader sees it.
"""

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from io import BytesIO
from typing import Any

import numpy as np

from sma_bench.border import MEGABYTE, Budget, OverBudget, printable
from sma_bench.errors import InputError
from sma_bench.records.sheets import missing_package, why
from sma_bench.records.structure import LONGEST_NAME, MOST_COLUMNS, Column, Table
from sma_bench.records.units import WORDS, parse_unit, split_title

_Found = tuple[list[Table], list[str]]
_MOST_LEAVES = 10_000
_DEEPEST = 16
_MEANS = {text: key for key, texts in WORDS["attributes"].items() for text in texts}


@dataclass(frozen=True)
class _Leaf:
    """An array, a text or a list of texts somewhere in a file, with what its attributes say."""

    path: tuple[str, ...]
    value: Any
    said: dict[str, Any] = field(default_factory=dict)

    @property
    def folder(self) -> tuple[str, ...]:
        """Where it lies."""
        return self.path[:-1]


def read_matlab(content: bytes, budget: Budget) -> _Found:
    from scipy.io import loadmat

    try:
        _measure_matlab(content, budget)
        tree = loadmat(BytesIO(content), squeeze_me=True, struct_as_record=False)
    except InputError:
        raise
    except Exception as error:  # scipy passes on whatever its parser stumbles over
        raise InputError(_NOT_MATLAB.format(why(error))) from None
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
    items = value.ravel()[:MOST_COLUMNS] if isinstance(value, np.ndarray) else np.zeros(0)
    are_texts = items.dtype == object and len(items) and all(isinstance(i, str) for i in items)
    if hasattr(value, "_fieldnames"):
        for name in value._fieldnames:
            yield from _matlab_leaves((*path, name), getattr(value, name))
    elif are_texts or (items.dtype.kind == "U" and len(items) > 1):
        yield _Leaf(path, [str(item).strip() for item in items])
    elif items.dtype == object:
        for k, item in enumerate(items):
            yield from _matlab_leaves((*path, str(k + 1)), item)
    else:  # of timeseries and table objects MATLAB alone knows what is in them
        is_closed = type(value).__name__ in ("MatlabOpaque", "MatlabFunction")
        yield _Leaf(path, None if is_closed else value)


def read_hdf5(content: bytes, budget: Budget) -> _Found:
    try:
        import h5py
    except ImportError:
        raise missing_package("h5py", "python3-h5py") from None
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
        said = {_MEANS[k.lower()]: v for k, v in item.attrs.items() if k.lower() in _MEANS}
        if item.dtype.names and value is not None:  # a compound table: a column each
            value = np.atleast_1d(value).ravel()
            leaves.extend(_Leaf((*path, n), value[n]) for n in item.dtype.names)
        elif item.dtype.kind in "OS" and value is not None and np.size(value) > 1:
            leaves.append(_Leaf(path, [_text(v) for v in np.ravel(value)[:MOST_COLUMNS]]))
        else:
            leaves.append(_Leaf(path, value, said))

    try:
        with h5py.File(BytesIO(content), "r") as file:
            file.visititems(visit)  # follows no links to other files
    except InputError:
        raise
    except Exception as error:  # h5py raises what its C library says, in many types
        raise InputError(f"not a readable HDF5 file: {why(error)}") from None
    return _from_leaves(leaves, "/", budget)


def _text(value: Any) -> str:
    if isinstance(value, np.ndarray):
        value = value.ravel()[0] if value.size == 1 else ""
    return value.decode(errors="replace") if isinstance(value, bytes) else str(value)


def _from_leaves(leaves: list[_Leaf], mark: str, budget: Budget) -> _Found:
    """Tables of all arrays of numbers, those of one length together; texts called unit, label or
    name speak for the arrays beside them, lists of texts for the columns of one."""
    said: dict[tuple[str, ...], dict[str, str]] = {}
    for leaf in leaves:
        key = _MEANS.get(leaf.path[-1].lower())
        if key in ("unit", "title") and isinstance(leaf.value, (str, bytes)):
            said.setdefault(leaf.folder, {})[key] = _text(leaf.value)
    lists = [leaf for leaf in leaves if isinstance(leaf.value, list)]
    valued = [leaf.folder for leaf in leaves if leaf.path[-1] == "values"]
    simulink = {folder[:n] for folder in valued for n in range(len(folder) + 1)}
    columns: dict[int, list[Column]] = {}
    outside: list[str] = []
    for leaf in leaves:
        array, label = _rows_of(leaf.value), mark.join(leaf.path)
        if array is None:
            if leaf.value is None:
                outside.append(f"{printable(label)} (an object that MATLAB alone can read)")
            elif not isinstance(leaf.value, (str, bytes, list)) and np.size(leaf.value) != 1:
                outside.append(f"{printable(label)} (no array of numbers)")
            continue
        is_time = leaf.path[-1].lower() in ("time", "t", "tout")
        own = {key: _text(v) for key, v in leaf.said.items() if key in ("unit", "title")}
        named = ({} if is_time else said.get(leaf.folder, {})) | own
        if is_time and leaf.folder in simulink:
            named.setdefault("unit", "s")  # of a Simulink structure with time
        title, unit = split_title(named.get("title") or leaf.path[-1])
        many = array.shape[1]
        ends = [f" {k + 1}" for k in range(many)] if many > 1 else [""]
        found = [(label + end, title + end, named.get("unit", unit)) for end in ends]
        for other in lists if many > 1 else ():
            texts = other.value
            if other.folder != leaf.folder or len(texts) != many:
                continue
            if other.path[-1].lower() in WORDS["lists"] or not all(map(parse_unit, texts)):
                split = [(f"{label}{mark}{text}", *split_title(text)) for text in texts]
                pairs = zip(split, found, strict=True)
                found = [(name, title, unit or old[2]) for (name, title, unit), old in pairs]
            else:
                found = [(*old[:2], unit) for old, unit in zip(found, texts, strict=True)]
        # Attributes that scale, and what stands for a missing value.
        numbers = {
            key: float(np.ravel(v)[0])
            for key, v in leaf.said.items()
            if np.size(v) == 1 and np.asarray(v).dtype.kind in "fiu"
        }
        array = np.array(array, dtype=np.float64)
        array[array == numbers.get("fill", np.nan)] = np.nan
        array = array * numbers.get("scale", 1.0) + numbers.get("offset", 0.0)
        budget.take(8 * array.size)
        columns.setdefault(len(array), []).extend(
            Column(*texts, values.copy(), mark.join(leaf.folder))
            for texts, values in zip(found, array.T, strict=True)
        )
    if sum(map(len, columns.values())) > MOST_COLUMNS:
        raise InputError(f"more than {MOST_COLUMNS} columns, expected at most that")
    tables = [Table("", tuple(found), np.arange(1, n + 1), n) for n, found in columns.items()]
    return tables, outside


def _rows_of(value: Any) -> Any:
    """An array of numbers as (n, k) with n the longer side; None for anything else."""
    array = np.squeeze(np.asarray(value)) if isinstance(value, (np.ndarray, list)) else np.zeros(0)
    if array.dtype.kind not in "fiub" or array.size < 2 or array.ndim > 2:
        return None
    array = array.reshape(len(array), -1)
    return array if array.shape[0] >= array.shape[1] else array.T
