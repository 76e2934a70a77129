"""What is gathered from the storage files of a bag and decompressed before messages are decoded."""

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import zstandard
from numpy.typing import NDArray

from sma_bench.border import Budget, OverBudget, printable, reading_budget
from sma_bench.findings import Finding
from sma_bench.records.record import IntArray

# Bytes: a smaller file is read one message after the other before numba is even loaded.
_WORTH_LOADING = 8 << 20
_MOST_TOPICS = 4096


@dataclass
class RawTopic:
    """Serialised messages of one topic in the order of the file.

    They are added one by one to `times` (receive times, ns) and `blobs`, or many at once by
    `add_run`; both stay empty for topics that are only counted.
    """

    name: str
    type: str
    wanted: bool
    count: int = 0
    times: list[int] = field(default_factory=list)
    blobs: list[bytes] = field(default_factory=list)
    _runs: list[tuple[IntArray, IntArray, bytes | memoryview]] = field(default_factory=list)

    def add_run(self, times: IntArray, lengths: IntArray, joined: bytes | memoryview) -> None:
        """Add messages whose bytes lie one after the other."""
        self._end_run()
        self._runs.append((times, lengths, joined))

    def add_found(
        self, number: int, raw: NDArray[np.uint8], starts: IntArray, stops: IntArray,
        topics: IntArray, times: IntArray,
    ) -> int:
        """Add those of the messages found in `raw` that are of topic `number`, by compiled code.

        Args:
            starts, stops: (n,) offsets of each message's data; topics, times [ns]: (n,).

        Returns:
            How many they are; those of a topic that is not wanted are only counted.
        """
        from sma_bench.records.message_buffers import measure_topic, take_topic

        rows, size = measure_topic(number, starts, stops, topics)
        self.count += rows
        if rows and self.wanted:
            taken, lengths = np.empty((2, rows), dtype=np.int64)
            joined = np.empty(size, dtype=np.uint8)
            take_topic(raw, number, starts, stops, topics, times, taken, lengths, joined)
            self.add_run(taken, lengths, joined.data)
        return int(rows)

    def taken(self) -> tuple[IntArray, IntArray, bytes]:
        """Receive times (n,) [ns], lengths (n,) and all bytes, joined; the topic is empty then."""
        self._end_run()
        runs, self._runs = self._runs, []
        empty: IntArray = np.empty(0, dtype=np.int64)
        times, lengths = (np.concatenate([empty, *(run[k] for run in runs)]) for k in (0, 1))
        return times, lengths, b"".join(run[2] for run in runs)

    def _end_run(self) -> None:
        """What came one by one, as a run."""
        if not self.blobs:
            return
        lengths = np.fromiter(map(len, self.blobs), dtype=np.int64, count=len(self.blobs))
        times = np.array(self.times, dtype=np.int64)
        self._runs.append((times, lengths, b"".join(self.blobs)))
        self.times.clear()
        self.blobs.clear()


@dataclass
class Harvest:
    """Topics of all files of a bag, and what could not be read."""

    wanted: Callable[[str, str], bool]
    topics: dict[tuple[str, str], RawTopic] = field(default_factory=dict)
    findings: list[Finding] = field(default_factory=list)
    budget: Budget = field(default_factory=lambda: reading_budget(0))

    def topic(self, name: str, msgtype: str, encoding: str = "cdr") -> RawTopic:
        """The topic to append messages to, created when it is new."""
        key = printable(name), printable(normal_type(msgtype))
        if key not in self.topics:
            if len(self.topics) >= _MOST_TOPICS:
                raise OverBudget(f"more than {_MOST_TOPICS} topics")
            wanted = self.wanted(*key)
            if wanted and encoding != "cdr":
                text = f"messages are encoded as {encoding[:40]!r}, expected 'cdr'; not decoded"
                self.findings.append(Finding("error", key[0], text))
                wanted = False
            self.topics[key] = RawTopic(*key, wanted)
        return self.topics[key]

    @property
    def count(self) -> int:
        """Messages found on all topics."""
        return sum(topic.count for topic in self.topics.values())

    def lost(self, subject: str, text: str, **numbers: float) -> None:
        """Note that something of the bag could not be read."""
        self.findings.append(Finding("warning", subject, text, dict(numbers)))


