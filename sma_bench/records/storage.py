"""Reads the serialised messages in the storage files of a bag: mcap up to the first damage, sqlite3
completely or not at all. A Budget, by the size of the files, limits both."""

import mmap
import re
import sqlite3
import struct
import sys
import zlib
from array import array
from collections import Counter
from collections.abc import Callable
from contextlib import closing, suppress
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path, PurePath
from shlex import quote
from tempfile import TemporaryDirectory
from typing import Any

from sma_bench import border
from sma_bench.border import Budget, OverBudget, printable
from sma_bench.errors import InputError, errors_in
from sma_bench.findings import Finding, Severity

if sys.version_info >= (3, 14):
    from compression import zstd
else:  # a dependency of rosbags
    from backports import zstd

METADATA = "metadata.yaml"
PROVENANCE = "sma_bench_provenance"  # a key of its custom_data
_MCAP_MAGIC, _SQLITE_MAGIC = b"\x89MCAP0\r\n", b"SQLite format 3\0"
_ZSTD_MAGIC, _ROS1_MAGIC = b"\x28\xb5\x2f\xfd", b"#ROSBAG V2.0"
_SUFFIXES = (".mcap", ".db3", ".mcap.zstd", ".db3.zstd")
_TABLES = (".csv", ".tsv", ".txt", ".dat", ".xlsx", ".mat", ".h5", ".hdf5", ".parquet")
_LONGEST_NAME, _LONGEST_PROVENANCE = 255, 2000  # characters
_MOST_SENTENCES, _MOST_TOPICS = 50, 4096
_LARGEST_MESSAGE, _PIECE = 1 << 24, 1 << 16  # bytes


@dataclass
class RawTopic:
    """Serialised messages of one topic, concatenated in the order of the files."""

    name: str
    type: str
    wanted: bool  # False: messages are only counted
    count: int = 0
    times: "array[int]" = field(default_factory=lambda: array("q"))  # of each message, ns
    lengths: "array[int]" = field(default_factory=lambda: array("q"))  # bytes
    data: bytearray = field(default_factory=bytearray)
    definition: str = ""  # of its type, if the bag has it
    is_packed: bool = False  # encoded by ROS 1

    def add(self, time: int, data: bytes) -> None:
        self.count += 1
        if self.wanted:
            self.times.append(time)
            self.lengths.append(len(data))
            self.data += data


@dataclass
class RawTopics:
    """The topics of all files of a bag, by name and type, and findings about it."""

    wanted: Callable[[str, str], bool]
    topics: dict[tuple[str, str], RawTopic] = field(default_factory=dict)
    findings: list[Finding] = field(default_factory=list)
    budget: Budget = field(default_factory=lambda: border.reading_budget(0))
    is_foreign: bool = False  # True: messages of ROS 1 are wanted, too

    def topic(self, name: str, msgtype: str, encoding: str, definition: str = "") -> RawTopic:
        """The topic with this name and type, created if it is new."""
        parts = msgtype.split("/")  # old bags have sensor_msgs/Temperature
        key = printable(name), printable("/msg/".join(parts) if len(parts) == 2 else msgtype)
        if key not in self.topics:
            if len(self.topics) >= _MOST_TOPICS:
                raise OverBudget(f"more than {_MOST_TOPICS} topics")
            wanted = self.wanted(*key)
            is_packed = encoding == "ros1" and self.is_foreign
            if wanted and encoding != "cdr" and not is_packed:
                text = f"messages are encoded as {encoding[:40]!r}, expected 'cdr'; not decoded"
                self.remark(key[0], text, "error")
                wanted = False
            self.topics[key] = RawTopic(*key, wanted, definition=definition, is_packed=is_packed)
        return self.topics[key]

    def remark(self, of: str, text: str, severity: Severity = "warning", **numbers: float) -> None:
        self.findings.append(Finding(severity, printable(of), printable(text), numbers))


def is_bag(path: Path) -> bool:
    """True if a path is a bag by name or content. InputError: it is no folder or readable file."""
    border.require_there(path)
    if path.is_dir():
        return True
    with errors_in(f"{path}: cannot be read"):
        known = _head(path).startswith((_MCAP_MAGIC, _SQLITE_MAGIC, _ZSTD_MAGIC, _ROS1_MAGIC))
    return known or path.name.endswith(_SUFFIXES)


def _head(path: Path) -> bytes:
    with path.open("rb") as file:
        return file.read(100)


