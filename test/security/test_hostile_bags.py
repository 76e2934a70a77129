"""Bags that are well formed and made to harm: one line or a record, in bounds, nothing deleted."""

import contextlib
import os
import re
import sqlite3
import struct
from collections.abc import Sequence

import numpy as np
import pytest
import zstandard
from hostile_texts import MERGED

from examination.campaign import mutations as harm
from examination.pieces import allowance
from sma_bench.errors import InputError
from sma_bench.estimation.observation import observe
from sma_bench.parameters import Parameters
from sma_bench.records import Record, Signal, contract, read_record
from sma_bench.records.storage import METADATA


def said_of(path) -> tuple[str, int]:
    """What is said of a bag that is read or refused within 1 GB and 10 s; voltages that it has."""
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
    return storage_of(harm.small_bag(tmp_path / "bag", "sqlite3"))


def test_no_file_is_deleted_by_the_journal_beside_a_bag_nor_read_through_a_link(db3, tmp_path):
    victim = tmp_path / "thesis.tex"
    victim.write_text("years of work")
    journal = harm.journal_naming(db3, victim)
    db3.with_name(db3.name + "-wal").symlink_to(victim)
    before = db3.read_bytes(), journal.read_bytes()
    assert said_of(db3)[1] == 20
    assert victim.read_text() == "years of work"
    assert (db3.read_bytes(), journal.read_bytes()) == before


# The schema is data too: what it calls a table may be a view's text.
ENTERED_VIEW = (
    "PRAGMA writable_schema = ON",
    f"UPDATE sqlite_master SET sql = '{harm.TRICKS[0]}' WHERE name = 'messages'",
)
ODD_STAMPS = "UPDATE messages SET timestamp = {} WHERE rowid % 7 = 3"


@pytest.mark.parametrize(("statements", "said", "readings"), [
    (("DROP TABLE messages", harm.TRICKS[0]), "refused: .*messages is no", 0),
    (("DROP TABLE messages", harm.TRICKS[1]), "refused: .*messages has columns", 0),
    (("DROP TABLE messages", harm.TRICKS[2]), "refused: .*messages is no", 0),
    (ENTERED_VIEW, "refused: .*(messages is no|malformed)", 0),
    ((ODD_STAMPS.format("'now'"),), "", 17), ((ODD_STAMPS.format("1e308"),), "", 17),
])  # fmt: skip
def test_messages_that_a_program_makes_are_refused_and_stamps_are_integers(
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


def mcap_of(*parts: bytes, topics: Sequence[tuple[str, str]] = BENCH_TOPICS) -> bytes:
    """A file with these topics, never finished."""
    file = [harm.MAGIC, harm.record(1, text_of(b"ros2") + text_of(b""))]
    for number, (name, msgtype) in enumerate(topics, 1):
        topic = text_of(name.encode("utf-8", "surrogateescape"))
        schema = struct.pack("<H", number) + text_of(msgtype.encode()) + text_of(b"ros2msg")
        channel = struct.pack("<HH", number, number) + topic + text_of(b"cdr")
        file += [harm.record(3, schema + text_of(b"")), harm.record(4, channel + text_of(b""))]
    return b"".join([*file, *parts])


def text_of(content: bytes) -> bytes:
    return struct.pack("<I", len(content)) + content


def named_joints(count: int) -> bytes:
    """A JointState of so many joints without a name."""
    head = b"\0\1\0\0" + struct.pack("<iII4sI", 0, 0, 2, b"f", count)
    return head + bytes(4 * count) + bytes(12)


def chunks_in_chunks(content: bytes) -> bytes:
    for _ in range(1500):
        content = harm.chunk(content, compressed=False)
    return mcap_of(content)


HARMFUL_FILES = {
    # 183 kB took 3.8 GB: a million messages in compressed chunks.
    "bag.mcap: unfolds to more than": lambda: mcap_of(
        *[harm.chunk(harm.message(1, 0, b"\0\1\0\0" + bytes(200)) * 80_000)] * 30
    ),
    "a chunk inside a chunk": lambda: chunks_in_chunks(harm.message(1, 0, b"\0\1\0\0")),
    "1 of 1 messages cannot be decoded": lambda: mcap_of(
        harm.chunk(harm.message(2, 0, named_joints(10**6)))
    ),
    "more than 4096 topics": lambda: mcap_of(
        topics=[(f"/t{k}", "a/msg/B") for k in range(5000)]
    ),
    "zstd: unfolds to more than": lambda: zstandard.compress(bytes(1 << 28), 19),
}


@pytest.mark.parametrize("expected", HARMFUL_FILES)
def test_a_small_file_does_not_unfold_to_gigabytes(tmp_path, monkeypatch, expected):
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    bag = tmp_path / ("bag.mcap.zstd" if "zstd" in expected else "bag.mcap")
    bag.write_bytes(HARMFUL_FILES[expected]())
    assert bag.stat().st_size < 400_000
    assert expected in said_of(bag)[0]


BOMB = "a0: &a0 [x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 9)}]\n" for k in range(1, 12)
)
BOMB += (
    "rosbag2_bagfile_information:\n  relative_file_paths: [bag.mcap]\n"
    "  topics_with_message_count: [{topic_metadata: {name: %s}, message_count: %s}]\n"
)


def test_metadata_is_read_within_bounds_and_the_bag_without_it(tmp_path):
    bag = harm.small_bag(tmp_path / "bag", "mcap")
    good = (bag / METADATA).read_text()
    deep, long = good + "y: " + "[" * 5000, good + "x: " + "9" * 401
    odd = ["{", "rosbag2_bagfile_information: 3", "\0\0", "", "#" * (2 << 20)]
    for bad in (MERGED + good, long, deep, *odd, BOMB % ("*a11", 1), BOMB % ("/b/t", "*a11")):
        (bag / METADATA).write_text(bad)
        said, readings = said_of(bag)
        assert "metadata.yaml: cannot be understood" in said and readings == 20


def test_links_out_of_the_folder_of_a_bag_are_not_followed(tmp_path):
    bag = harm.small_bag(tmp_path / "bag", "mcap")
    (bag / "stolen.mcap").symlink_to(storage_of(harm.small_bag(tmp_path / "other", "mcap")))
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
def test_a_grid_has_an_end_whatever_the_times(step, last, most):
    """Of a few readings over a day, and of one reading far away: cells get wider, not more."""
    count = np.arange(1200 if step < 1.0 else 100)
    time = np.append(count[:-1] * step, last)
    record = Record("day", 0, {
        "wire.voltage": Signal("wire.voltage", "V", time, np.where(count % 20 < 10, 1.0, 0.0)),
        "wire.temperature": Signal("wire.temperature", "K", time, 300.0 + count % 7),
    })  # fmt: skip
    with allowance(1 << 30, 60.0):
        assert len(observe(record, Parameters.of_paper()).grid) < most
