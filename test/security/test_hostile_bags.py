"""Malicious but well-formed bags: refused in one line or read, within bounds, nothing deleted."""

import contextlib
import os
import re
import sqlite3
import struct

import numpy as np
import pytest
import zstandard
from hostile_texts import MERGED

from examination.bags import in_sqlite3
from examination.pieces import allowance
from sma_bench.errors import InputError
from sma_bench.estimation.observation import observe
from sma_bench.parameters import Parameters
from sma_bench.records import Record, Signal, contract, read_record
from sma_bench.records.bag_writer import write_record
from sma_bench.records.storage import METADATA

MAGIC = b"\x89MCAP0\r\n"
# Malicious replacements for the messages table of an sqlite3 bag.
TRICKS = (
    "CREATE VIEW messages AS WITH RECURSIVE r(n) AS (SELECT 1 UNION ALL SELECT n + 1 FROM r) "
    "SELECT n AS id, 1 AS topic_id, n AS timestamp, zeroblob(64) AS data FROM r",
    "CREATE TABLE messages (id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, "
    "data BLOB AS (zeroblob(60000000)))",
    "CREATE VIRTUAL TABLE messages USING fts5(topic_id, timestamp, data)",
)


def small_bag(path, storage):
    write_record(path, [Signal("wire.voltage", "V", np.arange(20) * 0.1, np.ones(20))])
    if storage == "sqlite3":
        in_sqlite3(path)
    return path


def record(opcode, content):
    return struct.pack("<BQ", opcode, len(content)) + content


def message(channel, data):
    """A message record; `channel` counts from 1, in the order of the topics."""
    return record(5, struct.pack("<HIQQ", channel, 0, 0, 0) + data)


def chunk(content, compressed=True):
    stored = zstandard.compress(content, 3) if compressed else content
    codec = b"zstd" if compressed else b""
    head = struct.pack("<QQQII", 0, 0, len(content), 0, len(codec))
    return record(6, head + codec + struct.pack("<Q", len(stored)) + stored)