def read_storage(path: Path, wanted: Callable[[str, str], bool],
                 is_foreign: bool = False) -> RawTopics:
    """Messages, from a bag's folder or file, whose topic and type are `wanted`; findings say what
    could not be read. `is_foreign`: messages of ROS 1, too. Raises InputError: no bag, no message,
    or a damaged sqlite3 file."""
    topics = RawTopics(wanted, is_foreign=is_foreign)
    files, announced = _files_of(path, topics)
    topics.budget = border.reading_budget(sum(file.stat().st_size for file in files))
    for file in files:
        try:
            with TemporaryDirectory() as folder:
                plain, head = file, _head(file)
                if head.startswith(_ZSTD_MAGIC) or file.name.endswith(".zstd"):
                    plain = Path(folder, file.name.removesuffix(".zstd"))
                    if ended := _decompress_file(file, plain, topics.budget):
                        topics.remark(file.name, f"{ended}; read up to there")
                    head = _head(plain)
                # The content decides; the name, if the beginning is damaged.
                is_mcap = head.startswith(_MCAP_MAGIC)
                if head.startswith(_SQLITE_MAGIC) or (plain.suffix == ".db3" and not is_mcap):
                    _read_sqlite(plain, topics, file)
                elif head.startswith(_ROS1_MAGIC):
                    _read_ros1(plain, topics)
                else:
                    _read_mcap(plain, topics, file.name)
        except OverBudget as error:
            topics.remark(file.name, f"{error}; read up to there")
        except OSError as error:
            topics.remark(file.name, f"cannot be read: {error.strerror or error}")
    found = topics.topics.values()
    if not any(topic.count for topic in found):
        first = [f"nothing can be read: {f.subject}: {f.text}" for f in topics.findings[:1]]
        why = (*first, "the bag holds no messages (did its recorder die?)")[0]
        raise InputError(f"{path}: {why}")
    for name, count in announced.items():
        missing = count - sum(topic.count for topic in found if topic.name == name)
        if missing > 0:
            share = f"{missing} of {count} messages ({missing / count:.1%})"
            text = f"{share} announced by {METADATA} cannot be read"
            topics.remark(name, text, missing=missing, announced=count)
    return topics


def _files_of(path: Path, topics: RawTopics) -> tuple[list[Path], dict[str, int]]:
    """The storage files in order, and how many messages of each topic the metadata announces."""
    if not is_bag(path):
        how = ""
        if path.suffix.lower() in _TABLES:
            words = f"{quote(str(path))} --out {quote(path.stem)}"
            how = f"; to make a bag from a table: sma-bench import {words}"
        raise InputError(f"{path}: not a bag: expected a folder, an .mcap or a .db3 file{how}")
    if not path.is_dir():
        return [path], {}
    # Files in order of their numbers; links out of the folder are not followed.
    with errors_in(f"{path}: cannot be read"):
        names = {file.name for file in path.iterdir() if file.is_file()}
        own = {name for name in names if border.is_inside(path / name, path)}
    for name in sorted(names - own):
        if name == METADATA or name.endswith(_SUFFIXES):
            topics.remark(name, "a link out of the bag's folder; not followed")
    numbered = {re.sub(r"\d+", lambda m: m[0].zfill(9), n): n for n in own if n.endswith(_SUFFIXES)}
    present = [path / numbered[key] for key in sorted(numbered)]
    listed, announced = list[str](), Counter[str]()
    try:
        if METADATA in own:
            about = border.read_yaml(path / METADATA, aliases=True)["rosbag2_bagfile_information"]
            for entry in about.get("topics_with_message_count") or ():
                topic = _of(str, entry["topic_metadata"]["name"])
                announced[topic] += _of(int, entry["message_count"])
            listed = [PurePath(_of(str, name)).name for name in about["relative_file_paths"]]
            _remark_provenance(about.get("custom_data"), topics)
    except (InputError, KeyError, TypeError, ValueError, AttributeError):
        announced.clear()
        topics.remark(METADATA, "cannot be understood; the storage files next to it are read")
    if METADATA not in names:
        if not present:
            inner = any((folder / METADATA).is_file() for folder in path.iterdir())
            why = "a folder of bags: give each of them, as in " + f"{path}/*" if inner else \
                f"the folder holds no {METADATA} and no .mcap or .db3 file"
            raise InputError(f"{path}: not a bag: {why}")
        if len({re.sub(r"_\d+$", "", f.name.partition(".")[0]) for f in present}) > 1:
            why = f"files of several bags in it: {', '.join(file.name for file in present[:3])}"
            how = "expected one bag, or the path of a file"
            raise InputError(f"{path}: no {METADATA} in the folder, but {why}; {how}")
        read = f"{len(present)} storage file{'s' * (len(present) > 1)} read without it"
        topics.remark(METADATA, f"is missing; {read}", "info")
    # The listed files, then others: a recorder that died after a split did not list the newest.
    listed = [name for name in dict.fromkeys(listed) if len(name) <= _LONGEST_NAME]
    for name in listed:
        if name not in names:
            topics.remark(name, f"the storage file {name} is missing; the others are read")
    extra = [file for file in present if file.name not in listed]
    for file in extra if listed else ():
        topics.remark(file.name, f"not listed in {METADATA}, but read")
    numbers = [re.search(r"_(\d+)\.", file.name) for file in extra if not listed]
    for before, after in pairwise(number for number in numbers if number):
        first, last = int(before[1]) + 1, int(after[1]) - 1
        if first <= last:
            topics.remark(after.string, f"files {first} to {last} before it are missing")
    return [path / name for name in listed if name in own] + extra, announced


