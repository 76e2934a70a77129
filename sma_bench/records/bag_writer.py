"""Writes bags: message by message, readable whenever the writer dies, and signals as a bag of the
contract.
"""

import errno
import fcntl
import json
import shutil
import sqlite3
import struct
import threading
import time
import zlib
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from io import BytesIO
from math import inf
from pathlib import Path
from tempfile import mkdtemp
from types import TracebackType
from typing import Any, Literal, Self

import numpy as np
import yaml
from rosbags.interfaces import Connection
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.rosbag2.enums import CompressionFormat, CompressionMode
from rosbags.rosbag2.errors import WriterError

from sma_bench.errors import InputError
from sma_bench.progress import Report, in_turn, silent
from sma_bench.records.bag_files import PROVENANCE
from sma_bench.records.messages import TYPES, Stream, marker_stream, streams_of
from sma_bench.records.record import Record, Signal

STORAGES = {"mcap": StoragePlugin.MCAP, "sqlite3": StoragePlugin.SQLITE3}

STILL_READABLE = "; what was written until then can be read"

_FORMAT_VERSION: Literal[9] = 9
# Half of the second that may be lost, so that a message is on its way to the disk in time even
# when the next one is late.
_FLUSH_EVERY = 0.5
# From the beginning of an mcap's chunk record: opcode, length, two times, size.
_TO_CHECKSUM = 1 + 8 + 8 + 8 + 8
_LENGTH = struct.Struct("<I")


