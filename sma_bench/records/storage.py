"""Reads the serialised messages of a bag's storage files.

An mcap file is walked from its beginning, so one whose recorder died is read like any other, up to
its first damage; what lies behind that is given up, and said. An sqlite3 file is read whole or
refused. Both spend a Budget, so that no file takes more memory or time than its size allows.
"""

import fcntl
import mmap
import os
import sqlite3
import struct
import sys
import zlib
from array import array
from collections.abc import Callable
from contextlib import closing, suppress
from dataclasses import dataclass, field
from pathlib import Path

from sma_bench.border import Budget, OverBudget, printable, reading_budget
from sma_bench.errors import InputError
from sma_bench.findings import Finding

if sys.version_info >= (3, 14):
    from compression import zstd
else:  # rosbags brings it along
    from backports import zstd

MCAP_MAGIC, SQLITE_MAGIC = b"\x89MCAP0\r\n", b"SQLite format 3\0"
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
_MOST_TOPICS = 4096
_LARGEST_MESSAGE = 1 << 24
_PIECE = 1 << 16


@dataclass
class RawTopic:
    """Serialised messages of one topic in the order of the files, one behind the other in `data`.

    Attributes:
        wanted: whether they are kept; others are only counted.
        times, lengths: of each message, ns and bytes.
    """

    name: str
    type: str
    wanted: bool
    count: int = 0
    times: "array[int]" = field(default_factory=lambda: array("q"))
    lengths: "array[int]" = field(default_factory=lambda: array("q"))
    data: bytearray = field(default_factory=bytearray)


@dataclass
class RawTopics:
    """The topics of all files of a bag by name and type, and what of them could not be read."""

    wanted: Callable[[str, str], bool]
    topics: dict[tuple[str, str], RawTopic] = field(default_factory=dict)
    findings: list[Finding] = field(default_factory=list)
    budget: Budget = field(default_factory=lambda: reading_budget(0))

    def topic(self, name: str, msgtype: str, encoding: str) -> RawTopic:
        """The topic to add messages to, created when it is new."""
        parts = msgtype.split("/")  # old bags have sensor_msgs/Temperature
        key = printable(name), printable("/msg/".join(parts) if len(parts) == 2 else msgtype)
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

    def lost(self, subject: str, text: str, **numbers: float) -> None:
        """Note that something of the bag could not be read."""
        self.findings.append(Finding("warning", printable(subject), printable(text), dict(numbers)))


# --- mcap (https://mcap.dev/spec) ---------------------------------------------------------------

_SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _DATA_END = 0x03, 0x04, 0x05, 0x06, 0x0F
_DATA_END_SIZE = 4
_RECORD, _MESSAGE_HEAD = struct.Struct("<BQ"), struct.Struct("<HIQQ")
_CHUNK_HEAD = struct.Struct("<QQQII")
_CHECK_TIME_EVERY = 1 << 17  # bytes
_BLOCK = 512  # bytes, the smallest that disks have
_NO_SCHEMA = 0


class _Damage(Exception):
    """Bytes that are no record."""


def read_mcap(path: Path, topics: RawTopics, name: str) -> None:
    """Add the messages of one mcap file, called `name` in findings.

    Raises:
        OSError: the file cannot be opened.
        OverBudget: it asks for more than such a file may; what was found until then is there.
    """
    size = path.stat().st_size
    if not size:
        topics.lost(name, "the file is empty")
        return
    walk = _McapWalk(topics)
    damage = ""
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as buffer:
        try:
            if buffer[: len(MCAP_MAGIC)] != MCAP_MAGIC:
                raise _Damage("it does not begin like an mcap file")
            walk.position = len(MCAP_MAGIC)
            walk.take(buffer, walk.position, inside_chunk=False)
        except (_Damage, struct.error) as error:
            damage = str(error) if isinstance(error, _Damage) else "a record is broken"
        growing = not walk.ended and _is_being_written(file.fileno(), path)
    if walk.orphans:
        text = f"{walk.orphans} messages belong to no known topic and are lost"
        topics.lost(name, text, messages=walk.orphans)
    if growing:
        text = "is still being recorded: what was written until now is read"
        topics.findings.append(Finding("info", name, text))
    elif damage:
        lost = size - walk.position
        text = f"damaged at byte {walk.position}: {damage}; what comes after, {lost} bytes at most "
        topics.lost(name, text + f"({lost / size:.1%}), is lost", bytes=lost)
    elif not walk.ended:
        text = "the file was never finished (its writer died); all whole messages are read"
        topics.lost(name, text)


