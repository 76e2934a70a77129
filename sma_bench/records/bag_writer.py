"""Writes bags: message by message (readable even if the writer dies), or whole from signals."""

import dataclasses
import errno
import json
import threading
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext, suppress
from math import inf
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import yaml
from rosbags.typesys import Stores, get_typestore

from sma_bench.arrays import Array, IntArray
from sma_bench.errors import InputError
from sma_bench.progress import Report, in_turn, silent
from sma_bench.records import contract
from sma_bench.records.bag import STAMP, encode
from sma_bench.records.record import SIGNALS, Record, Signal
from sma_bench.records.storage import METADATA, PROVENANCE

TYPES = get_typestore(Stores.ROS2_JAZZY)
_FLUSH_EVERY = 0.5  # s; 1 s may be lost at most, and the message that triggers a flush may be late
_MESSAGES_PER_REPORT = 50_000
_EXISTS = "exists already, expected a new path for the bag"
_STILL_READABLE = "; what was written before can be read"
_LATEST_STAMP = 2**31  # s after 1970


class BagWriter(AbstractContextManager["BagWriter"]):
    """An mcap bag being recorded; thread-safe, flushed every half second and by `flush`. If the
    writer is killed, the bag has no index but `read_record` reads it. Raises InputError: the path
    exists or cannot be written; what was written before stays readable."""

    def __init__(self, path: str | Path, flush_every: float = _FLUSH_EVERY,
                 custom_data: Mapping[str, str] | None = None) -> None:
        """`flush_every`: s; with inf, equal messages give an equal file."""
        try:
            from mcap.writer import CompressionType, Writer
        except ModuleNotFoundError:
            raise InputError("writing bags needs mcap: pip install mcap") from None
        self.path, self._lock = Path(path), threading.RLock()
        self._ended: InputError | None = None  # raised by every call after a failure or `close`
        self._flush_every, self._next_flush = flush_every, 0.0
        self._custom_data = dict(custom_data or {})
        self._topics: dict[str, dict[str, Any]] = {}  # as metadata.yaml has them
        self._schemas, self._channels = dict[str, int](), dict[str, int]()  # numbers in the file
        self._counts: Counter[str] = Counter()
        self._first, self._last = 2**63, 0
        with self._disk():
            try:
                self.path.mkdir(parents=True)
            except FileExistsError:
                raise InputError(f"{self.path}: {_EXISTS}") from None
            self._file = (self.path / f"{self.path.name}.mcap").open("xb")
            self._writer = Writer(self._file, compression=CompressionType.ZSTD)
            self._writer.start("ros2")
            self.flush()

    def add_topic(self, topic: str, msgtype: str) -> None:
        """Announce a topic, once or again. InputError: the type is unknown or has changed."""
        with self._lock, self._disk():
            known = self._topics.get(topic, {"type": msgtype})["type"]
            if known != msgtype:
                raise InputError(f"topic {topic}: type {msgtype}, expected {known}")
            if topic in self._topics:
                return
            if msgtype not in TYPES.fielddefs:
                raise InputError(f"topic {topic}: unknown message type {msgtype}")
            if (schema := self._schemas.get(msgtype)) is None:
                text, _ = TYPES.generate_msgdef(msgtype, ros_version=2)
                schema = self._writer.register_schema(msgtype, "ros2msg", text.encode())
                self._schemas[msgtype] = schema
            self._channels[topic] = self._writer.register_channel(topic, "cdr", schema)
            self._topics[topic] = {"name": topic, "type": msgtype, "serialization_format": "cdr",
                                   "offered_qos_profiles": [],
                                   "type_description_hash": TYPES.hash_rihs01(msgtype)}

    def write(self, topic: str, stamp_ns: int, data: bytes) -> None:
        """Append a serialised message of a known topic, received at `stamp_ns` since the epoch."""
        self.write_many([(topic, stamp_ns, data)])

    def write_many(self, messages: Iterable[tuple[str, int, bytes]]) -> None:
        """As `write`, for many (topic, receive time in ns since the epoch, data)."""
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
        """Finish the bag with its index; closing twice is harmless."""
        with self._lock:
            if self._ended is not None:
                return
            with self._disk():
                self._writer.finish()
                self._file.close()
                self._write_metadata()
            self._ended = InputError(f"{self.path}: closed, expected an open bag to write to")

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        with suppress(InputError) if kind is not None else nullcontext():
            self.close()

    @contextmanager
    def _disk(self) -> Iterator[None]:
        """Turns an OSError into a one-line InputError, which every later call raises too."""
        if self._ended is not None:
            raise self._ended
        try:
            yield
        except OSError as error:
            reason = "the disk is full" if error.errno == errno.ENOSPC else error.strerror or error
            self._ended = InputError(f"{self.path}: cannot be written: {reason}{_STILL_READABLE}")
            with suppress(OSError, AttributeError):  # close() would flush to the full disk again
                self._file.raw.close()
            raise self._ended from None

    def _write_metadata(self) -> None:
        first, last = (self._first, self._last) if self._counts else (0, 0)
        file, count = f"{self.path.name}.mcap", self._counts.total()
        information = {
            "version": 9, "storage_identifier": "mcap", "duration": {"nanoseconds": last - first},
            "starting_time": {"nanoseconds_since_epoch": first}, "message_count": count,
            "topics_with_message_count": [
                {"topic_metadata": about, "message_count": self._counts[name]}
                for name, about in self._topics.items()],
            "compression_format": "", "compression_mode": "", "relative_file_paths": [file],
            "files": [{"path": file, "starting_time": {"nanoseconds_since_epoch": first},
                       "duration": {"nanoseconds": last - first}, "message_count": count}],
            "custom_data": self._custom_data or None, "ros_distro": "jazzy"}
        text = yaml.safe_dump({"rosbag2_bagfile_information": information}, sort_keys=False)
        new = self.path / f"{METADATA}.new"
        new.write_text(text, encoding="utf-8")
        new.replace(self.path / METADATA)


