"""Bags that keep their format's rules and are made to harm: the pieces they are put together of."""

import struct
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import yaml
import zstandard

from examination.bags import in_sqlite3
from sma_bench.records import Signal, contract
from sma_bench.records.bag_writer import write_record

TOPICS = (("/bench/wire/power", contract.BATTERY_STATE),
          ("/bench/joint_states", contract.JOINT_STATE))  # fmt: skip
MAGIC = b"\x89MCAP0\r\n"
_SUPER_JOURNAL = b"\xd9\xd5\x05\xf9\x20\xa1\x63\xd7"
_PAGE, _SECTOR = 4096, 512
TRICKS = yaml.safe_load(Path(__file__).with_name("hostile.yaml").read_text())["tricks"]


def small_bag(path: Path, storage: str) -> Path:
    write_record(path, [Signal("wire.voltage", "V", np.arange(20) * 0.1, np.ones(20))])
    if storage == "sqlite3":
        in_sqlite3(path)
    return path


def record(opcode: int, content: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(content)) + content


def message(channel: int, time: int, data: bytes) -> bytes:
    """A message record; `channel` counts from 1, in the order of the topics."""
    head = struct.pack("<HIQQ", channel, 0, time % 2**64, time % 2**64)
    return record(5, head + data)


def chunk(content: bytes, compressed: bool = True, size: int | None = None) -> bytes:
    """A chunk record, of `size` bytes as it says."""
    stored = zstandard.compress(content, 3) if compressed else content
    codec = b"zstd" if compressed else b""
    head = struct.pack("<QQQII", 0, 0, len(content) if size is None else size, 0, len(codec))
    return record(6, head + codec + struct.pack("<Q", len(stored)) + stored)


def mcap_of(*parts: bytes, topics: Sequence[tuple[str, str]] = TOPICS) -> bytes:
    """A file with these topics, never finished."""
    file = [MAGIC, record(1, _text(b"ros2") + _text(b""))]
    for number, (name, msgtype) in enumerate(topics, 1):
        topic = _text(name.encode("utf-8", "surrogateescape"))
        schema = struct.pack("<H", number) + _text(msgtype.encode()) + _text(b"ros2msg")
        channel = struct.pack("<HH", number, number) + topic + _text(b"cdr")
        file += [record(3, schema + _text(b"")), record(4, channel + _text(b""))]
    return b"".join([*file, *parts])


def _text(content: bytes) -> bytes:
    return struct.pack("<I", len(content)) + content


def named_joints(count: int) -> bytes:
    """A JointState of so many joints without a name."""
    head = b"\0\1\0\0" + struct.pack("<iII4sI", 0, 0, 2, b"f", count)
    return head + bytes(4 * count) + bytes(12)


def journal_naming(db3: Path, victim: Path) -> Path:
    """A dead writer's journal with `victim`: SQLite deletes that file once it has rolled back."""
    pages = db3.stat().st_size // _PAGE
    head = struct.pack(">8sIIIII", _SUPER_JOURNAL, 0, 1, pages, _SECTOR, _PAGE)
    name = str(victim).encode()
    tail = struct.pack(">I", (1 << 30) // _PAGE + 1) + name
    tail += struct.pack(">II", len(name), sum(name)) + _SUPER_JOURNAL
    journal = db3.with_name(db3.name + "-journal")
    journal.write_bytes(head.ljust(_SECTOR, b"\0") + tail)
    return journal
