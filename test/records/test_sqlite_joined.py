"""Rows that SQLite joins itself are those that it gives one by one, damage or not."""

import random
import sqlite3

import pytest
from harvested import everything_in

from sma_bench.records import sqlite_scan
from sma_bench.records.harvest import Harvest
from sma_bench.records.sqlite_scan import scan_sqlite


def scanned(path, joined, monkeypatch):
    """Everything that a scan finds: counts, times, bytes, what it says was lost."""
    monkeypatch.setattr(sqlite_scan, "is_compiled", lambda size: joined)
    harvest = Harvest(lambda name, msgtype: "temperature" not in name)
    scan_sqlite(path, harvest)
    return everything_in(harvest)


def batches_of_joined_rows(monkeypatch):
    """A list that grows with each batch that SQLite joins."""
    taken = []
    take = sqlite_scan._take_joined
    monkeypatch.setattr(
        sqlite_scan, "_take_joined", lambda batch, wanted: (taken.append(1), take(batch, wanted))
    )
    return taken


@pytest.fixture
def file(tmp_path, write_bag, ramp):
    bag = write_bag(tmp_path / "bag", ramp, storage="sqlite3")
    return next(bag.glob("*.db3"))


def test_the_same_messages_are_found(file, monkeypatch):
    plain, _ = scanned(file, False, monkeypatch)
    monkeypatch.setattr(sqlite_scan, "_BATCH", 70)
    joined = batches_of_joined_rows(monkeypatch)
    assert scanned(file, True, monkeypatch) == (plain, [])
    assert len(joined) == 3
    assert sum(len(times) for _, times, _, _ in plain.values()) >= 200


@pytest.mark.parametrize(
    "odd",
    [
        "UPDATE messages SET timestamp = -5 WHERE rowid % 50 = 0",
        "UPDATE messages SET timestamp = 1.5 WHERE rowid = 40",
        "UPDATE messages SET timestamp = 'soon' WHERE rowid = 40",
        "UPDATE messages SET data = 'text' WHERE rowid % 50 = 0",
        "UPDATE messages SET data = x'' WHERE rowid % 50 = 0",
        "UPDATE messages SET data = 12 WHERE rowid = 40",
        "DELETE FROM messages WHERE rowid % 3 = 0",
        "DELETE FROM messages",
    ],
)
def test_odd_rows_cost_the_same(file, monkeypatch, odd):
    with sqlite3.connect(file) as database:
        database.execute(odd)
    database.close()
    monkeypatch.setattr(sqlite_scan, "_BATCH", 70)
    plain = scanned(file, False, monkeypatch)
    assert scanned(file, True, monkeypatch) == plain


def test_a_database_of_another_encoding_is_read_row_by_row(file, monkeypatch):
    other = file.with_name("other.db3")
    source, target = sqlite3.connect(file), sqlite3.connect(other)
    target.execute("PRAGMA encoding = 'UTF-16'")
    for sql in source.iterdump():
        target.execute(sql) if sql not in ("BEGIN TRANSACTION;", "COMMIT;") else None
    target.commit()
    assert target.execute("PRAGMA encoding").fetchone() == ("UTF-16le",)
    source.close()
    target.close()
    joined = batches_of_joined_rows(monkeypatch)
    assert scanned(other, True, monkeypatch) == scanned(file, False, monkeypatch)
    assert not joined


@pytest.mark.parametrize("seed", range(40))
def test_damage_at_random_places_costs_the_same(file, tmp_path, monkeypatch, seed):
    rng = random.Random(seed)
    content = bytearray(file.read_bytes())
    for _ in range(rng.randint(1, 6)):
        at = rng.randrange(100, len(content))
        content[at : at + 40] = rng.randbytes(40)
    damaged = tmp_path / "damaged.db3"
    damaged.write_bytes(content[: rng.randint(len(content) // 2, len(content))])
    monkeypatch.setattr(sqlite_scan, "_BATCH", 70)
    plain, said = scanned(damaged, False, monkeypatch)
    found, says = scanned(damaged, True, monkeypatch)
    assert found == plain
    # One hole may show as two where a batch ends in it.
    assert [finding.numbers.get("rows") for finding in says] == [
        finding.numbers.get("rows") for finding in said
    ]
