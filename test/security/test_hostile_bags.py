"""Bags that are well formed and made to harm: one line or a record, in bounds, nothing deleted."""

import contextlib
import os
import sqlite3
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import zstandard

from examination.campaign.allowance import allowance
from examination.campaign.hostile_bags import (
    TRICKS,
    chunk,
    journal_naming,
    mcap_of,
    message,
    named_joints,
    small_bag,
)
from sma_bench.errors import InputError
from sma_bench.estimation.observation import observe
from sma_bench.parameters import read_parameters
from sma_bench.records import Record, Signal, read_record
from sma_bench.records.bag_files import METADATA
from sma_bench.records.bag_writer import write_record

GIGABYTE = 1 << 30
RIG = Path(__file__).resolve().parents[2] / "config" / "wire_rig.yaml"


def said(record) -> str:
    return " | ".join(f"{f.subject}: {f.text}" for f in record.findings)


def storage_of(bag: Path) -> Path:
    return next(p for p in bag.iterdir() if p.name != METADATA)


@pytest.fixture
def db3(tmp_path):
    return storage_of(small_bag(tmp_path / "bag", "sqlite3"))


# --- sqlite3 ------------------------------------------------------------------------------------


def test_no_file_is_deleted_by_the_journal_beside_a_bag(db3, tmp_path):
    victim = tmp_path / "thesis.tex"
    victim.write_text("years of work")
    journal = journal_naming(db3, victim)
    before = db3.read_bytes(), journal.read_bytes()
    record = read_record(db3)
    assert victim.read_text() == "years of work"
    assert (db3.read_bytes(), journal.read_bytes()) == before
    assert len(record["wire.voltage"])


def test_a_journal_that_is_a_link_is_not_followed(db3, tmp_path):
    secret = tmp_path / "secret"
    secret.write_bytes(b"x" * 100)
    db3.with_name(db3.name + "-wal").symlink_to(secret)
    assert len(read_record(db3)["wire.voltage"]) == 20


@pytest.mark.parametrize("statement", TRICKS[:3])
def test_messages_that_a_program_makes_are_refused(db3, statement):
    with sqlite3.connect(db3) as database:
        database.execute("DROP TABLE messages")
        database.execute(statement)
    database.close()
    with allowance(GIGABYTE, 10.0), pytest.raises(InputError, match="messages (is no|has columns)"):
        read_record(db3)


@pytest.mark.parametrize("stamp", ["'now'", "1e308"])
def test_stamps_that_are_no_integers_are_left_out(db3, stamp):
    import sma_bench.compiled  # noqa: F401, with it rows are joined

    with contextlib.closing(sqlite3.connect(db3)) as database:
        database.execute(f"UPDATE messages SET timestamp = {stamp} WHERE rowid % 7 = 3")
        database.commit()
    assert len(read_record(db3)["wire.voltage"]) == 17


def test_a_view_that_is_entered_as_a_table_is_no_table(db3):
    """The schema is data too: what it calls a table may be a view's text."""
    with sqlite3.connect(db3) as database:
        database.execute("PRAGMA writable_schema = ON")
        database.execute(
            "UPDATE sqlite_master SET sql = 'CREATE VIEW messages AS WITH RECURSIVE r(n) AS "
            "(SELECT 1 UNION ALL SELECT n + 1 FROM r) SELECT n AS id, 1 AS topic_id, "
            "n AS timestamp, zeroblob(64) AS data FROM r' WHERE name = 'messages'"
        )
    database.close()
    with allowance(GIGABYTE, 10.0), pytest.raises(InputError, match="malformed"):
        read_record(db3)


# --- mcap ---------------------------------------------------------------------------------------


def test_a_small_file_does_not_unfold_to_gigabytes(tmp_path):
    """183 kB took 3.8 GB: a million messages in compressed chunks."""
    run = message(1, 0, b"\0\1\0\0" + bytes(200)) * 80_000
    bag = tmp_path / "bag.mcap"
    bag.write_bytes(mcap_of(*[chunk(run)] * 30))
    assert bag.stat().st_size < 200_000
    with allowance(GIGABYTE, 10.0):
        assert "bag.mcap: unfolds to more than" in said(read_record(bag))


def test_chunks_in_chunks_are_not_opened(tmp_path):
    inner = message(1, 0, b"\0\1\0\0")
    for _ in range(1500):
        inner = chunk(inner, compressed=False)
    bag = tmp_path / "bag.mcap"
    bag.write_bytes(mcap_of(inner))
    with allowance(GIGABYTE, 10.0), pytest.raises(InputError, match="a chunk inside a chunk"):
        read_record(bag)


def test_a_million_joint_names_are_too_many_for_a_message(tmp_path):
    bag = tmp_path / "bag.mcap"
    bag.write_bytes(mcap_of(chunk(message(2, 0, named_joints(10**6)))))
    assert bag.stat().st_size < 2000
    with allowance(GIGABYTE, 10.0):
        record = read_record(bag)
    assert "1 of 1 messages cannot be decoded" in said(record)


def test_more_topics_than_any_bench_has_end_the_reading(tmp_path):
    bag = tmp_path / "bag.mcap"
    bag.write_bytes(mcap_of(topics=[(f"/t{k}", "a/msg/B") for k in range(5000)]))
    with allowance(GIGABYTE, 10.0), pytest.raises(InputError, match="more than 4096 topics"):
        read_record(bag)


# --- files --------------------------------------------------------------------------------------