def write_record(path: str | Path, source: Record | Mapping[str, Signal] | Iterable[Signal],
                 namespace: str = "bench", start_ns: int | None = None,
                 markers: Iterable[tuple[float, str]] = (),
                 provenance: Mapping[str, Any] | None = None, report: Report = silent,
                 replace: bool = False) -> None:
    """Write a record, or signals (by name or a sequence), as a bag in a new folder, which appears
    complete or not at all; equal signals give an equal file. Signals of one topic share messages,
    NaN where one has no sample; voltage, current and range are float32, about 7 digits.

    `start_ns`: epoch of t = 0, by default the record's own or 0; `markers`: (s, text), added to the
    record's; `provenance`: `source`, `sha256` and `how`, for metadata.yaml; `replace`: overwrite
    the path once the new bag is complete. Raises InputError: the path exists or cannot be written,
    a signal is not in the contract or has times that cannot be stamped."""
    path, texts, start = Path(path), list(markers), start_ns or 0
    if isinstance(source, Record):
        start = source.start_ns if start_ns is None else start_ns
        texts, source = [*source.markers, *texts], source.signals
    given = source.values() if isinstance(source, Mapping) else source
    prefix = "/" + namespace.strip("/") + "/" if namespace.strip("/") else "/"
    streams = [*streams_of({signal.name: signal for signal in given}, prefix, start)]
    if texts:
        received = _stamps("marker", np.array([at for at, _ in texts], dtype=float), start)
        blobs = [_serialised(contract.STRING, data=text) for _, text in texts]
        streams.append((f"{prefix}experiment/marker", contract.STRING, received, blobs))
    if not streams:
        raise InputError(f"{path}: no signals to write, expected at least one")
    custom = {PROVENANCE: json.dumps(dict(provenance))} if provenance else None
    messages = [(topic, stamp, blob) for topic, _, received, blobs in streams
                for stamp, blob in zip(received.tolist(), blobs, strict=True)]
    messages.sort(key=lambda row: row[1])
    parts = range(0, len(messages), _MESSAGES_PER_REPORT)
    with _beside(path, replace) as new, BagWriter(new, inf, custom) as writer:
        for topic, msgtype, *_ in streams:
            writer.add_topic(topic, msgtype)
        for first in in_turn(parts, report, lambda _: "writing"):
            writer.write_many(messages[first : first + _MESSAGES_PER_REPORT])


@contextmanager
def _beside(path: Path, replace: bool) -> Iterator[Path]:
    """A temporary path next to `path`, renamed to it if the block succeeds."""
    new = path
    try:
        if path.exists() and not replace:
            raise InputError(f"{path}: {_EXISTS}")
        path.parent.mkdir(parents=True, exist_ok=True)
        staged = TemporaryDirectory(prefix=f".{path.name}.", dir=path.parent)
        with staged as folder, ExitStack() as undo:
            new, old = Path(folder, path.name), Path(folder, f"{path.name}.replaced")
            yield new
            if replace and path.exists():
                path.rename(old)
                undo.callback(old.rename, path)
            new.rename(path)
            undo.pop_all()
    except InputError as error:
        # The unfinished bag is deleted, so nothing of it can be read.
        text = str(error).removesuffix(_STILL_READABLE)
        raise InputError(text.replace(str(new), str(path))) from None
    except OSError as error:
        taken = error.errno == errno.ENOTEMPTY  # another writer was faster
        why = _EXISTS if taken else f"cannot be written: {error.strerror}"
        raise InputError(f"{path}: {why}") from None


