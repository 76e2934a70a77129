"""Reads an mcap file front to back, past whatever is damaged in it.

The index at the end is not needed, so a file whose writer died is read like any other. Where the
bytes make no sense the scan looks for the next place where records follow one another again.
Format: https://mcap.dev/spec.
"""

import fcntl
import mmap
import os
import re
import struct
import zlib
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO

import numpy as np

from sma_bench.border import Budget, OverBudget
from sma_bench.findings import Finding
from sma_bench.records.harvest import (
    Harvest,
    RawTopic,
    decompress_lz4,
    decompress_zstd,
    is_compiled,
)
from sma_bench.records.record import IntArray

MAGIC = b"\x89MCAP0\r\n"

_FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _DATA_END = 0x02, 0x03, 0x04, 0x05, 0x06, 0x0F
_RECORD = struct.Struct("<BQ")
_MESSAGE_RECORD = struct.Struct("<BQHIQQ")
_CHUNK_HEAD = struct.Struct("<QQQII")
_FOOTER_SIZE = 9 + 20 + len(MAGIC)

_CANDIDATE = re.compile(rb"[\x01-\x0f].{4}\x00{4}", re.DOTALL)
_LARGEST_CHUNK = 1 << 28
_WINDOW = 1 << 20
_LEAST_MESSAGE = 31
_LATEST = 1 << 63
_CHECK_TIME_EVERY = 4096  # records

_Bytes = bytes | mmap.mmap


class _Truncated(Exception):
    """A structure reaches past the end of its bytes."""