def _of(kind: type, value: Any) -> Any:
    """The value, if of that type: str() of another may be gigabytes long, by YAML's aliases."""
    if not isinstance(value, kind):
        raise TypeError(kind.__name__)
    return value


def _remark_provenance(custom: Any, topics: RawTopics) -> None:
    text = custom.get(PROVENANCE) if isinstance(custom, dict) else None
    if not isinstance(text, str):
        return
    try:
        source = border.read_json_object(text, PROVENANCE)
    except InputError as error:
        topics.remark(METADATA, str(error))
        return
    how, repeated = source.get("how"), source.get("repeated")
    parts = [f"imported from {source.get('source', '?')}, sha256 {source.get('sha256', '?')}"]
    parts += map(str, how[:_MOST_SENTENCES] if isinstance(how, list) else ())
    topics.remark("record", border.shown("; ".join(parts), _LONGEST_PROVENANCE), "info")
    if isinstance(repeated, int) and repeated > 0:
        text = f"{repeated} rows repeated the stamp of the row before and were spread at import"
        topics.remark("record", text, repeated=float(repeated))


_SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _DATA_END = 0x03, 0x04, 0x05, 0x06, 0x0F
_RECORD, _MESSAGE_HEAD = struct.Struct("<BQ"), struct.Struct("<HIQQ")
_CHUNK_HEAD = struct.Struct("<QQQII")
_CHECK_TIME_EVERY, _BLOCK = 1 << 17, 512  # bytes; the latter is the smallest block of disks


class _Damage(Exception):
    """Bytes that are no valid mcap record."""