class BagWriter:
    """A bag that grows while it is recorded.

    Messages go into chunks; a chunk is closed and handed to the operating system every half
    second while messages come in, and by `flush`, which a recorder calls from a timer so that the
    last messages before a silence are safe too. metadata.yaml is there from the start and kept up
    with every flush. Methods may be called from several threads.

    A killed mcap lacks its index: `read_record` (and `mcap recover`) read it whole. An sqlite3
    bag is written in one transaction and exists only once closed: not for live recording.

    Raises:
        InputError: the path exists, cannot be made, or (while writing) the disk is full. What was
            written until then stays readable.
    """

    def __init__(
        self,
        path: str | Path,
        storage: str = "mcap",
        compress: bool = True,
        flush_every: float = _FLUSH_EVERY,
        custom_data: Mapping[str, str] | None = None,
    ) -> None:
        """Begin a bag.

        Args:
            path: new folder.
            storage: "mcap" or "sqlite3".
            compress: the chunks of an mcap.
            flush_every: s of wall time between flushes. Where the chunks end depends on it; with
                inf they are full, and the bytes depend on the messages alone.
            custom_data: texts by name for metadata.yaml, which rosbag2 keeps a place for.
        """
        self.path = Path(path)
        if storage not in STORAGES:
            raise InputError(f"storage {storage!r}: expected one of {', '.join(STORAGES)}")
        if self.path.exists():
            raise InputError(f"{self.path}: exists already, expected a new path for the bag")
        if storage == "sqlite3" and set(str(self.path)) & set("?#%"):
            raise InputError(f"{self.path}: sqlite3 cannot write a path with ?, # or % in it")
        self.count = 0
        self._connections: dict[str, Connection] = {}
        self._lock = threading.RLock()
        self._failure: InputError | None = None
        self._closed = False
        self._flush_every, self._next_flush = flush_every, 0.0
        self._writer = Writer(self.path, version=_FORMAT_VERSION, storage_plugin=STORAGES[storage])
        for key, text in (custom_data or {}).items():
            self._writer.set_custom_data(key, text)
        self._live = storage == "mcap"
        if compress and self._live:
            self._writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        try:
            self._open()
        except InputError:
            self._abandon()
            raise

    def _open(self) -> None:
        with self._disk():
            try:
                self._writer.open()
            except WriterError as error:
                raise InputError(f"{self.path}: {error}") from None
        if self._live:
            storage: Any = self._writer.storage
            _give_chunks_a_checksum(storage)
            storage.chunks = _ChunkIndex()
            with suppress(OSError):  # a reader sees that nobody has died here
                fcntl.flock(storage.bio, fcntl.LOCK_EX | fcntl.LOCK_NB)
        self.flush()

    def add_topic(self, topic: str, msgtype: str) -> None:
        """Announce a topic, `sensor_msgs/msg/Temperature` say; again is harmless.

        Raises:
            InputError: the type is not one of ROS 2 Jazzy, or not the topic's.
        """
        with self._lock:
            known = self._connections.get(topic)
            if known is not None:
                if known.msgtype != msgtype:
                    raise InputError(f"topic {topic}: type {msgtype}, expected {known.msgtype}")
                return
            if msgtype not in TYPES.fielddefs:
                raise InputError(f"topic {topic}: unknown message type {msgtype}")
            with self._disk():
                self._connections[topic] = self._writer.add_connection(
                    topic, msgtype, typestore=TYPES
                )

    def write(self, topic: str, stamp_ns: int, data: bytes) -> None:
        """Append one serialised message, received at `stamp_ns` since the epoch.

        Raises:
            InputError: unknown topic, or the disk does not take it.
        """
        self.write_many([(topic, stamp_ns, data)])

    def write_many(self, messages: Iterable[tuple[str, int, bytes]]) -> None:
        """Append serialised messages: (topic, receive time in ns since the epoch, data) each.

        Raises:
            InputError: unknown topic, or the disk does not take it.
        """
        connections, write = self._connections, self._writer.write
        with self._lock, self._disk():
            for topic, stamp_ns, data in messages:
                if topic not in connections:
                    raise InputError(f"topic {topic}: not announced, expected add_topic first")
                if stamp_ns < 0:
                    raise InputError(f"topic {topic}: stamp {stamp_ns} ns, expected one after 1970")
                write(connections[topic], int(stamp_ns), data)
                self.count += 1
                if self._live and time.monotonic() >= self._next_flush:
                    self.flush()

    def flush(self) -> None:
        """Hand everything written so far to the operating system."""
        with self._lock, self._disk():
            storage: Any = self._writer.storage
            if self._live:
                if storage.chunk.bio.tell():
                    storage.close_chunk()
                storage.bio.flush()
            self._write_metadata()
            self._next_flush = time.monotonic() + self._flush_every

    def close(self) -> None:
        """Finish the bag with its index; again is harmless."""
        with self._lock:
            if self._closed:
                return
            try:
                if self._failure is None:
                    with self._disk():
                        self._writer.close()
            finally:
                self._closed = True
                self._abandon()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if error is None:
            self.close()
        else:
            with suppress(InputError):
                self.close()

    def _disk(self) -> "_DiskErrors":
        if self._failure is not None:
            raise self._failure
        if self._closed:
            raise InputError(f"{self.path}: closed, expected an open bag to write to")
        return _DiskErrors(self)

    def fail(self, error: OSError | sqlite3.Error) -> InputError:
        """Remember why the bag ends here; the error to raise, now and from every later call."""
        full = isinstance(error, OSError) and error.errno == errno.ENOSPC
        reason = "the disk is full" if full else getattr(error, "strerror", None) or error
        self._failure = InputError(
            f"{self.path}: cannot be written: {reason}{STILL_READABLE}"
        )
        return self._failure

    def _abandon(self) -> None:
        """Close a storage file that is still open; a full disk does not take its buffer."""
        storage: Any = self._writer.storage
        if storage is not None and self._live:
            with suppress(OSError):
                storage.bio.raw.close()
        with suppress(Exception):
            self._writer.abort()

    def _write_metadata(self) -> None:
        target = self.path / "metadata.yaml"
        beside = self.path / "metadata.yaml.new"
        beside.write_text(self._metadata(), encoding="utf-8")
        beside.replace(target)

    def _metadata(self) -> str:
        writer: Any = self._writer
        count = sum(writer.counts.values())
        start = {"nanoseconds_since_epoch": writer.min_timestamp if count else 0}
        duration = {"nanoseconds": writer.max_timestamp - writer.min_timestamp if count else 0}
        name = writer.storage.path.name
        topics = [
            {
                "topic_metadata": {
                    "name": connection.topic,
                    "type": connection.msgtype,
                    "serialization_format": "cdr",
                    "offered_qos_profiles": [],
                    "type_description_hash": connection.digest,
                },
                "message_count": writer.counts[connection.id],
            }
            for connection in self._connections.values()
        ]
        information = {
            "version": _FORMAT_VERSION,
            "storage_identifier": "mcap" if self._live else "sqlite3",
            "duration": duration,
            "starting_time": start,
            "message_count": count,
            "topics_with_message_count": topics,
            "compression_format": "",
            "compression_mode": "",
            "relative_file_paths": [name],
            "files": [
                {
                    "path": name,
                    "starting_time": start,
                    "duration": duration,
                    "message_count": count,
                }
            ],
            "custom_data": writer.custom_data or None,
            "ros_distro": "jazzy",
        }
        return yaml.safe_dump({"rosbag2_bagfile_information": information}, sort_keys=False)


class _ChunkIndex:
    """Index records of an mcap's chunks until its end, where they are written.

    The one thing that grows with a bag, by two to three chunks a second: as bytes, one behind the
    other, 1.3 MB an hour, where rosbags' list of a BytesIO each takes twice that.
    """

    def __init__(self) -> None:
        self._records = bytearray()
        self._count = 0

    def __len__(self) -> int:
        return self._count

    def append(self, record: BytesIO) -> None:
        self._records += _LENGTH.pack(record.tell())
        self._records += record.getbuffer()
        self._count += 1

    def __iter__(self) -> Iterator[BytesIO]:
        start = 0
        while start < len(self._records):
            (length,) = _LENGTH.unpack_from(self._records, start)
            start += _LENGTH.size
            record = BytesIO()  # with its position at the end, as rosbags takes its length from it
            record.write(self._records[start : start + length])
            yield record
            start += length