def journal_naming(db3, victim):
    """A journal of a crashed writer that names `victim`: SQLite deletes that file on a rollback."""
    magic, page, sector, name = b"\xd9\xd5\x05\xf9\x20\xa1\x63\xd7", 4096, 512, str(victim).encode()
    head = struct.pack(">8sIIIII", magic, 0, 1, db3.stat().st_size // page, sector, page)
    tail = struct.pack(">I", (1 << 30) // page + 1) + name
    tail += struct.pack(">II", len(name), sum(name)) + magic
    journal = db3.with_name(db3.name + "-journal")
    journal.write_bytes(head.ljust(sector, b"\0") + tail)
    return journal


def said_of(path):
    """Output for a bag that is read or refused within 1 GB and 10 s; its number of voltages."""
    with allowance(1 << 30, 10.0):
        try:
            record = read_record(path)
        except InputError as error:
            return f"refused: {error}", 0
    findings = " | ".join(f"{f.subject}: {f.text}" for f in record.findings)
    return findings, len(record["wire.voltage"]) if "wire.voltage" in record.signals else 0


def storage_of(bag):
    return next(p for p in bag.iterdir() if p.name != METADATA)


@pytest.fixture
def db3(tmp_path):
    return storage_of(small_bag(tmp_path / "bag", "sqlite3"))


def test_no_file_is_deleted_by_the_journal_beside_a_bag_nor_read_through_a_link(db3, tmp_path):
    victim = tmp_path / "thesis.tex"
    victim.write_text("years of work")
    journal = journal_naming(db3, victim)
    db3.with_name(db3.name + "-wal").symlink_to(victim)
    before = db3.read_bytes(), journal.read_bytes()
    assert said_of(db3)[1] == 20
    assert victim.read_text() == "years of work"
    assert (db3.read_bytes(), journal.read_bytes()) == before


# The schema is data, too: an entry called a table may be a view.
ENTERED_VIEW = (
    "PRAGMA writable_schema = ON",
    f"UPDATE sqlite_master SET sql = '{TRICKS[0]}' WHERE name = 'messages'",
)
ODD_STAMPS = "UPDATE messages SET timestamp = {} WHERE rowid % 7 = 3"


@pytest.mark.parametrize(("statements", "said", "readings"), [
    (("DROP TABLE messages", TRICKS[0]), "refused: .*messages is no", 0),
    (("DROP TABLE messages", TRICKS[1]), "refused: .*messages has computed columns", 0),
    (("DROP TABLE messages", TRICKS[2]), "refused: .*messages is no", 0),
    (ENTERED_VIEW, "refused: .*(messages is no|malformed)", 0),
    ((ODD_STAMPS.format("'now'"),), "", 17), ((ODD_STAMPS.format("1e308"),), "", 17),
])  # fmt: skip
def test_messages_made_by_sql_code_are_refused_and_stamps_are_integers(
    db3, statements, said, readings
):
    import sma_bench.compiled  # noqa: F401, with it rows are joined

    with contextlib.closing(sqlite3.connect(db3)) as database:
        for statement in statements:
            database.execute(statement)
        database.commit()
    found, count = said_of(db3)
    assert re.match(said, found) and count == readings


BENCH_TOPICS = (("/bench/wire/power", contract.BATTERY_STATE),
                ("/bench/joint_states", contract.JOINT_STATE))


def mcap_of(*parts, topics=BENCH_TOPICS):
    """A file with these topics, never finished."""
    file = [MAGIC, record(1, texts("ros2", ""))]
    for number, (name, msgtype) in enumerate(topics, 1):
        file.append(record(3, struct.pack("<H", number) + texts(msgtype, "ros2msg", "")))
        file.append(record(4, struct.pack("<HH", number, number) + texts(name, "cdr", "")))
    return b"".join([*file, *parts])


def texts(*several):
    return b"".join(struct.pack("<I", len(text)) + text.encode() for text in several)


def named_joints(count):
    """A JointState of so many unnamed joints."""
    head = b"\0\1\0\0" + struct.pack("<iII4sI", 0, 0, 2, b"f", count)
    return head + bytes(4 * count) + bytes(12)


def chunks_in_chunks(content):
    for _ in range(1500):
        content = chunk(content, compressed=False)
    return mcap_of(content)


HARMFUL_FILES = {
    # 183 kB once used 3.8 GB: a million messages in compressed chunks.
    "bag.mcap: unfolds to more than": lambda: mcap_of(
        *[chunk(message(1, b"\0\1\0\0" + bytes(200)) * 80_000)] * 30),
    "a chunk inside a chunk": lambda: chunks_in_chunks(message(1, b"\0\1\0\0")),
    "1 of 1 messages cannot be decoded": lambda: mcap_of(chunk(message(2, named_joints(10**6)))),
    "more than 4096 topics": lambda: mcap_of(topics=[(f"/t{k}", "a/msg/B") for k in range(5000)]),
    "zstd: unfolds to more than": lambda: zstandard.compress(bytes(1 << 28), 19),
}  # fmt: skip


@pytest.mark.parametrize("expected", HARMFUL_FILES)
def test_a_small_file_does_not_unfold_to_gigabytes(tmp_path, monkeypatch, expected):
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    bag = tmp_path / ("bag.mcap.zstd" if "zstd" in expected else "bag.mcap")
    bag.write_bytes(HARMFUL_FILES[expected]())
    assert bag.stat().st_size < 400_000
    assert expected in said_of(bag)[0]


BOMB = "a0: &a0 [x]\n" + "".join(f"a{k}: &a{k} [{f'*a{k - 1},' * 9}]\n" for k in range(1, 12)) + (
    "rosbag2_bagfile_information:\n  relative_file_paths: [bag.mcap]\n"
    "  topics_with_message_count: [{topic_metadata: {name: %s}, message_count: %s}]\n"
)


def test_metadata_is_read_within_bounds_and_the_bag_without_it(tmp_path):
    bag = small_bag(tmp_path / "bag", "mcap")
    good = (bag / METADATA).read_text()
    deep, long = good + "y: " + "[" * 5000, good + "x: " + "9" * 401
    odd = ["{", "rosbag2_bagfile_information: 3", "\0\0", "", "#" * (2 << 20)]
    for bad in (MERGED + good, long, deep, *odd, BOMB % ("*a11", 1), BOMB % ("/b/t", "*a11")):
        (bag / METADATA).write_text(bad)
        said, readings = said_of(bag)
        assert "metadata.yaml: cannot be understood" in said and readings == 20


def test_links_out_of_the_folder_of_a_bag_are_not_followed(tmp_path):
    bag = small_bag(tmp_path / "bag", "mcap")
    (bag / "stolen.mcap").symlink_to(storage_of(small_bag(tmp_path / "other", "mcap")))
    said, readings = said_of(bag)
    assert "stolen.mcap: a link out of the bag's folder; not followed" in said and readings == 20
    storage_of(bag).unlink()
    assert "refused" in said_of(bag)[0] and "a link out of the bag's folder" in said_of(bag)[0]
    (bag / METADATA).rename(tmp_path / METADATA)
    (bag / METADATA).symlink_to(tmp_path / METADATA)
    assert "refused" in said_of(bag)[0] and "a link out of the bag's folder" in said_of(bag)[0]


def test_a_pipe_is_no_bag(tmp_path):
    os.mkfifo(tmp_path / "bag.mcap")
    assert "expected a regular file" in said_of(tmp_path / "bag.mcap")[0]
    for path in ("a\0b", "x" * 5000):
        assert any(text in said_of(tmp_path / path)[0] for text in ("no such file", "cannot be"))


@pytest.mark.parametrize(("step", "last", "most"), [(1000.0, 99e3, 5e4), (0.05, 1e9, 5e6)])
def test_the_size_of_a_grid_is_limited_whatever_the_times(step, last, most):
    """For a few readings over a day, or one at a distant time, cells get wider, not more."""
    count = np.arange(1200 if step < 1.0 else 100)
    time = np.append(count[:-1] * step, last)
    record = Record("day", 0, {
        "wire.voltage": Signal("wire.voltage", "V", time, np.where(count % 20 < 10, 1.0, 0.0)),
        "wire.temperature": Signal("wire.temperature", "K", time, 300.0 + count % 7),
    })  # fmt: skip
    with allowance(1 << 30, 60.0):
        assert len(observe(record, Parameters.of_paper()).grid) < most
