"""Whole topics of serialised ROS messages into arrays.

Messages of one topic mostly have one length, so a topic is a matrix of bytes. The layout is found
by walking one message; every count in it (strings, sequences) is a guard that must be equal in all
rows decoded with that layout. Rows that differ get a layout of their own, in the end one by one,
so the outcome is that of decoding each message by itself.

Encoding: plain CDR (XCDR1) of either byte order. Bytes after the last field are ignored: a
middleware may append a few.
"""

import struct
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from sma_bench.border import Budget
from sma_bench.records import contract
from sma_bench.records.record import FloatArray, IntArray

_Field = tuple[str, str]

_HEADER: tuple[_Field, ...] = (("stamp.sec", "i4"), ("stamp.nanosec", "u4"), ("frame_id", "string"))

# Fields in order, up to the last one used. "x[]" is a sequence; "text" is a string whose content
# matters, "string" one that is passed over; "dim[]" is std_msgs/MultiArrayDimension[].
FIELDS: dict[str, tuple[_Field, ...]] = {
    contract.TEMPERATURE: (*_HEADER, ("temperature", "f8"), ("variance", "f8")),
    contract.BATTERY_STATE: (
        *_HEADER, ("voltage", "f4"), ("temperature", "f4"), ("current", "f4"),
    ),
    contract.RANGE: (
        *_HEADER, ("radiation_type", "u1"), ("field_of_view", "f4"), ("min_range", "f4"),
        ("max_range", "f4"), ("range", "f4"),
    ),
    contract.JOINT_STATE: (
        *_HEADER, ("name", "text[]"), ("position", "f8[]"), ("velocity", "f8[]"),
        ("effort", "f8[]"),
    ),
    contract.MULTI_ARRAY: (
        ("layout.dim", "dim[]"), ("layout.data_offset", "u4"), ("data", "f8[]"),
    ),
    contract.STRING: (("data", "text"),),
}  # fmt: skip

_ENCAPSULATION = 4
_BYTE_ORDERS = {b"\x00\x00": ">", b"\x00\x01": "<"}
_LAYOUTS_PER_LENGTH = 32
# More than any message of a bench has: elements of texts and dimensions are walked one by one.
_MOST_TEXTS, _MOST_NUMBERS, _LONGEST_TEXT = 256, 1024, 4096
_CHECK_TIME_EVERY = 256


class CdrError(Exception):
    """A message that does not follow its type's layout."""


@dataclass
class Layout:
    """Where the fields of one message lie.

    Attributes:
        columns: field -> (offset, numpy type, number of elements).
        guards: (offset, bytes) that another message must share to have this layout.
        texts: field -> strings found.
    """

    columns: dict[str, tuple[int, str, int]] = field(default_factory=dict)
    guards: list[tuple[int, bytes]] = field(default_factory=list)
    texts: dict[str, tuple[str, ...]] = field(default_factory=dict)


@dataclass(frozen=True)
class Batch:
    """Messages decoded together: `columns[field]` is (len(rows), elements)."""

    rows: IntArray
    columns: dict[str, NDArray[np.generic]]
    texts: dict[str, tuple[str, ...]]


def find_layout(blob: bytes, msgtype: str) -> Layout:
    """Layout of one serialised message.

    Raises:
        CdrError: the bytes do not follow the type.
    """
    order = _BYTE_ORDERS.get(blob[:2])
    if order is None or len(blob) < _ENCAPSULATION:
        raise CdrError("not plain CDR")
    layout, position = Layout(guards=[(0, blob[:2])]), _ENCAPSULATION

    def step(size: int, count: int = 1) -> int:
        """Offset of so many elements, aligned, which are passed over."""
        nonlocal position
        if count:  # an empty sequence is not followed by the padding of its elements
            position += -(position - _ENCAPSULATION) % size
        start, position = position, position + size * count
        if position > len(blob):
            raise CdrError("the message ends inside a field")
        return start

    def guarded_count(most: int) -> int:
        start = step(4)
        layout.guards.append((start, blob[start:position]))
        (count,) = struct.unpack_from(order + "I", blob, start)
        if count > most:
            raise CdrError(f"{count} elements, expected at most {most}")
        return int(count)

    for name, kind in FIELDS[msgtype]:
        many, kind = kind.endswith("[]"), kind.removesuffix("[]")
        if kind in ("string", "text", "dim"):
            found = []
            for _ in range(guarded_count(_MOST_TEXTS) if many else 1):
                length = guarded_count(_LONGEST_TEXT)
                start = step(1, length)
                if kind == "text":
                    content = blob[start:position]
                    layout.guards.append((start, content))
                    found.append(content.rstrip(b"\0").decode(errors="replace"))
                elif kind == "dim":
                    step(4, 2)
            layout.texts[name] = tuple(found)
        else:
            count = guarded_count(_MOST_NUMBERS) if many else 1
            layout.columns[name] = (step(int(kind[1]), count), order + kind, count)
    return layout