def _give_chunks_a_checksum(storage: Any) -> None:
    """rosbags writes none, so an altered bit would be read as an altered number."""
    close_chunk = storage.close_chunk

    def with_checksum() -> None:
        checksum, start = zlib.crc32(storage.chunk.bio.getbuffer()), storage.bio.tell()
        close_chunk()
        end = storage.bio.tell()
        storage.bio.seek(start + _TO_CHECKSUM)
        storage.bio.write(struct.pack("<I", checksum))
        storage.bio.seek(end)

    storage.close_chunk = with_checksum


class _DiskErrors:
    """Turns what the disk refuses into one line, and stops the writer there."""

    def __init__(self, writer: BagWriter) -> None:
        self.writer = writer

    def __enter__(self) -> None:
        return None

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if isinstance(error, (OSError, sqlite3.Error)):
            raise self.writer.fail(error) from None


_MESSAGES = 50_000
"""about as many are written between two reports"""

_SignalSource = Record | Mapping[str, Signal] | Iterable[Signal]


def write_record(
    path: str | Path,
    source: _SignalSource,
    namespace: str = "bench",
    storage: str = "mcap",
    start_ns: int | None = None,
    markers: Iterable[tuple[float, str]] = (),
    provenance: Mapping[str, Any] | None = None,
    report: Report = silent,
    replace: bool = False,
) -> None:
    """Write a record, or signals, as a bag; the bag appears whole or not at all.

    The same signals give the same bytes.

    Signals that share a message type and place (voltage and current of a wire) share messages;
    where their times differ the other one is NaN, that is not measured. Voltage, current and range
    are 32-bit on the wire: about 7 digits.

    Args:
        path: new folder.
        source: a Record, or Signals (by name or just a sequence).
        namespace: of the topics, without slashes at the ends.
        storage: "mcap" or "sqlite3".
        start_ns: epoch time of t = 0 in ns; the record's own, else 0.
        markers: (time in s, text), added to the record's own.
        provenance: where the signals come from, kept in metadata.yaml (`source`, `sha256`, `how`
            and whatever else, as JSON) and given back by `read_record`.
        report: called with how far it is.
        replace: a bag that lies at the path, once the new one is whole.

    Raises:
        InputError: the path exists (and is not to be replaced) or cannot be written, a signal has
            no place in the contract or times that cannot be stamped.
    """
    path = Path(path)
    signals, start, texts = _unpack(source, start_ns, markers)
    prefix = "/" + namespace.strip("/") + "/" if namespace.strip("/") else "/"
    streams = [*streams_of(signals, prefix, start)]
    if texts:
        streams.append(marker_stream(texts, prefix, start))
    if not streams:
        raise InputError(f"{path}: no signals to write, expected at least one")
    custom = {PROVENANCE: json.dumps(dict(provenance))} if provenance else None
    with (
        _beside(path, replace) as temporary,
        BagWriter(temporary, storage, flush_every=inf, custom_data=custom) as writer,
    ):
        _write_streams(writer, streams, report)


def _unpack(
    source: _SignalSource, start_ns: int | None, markers: Iterable[tuple[float, str]]
) -> tuple[dict[str, Signal], int, list[tuple[float, str]]]:
    texts = [*markers]
    if isinstance(source, Record):
        start = source.start_ns if start_ns is None else start_ns
        return dict(source.signals), start, [*source.markers, *texts]
    given = source.values() if isinstance(source, Mapping) else source
    return {signal.name: signal for signal in given}, start_ns or 0, texts


@contextmanager
def _beside(path: Path, replace: bool) -> Iterator[Path]:
    """A path to write to that becomes `path` when all went well."""
    if path.exists() and not replace:
        raise InputError(f"{path}: exists already, expected a new path for the bag")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        folder = Path(mkdtemp(prefix=f".{path.name}.", dir=path.parent))
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}") from None
    try:
        yield folder / path.name
        if path.exists() and not replace:
            raise InputError(f"{path}: exists already, expected a new path for the bag")
        old = folder / f"{path.name}.replaced"
        if path.exists():
            path.rename(old)
        try:
            (folder / path.name).rename(path)
        except OSError:
            if old.exists():
                old.rename(path)
            raise
    except InputError as error:
        # Of a bag that appears whole or not at all nothing is left to read.
        text = str(error).replace(str(folder / path.name), str(path)).removesuffix(STILL_READABLE)
        raise InputError(text) from None
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}") from None
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _write_streams(writer: BagWriter, streams: list[Stream], report: Report) -> None:
    for stream in streams:
        writer.add_topic(stream.topic, stream.type)
    received = np.concatenate([stream.received for stream in streams])
    owner = np.repeat(np.arange(len(streams)), [len(stream.blobs) for stream in streams])
    index = np.concatenate([np.arange(len(stream.blobs)) for stream in streams])
    order = np.argsort(received, kind="stable")
    parts = np.array_split(order, max(1, len(order) // _MESSAGES))
    for chosen in in_turn(parts, report, lambda _: "writing"):
        rows = zip(*(a[chosen].tolist() for a in (owner, index, received)), strict=True)
        writer.write_many(
            (streams[which].topic, stamp, streams[which].blobs[row]) for which, row, stamp in rows
        )
