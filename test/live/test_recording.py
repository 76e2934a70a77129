"""What a recorder writes, without ROS and without a disk."""

import json

import pytest

from sma_bench.errors import InputError
from sma_bench.live.recording import (
    Recording,
    recorded_type,
    recorder_failure,
    recorder_state,
)

READING, STATE = "/bench/wire/temperature", "/bench/experiment/state"


class Bag:
    """A bag in memory; a disk that is full takes nothing more."""

    full = False

    def __init__(self, path):
        self.path, self.written, self.topics, self.closed = path, [], [], False

    def add_topic(self, topic, kind):
        self.topics.append(topic)

    def write(self, *message):
        if Bag.full:
            raise InputError(f"{self.path}: the disk is full")
        self.written.append(message)

    def flush(self):
        pass

    def close(self):
        self.closed = True


@pytest.fixture
def make(monkeypatch):
    monkeypatch.setattr(Bag, "full", False)
    bags, failures = [], []

    def make(output="bag", skip_idle=False, margin=0.0):
        def open_bag(path):
            bags.append(Bag(path))
            return bags[-1]

        recording = Recording(output, skip_idle, margin, failures.append, open_bag)
        return recording, bags, failures

    return make


def write(recording, topic, second, text="x"):
    recording.write(topic, round(second * 1e9), text.encode(), bytes.decode)


def test_messages_of_one_tick_keep_their_order_and_each_bag_begins_with_all_topics(make, tmp_path):
    for topic, kind in (
        ("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray"),
        ("/bench/wire/power", "sensor_msgs/msg/BatteryState"),
        ("/bench/experiment/progress", ""), ("/other/wire/power", ""),
    ):
        assert recorded_type(topic, "/bench/") == kind
    recording, bags, _ = make(str(tmp_path / "bag"))
    assert recording.next_output() == str(tmp_path / "bag")
    recording.begin("bag")
    recording.add(READING, "t")
    for _ in range(3):
        write(recording, READING, 1.0)
    assert [stamp for _, stamp, _ in bags[0].written] == [10**9, 10**9 + 1, 10**9 + 2]
    assert recording.finish() and bags[0].closed and not recording.finish()
    write(recording, READING, 2.0)  # nobody writes it
    for name in ("bag", "bag_2"):
        (tmp_path / name).mkdir()
    assert recording.next_output() == str(tmp_path / "bag_3")
    recording.begin("bag_3")
    write(recording, READING, 3.0)
    assert bags[1].topics == [READING] and recording.messages == {READING: 1}
    assert recorder_state(recording.state("recording")) == {
        "state": "recording", "output": "bag_3", "failure": "", "messages": {READING: 1},
    }  # fmt: skip


@pytest.mark.parametrize(("margin", "expected"), [(0.0, [2.0, 3.0]), (1.0, [1.0, 2.0, 3.0, 4.0])])
def test_idle_time_is_left_out_where_asked_but_for_a_margin(make, margin, expected):
    recording, bags, _ = make(skip_idle=True, margin=margin)
    recording.begin("bag")
    for topic in (READING, STATE):
        recording.add(topic, "t")
    write(recording, STATE, 0.0, "idle")
    for second in range(1, 7):
        if second == 2:
            write(recording, STATE, 1.9, "running: ramp")
        if second == 4:
            write(recording, STATE, 3.1, "done: ramp")
        write(recording, READING, second)
    found = [stamp / 1e9 for topic, stamp, _ in bags[0].written if topic == READING]
    assert found == expected


def test_a_full_disk_is_said_once_and_counted_as_not_written(make):
    recording, bags, failures = make()
    recording.begin("bag")
    recording.add(READING, "t")
    write(recording, READING, 1.0)
    Bag.full = True
    write(recording, READING, 2.0)
    write(recording, READING, 3.0)
    assert recording.messages == {READING: 1} and len(bags[0].written) == 1
    assert str(recording.failure) == "bag: the disk is full" and failures
    assert not recording.finish()
    assert recorder_failure(recording.state("failed")) == "bag: the disk is full"
    assert recorder_failure(json.dumps({"state": "failed", "failure": ""})) == "failed"
    assert recorder_failure("not what a recorder says") == ""
