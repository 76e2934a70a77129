"""Signals are the same after writing and reading; a bag is complete or not there at all."""

import os
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.rosbag2 import Reader

from sma_bench.errors import InputError
from sma_bench.records import Record, Signal, read_record
from sma_bench.records.bag_writer import BagWriter, write_record
from sma_bench.records.contract import TEMPERATURE

NAMES = {"wire.voltage": ("V", np.float32), "wire.current": ("A", np.float32),
         "wire.temperature": ("K", float), "ambient.temperature": ("K", float),
         "front.range": ("m", np.float32), "deflection": ("m", float), "elongation": ("m", float),
         "force": ("N", float)}
CLOCK = np.arange(50) * 0.02
RAMP = Signal("wire.voltage", "V", CLOCK, 1 + CLOCK)


@st.composite
def a_signal(draw, name):
    unit, kind = NAMES[name]
    stamps = draw(st.lists(st.integers(0, 10**12), min_size=1, max_size=20, unique=True))
    values = np.array(draw(st.lists(st.floats(-1e3, 1e3), min_size=20, max_size=20)))
    rounded = values[: len(stamps)].astype(kind).astype(float)
    return Signal(name, unit, np.sort(np.array(stamps)) / 1e9, rounded)


@settings(max_examples=25, deadline=None)
@given(data=st.data())
def test_any_signals_come_back_as_they_were(tmp_path_factory, data):
    names = data.draw(st.lists(st.sampled_from(sorted(NAMES)), min_size=1, unique=True))
    given_signals = [data.draw(a_signal(name)) for name in names]
    bag = tmp_path_factory.mktemp("round") / "bag"
    write_record(bag, given_signals, start_ns=10**18)
    record = read_record(bag)
    assert set(record.signals) == set(names)
    first = min(s.time[0] for s in given_signals)
    assert record.start_ns == 10**18 + round(first * 1e9)
    for signal in given_signals:
        back = record[signal.name]
        assert back.unit == signal.unit
        np.testing.assert_allclose(back.time, signal.time - first, rtol=0, atol=2e-9)
        np.testing.assert_allclose(back.values, signal.values, rtol=1e-12, atol=1e-12)


def test_a_slow_log_of_two_days_is_no_clock_that_was_set(tmp_path):
    minutes = np.arange(2880) * 60.0
    kelvin = Signal("wire.temperature", "K", minutes, 300.0 + 5.0 * np.sin(minutes / 7e3))
    write_record(tmp_path / "slow", [kelvin], start_ns=10**18)
    assert len(read_record(tmp_path / "slow")["wire.temperature"]) == 2880


def test_receive_times_markers_and_commands_are_written_and_rosbags_reads_them(tmp_path, messages):
    warm = Signal("wire.temperature", "K", CLOCK, 300 + CLOCK, CLOCK + 0.02)
    command = Signal("voltage_command", "V", CLOCK, np.column_stack([CLOCK, -CLOCK]))
    pull = Signal("force", "N", CLOCK, CLOCK)
    made = {signal.name: signal for signal in (warm, command, pull, RAMP)}
    record = Record(tmp_path, 10**18, made, markers=((0.1, "up"), (0.5, "down")))
    write_record(tmp_path / "bag", record, namespace="/lab/rig/")
    back = read_record(tmp_path / "bag")
    assert back.markers == record.markers and back.start_ns == record.start_ns
    assert back["wire.temperature"].topic == "/lab/rig/wire/temperature"
    np.testing.assert_allclose(back["wire.temperature"].received, warm.received, atol=1e-9)
    np.testing.assert_allclose(back["voltage_command"].values, command.values)
    with Reader(tmp_path / "bag") as reader:
        assert reader.message_count == 4 * len(CLOCK) + 2
        for connection, _, data in reader.messages(reader.connections):
            message = messages.types.deserialize_cdr(data, connection.msgtype)
            if connection.topic == "/lab/rig/wire/power":
                assert message.location == "wire" and np.isnan(message.current)
            elif connection.topic == "/lab/rig/joint_states":
                assert message.name == ["wire"] and np.isnan(message.position[0])


