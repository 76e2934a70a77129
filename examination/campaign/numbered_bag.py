"""Bags whose messages are numbered, and where in the file each of them lies."""

import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import zstandard
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.rosbag2.enums import CompressionFormat, CompressionMode

from sma_bench.records import Record, Signal
from sma_bench.records.bag_writer import BagWriter
from sma_bench.records.contract import BATTERY_STATE
from sma_bench.records.messages import TYPES, Stream, streams_of

MESSAGES = 3000
START = 1_700_000_000 * 10**9
STEP = 0.01
_CHUNK = 250
_PAGE = 4096
_TOPIC = "/bench/wire/power"
_MCAP_MAGIC = 8
_SAME_STAMP = 1e-3
_RECORD = struct.Struct("<BQ")
_CHUNK_RECORD, _MESSAGE_RECORD = 0x06, 0x05

# As the recorder writes it, and as other programs do.
FORMATS = (
    "mcap of the recorder", "mcap, plain", "mcap, compressed chunks", "mcap, compressed messages",
    "sqlite3", "sqlite3, compressed file",
)  # fmt: skip
_OTHERS = {
    "mcap, plain": (StoragePlugin.MCAP, CompressionMode.NONE),
    "mcap, compressed chunks": (StoragePlugin.MCAP, CompressionMode.STORAGE),
    "mcap, compressed messages": (StoragePlugin.MCAP, CompressionMode.MESSAGE),
    "sqlite3": (StoragePlugin.SQLITE3, CompressionMode.NONE),
    "sqlite3, compressed file": (StoragePlugin.SQLITE3, CompressionMode.FILE),
}


@dataclass(frozen=True)
class NumberedBag:
    """A whole bag; `ends[k]` is the byte at which message k is complete in its storage file,
    beyond the file's end where nothing can be said of it."""

    path: Path
    format: str
    storage: str
    ends: np.ndarray

    @property
    def without_checksum(self) -> bool:
        """Whether the format cannot tell that a number was altered."""
        return self.format != "mcap of the recorder"

    def numbers_before(self, byte: int) -> set[int]:
        """Messages that are complete before a byte."""
        return set(np.flatnonzero(self.ends <= byte).tolist())


def numbered_bag(path: Path, form: str) -> NumberedBag:
    """Write MESSAGES messages, the k-th of k mV at k times STEP s, in one of FORMATS."""
    time = np.arange(MESSAGES) * STEP
    signal = Signal("wire.voltage", "V", time, np.arange(MESSAGES) * 1e-3)
    (stream,) = streams_of({signal.name: signal}, "/bench/", START)
    if form in _OTHERS:
        plugin, mode = _OTHERS[form]
        writer: Any = Writer(path, version=9, storage_plugin=plugin)
        writer.set_compression(mode, CompressionFormat.ZSTD)
        with writer:
            connection = writer.add_connection(stream.topic, stream.type, typestore=TYPES)
            for k, blob in enumerate(stream.blobs):
                writer.write(connection, int(stream.received[k]), blob)
                if plugin == StoragePlugin.MCAP and k % _CHUNK == _CHUNK - 1:
                    writer.storage.close_chunk()
    else:
        with BagWriter(path, flush_every=float("inf")) as bag:
            bag.add_topic(_TOPIC, BATTERY_STATE)
            for k, blob in enumerate(stream.blobs):
                bag.write(_TOPIC, int(stream.received[k]), blob)
                if k % _CHUNK == _CHUNK - 1:
                    bag.flush()
    storage = next(file for file in path.iterdir() if file.name != "metadata.yaml")
    return NumberedBag(path, form, storage.name, _ends(storage, stream))


def numbers_in(record: Record) -> dict[int, int]:
    """Number by place in the sequence, of the voltages of a record.

    Of two with nearly the same stamp it is the nearer: a damaged stamp may come close to another.
    """
    voltage = record.get("wire.voltage")
    if voltage is None:
        return {}
    places = ((record.start_ns - START) * 1e-9 + voltage.time) / STEP
    numbers = np.rint(voltage.values * 1e3)
    away = np.abs(places - np.rint(places))
    found = {}
    for k in np.argsort(-away, kind="stable").tolist():
        place, number = round(places[k]), float(numbers[k])
        if away[k] < _SAME_STAMP and 0 <= place < MESSAGES:
            found[place] = int(number) if np.isfinite(number) and abs(number) < 1e9 else -1
    return found


def _ends(storage: Path, stream: Stream) -> np.ndarray:
    raw = storage.read_bytes()
    ends = np.full(MESSAGES, len(raw) + 1)
    if storage.suffix == ".mcap":
        return _ends_of_chunks(raw, ends)
    for k, blob in enumerate(stream.blobs):
        at = raw.find(blob)
        if at >= 0:  # not in a compressed file
            # Sqlite's pages: the whole page, for what its beginning says of its rows.
            ends[k] = -(-(at + len(blob)) // _PAGE) * _PAGE
    return ends


def _ends_of_chunks(raw: bytes, ends: np.ndarray) -> np.ndarray:
    """A chunk is taken whole or not at all where it is compressed or has a checksum."""
    position, number = _MCAP_MAGIC, 0
    while position + _RECORD.size <= len(raw) and number < MESSAGES:
        opcode, length = _RECORD.unpack_from(raw, position)
        end = position + _RECORD.size + length
        if opcode == _CHUNK_RECORD:
            count = _messages_in(raw[position + _RECORD.size : end])
            ends[number : number + count] = end
            number += count
        position = end
    return ends


def _messages_in(chunk: bytes) -> int:
    (length,) = struct.unpack_from("<I", chunk, 28)
    codec = chunk[32 : 32 + length]
    data = chunk[32 + length + 8 :]
    if codec:
        data = zstandard.ZstdDecompressor().decompress(data, max_output_size=1 << 28)
    position = count = 0
    while position < len(data):
        opcode, length = _RECORD.unpack_from(data, position)
        count += opcode == _MESSAGE_RECORD
        position += _RECORD.size + length
    return count
