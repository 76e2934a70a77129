"""The compiled search for messages of an mcap finds what the plain walk finds, damage or not."""

import random

import numpy as np
import pytest
from harvested import everything_in
from rosbags.rosbag2.enums import CompressionMode

from sma_bench.records import mcap_scan
from sma_bench.records.harvest import Harvest
from sma_bench.records.mcap_scan import scan_mcap


def scanned(path, compiled, monkeypatch, wanted=lambda name, msgtype: True):
    """Everything that a scan finds: counts, times, bytes, what it says was lost."""
    monkeypatch.setattr(mcap_scan, "is_compiled", lambda size: compiled)
    harvest = Harvest(wanted)
    scan_mcap(path, harvest)
    return everything_in(harvest)


@pytest.fixture
def file(tmp_path, write_bag, ramp):
    return next(write_bag(tmp_path / "bag", ramp, chunk=50).glob("*.mcap"))


def test_the_same_messages_are_found(file, monkeypatch):
    plain, _ = scanned(file, False, monkeypatch)
    found, remarks = scanned(file, True, monkeypatch)
    assert found == plain
    assert remarks == []
    assert sum(len(times) for _, times, _, _ in found.values()) >= 400


def test_a_compressed_file_too_and_windows_cut_no_message(
    tmp_path, write_bag, ramp, monkeypatch
):
    bag = write_bag(tmp_path / "packed", ramp, compression=CompressionMode.STORAGE)
    path = next(bag.glob("*.mcap"))
    plain, _ = scanned(path, False, monkeypatch)
    monkeypatch.setattr(mcap_scan, "_WINDOW", 1000)
    assert scanned(path, True, monkeypatch)[0] == plain


def test_topics_that_nobody_wants_are_counted_only(file, monkeypatch):
    def wanted(name, msgtype):
        return name.endswith("temperature")

    plain, _ = scanned(file, False, monkeypatch, wanted)
    found, _ = scanned(file, True, monkeypatch, wanted)
    assert found == plain
    assert {bool(times) for _, times, _, _ in found.values()} == {True, False}


@pytest.mark.parametrize("seed", range(40))
def test_damage_at_random_places_costs_the_same(file, monkeypatch, seed):
    rng = random.Random(seed)
    content = bytearray(file.read_bytes())
    for _ in range(rng.randint(1, 6)):
        at = rng.randrange(8, len(content))
        content[at : at + rng.choice((1, 8, 40))] = rng.randbytes(rng.choice((1, 8, 40)))
    file.write_bytes(content[: rng.randint(len(content) // 2, len(content))])
    plain, said = scanned(file, False, monkeypatch)
    assert scanned(file, True, monkeypatch) == (plain, said)


def test_taken_keeps_the_order_of_single_messages_and_runs():
    topic = Harvest(lambda name, msgtype: True).topic("a", "b/msg/C")
    topic.times.append(1)
    topic.blobs.append(b"x")
    topic.add_run(np.array([2, 3]), np.array([2, 0]), b"yy")
    topic.times.append(4)
    topic.blobs.append(b"zzz")
    times, lengths, joined = topic.taken()
    assert times.tolist() == [1, 2, 3, 4]
    assert lengths.tolist() == [1, 2, 0, 3]
    assert joined == b"xyyzzz"
    assert len(topic.taken()[0]) == 0
