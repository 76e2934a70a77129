"""Whole topics of serialised ROS messages into arrays.

Messages of one topic mostly have one length, so a topic is a matrix of bytes. The layout is found
by walking one message; every count in it (strings, sequences) is a guard that must be equal in all
rows decoded with that layout. Rows that differ get a layout of their own, in the end one by one,
so the outcome is that of decoding each message by itself.

Encoding: plain CDR (XCDR1) of either byte order. Bytes after the last field are ignored: a
middleware may append a few.
"""

import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sma_bench.border import Budget
from sma_bench.records import contract

_Field = tuple[str, str]

_HEADER: tuple[_Field, ...] = (
    ("stamp.sec", "i4"),
    ("stamp.nanosec", "u4"),
    ("frame_id", "string"),
)

# Fields in order, up to the last one used. "x[]" is a sequence; "text" is a string whose content
# matters, "string" one that is passed over; "dim[]" is std_msgs/MultiArrayDimension[].
FIELDS: dict[str, tuple[_Field, ...]] = {
    contract.TEMPERATURE: (*_HEADER, ("temperature", "f8"), ("variance", "f8")),
    contract.BATTERY_STATE: (
        *_HEADER,
        ("voltage", "f4"),
        ("temperature", "f4"),
        ("current", "f4"),
    ),
    contract.RANGE: (
        *_HEADER,
        ("radiation_type", "u1"),
        ("field_of_view", "f4"),
        ("min_range", "f4"),
        ("max_range", "f4"),
        ("range", "f4"),
    ),
    contract.JOINT_STATE: (
        *_HEADER,
        ("name", "text[]"),
        ("position", "f8[]"),
        ("velocity", "f8[]"),
        ("effort", "f8[]"),
    ),
    contract.MULTI_ARRAY: (
        ("layout.dim", "dim[]"),
        ("layout.data_offset", "u4"),
        ("data", "f8[]"),
    ),
    contract.STRING: (("data", "text"),),
}

_ENCAPSULATION = 4
_BYTE_ORDERS = {b"\x00\x00": ">", b"\x00\x01": "<"}
_LAYOUTS_PER_LENGTH = 32
# More than any message of a bench has. All elements of texts[] and dim[] are walked one by one.
_MOST = {"texts": 256, "dimensions": 32, "numbers": 1024}
_LONGEST_TEXT = 4096
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

    rows: NDArray[np.int64]
    columns: dict[str, NDArray[np.generic]]
    texts: dict[str, tuple[str, ...]]


class _Walker:
    """Steps through one message and notes the layout."""

    def __init__(self, blob: bytes) -> None:
        order = _BYTE_ORDERS.get(blob[:2])
        if order is None or len(blob) < _ENCAPSULATION:
            raise CdrError("not plain CDR")
        self.blob, self.order, self.position = blob, order, _ENCAPSULATION
        self.layout = Layout(guards=[(0, blob[:2])])

    def walk(self, fields: Sequence[_Field]) -> Layout:
        for name, kind in fields:
            if kind == "dim[]":
                self._dimensions()
            elif kind.removesuffix("[]") in ("string", "text"):
                self._texts(name, kind)
            elif kind.endswith("[]"):
                self._numbers(name, kind.removesuffix("[]"), self._few("numbers"))
            else:
                self._numbers(name, kind, 1)
        return self.layout

    def _align(self, size: int) -> None:
        self.position += -(self.position - _ENCAPSULATION) % size

    def _few(self, what: str) -> int:
        count = self._count()
        if count > _MOST[what]:
            raise CdrError(f"{count} {what}, expected at most {_MOST[what]}")
        return count

    def _count(self) -> int:
        self._align(4)
        raw = self.blob[self.position : self.position + 4]
        if len(raw) < 4:
            raise CdrError("message ends before a count")
        self.layout.guards.append((self.position, raw))
        self.position += 4
        return int(struct.unpack(self.order + "I", raw)[0])

    def _numbers(self, name: str, kind: str, count: int) -> None:
        size = int(kind[1])
        # An empty sequence is not followed by the padding of its elements.
        if count:
            self._align(size)
        if self.position + count * size > len(self.blob):
            raise CdrError(f"message ends inside {name}")
        self.layout.columns[name] = (self.position, self.order + kind, count)
        self.position += count * size

    def _string(self) -> tuple[int, bytes]:
        length = self._count()
        start, self.position = self.position, self.position + length
        if self.position > len(self.blob):
            raise CdrError("message ends inside a string")
        return start, self.blob[start : self.position]

    def _texts(self, name: str, kind: str) -> None:
        count = self._few("texts") if kind.endswith("[]") else 1
        found = []
        for _ in range(count):
            start, content = self._string()
            if kind.startswith("text"):
                if len(content) > _LONGEST_TEXT:
                    raise CdrError(f"a text of {len(content)} bytes in {name}")
                self.layout.guards.append((start, content))
                found.append(content.rstrip(b"\0").decode(errors="replace"))
        self.layout.texts[name] = tuple(found)

    def _dimensions(self) -> None:
        for _ in range(self._few("dimensions")):
            self._string()
            self._align(4)
            self.position += 8


