"""Reading a bag beside what one would pick instead, and beside the bytes alone.

A loop in Python over the messages, with numpy for what is in them: it takes no compiled code, and
needs to be no slower than what reads one message after the other into an object.
"""

import sqlite3
import struct
from contextlib import closing
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import zstandard
from rosbags.rosbag2 import Reader

from examination.bags import in_sqlite3
from examination.perf.figures import Figure, Outcome, Skipped, at_least
from examination.perf.timing import interleaved, ratio
from sma_bench.records import Signal, read_record
from sma_bench.records.bag_writer import write_record
from sma_bench.records.messages import TYPES

try:
    from mcap_ros2.reader import read_ros2_messages
except ImportError:
    read_ros2_messages = None

MESSAGES = 480_000
_TOPICS = 4
_CHUNK = 0x06


def signals_of_a_bench(messages: int) -> list[Signal]:
    """Signals that make `messages` messages: power, temperature, joints and commands alike."""
    n = messages // _TOPICS
    clock = np.arange(n) * 1e-3
    noise = np.random.default_rng(0).normal(size=n)
    return [
        Signal("wire.voltage", "V", clock, 3 + noise),
        Signal("wire.current", "A", clock, 1 + noise),
        Signal("wire.temperature", "K", clock, 300 + noise),
        Signal("elongation", "m", clock, 1e-3 * noise),
        Signal("force", "N", clock, noise),
        Signal("voltage_command", "V", clock, np.column_stack([noise] * 4)),
    ]


def measure(tiny: bool = False) -> list[Outcome]:
    """Ratios for both storages."""
    messages = 4000 if tiny else MESSAGES
    outcomes: list[Outcome] = []
    with TemporaryDirectory() as folder:
        for storage in ("mcap", "sqlite3"):
            bag = Path(folder, storage)
            write_record(bag, signals_of_a_bench(messages))
            if storage == "sqlite3":
                in_sqlite3(bag)
            outcomes += _of_bag(bag, storage, messages, tiny)
    return outcomes


def _of_bag(bag: Path, storage: str, messages: int, tiny: bool) -> list[Outcome]:
    files = [path for path in bag.iterdir() if path.suffix in (".mcap", ".db3")]
    content = _chunks if storage == "mcap" else _rows
    calls = {
        "ours": lambda: read_record(bag),
        "rosbags, message by message": lambda: _rosbags(bag),
        "bytes": lambda: [path.read_bytes() for path in files],
        "content": lambda: [content(path) for path in files],
    }
    outcomes: list[Outcome] = []
    if storage == "mcap" and read_ros2_messages:
        calls["mcap-ros2-support"] = lambda: [_mcap_ros2(path) for path in files]
    elif storage == "mcap":
        outcomes.append(Skipped("mcap-ros2-support", "it is not installed"))
    seconds = interleaved(calls, 2 if tiny else 5, budget=30.0)
    case = f"{storage}, {messages:,} messages"
    ours = seconds["ours"]
    outcomes.append(Figure(case, "messages a second", messages / float(np.median(ours)), "1/s"))
    for name in ("rosbags, message by message", "mcap-ros2-support"):
        if name in seconds:
            slower = ratio(seconds[name], ours)
            outcomes.append(Figure(case, f"{name}: times slower", slower, "x", at_least(1.5)))
    inside = "chunks unpacked" if storage == "mcap" else "rows fetched by SQL"
    outcomes.append(
        Figure(case, f"times the time of {inside}", ratio(ours, seconds["content"]), "x")
    )
    outcomes.append(
        Figure(case, "times the time of the file's bytes", ratio(ours, seconds["bytes"]), "x")
    )
    return outcomes


def _rosbags(bag: Path) -> int:
    with Reader(bag) as reader:
        return sum(
            TYPES.deserialize_cdr(data, connection.msgtype) is not None
            for connection, _, data in reader.messages(reader.connections)
        )


def _mcap_ros2(path: Path) -> int:
    return sum(message.ros_msg is not None for message in read_ros2_messages(str(path)))


def _chunks(path: Path) -> int:
    """Bytes of all chunks, decompressed: what any reader of an mcap has to do at least."""
    data, position, unpacked = path.read_bytes(), 8, 0
    unpacker = zstandard.ZstdDecompressor()
    while position + 9 <= len(data):
        opcode, length = struct.unpack_from("<BQ", data, position)
        start = position + 9
        position = start + length
        if opcode == _CHUNK:
            _, _, size, _, name = struct.unpack_from("<QQQII", data, start)
            block = data[start + 32 + name + 8 : position]
            packed = data[start + 32 : start + 32 + name] == b"zstd"
            unpacked += len(unpacker.decompress(block, max_output_size=size) if packed else block)
    return unpacked


def _rows(path: Path) -> int:
    """All rows as SQLite gives them."""
    with closing(sqlite3.connect(f"{path.as_uri()}?mode=ro&immutable=1", uri=True)) as database:
        query = "SELECT topic_id, timestamp, data FROM messages"
        return len(database.execute(query).fetchall())