class _McapWalk:
    """Takes one record after the other; `position` is the first in the file not taken whole."""

    def __init__(self, topics: RawTopics) -> None:
        self.topics = topics
        self.schemas = {_NO_SCHEMA: ""}
        self.channels: dict[int, RawTopic] = {}
        self.position = self.orphans = 0
        self.ended = False

    def take(
        self, buffer: bytes | mmap.mmap, position: int, inside_chunk: bool, at: int = 0
    ) -> None:
        """Take the records from `position` to the end, of the file or of a chunk, that begins at
        byte `at` of the file.

        Raises:
            _Damage, struct.error: what comes next is no record.
        """
        end, unpack, channels = len(buffer), _RECORD.unpack_from, self.channels
        checked, topic = position, None
        while position < end and not self.ended:
            if position - checked > _CHECK_TIME_EVERY:
                self.topics.budget.check()
                checked = position
            if position + _RECORD.size > end:
                raise _Damage("it ends inside a record")
            opcode, length = unpack(buffer, position)
            start = position + _RECORD.size
            stop = start + length
            if not 0 < opcode < 0x80:
                if topic is not None and topic.wanted:
                    _forget_half_zeroed(topic, buffer, position, at)
                raise _Damage("the bytes make no sense")
            if stop > end and opcode == _CHUNK and not inside_chunk:
                self.take(_begun_chunk(buffer[start:], self.topics.budget), 0, True)
                raise _Damage("it ends inside a chunk, of which the whole messages are read")
            if stop > end:
                raise _Damage("it ends inside a record")
            if opcode == _MESSAGE:
                channel, _, time, _ = _MESSAGE_HEAD.unpack_from(buffer, start)
                topic = channels.get(channel)
                if topic is None or time >> 63 or length < _MESSAGE_HEAD.size:
                    self.orphans += 1
                else:
                    topic.count += 1
                    if topic.wanted:
                        topic.times.append(time)
                        topic.lengths.append(length - _MESSAGE_HEAD.size)
                        topic.data += buffer[start + _MESSAGE_HEAD.size : stop]
            elif opcode == _CHUNK:
                if inside_chunk:  # thousands in each other would end the stack
                    raise _Damage("a chunk inside a chunk")
                data = _plain_chunk(buffer[start:stop], self.topics.budget)
                self.take(data, 0, True, stop - len(data))
            elif opcode == _SCHEMA:
                content = buffer[start:stop]
                (number,) = struct.unpack_from("<H", content)
                self.schemas.setdefault(number, _string(content, 2)[0])
            elif opcode == _CHANNEL:
                self._channel(buffer[start:stop])
            elif opcode == _DATA_END and not inside_chunk:
                if length != _DATA_END_SIZE:
                    raise _Damage("the bytes make no sense")
                self.ended = True
            position = stop
            if not inside_chunk:
                self.position = stop

    def _channel(self, content: bytes) -> None:
        number, schema = struct.unpack_from("<HH", content)
        name, at = _string(content, 4)
        encoding, _ = _string(content, at)
        if schema not in self.schemas:
            raise _Damage(f"the topic {printable(name)} has an unknown type")
        if number not in self.channels:
            kind = self.schemas[schema]  # none is no damage, but no ROS topic either
            topic = self.topics.topic(name, kind, encoding) if kind else RawTopic(name, "", False)
            self.channels[number] = topic


def _forget_half_zeroed(
    topic: RawTopic, buffer: bytes | mmap.mmap, position: int, at: int
) -> None:
    """Take back a message in front of zeros that may have begun inside it: a computer that lost its
    power leaves them from the beginning of a block."""
    size = _RECORD.size + _MESSAGE_HEAD.size + topic.lengths[-1]
    block = (at + position) // _BLOCK * _BLOCK - at
    if position - size < block < position and not any(buffer[block : position + 1]):
        del topic.data[-topic.lengths.pop() :], topic.times[-1]
        topic.count -= 1