def test_a_zstd_file_does_not_unfold_into_the_temporary_folder(tmp_path, monkeypatch):
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    bag = tmp_path / "bag.mcap.zstd"
    bag.write_bytes(zstandard.compress(bytes(1 << 28), 19))
    with allowance(GIGABYTE, 10.0), pytest.raises(InputError, match="unfolds to more than"):
        read_record(bag)


def test_metadata_is_read_within_bounds_and_the_bag_without_it(tmp_path):
    from test_border import MERGED

    bag = small_bag(tmp_path / "bag", "mcap")
    good = (bag / METADATA).read_text()
    deep, long = good + "y: " + "[" * 5000, good + "x: " + "9" * 401
    for bad in (MERGED + good, long, deep, "#" * (2 << 20)):
        (bag / METADATA).write_text(bad)
        with allowance(GIGABYTE, 10.0):
            record = read_record(bag)
        assert "metadata.yaml: cannot be understood" in said(record)
        assert len(record["wire.voltage"]) == 20


def test_links_out_of_the_folder_of_a_bag_are_not_followed(tmp_path):
    bag = small_bag(tmp_path / "bag", "mcap")
    other = storage_of(small_bag(tmp_path / "other", "mcap"))
    (bag / "stolen.mcap").symlink_to(other)
    record = read_record(bag)
    assert "stolen.mcap: a link out of the bag's folder; not followed" in said(record)
    assert len(record["wire.voltage"]) == 20
    storage_of(bag).unlink()
    with pytest.raises(InputError, match="a link out of the bag's folder"):
        read_record(bag)
    (bag / METADATA).rename(tmp_path / METADATA)
    (bag / METADATA).symlink_to(tmp_path / METADATA)
    with pytest.raises(InputError, match="a link out of the bag's folder"):
        read_record(bag)


def test_a_pipe_is_no_bag(tmp_path):
    os.mkfifo(tmp_path / "bag.mcap")
    with pytest.raises(InputError, match="expected a regular file"):
        read_record(tmp_path / "bag.mcap")
    for path in ("a\0b", "x" * 5000):
        with pytest.raises(InputError, match="no such file|cannot be read"):
            read_record(tmp_path / path)


# --- clocks -------------------------------------------------------------------------------------


def test_one_late_stamp_is_left_out_and_said(tmp_path):
    time = np.append(np.arange(200) * 0.1, 1e8)
    bag = tmp_path / "bag"
    write_record(bag, [Signal("wire.voltage", "V", time, np.ones(201))])
    record = read_record(bag)
    assert record.duration == pytest.approx(19.9)
    assert "1 of 201 messages are stamped up to 1e+08 s after the others" in said(record)


def test_of_two_times_the_one_with_more_messages_is_kept(tmp_path):
    time = np.concatenate([np.arange(50) * 0.1, 1e6 + np.arange(200) * 0.1, [1e6 + 5e5, 1e6 + 9e5]])
    write_record(tmp_path / "bag", [Signal("wire.voltage", "V", time, np.ones(252))])
    record = read_record(tmp_path / "bag")
    assert len(record["wire.voltage"]) == 200 and record["wire.voltage"].time[0] == 0.0
    assert "52 of 252" in said(record) and "before and up to 9e+05 s after" in said(record)


@pytest.fixture
def drive(tmp_path):
    """A wire driven and cooled, 20 readings a second."""
    time = np.arange(1200) * 0.05
    voltage = np.where(np.arange(1200) % 400 < 200, 2.0, 0.0)
    kernel = np.exp(-time / 5.0) * 0.05 / 5.0
    warmth = 300.0 + 15.0 * np.convolve(voltage, kernel)[:1200]
    write_record(tmp_path / "drive", [
        Signal("wire.voltage", "V", time, voltage),
        Signal("wire.current", "A", time, voltage / 3.0),
        Signal("wire.temperature", "K", time, warmth),
    ])  # fmt: skip
    return read_record(tmp_path / "drive")


def test_a_late_stamp_costs_no_memory(drive, tmp_path):
    """It asked for 745 GiB: an even grid from the first stamp to the last."""
    late = [
        Signal(s.name, s.unit, np.append(s.time, 1e9), np.concatenate([s.values, s.values[-1:]]))
        for s in drive.signals.values()
    ]
    write_record(tmp_path / "bag", late)
    record, parameters = read_record(tmp_path / "bag"), read_parameters(RIG)
    with allowance(GIGABYTE, 60.0):
        observation = observe(record, parameters)
    assert observation.grid[-1] < 1e4
    assert "are stamped up to 1e+09 s after the others" in said(record)


def test_a_grid_has_an_end_whatever_the_times(drive):
    """A record made in memory may hold any times: the cells get wider, not more."""
    far = {
        name: replace(s, time=np.append(s.time[:-1], 1e9), received=None)
        for name, s in drive.signals.items()
    }
    with allowance(GIGABYTE, 60.0):
        assert len(observe(replace(drive, signals=far), read_parameters(RIG)).grid) < 5e6


def test_few_readings_over_a_day_are_diagnosed_on_a_grid_of_their_number():
    count = np.arange(100)
    signals = [
        Signal("wire.voltage", "V", count * 1000.0, np.where(count % 20 < 10, 1.0, 0.0)),
        Signal("wire.temperature", "K", count * 1000.0, 300.0 + count % 7),
    ]
    record = Record(Path("day"), 0, {signal.name: signal for signal in signals})
    grid = observe(record, read_parameters(RIG)).grid
    assert len(grid) < 50_000