def decode(
    data: bytes | bytearray, lengths: IntArray, msgtype: str, budget: Budget
) -> Iterator[Batch]:
    """Messages that lie one after the other, lengths (n,) bytes each; those that cannot be decoded
    are in no batch.

    Raises:
        OverBudget: it takes too long.
    """
    ends = np.cumsum(lengths)
    for length in np.unique(lengths[lengths >= _ENCAPSULATION]).tolist():
        rows = np.flatnonzero(lengths == length)
        content: bytes | bytearray = data
        if len(rows) < len(lengths):
            content = b"".join([data[end - length : end] for end in ends[rows].tolist()])
        matrix = np.frombuffer(content, dtype=np.uint8).reshape(len(rows), length)
        remaining, layouts = np.arange(len(rows)), 0
        while len(remaining):
            if layouts % _CHECK_TIME_EVERY == 0 or layouts < _LAYOUTS_PER_LENGTH:
                budget.check()
            layouts += 1
            try:
                layout = find_layout(matrix[remaining[0]].tobytes(), msgtype)
            except CdrError:
                remaining = remaining[1:]
                continue
            # From some layouts on one message at a time: comparing all with each would take n^2.
            some = remaining if layouts <= _LAYOUTS_PER_LENGTH else remaining[:1]
            alike = _matches(matrix[some], layout)
            yield _batch(matrix, some[alike], rows, layout)
            remaining = remaining[1:] if len(some) == 1 else remaining[~alike]


def _matches(matrix: NDArray[np.uint8], layout: Layout) -> NDArray[np.bool_]:
    """Which rows share the layout's guards, (n,)."""
    same = np.ones(len(matrix), dtype=bool)
    for offset, content in layout.guards:
        expected = np.frombuffer(content, np.uint8)
        same &= (matrix[:, offset : offset + len(content)] == expected).all(axis=1)
    return same


def _batch(matrix: NDArray[np.uint8], taken: IntArray, rows: IntArray, layout: Layout) -> Batch:
    columns = {}
    for name, (offset, kind, count) in layout.columns.items():
        part = matrix[taken, offset : offset + count * int(kind[2])]
        columns[name] = np.ascontiguousarray(part).view(kind).reshape(len(taken), count)
    return Batch(rows[taken], columns, layout.texts)


def encode(template: bytes, msgtype: str, columns: dict[str, FloatArray]) -> list[bytes]:
    """Copies of one serialised message with other numbers in it.

    Args:
        template: a message whose strings and sequences have the wanted content and length.
        columns: field -> (n,) or (n, elements).
    """
    layout = find_layout(template, msgtype)
    n = len(next(iter(columns.values())))
    matrix = np.tile(np.frombuffer(template, dtype=np.uint8), (n, 1))
    for name, values in columns.items():
        offset, kind, count = layout.columns[name]
        if np.size(values) != n * count:
            raise CdrError(f"{name}: {np.size(values)} elements, expected {n} times {count}")
        block = np.ascontiguousarray(np.reshape(values, (n, count)).astype(kind))
        matrix[:, offset : offset + count * int(kind[2])] = block.view(np.uint8).reshape(n, -1)
    length, joined = len(template), matrix.tobytes()
    return [joined[start : start + length] for start in range(0, n * length, length)]