# Topic, type, receive times (n,) ns in order, and the messages.
_Stream = tuple[str, str, IntArray, list[bytes]]


def streams_of(signals: dict[str, Signal], prefix: str, start: int) -> Iterator[_Stream]:
    """The messages that carry signals, by topic; `start`: epoch of t = 0 in ns."""
    groups: dict[str, dict[str, Signal]] = {}
    for name, signal in signals.items():
        if (carried := contract.topic_of(name)) is None:
            text = f"no topic of the contract carries it, expected {SIGNALS}"
            raise InputError(f"signal {name}: {text}")
        topic, column = carried
        groups.setdefault(topic, {})[column] = signal
    for topic, columns in groups.items():
        place = contract.place_of(topic)
        assert place is not None
        yield _stream(prefix + topic, place.type, columns, start)


def _stream(topic: str, msgtype: str, columns: dict[str, Signal], start: int) -> _Stream:
    """Signals of one topic as copies of a template, at all their times; NaN where one has none."""
    if msgtype == contract.MULTI_ARRAY:
        signal = columns["data"]
        values = signal.values.reshape(len(signal), -1)
        template = _serialised(msgtype, data=np.zeros(values.shape[1]))
        blobs = encode(template, msgtype, {"data": values})
        return topic, msgtype, _stamps(signal.name, signal.time, start), blobs
    stamps = {name: _stamps(s.name, s.time, start) for name, s in columns.items()}
    union = np.unique(np.concatenate([*stamps.values()]))
    received, absent = union.copy(), np.full(len(union), np.nan)
    merged: dict[str, Array] = {}
    for name, signal in columns.items():
        if (shape := signal.values.shape) != (len(signal),):
            raise InputError(f"signal {signal.name}: values of shape {shape}, expected (n,)")
        rows = np.searchsorted(union, stamps[name])
        merged[name] = absent.copy()
        merged[name][rows] = signal.values
        if signal.received is not None:
            received[rows] = _stamps(signal.name, signal.received, start)
    channel = topic.split("/")[-2]
    frame, rest = channel, {}
    if msgtype == contract.BATTERY_STATE:
        merged = {"voltage": absent, "current": absent, **merged}
        unknown = ("temperature", "charge", "capacity", "design_capacity", "percentage")
        rest = {"present": True, "location": channel, **dict.fromkeys(unknown, np.nan)}
    elif msgtype == contract.TEMPERATURE:
        merged = {"temperature": merged["temperature"] - contract.CELSIUS_ZERO}
    elif msgtype == contract.RANGE:
        frame, rest = f"{channel}_range", {"radiation_type": 1, "max_range": inf}
    else:
        frame, joints = "base", sorted({contract.JOINT_OF[name] for name in columns})
        found = {(joint, field): merged[name] for joint in joints
                 for name, field in contract.JOINT_SIGNALS[joint].items() if name in merged}
        merged = {field: np.column_stack([found.get((joint, field), absent) for joint in joints])
                  for field in ("position", "effort")}
        rest = {"name": joints, **dict.fromkeys(merged, np.zeros(len(joints)))}
    template = _serialised(msgtype, header=message("std_msgs/msg/Header", frame_id=frame), **rest)
    seconds, nanoseconds = np.divmod(union, 10**9)
    numbers: dict[str, Any] = {**dict(zip(STAMP, (seconds, nanoseconds), strict=True)), **merged}
    return topic, msgtype, received, encode(template, msgtype, numbers)


def _stamps(name: str, times: Array, start: int) -> IntArray:
    """A signal's times (n,) s as ns since the epoch."""
    if not np.isfinite(times).all():
        raise InputError(f"signal {name}: a time is not finite, expected seconds")
    seconds = times + start * 1e-9
    if len(times) and not (seconds.min() >= -1e-6 and seconds.max() < _LATEST_STAMP):
        raise InputError(
            f"signal {name}: times {times.min():g} to {times.max():g} s after epoch second "
            f"{start * 1e-9:g} cannot be stamped, expected between 1970 and 2038")
    return np.maximum(np.rint(times * 1e9).astype(np.int64) + start, 0)


def message(msgtype: str, **fields: Any) -> Any:
    """A ROS 2 Jazzy message as rosbags has it; fields not given are zero or empty."""
    from rosbags.convert.converter import default_message
    made: Any = default_message(TYPES, msgtype)
    return dataclasses.replace(made, **fields)


def _serialised(msgtype: str, **fields: Any) -> bytes:
    return bytes(TYPES.serialize_cdr(message(msgtype, **fields), msgtype))