def _read_mcap(path: Path, topics: RawTopics, name: str) -> None:
    """Add the messages of an mcap file up to the first damage. Raises OSError, OverBudget."""
    if not (size := path.stat().st_size):
        topics.remark(name, "the file is empty")
        return
    schemas = {0: ("", "")}  # name and definition; 0: a channel without a schema
    channels: dict[int, RawTopic] = {}
    reached, orphans, ended, damage = len(_MCAP_MAGIC), 0, False, ""

    def take(buffer: bytes | mmap.mmap, position: int, inside: int | None = None) -> None:
        """Read the records of the file, or of a chunk; `inside`: offset that makes a position in
        the chunk's records one in the file. Raises _Damage, struct.error."""
        nonlocal reached, orphans, ended
        end, unpack, checked = len(buffer), _RECORD.unpack_from, position
        topic: RawTopic | None = None
        while position < end and not ended:
            if position - checked > _CHECK_TIME_EVERY:
                topics.budget.check()
                checked = position
            start = position + _RECORD.size
            opcode, length = unpack(buffer, position) if start <= end else (_DATA_END, end)
            stop = start + length
            if not 0 < opcode < 0x80:
                if topic is not None and topic.wanted:
                    # Lost power leaves blocks of zeros, which may be the end of the last message.
                    before = _RECORD.size + _MESSAGE_HEAD.size + topic.lengths[-1]
                    block = position - ((inside or 0) + position) % _BLOCK
                    is_torn = position - before < block < position
                    if is_torn and not any(buffer[block : position + 1]):
                        del topic.data[-topic.lengths.pop() :], topic.times[-1]
                        topic.count -= 1
                raise _Damage("the bytes are no mcap record")
            if stop > end:
                if inside is not None:
                    raise _Damage("a chunk ends inside a record")
                # The file ends inside a chunk: its complete records, which no checksum covers.
                with suppress(_Damage, struct.error):
                    if opcode == _CHUNK:
                        begun = _unpacked(buffer[start:], topics.budget.left, topics.budget)
                        take(begun, 0, end - len(begun))
                return
            if opcode == _MESSAGE:
                channel, _, time, _ = _MESSAGE_HEAD.unpack_from(buffer, start)
                topic = channels.get(channel)
                if topic is None or time >> 63 or length < _MESSAGE_HEAD.size:
                    orphans += 1
                else:
                    begin = start + _MESSAGE_HEAD.size
                    topic.add(time, buffer[begin:stop] if topic.wanted else b"")
            elif opcode == _CHUNK:
                if inside is not None:  # thousands of nested ones would overflow the stack
                    raise _Damage("a chunk inside a chunk")
                _, _, plain, checksum, _ = _CHUNK_HEAD.unpack_from(buffer[start:stop])
                data = _unpacked(buffer[start:stop], plain, topics.budget)
                if len(data) != plain or (checksum and zlib.crc32(data) != checksum):
                    raise _Damage("a chunk with a wrong checksum or size")
                take(data, 0, stop - len(data))
            elif opcode == _SCHEMA:
                (number,) = struct.unpack_from("<H", buffer[start:stop])
                content = buffer[start:stop]
                name_of, after = _string(content, 2)
                definition, _ = _string(content, _string(content, after)[1])
                schemas.setdefault(number, (name_of, definition))
            elif opcode == _CHANNEL:
                content = buffer[start:stop]
                number, schema = struct.unpack_from("<HH", content)
                called, after = _string(content, 4)
                if schema not in schemas:
                    raise _Damage(f"the topic {printable(called)} has an unknown type")
                if number not in channels:
                    kind, definition = schemas[schema]  # "" is no damage, but no ROS topic either
                    channels[number] = RawTopic(called, "", False)
                    if kind:
                        channels[number] = topics.topic(called, kind, _string(content, after)[0],
                                                         definition)
            elif opcode == _DATA_END and inside is None:
                if length != 4:  # bytes of a checksum
                    raise _Damage("the bytes are no mcap record")
                ended = True
            position = stop
            if inside is None:
                reached = stop

    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
        try:
            if content[: len(_MCAP_MAGIC)] != _MCAP_MAGIC:
                raise _Damage("it does not begin like an mcap file")
            take(content, len(_MCAP_MAGIC))
        except (_Damage, struct.error) as error:
            damage = str(error) if isinstance(error, _Damage) else "a record is broken"
    if orphans:
        text = f"{orphans} messages belong to no known topic and are lost"
        topics.remark(name, text, messages=orphans)
    lost = size - reached
    share = f"{lost} bytes at most ({lost / size:.1%})"
    if damage:
        text = f"damaged at byte {reached}: {damage}; the rest, {share}, is lost"
        topics.remark(name, text, bytes=lost)
    elif not ended:
        text = "has no end: it is still being recorded, or its writer died; whole messages are read"
        topics.remark(name, text + f", {share} are lost" * bool(lost), bytes=lost)


def _unpacked(content: bytes, size: int, budget: Budget) -> bytes:
    begin = _CHUNK_HEAD.size + _CHUNK_HEAD.unpack_from(content)[-1] + 8
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
    end = position + 4 + struct.unpack_from("<I", buffer, position)[0]
    if end > len(buffer):
        raise _Damage("a text reaches beyond its record")
    return buffer[position + 4 : end].decode(errors="replace"), end


_STEPS = 10_000  # instructions of SQLite between two checks of the time
# A damaged schema can make sqlite3 fail to decode its own error message.
_READ_ERRORS = (sqlite3.Error, OverflowError, MemoryError, UnicodeError)
_TOPICS = "SELECT id, name, type, serialization_format FROM topics"
_MESSAGES = ("SELECT rowid, topic_id, timestamp, data FROM messages WHERE topic_id IN ({}) AND "
             "typeof(data) = 'blob' AND typeof(timestamp) = 'integer' AND timestamp >= 0 "
             "ORDER BY rowid")
_DEFINITIONS = ("SELECT topic_type, encoded_message_definition FROM message_definitions WHERE "
                "typeof(encoded_message_definition) = 'text'")
_COUNTS = "SELECT topic_id, COUNT(*) FROM messages WHERE topic_id IN ({}) GROUP BY topic_id"