@pytest.mark.parametrize(("name", "time", "values"), [
    ("wire.colour", 0.0, [0.0]), ("left.range", 0.0, [0.0]), ("force", -5.0, [0.0]),
    ("force", 1e12, [0.0]), ("force", np.nan, [0.0]), ("force", 0.0, [[0.0, 0.0]]),
])  # fmt: skip
def test_signals_that_fit_no_message_are_refused_and_leave_nothing(tmp_path, name, time, values):
    wrong = Signal(name, "", np.array([time]), np.array(values))
    for signals, said in (([RAMP, wrong], name), ([], "no signals")):
        with pytest.raises(InputError, match=said):
            write_record(tmp_path / "bag", signals)
    assert list(tmp_path.iterdir()) == []


def test_a_path_that_cannot_be_written_is_refused(tmp_path, monkeypatch, write_bag, ramp):
    taken = tmp_path / "file"
    taken.write_text("precious")
    for path, said in ((taken, "exists already"), (taken / "bag", "cannot be written")):
        for write in (BagWriter, lambda path: write_record(path, [RAMP])):
            with pytest.raises(InputError, match=said):
                write(path)
    assert taken.read_text() == "precious"

    def full(*_, **__):
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(Path, "write_text", full)
        with pytest.raises(InputError, match="the disk is full"):
            BagWriter(tmp_path / "bag")
    held = [os.readlink(link) for link in Path("/proc/self/fd").iterdir() if link.exists()]
    assert not [path for path in held if str(tmp_path) in path]
    monkeypatch.setitem(sys.modules, "mcap.writer", None)  # reading does not need it
    with pytest.raises(InputError, match="mcap") as refused:
        BagWriter(tmp_path / "new")
    assert "\n" not in str(refused.value) and not (tmp_path / "new").exists()
    assert len(read_record(write_bag(tmp_path / "read", ramp))["wire.voltage"]) == 200


def test_a_bag_is_readable_after_every_flush_and_takes_only_announced_topics(tmp_path, messages):
    bag, topic = tmp_path / "bag", "/bench/wire/temperature"
    with BagWriter(bag) as writer:
        assert (bag / "metadata.yaml").exists()
        with pytest.raises(InputError, match="/a: not announced"):
            writer.write("/a", 1, b"")
        with pytest.raises(InputError, match="unknown message type lab_msgs/msg/Colour"):
            writer.add_topic("/a", "lab_msgs/msg/Colour")
        for _ in range(2):
            writer.add_topic(topic, TEMPERATURE)
        with pytest.raises(InputError, match=f"expected {TEMPERATURE}"):
            writer.add_topic(topic, "std_msgs/msg/Float64")
        with pytest.raises(InputError, match="expected one after 1970"):
            writer.write(topic, -1, b"")
        for k in range(3):
            stamp = messages.start + k
            writer.write(topic, stamp, messages.serialise(messages.temperature(stamp, 20.0 + k)))
            writer.flush()
            record = read_record(bag)
            assert len(record["wire.temperature"]) == k + 1
            (said,) = record.findings
            assert said.text.startswith("has no end: it is still being recorded, or its writer")
    assert read_record(bag).findings == ()
    with pytest.raises(InputError, match="closed"):
        writer.write(topic, 1, b"")


@pytest.mark.parametrize("whole", [True, False])
def test_of_many_writers_of_one_path_at_once_one_writes_and_the_others_fail(tmp_path, whole):
    gate = threading.Barrier(8)

    def written(_):
        gate.wait()
        try:
            if whole:
                write_record(tmp_path / "bag", [RAMP])
            else:
                BagWriter(tmp_path / "bag").close()
            return "written"
        except InputError as error:
            return str(error)

    with ThreadPoolExecutor(gate.parties) as writers:
        said = sorted(writers.map(written, range(gate.parties)))
    line = f"{tmp_path / 'bag'}: exists already, expected a new path for the bag"
    assert said == sorted(["written", *[line] * (gate.parties - 1)])
    assert [path.name for path in tmp_path.iterdir()] == ["bag"]
    assert not whole or len(read_record(tmp_path / "bag")["wire.voltage"]) == len(CLOCK)
