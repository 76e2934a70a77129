"""Writes bags: message by message, readable whenever the writer dies, and signals as a bag of the
contract.
"""

import errno
import fcntl
import json
import shutil
import threading
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from math import inf
from pathlib import Path
from tempfile import mkdtemp
from types import TracebackType
from typing import Any, Self

import numpy as np
import yaml

from sma_bench.errors import InputError
from sma_bench.progress import Report, in_turn, silent
from sma_bench.records.bag_files import METADATA, PROVENANCE
from sma_bench.records.messages import TYPES, Stream, marker_stream, streams_of
from sma_bench.records.record import Record, Signal

# s: half of the second that may be lost, so that a message is on its way to the disk in time even
# when the next one is late.
_FLUSH_EVERY = 0.5
_MESSAGES_A_REPORT = 50_000
_STILL_READABLE = "; what was written until then can be read"

_SignalSource = Record | Mapping[str, Signal] | Iterable[Signal]


class BagWriter:
    """An mcap bag that grows while it is recorded.

    Messages go into chunks; a chunk is closed and handed to the operating system every half
    second while messages come in, and by `flush`, which a recorder calls from a timer so that the
    last messages before a silence are safe too. metadata.yaml is there from the start and kept up
    with every flush. A killed bag lacks its index: `read_record` (and `mcap recover`) read it.
    Methods may be called from several threads.

    Raises:
        InputError: the path exists, cannot be made, or (while writing) the disk is full. What was
            written until then stays readable.
    """

    def __init__(
        self,
        path: str | Path,
        compress: bool = True,
        flush_every: float = _FLUSH_EVERY,
        custom_data: Mapping[str, str] | None = None,
    ) -> None:
        """Begin a bag.

        Args:
            path: new folder.
            compress: the chunks.
            flush_every: s of wall time between flushes. Where the chunks end depends on it; with
                inf they are full, and the bytes depend on the messages alone.
            custom_data: texts by name for metadata.yaml, which rosbag2 keeps a place for.
        """
        try:
            from mcap.writer import CompressionType, Writer
        except ModuleNotFoundError:
            raise InputError("mcap is not installed, which writes bags: pip install mcap") from None
        self.path = Path(path)
        if self.path.exists():
            raise InputError(f"{self.path}: exists already, expected a new path for the bag")
        self._lock = threading.RLock()
        self._failure: InputError | None = None
        self._closed = False
        self._flush_every, self._next_flush = flush_every, 0.0
        self._custom_data = dict(custom_data or {})
        self._topics: dict[str, dict[str, Any]] = {}  # as metadata.yaml has them
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}
        self._counts: Counter[str] = Counter()
        self._first, self._last = 2**63, 0
        with self._disk():
            self.path.mkdir(parents=True)
            self._file = (self.path / f"{self.path.name}.mcap").open("xb")
        with suppress(OSError):  # a reader sees that nobody has died here
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        compression = CompressionType.ZSTD if compress else CompressionType.NONE
        with self._disk():
            self._writer = Writer(self._file, compression=compression)
            self._writer.start("ros2")
            self.flush()

    @property
    def count(self) -> int:
        """Messages written."""
        return self._counts.total()

    def add_topic(self, topic: str, msgtype: str) -> None:
        """Announce a topic, `sensor_msgs/msg/Temperature` say; again is harmless.

        Raises:
            InputError: the type is not one of ROS 2 Jazzy, or not the topic's.
        """
        with self._lock, self._disk():
            if topic in self._topics:
                known = self._topics[topic]["type"]
                if known != msgtype:
                    raise InputError(f"topic {topic}: type {msgtype}, expected {known}")
                return
            if msgtype not in TYPES.fielddefs:
                raise InputError(f"topic {topic}: unknown message type {msgtype}")
            if msgtype not in self._schemas:
                text, _ = TYPES.generate_msgdef(msgtype, ros_version=2)
                number = self._writer.register_schema(msgtype, "ros2msg", text.encode())
                self._schemas[msgtype] = number
            schema = self._schemas[msgtype]
            self._channels[topic] = self._writer.register_channel(topic, "cdr", schema)
            self._topics[topic] = {
                "name": topic,
                "type": msgtype,
                "serialization_format": "cdr",
                "offered_qos_profiles": [],
                "type_description_hash": TYPES.hash_rihs01(msgtype),
            }

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
        with self._lock, self._disk():
            for topic, stamp, data in messages:
                if topic not in self._channels:
                    raise InputError(f"topic {topic}: not announced, expected add_topic first")
                if stamp < 0:
                    raise InputError(f"topic {topic}: stamp {stamp} ns, expected one after 1970")
                self._writer.add_message(self._channels[topic], stamp, data, stamp)
                self._counts[topic] += 1
                self._first, self._last = min(self._first, stamp), max(self._last, stamp)
                if time.monotonic() >= self._next_flush:
                    self.flush()

    def flush(self) -> None:
        """Hand everything written so far to the operating system."""
        with self._lock, self._disk():
            self._writer.flush()
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
                        self._writer.finish()
                        self._file.close()
                        self._write_metadata()
            finally:
                self._closed = True

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

    @contextmanager
    def _disk(self) -> Iterator[None]:
        """Turns what the disk refuses into one line, which every later call has too."""
        if self._failure is not None:
            raise self._failure
        if self._closed:
            raise InputError(f"{self.path}: closed, expected an open bag to write to")
        try:
            yield
        except OSError as error:
            reason = "the disk is full" if error.errno == errno.ENOSPC else error.strerror or error
            self._failure = InputError(f"{self.path}: cannot be written: {reason}{_STILL_READABLE}")
            with suppress(OSError, AttributeError):  # a full disk does not take its buffer
                self._file.raw.close()
            raise self._failure from None

    def _write_metadata(self) -> None:
        start = {"nanoseconds_since_epoch": self._first if self._counts else 0}
        duration = {"nanoseconds": self._last - self._first if self._counts else 0}
        file = f"{self.path.name}.mcap"
        topics = [
            {"topic_metadata": dict(topic), "message_count": self._counts[name]}
            for name, topic in self._topics.items()
        ]
        about_file = {"path": file, "starting_time": dict(start), "duration": dict(duration)}
        information = {
            "version": 9,
            "storage_identifier": "mcap",
            "duration": duration,
            "starting_time": start,
            "message_count": self.count,
            "topics_with_message_count": topics,
            "compression_format": "",
            "compression_mode": "",
            "relative_file_paths": [file],
            "files": [{**about_file, "message_count": self.count}],
            "custom_data": self._custom_data or None,
            "ros_distro": "jazzy",
        }
        text = yaml.safe_dump({"rosbag2_bagfile_information": information}, sort_keys=False)
        beside = self.path / f"{METADATA}.new"
        beside.write_text(text, encoding="utf-8")
        beside.replace(self.path / METADATA)