def find_layout(blob: bytes, msgtype: str) -> Layout:
    """Layout of one serialised message.

    Raises:
        CdrError: the bytes do not follow the type.
    """
    return _Walker(blob).walk(FIELDS[msgtype])


def lengths_of(blobs: Sequence[bytes]) -> NDArray[np.int64]:
    """(n,) bytes of each message."""
    return np.fromiter(map(len, blobs), dtype=np.int64, count=len(blobs))


def split(joined: bytes, lengths: NDArray[np.int64]) -> list[bytes]:
    """Messages that lie one after the other, one by one."""
    ends = np.cumsum(lengths)
    return list(map(joined.__getitem__, map(slice, (ends - lengths).tolist(), ends.tolist())))


def decode_joined(
    joined: bytes, lengths: NDArray[np.int64], msgtype: str, budget: Budget
) -> Iterator[Batch]:
    """As `decode`, for messages that lie one after the other; lengths: (n,) bytes of each."""
    order = np.argsort(lengths, kind="stable")
    ends = np.flatnonzero(np.diff(lengths[order])) + 1
    blobs = split(joined, lengths) if len(ends) else []
    for rows in np.split(order, ends):
        if len(rows) and lengths[rows[0]] >= _ENCAPSULATION:
            same_length = b"".join([blobs[row] for row in rows.tolist()]) if blobs else joined
            yield from _decode_matrix(same_length, rows, msgtype, budget)


def _decode_matrix(
    joined: bytes, rows: NDArray[np.int64], msgtype: str, budget: Budget
) -> Iterator[Batch]:
    length = len(joined) // len(rows)
    matrix = np.frombuffer(joined, dtype=np.uint8).reshape(len(rows), length)
    remaining = np.arange(len(rows))
    for _ in range(_LAYOUTS_PER_LENGTH):
        if not len(remaining):
            return
        budget.check()
        first = int(remaining[0])
        try:
            layout = find_layout(joined[first * length : (first + 1) * length], msgtype)
        except CdrError:
            remaining = remaining[1:]
            continue
        same = _matches(matrix[remaining] if len(remaining) < len(rows) else matrix, layout)
        taken, remaining = remaining[same], remaining[~same]
        yield _batch(matrix, taken, rows, layout)
    for number, row in enumerate(remaining.tolist()):
        if number % _CHECK_TIME_EVERY == 0:
            budget.check()
        try:
            layout = find_layout(joined[row * length : (row + 1) * length], msgtype)
        except CdrError:
            continue
        yield _batch(matrix, np.array([row]), rows, layout)


def _matches(matrix: NDArray[np.uint8], layout: Layout) -> NDArray[np.bool_]:
    """Which rows share the layout's guards, (n,); compared eight bytes at a time."""
    same = np.ones(len(matrix), dtype=bool)
    for offset, content in layout.guards:
        words = len(content) // 8 * 8
        for at in (*range(0, words, 8), *range(words, len(content))):
            kind = np.uint64 if at < words else np.uint8
            column: NDArray[Any] = np.ndarray(
                len(matrix), kind, matrix, offset + at, matrix.strides[:1]
            )
            same &= column == np.frombuffer(content, kind, 1, at)
    return same


def _batch(
    matrix: NDArray[np.uint8],
    taken: NDArray[np.int64],
    rows: NDArray[np.int64],
    layout: Layout,
) -> Batch:
    whole = len(taken) == len(rows)
    columns = {}
    for name, (offset, kind, count) in layout.columns.items():
        view: NDArray[np.generic] = np.ndarray(
            (len(matrix), count),
            dtype=kind,
            buffer=matrix,
            offset=offset if count else 0,
            strides=(matrix.shape[1], int(kind[2])),
        )
        columns[name] = view if whole else view[taken]
    return Batch(rows[taken], columns, layout.texts)


def encode(template: bytes, msgtype: str, columns: dict[str, NDArray[np.float64]]) -> list[bytes]:
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
        block = np.asarray(values).reshape(n, -1).astype(kind)
        if block.shape[1] != count:
            raise CdrError(f"{name}: {block.shape[1]} elements for a template of {count}")
        raw = np.ascontiguousarray(block).view(np.uint8).reshape(n, -1)
        matrix[:, offset : offset + raw.shape[1]] = raw
    length = len(template)
    joined = matrix.tobytes()
    return [joined[start : start + length] for start in range(0, n * length, length)]