def is_compiled(size: int) -> bool:
    """Whether compiled code sorts the messages of a file of `size` bytes."""
    if size < _WORTH_LOADING and "numba" not in sys.modules:
        return False
    from sma_bench.compiled import COMPILES

    return COMPILES


def normal_type(msgtype: str) -> str:
    """`sensor_msgs/Temperature` written as `sensor_msgs/msg/Temperature`."""
    parts = msgtype.split("/")
    return f"{parts[0]}/msg/{parts[1]}" if len(parts) == 2 else msgtype


# --- decompression, with a limit on the output and with salvage of broken input

ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"

# Small pieces keep the output small (a zstd block makes 128 KiB from 4 bytes) and lose little of
# what lies before an error.
_PIECE = 4096
_LARGEST_MESSAGE = 1 << 24
_CUT = "the zstd compression is broken or cut short"


def decompress_zstd(data: bytes, limit: int) -> tuple[bytes, bool]:
    """Decompress one frame, as far as it goes.

    Returns:
        The output, at most `limit` bytes and one block, and whether the frame was whole.
    """
    decompressor = zstandard.ZstdDecompressor()
    try:
        if 0 <= zstandard.frame_content_size(data) <= limit:
            return decompressor.decompress(data), True
    except (zstandard.ZstdError, MemoryError):
        pass
    stream = decompressor.decompressobj()
    return _piece_by_piece(stream, data, limit, (zstandard.ZstdError, MemoryError))


def decompress_lz4(data: bytes, limit: int) -> tuple[bytes, bool]:
    """Decompress one lz4 frame, as far as it goes; nothing where lz4 is not installed."""
    try:
        import lz4.frame
    except ImportError:
        return b"", False
    stream = lz4.frame.LZ4FrameDecompressor()
    return _piece_by_piece(stream, data, limit, (RuntimeError, MemoryError, EOFError))


def _piece_by_piece(
    stream: Any, data: bytes, limit: int, broken: tuple[type[Exception], ...]
) -> tuple[bytes, bool]:
    """What a stream makes of the data until it raises one of `broken`, and whether that is all."""
    output, size = [], 0
    try:
        for start in range(0, len(data), _PIECE):
            if size > limit or stream.eof:
                break
            output.append(stream.decompress(data[start : start + _PIECE]))
            size += len(output[-1])
    except broken:
        return b"".join(output), False
    return b"".join(output), stream.eof and size <= limit


def decompress_file(source: Path, target: Path, budget: Budget) -> str:
    """Decompress a zstd file as far as it goes, and the budget does; what ended that too early."""
    decompressor = zstandard.ZstdDecompressor()
    stream = decompressor.decompressobj()
    with source.open("rb") as compressed, target.open("wb") as output:
        try:
            while piece := compressed.read(_PIECE):
                while piece:
                    if stream.eof:
                        stream = decompressor.decompressobj()
                    plain = stream.decompress(piece)
                    budget.take(len(plain))
                    output.write(plain)
                    piece = stream.unused_data if stream.eof else b""
        except OverBudget as error:
            return str(error)
        except (zstandard.ZstdError, MemoryError):
            return _CUT
    return "" if stream.eof else _CUT


def decompress_messages(blobs: Sequence[bytes], budget: Budget) -> tuple[list[bytes], int]:
    """Messages of a bag with per-message compression.

    Returns:
        The messages, those that cannot be decompressed as empty bytes, and how many those are.

    Raises:
        OverBudget: they are larger, all together, than they may be.
    """
    decompressor = zstandard.ZstdDecompressor()
    messages, broken = [], 0
    for blob in blobs:
        try:
            size = zstandard.frame_content_size(blob)
            if size > _LARGEST_MESSAGE:
                raise zstandard.ZstdError("larger than any message")
            messages.append(decompressor.decompress(blob, max_output_size=_LARGEST_MESSAGE))
            budget.take(len(messages[-1]))
        except (zstandard.ZstdError, MemoryError):
            messages.append(b"")
            broken += 1
    return messages, broken