def write_record(
    path: str | Path,
    source: _SignalSource,
    namespace: str = "bench",
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
    path, texts, start = Path(path), list(markers), start_ns or 0
    if isinstance(source, Record):
        start = source.start_ns if start_ns is None else start_ns
        texts = [*source.markers, *texts]
        source = source.signals
    given = source.values() if isinstance(source, Mapping) else source
    signals = {signal.name: signal for signal in given}
    prefix = "/" + namespace.strip("/") + "/" if namespace.strip("/") else "/"
    streams = [*streams_of(signals, prefix, start)]
    if texts:
        streams.append(marker_stream(texts, prefix, start))
    if not streams:
        raise InputError(f"{path}: no signals to write, expected at least one")
    custom = {PROVENANCE: json.dumps(dict(provenance))} if provenance else None
    with (
        _beside(path, replace) as temporary,
        BagWriter(temporary, flush_every=inf, custom_data=custom) as writer,
    ):
        _write_streams(writer, streams, report)


def _write_streams(writer: BagWriter, streams: list[Stream], report: Report) -> None:
    """All messages in order of their receive times."""
    for stream in streams:
        writer.add_topic(stream.topic, stream.type)
    received = np.concatenate([stream.received for stream in streams])
    owner = np.repeat(np.arange(len(streams)), [len(stream.blobs) for stream in streams])
    index = np.concatenate([np.arange(len(stream.blobs)) for stream in streams])
    order = np.argsort(received, kind="stable")
    parts = np.array_split(order, max(1, len(order) // _MESSAGES_A_REPORT))
    for chosen in in_turn(parts, report, lambda _: "writing"):
        rows = zip(*(a[chosen].tolist() for a in (owner, index, received)), strict=True)
        writer.write_many(
            (streams[which].topic, stamp, streams[which].blobs[row]) for which, row, stamp in rows
        )


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
        text = str(error).replace(str(folder / path.name), str(path)).removesuffix(_STILL_READABLE)
        raise InputError(text) from None
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}") from None
    finally:
        shutil.rmtree(folder, ignore_errors=True)