class _Scan:
    """State of the walk through one file."""

    def __init__(self, name: str, harvest: Harvest) -> None:
        self.name, self.harvest = name, harvest
        self.schemas: dict[int, str] = {}
        self.channels: dict[int, RawTopic] = {}
        self.ended = False
        self.growing = False
        self.skipped = 0
        self.first_remark, self.places = "", 0
        self.steps = 0
        self.orphans = 0
        self.compiled = False
        self.found: IntArray | None = None
        self.handlers = {_SCHEMA: self._schema, _CHANNEL: self._channel, _CHUNK: self._chunk}
        self.in_chunk = False

    def walk(self, buffer: _Bytes, position: int, end: int) -> None:
        """Take every record between two offsets."""
        channels = self.channels
        while position + _RECORD.size <= end and not self.ended:
            self.steps += 1
            if self.steps % _CHECK_TIME_EVERY == 0:
                self.harvest.budget.check()
            opcode, length = _RECORD.unpack_from(buffer, position)
            start = position + _RECORD.size
            stop = start + length
            if stop > end or not 0 < opcode < 0x80 or (opcode == _MESSAGE and length < 22):
                position = self._recover(buffer, position, end)
                continue
            if opcode == _MESSAGE and self.compiled:
                position = self._messages(buffer, position, end)
                if position >= stop:
                    continue
            if opcode == _MESSAGE:
                _, _, channel, _, time, _ = _MESSAGE_RECORD.unpack_from(buffer, position)
                topic = channels.get(channel)
                if topic is None or time >= _LATEST:
                    self.orphans += 1
                else:
                    topic.count += 1
                    if topic.wanted:
                        topic.times.append(time)
                        topic.blobs.append(buffer[start + 22 : stop])
            elif opcode in self.handlers:
                try:
                    self.handlers[opcode](buffer, start, stop)
                except (_Truncated, struct.error):
                    self._damage(f"a broken record at byte {position}", stop - position)
            elif opcode == _DATA_END:
                self.ended = True
            position = stop
        if position < end and not self.ended:
            self._damage("", end - position)

    def _messages(self, buffer: _Bytes, position: int, end: int) -> int:
        """Take the messages that follow one another from `position` on; where the next record is.

        None is taken where something is odd about the first.
        """
        from sma_bench.records.message_buffers import find_messages

        # A copy of the file's own bytes: a map that arrays look into cannot be closed.
        source = memoryview(buffer) if isinstance(buffer, bytes) else buffer
        raw = np.frombuffer(source[position : min(end, position + _WINDOW)], dtype=np.uint8)
        if self.found is None:
            self.found = np.empty((4, _WINDOW // _LEAST_MESSAGE), dtype=np.int64)
        count, passed = find_messages(raw, 0, len(raw), *self.found)
        starts, stops, channels, times = self.found[:, :count]
        known = sum(
            topic.add_found(channel, raw, starts, stops, channels, times)
            for channel, topic in self.channels.items()
        )
        self.orphans += count - known
        return position + passed

    def read_summary(self, buffer: _Bytes) -> None:
        """Learn the channels from the index, in case the records before it are damaged."""
        at = len(buffer) - _FOOTER_SIZE
        if at < len(MAGIC) or buffer[at + 29 :] != MAGIC:
            return
        opcode, length, position = struct.unpack_from("<BQQ", buffer, at)
        if (opcode, length) != (_FOOTER, 20) or not len(MAGIC) <= position < at:
            return
        while position + _RECORD.size <= at:
            opcode, length = _RECORD.unpack_from(buffer, position)
            start, position = position + _RECORD.size, position + _RECORD.size + length
            if position > at:
                return
            if opcode in (_SCHEMA, _CHANNEL):
                try:
                    self.handlers[opcode](buffer, start, position)
                except (_Truncated, struct.error):
                    return

    def _schema(self, buffer: _Bytes, start: int, stop: int) -> None:
        (number,) = struct.unpack_from("<H", buffer, start)
        name, _ = _string(buffer, start + 2, stop)
        self.schemas.setdefault(number, name)

    def _channel(self, buffer: _Bytes, start: int, stop: int) -> None:
        number, schema = struct.unpack_from("<HH", buffer, start)
        topic, position = _string(buffer, start + 4, stop)
        encoding, _ = _string(buffer, position, stop)
        if schema not in self.schemas:
            raise _Truncated
        if number not in self.channels:
            self.channels[number] = self.harvest.topic(topic, self.schemas[schema], encoding)

    def _chunk(self, buffer: _Bytes, start: int, stop: int, whole: bool = True) -> None:
        if self.in_chunk:  # the format knows none; thousands in each other would end the stack
            self._damage("a chunk inside a chunk", stop - start)
            return
        _, _, size, checksum, name_length = _CHUNK_HEAD.unpack_from(buffer, start)
        position = start + _CHUNK_HEAD.size
        codec = bytes(buffer[position : position + name_length])
        data_start = position + name_length + 8
        if data_start > stop or codec not in (b"", b"zstd", b"lz4"):
            raise _Truncated
        data, complete = buffer[data_start:stop], whole
        if codec:
            decompress = decompress_zstd if codec == b"zstd" else decompress_lz4
            budget = self.harvest.budget
            data, complete = decompress(data, min(size, _LARGEST_CHUNK, budget.left))
            budget.take(len(data) + 1)
        if complete and checksum and zlib.crc32(data) != checksum:
            self._damage(f"a chunk with a wrong checksum at byte {start - 9}", stop - start)
            return
        if not complete and whole:
            missing = 1 - len(data) / max(size, len(data), 1)
            self._damage(f"a broken chunk at byte {start - 9}", round(missing * (stop - start)))
        self.in_chunk = True
        self.walk(data, 0, len(data))
        self.in_chunk = False
        # A chunk cannot end the file, whatever its bytes say.
        self.ended = False

    def _recover(self, buffer: _Bytes, position: int, end: int) -> int:
        """Note the damage at `position`; where to go on."""
        if buffer[position] == _CHUNK and _is_cut_chunk(buffer, position, end):
            self._damage(f"the file ends inside the chunk at byte {position}", 0)
            self._chunk(buffer, position + _RECORD.size, end, whole=False)
            return end
        found = _next_records(buffer, position + 1, end, self.harvest.budget)
        text = f"bytes {position} to {found} make no sense"
        if found == end and 0 < buffer[position] <= _DATA_END:
            text = f"the file ends inside the record at byte {position}"
        self._damage(text, found - position)
        return found

    def _damage(self, text: str, lost: int) -> None:
        self.skipped += lost
        if text:
            self.first_remark = self.first_remark or text
            self.places += 1

    def report(self, size: int) -> None:
        """Say what was lost."""
        if self.orphans:
            text = f"{self.orphans} messages belong to no known topic and are lost"
            self.harvest.lost(self.name, text, messages=self.orphans)
        if self.growing and not self.places:
            text = "is still being recorded: what was written until now is read"
            self.harvest.findings.append(Finding("info", self.name, text))
        elif self.places or self.skipped:
            first = self.first_remark or "the last record is cut short"
            more = f" and {self.places - 1} more places" if self.places > 1 else ""
            lost = min(self.skipped, size)
            text = f"damaged: {first}{more}; about {lost} of {size} bytes are lost"
            text += f" ({lost / size:.1%})"
            self.harvest.lost(self.name, text, bytes=lost)
        elif not self.ended:
            text = "the file was never finished (its writer died); all whole messages are read"
            self.harvest.lost(self.name, text)


def scan_mcap(path: Path, harvest: Harvest) -> None:
    """Add the messages of one mcap file to the harvest.

    Raises:
        OSError: the file cannot be opened.
        OverBudget: it asks for more than such a file may; what was found until then is there.
    """
    scan = _Scan(path.name, harvest)
    size = path.stat().st_size
    if not size:
        harvest.lost(path.name, "the file is empty")
        return
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as buffer:
        scan.compiled = is_compiled(size)
        if buffer[-len(MAGIC):] != MAGIC:
            scan.growing = _is_locked(file) or _is_being_written(path)
        scan.read_summary(buffer)
        start = len(MAGIC)
        if buffer[:start] != MAGIC:
            start = _next_records(buffer, 0, size, harvest.budget)
            scan._damage("the file does not begin like an mcap file", start)
        try:
            scan.walk(buffer, start, size)
        except OverBudget:
            scan.ended = True  # what is said is why the reading ended
            scan.report(size)
            raise
    scan.report(size)


def _is_locked(file: BinaryIO) -> bool:
    """Whether a recorder has the file; BagWriter's lock is gone with it, however it went."""
    try:
        fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:  # a file system without locks
        return False
    return False


def _is_being_written(path: Path) -> bool:
    """Whether a process that may be asked has the file open to write, `ros2 bag record` for one;
    Linux only."""
    wanted = str(path.resolve())
    for link in Path("/proc").glob("[0-9]*/fd/*"):
        with suppress(OSError, StopIteration, IndexError, ValueError):  # gone, or not ours to see
            if os.readlink(link) != wanted:
                continue
            info = (link.parents[1] / "fdinfo" / link.name).read_text().splitlines()
            flags = next(line.split()[1] for line in info if line.startswith("flags:"))
            if int(flags, 8) & os.O_ACCMODE != os.O_RDONLY:
                return True
    return False


def _string(buffer: _Bytes, position: int, stop: int) -> tuple[str, int]:
    (length,) = struct.unpack_from("<I", buffer, position)
    end = position + 4 + length
    if end > stop:
        raise _Truncated
    return bytes(buffer[position + 4 : end]).decode(errors="replace"), end


def _is_cut_chunk(buffer: _Bytes, position: int, end: int) -> bool:
    """Whether the lengths inside agree with the record's own, which reaches past the end."""
    start = position + _RECORD.size
    if start + _CHUNK_HEAD.size > end:
        return False
    _, length = _RECORD.unpack_from(buffer, position)
    *_, name_length = _CHUNK_HEAD.unpack_from(buffer, start)
    at = start + _CHUNK_HEAD.size + name_length
    if name_length > 4 or at + 8 > end:
        return False
    (data_length,) = struct.unpack_from("<Q", buffer, at)
    return length == _CHUNK_HEAD.size + name_length + 8 + data_length


def _next_records(buffer: _Bytes, position: int, end: int, budget: Budget) -> int:
    """First offset from which three records follow one another, or `end`."""
    tried = 0
    while match := _CANDIDATE.search(buffer, position, end):
        if _follow(buffer, match.start(), end):
            return match.start()
        position = match.start() + 1
        tried += 1
        if tried % _CHECK_TIME_EVERY == 0:
            budget.check()
    return end


def _follow(buffer: _Bytes, position: int, end: int) -> bool:
    for _ in range(3):
        if position == end:
            return True
        if position + _RECORD.size > end:
            return False
        opcode, length = _RECORD.unpack_from(buffer, position)
        position += _RECORD.size + length
        if not 0 < opcode <= _DATA_END or position > end or (opcode == _MESSAGE and length < 22):
            return False
    return True