def _read_sqlite(path: Path, topics: RawTopics, origin: Path) -> None:
    """Add the messages of a sqlite3 file, decompressed from `origin`. InputError: it is damaged."""
    for journal in (path.with_name(path.name + suffix) for suffix in ("-wal", "-journal")):
        if journal.is_file() and not journal.is_symlink() and journal.stat().st_size:
            text = f"its writer died: messages in {journal.name} are not read; to merge them, run: "
            topics.remark(path.name, text + f"sqlite3 {path.name} .tables")
    budget = topics.budget
    try:
        # SQLite reads the missing end of a cut page as zeros, and silently finds fewer rows there.
        head = _head(path)
        page, pages = (int.from_bytes(head[a:b]) for a, b in ((16, 18), (28, 32)))
        page = 65536 if page == 1 else page
        if head[24:28] == head[92:96] and path.stat().st_size < page * pages:
            raise sqlite3.DatabaseError("the end of the file is missing")
        uri = f"{path.resolve().as_uri()}?mode=ro&immutable=1"
        with closing(sqlite3.connect(uri, uri=True)) as database:
            database.text_factory = bytes
            database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, _LARGEST_MESSAGE)
            database.set_progress_handler(budget.is_over, _STEPS)
            query = database.execute
            query("PRAGMA trusted_schema = OFF")
            # A view can be any program, even an endless one.
            tables = query("PRAGMA main.table_list").fetchall()
            kinds = {row[1].decode(errors="replace").lower(): row[2] for row in tables}
            for name in ("messages", "topics"):
                if kinds.get(name) != b"table":
                    raise sqlite3.DatabaseError(f"{name} is not a table")
                if any(c[6] for c in query(f"PRAGMA main.table_xinfo({name})").fetchall()):
                    raise sqlite3.DatabaseError(f"{name} has computed columns")
            defined = {}
            if topics.is_foreign and kinds.get("message_definitions") == b"table":
                defined = dict(query(_DEFINITIONS).fetchmany(_MOST_TOPICS))
            found = {number: topics.topic(*(text.decode(errors="replace") for text in (
                         name, kind, form, defined.get(kind, b""))))
                     for number, name, kind, form in query(_TOPICS) if isinstance(number, int)
                     and all(isinstance(text, bytes) for text in (name, kind, form))}
            wanted = [number for number, topic in found.items() if topic.wanted]
            others = [number for number in found if number not in wanted]

            def rows_of(sql: str, numbers: list[int]) -> sqlite3.Cursor:
                return query(sql.format(",".join("?" * len(numbers))), numbers)
            last = -1
            for row, number, time, data in rows_of(_MESSAGES, wanted):
                if not isinstance(row, int) or row <= last:
                    raise sqlite3.DatabaseError("the rows of messages are out of order")
                last = row
                budget.take(len(data) + 1)
                found[number].add(time, data)
            for number, count in rows_of(_COUNTS, others):
                found[number].count += count
    except _READ_ERRORS as error:
        if getattr(error, "sqlite_errorcode", None) == sqlite3.SQLITE_INTERRUPT:
            budget.check()
            raise KeyboardInterrupt from None  # SQLite swallows the exception of a signal handler
        reason = printable(" ".join(str(error).split()))
        how = f"sqlite3 {path.name} .recover | sqlite3 recovered.db3"
        raise InputError(f"{origin}: damaged: {reason}; to save what is left: {how}") from None


def _read_ros1(path: Path, topics: RawTopics) -> None:
    """Add the messages of a ROS 1 bag. InputError: it is damaged, or has no index."""
    from rosbags.rosbag1 import Reader
    try:
        with Reader(path) as bag:
            found = {c.id: topics.topic(c.topic, c.msgtype, "ros1", c.msgdef.data)
                     for c in bag.connections}
            for connection, time, data in bag.messages():
                topics.budget.take(len(data))
                found[connection.id].add(time, data)
    except OverBudget:
        raise
    except Exception as error:  # of the reader's many types
        why = printable(str(error))[:200]
        raise InputError(f"{path}: not a readable ROS 1 bag: {why}") from None


def _decompress_file(source: Path, target: Path, budget: Budget) -> str:
    """Decompress a zstd file as far as possible; why it ended early, or ""."""
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
    """Decompress messages that are compressed one by one; damaged ones become empty. OverBudget."""
    if not topic.data.startswith(_ZSTD_MAGIC):
        return
    plain, lengths, position = bytearray(), array("q"), 0
    for length in topic.lengths:
        packed, message = bytes(topic.data[position : position + length]), b""
        position += length
        decompressor = zstd.ZstdDecompressor()
        with suppress(zstd.ZstdError, MemoryError):
            message = decompressor.decompress(packed, _LARGEST_MESSAGE)
        message = message if decompressor.eof else b""
        budget.take(len(message))
        plain += message
        lengths.append(len(message))
    topic.data, topic.lengths = plain, lengths