def _plain_chunk(content: bytes, budget: Budget) -> bytes:
    """The records of a chunk, decompressed and compared with its checksum."""
    _, _, size, checksum, _ = _CHUNK_HEAD.unpack_from(content)
    data = _unpacked(content, size, budget)
    if len(data) != size or (checksum and zlib.crc32(data) != checksum):
        raise _Damage("a chunk with a wrong checksum or size")
    return data


def _begun_chunk(content: bytes, budget: Budget) -> bytes:
    """The whole records of a chunk that the file ends in; no checksum speaks for them."""
    data = _unpacked(content, budget.left, budget)
    position = 0
    while position + _RECORD.size <= len(data):
        length = _RECORD.unpack_from(data, position)[1]
        if position + _RECORD.size + length > len(data):
            break
        position += _RECORD.size + length
    return data[:position]


def _unpacked(content: bytes, size: int, budget: Budget) -> bytes:
    """The records in a chunk, one byte more than `size` at most."""
    codec_length = _CHUNK_HEAD.unpack_from(content)[-1]
    begin = _CHUNK_HEAD.size + codec_length + 8
    codec, data = content[_CHUNK_HEAD.size : begin - 8], content[begin:]
    most = min(size, budget.left) + 1
    try:
        if codec == b"zstd":
            data = zstd.ZstdDecompressor().decompress(data, most)
        elif codec == b"lz4":
            import lz4.frame

            data = lz4.frame.LZ4FrameDecompressor().decompress(data, most)
        elif codec:
            raise _Damage(f"a chunk is compressed as {codec[:20]!r}")
    except (zstd.ZstdError, EOFError, RuntimeError, MemoryError) as error:
        raise _Damage(f"a chunk cannot be decompressed: {error}") from None
    budget.take(len(data) if codec else 0)
    return data


def _string(buffer: bytes, position: int) -> tuple[str, int]:
    (length,) = struct.unpack_from("<I", buffer, position)
    end = position + 4 + length
    if end > len(buffer):
        raise _Damage("a text reaches beyond its record")
    return buffer[position + 4 : end].decode(errors="replace"), end


def _is_being_written(handle: int, path: Path) -> bool:
    """Whether a recorder has the file: BagWriter's by its lock, which is gone with it however it
    went, another one (`ros2 bag record`) by /proc, where it may be asked."""
    try:
        fcntl.flock(handle, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:  # a file system without locks
        pass
    wanted = str(path.resolve())
    for link in Path("/proc").glob("[0-9]*/fd/*"):
        with suppress(OSError, IndexError, ValueError):  # gone, or not ours to see
            if os.readlink(link) == wanted:
                info = (link.parents[1] / "fdinfo" / link.name).read_text()
                flags = int(info.partition("flags:")[2].split()[0], 8)
                if flags & os.O_ACCMODE != os.O_RDONLY:
                    return True
    return False


# --- sqlite3 ------------------------------------------------------------------------------------

_STEPS = 10_000  # of SQLite's machine, between two looks at the clock
# A damaged schema can make sqlite3 fail to decode its own error message.
_READ_ERRORS = (sqlite3.Error, OverflowError, MemoryError, UnicodeError)
_MESSAGES = (
    "SELECT rowid, topic_id, timestamp, data FROM messages WHERE topic_id IN ({}) "
    "AND typeof(data) = 'blob' AND typeof(timestamp) = 'integer' AND timestamp >= 0 ORDER BY rowid"
)


def read_sqlite(path: Path, topics: RawTopics, origin: Path) -> None:
    """Add the messages of one sqlite3 file, of which `origin` is the compressed one, or itself.

    It is opened as one that nobody changes: what a writer that died left in a journal beside it is
    not read, and said.

    Raises:
        InputError: the file is damaged.
        OverBudget: it asks for more than such a file may; what was found until then is there.
    """
    for suffix in ("-wal", "-journal"):
        beside = path.with_name(path.name + suffix)
        if beside.is_file() and not beside.is_symlink() and beside.stat().st_size:
            text = f"its writer died: what {beside.name} holds is not read; sqlite3 takes it up: "
            topics.lost(path.name, text + f"sqlite3 {path.name} .tables")
    budget = topics.budget
    try:
        uri = f"{path.resolve().as_uri()}?mode=ro&immutable=1"
        with closing(sqlite3.connect(uri, uri=True)) as database:
            database.text_factory = bytes
            database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, _LARGEST_MESSAGE)
            database.set_progress_handler(budget.is_over, _STEPS)
            database.execute("PRAGMA trusted_schema = OFF")
            _require_tables(database)
            _take_rows(database, topics)
    except _READ_ERRORS as error:
        if getattr(error, "sqlite_errorcode", None) == sqlite3.SQLITE_INTERRUPT:
            budget.check()
            raise KeyboardInterrupt from None  # a signal's exception does not get through SQLite
        reason = printable(" ".join(str(error).split()))
        raise InputError(
            f"{origin}: damaged: {reason}; what can be saved of it: sqlite3 {path.name} .recover | "
            "sqlite3 recovered.db3"
        ) from None


def _require_tables(database: sqlite3.Connection) -> None:
    """DatabaseError unless topics and messages are tables with columns of their own: what a view
    says may be any program, one that never ends too."""
    tables = database.execute("PRAGMA main.table_list").fetchall()
    kinds = {row[1].decode(errors="replace").lower(): row[2] for row in tables}
    for name in ("messages", "topics"):
        if kinds.get(name) != b"table":
            raise sqlite3.DatabaseError(f"{name} is no table")
        columns = database.execute(f"PRAGMA main.table_xinfo({name})").fetchall()
        if any(column[6] for column in columns):
            raise sqlite3.DatabaseError(f"{name} has columns that are computed")


def _take_rows(database: sqlite3.Connection, topics: RawTopics) -> None:
    found = {
        number: topics.topic(*(text.decode(errors="replace") for text in texts))
        for number, *texts in database.execute(
            "SELECT id, name, type, serialization_format FROM topics"
        )
        if isinstance(number, int) and all(isinstance(text, bytes) for text in texts)
    }
    wanted = [number for number, topic in found.items() if topic.wanted]
    last, take = -1, topics.budget.take
    rows = database.execute(_MESSAGES.format(",".join("?" * len(wanted))), wanted)
    for row, number, time, data in rows:
        if not isinstance(row, int) or row <= last:
            raise sqlite3.DatabaseError("rows lead back into the table")
        last = row
        take(len(data) + 1)
        topic = found[number]
        topic.count += 1
        topic.times.append(time)
        topic.lengths.append(len(data))
        topic.data += data
    others = [number for number in found if number not in wanted]
    query = "SELECT topic_id, COUNT(*) FROM messages WHERE topic_id IN ({}) GROUP BY topic_id"
    for number, count in database.execute(query.format(",".join("?" * len(others))), others):
        found[number].count += count


# --- compression --------------------------------------------------------------------------------


def decompress_file(source: Path, target: Path, budget: Budget) -> str:
    """Decompress a zstd file as far as it goes, and the budget does; what ended that too early."""
    with zstd.open(source) as compressed, target.open("wb") as output:
        try:
            while plain := compressed.read(_PIECE):
                budget.take(len(plain))
                output.write(plain)
        except OverBudget as error:
            return str(error)
        except (zstd.ZstdError, EOFError, MemoryError):
            return "the zstd compression is broken or cut short"
    return ""


def decompress_messages(topic: RawTopic, budget: Budget) -> None:
    """Replace a topic's messages, where they are compressed one by one, by what they unfold to;
    nothing where one cannot be.

    Raises:
        OverBudget: they are larger, all together, than they may be.
    """
    plain, lengths, position = bytearray(), array("q"), 0
    for length in topic.lengths:
        message = bytes(topic.data[position : position + length])
        position += length
        decompressor = zstd.ZstdDecompressor()
        try:
            message = decompressor.decompress(message, _LARGEST_MESSAGE)
        except (zstd.ZstdError, MemoryError):
            message = b""
        message = message if decompressor.eof else b""
        budget.take(len(message))
        plain += message
        lengths.append(len(message))
    topic.data, topic.lengths = plain, lengths
