"""Signals survive a bag; a bag is there whole or not at all."""

import os
import signal as signals
import subprocess
import sys
import time
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

NAMES = {
    "wire.voltage": ("V", np.float32),
    "wire.current": ("A", np.float32),
    "wire.temperature": ("K", None),
    "ambient.temperature": ("K", None),
    "front.range": ("m", np.float32),
    "deflection": ("m", None),
    "elongation": ("m", None),
    "force": ("N", None),
}
ROOT = Path(__file__).resolve().parents[2]


def ramp_signal(name="wire.voltage", n=50, period=0.02):
    time = np.arange(n) * period
    return Signal(name, NAMES[name][0], time, 1 + time)


@st.composite
def a_signal(draw, name):
    unit, kind = NAMES[name]
    stamps = draw(st.lists(st.integers(0, 10**12), min_size=1, max_size=20, unique=True))
    times = np.sort(np.array(stamps)) / 1e9
    values = np.array(draw(st.lists(st.floats(-1e3, 1e3), min_size=20, max_size=20)))[: len(times)]
    return Signal(name, unit, times, values.astype(kind).astype(float) if kind else values)


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


def test_record_round_trip_keeps_receive_times_markers_and_commands(tmp_path):
    time = np.arange(100) * 0.01
    record = Record(
        tmp_path,
        10**18,
        {
            "wire.temperature": Signal("wire.temperature", "K", time, 300 + time, time + 0.02),
            "voltage_command": Signal("voltage_command", "V", time, np.column_stack([time, -time])),
        },
        markers=((0.1, "up"), (0.5, "down")),
    )
    write_record(tmp_path / "bag", record, namespace="/lab/rig/")
    back = read_record(tmp_path / "bag")
    assert back.markers == ((0.1, "up"), (0.5, "down"))
    assert back.start_ns == record.start_ns
    assert back["wire.temperature"].topic == "/lab/rig/wire/temperature"
    np.testing.assert_allclose(back["wire.temperature"].received, time + 0.02, atol=1e-9)
    np.testing.assert_allclose(back["voltage_command"].values, np.column_stack([time, -time]))


def test_rosbags_reads_what_was_written(tmp_path, messages):
    write_record(tmp_path / "bag", [ramp_signal(), ramp_signal("force")])
    with Reader(tmp_path / "bag") as reader:
        assert reader.message_count == 100
        for connection, _, data in reader.messages(reader.connections):
            message = messages.types.deserialize_cdr(data, connection.msgtype)
            if connection.topic == "/bench/wire/power":
                assert message.location == "wire" and np.isnan(message.current)
            else:
                assert message.name == ["wire"] and np.isnan(message.position[0])


def test_existing_path_is_refused_and_untouched(tmp_path):
    bag = tmp_path / "bag"
    bag.write_text("precious")
    with pytest.raises(InputError, match="exists already"):
        write_record(bag, [ramp_signal()])
    with pytest.raises(InputError, match="exists already"):
        BagWriter(bag)
    assert bag.read_text() == "precious"


@pytest.mark.parametrize("signal", [
    Signal("wire.colour", "", np.zeros(1), np.zeros(1)),
    Signal("left.range", "m", np.zeros(1), np.zeros(1)),
    Signal("force", "N", np.array([-5.0]), np.zeros(1)),
    Signal("force", "N", np.array([1e12]), np.zeros(1)),
    Signal("force", "N", np.array([np.nan]), np.zeros(1)),
    Signal("force", "N", np.zeros(1), np.zeros((1, 2))),
])  # fmt: skip
def test_signals_that_fit_no_message_are_refused_and_leave_nothing(tmp_path, signal):
    with pytest.raises(InputError, match=signal.name):
        write_record(tmp_path / "bag", [ramp_signal(), signal])
    assert list(tmp_path.iterdir()) == []


def test_no_signals_are_refused(tmp_path):
    with pytest.raises(InputError, match="no signals"):
        write_record(tmp_path / "bag", [])
    assert list(tmp_path.iterdir()) == []


def test_unwritable_folder_is_one_line(tmp_path):
    in_the_way = tmp_path / "file"
    in_the_way.write_text("")
    with pytest.raises(InputError, match="cannot be written"):
        write_record(in_the_way / "bag", [ramp_signal()])
    with pytest.raises(InputError, match="cannot be written"):
        BagWriter(in_the_way / "bag")


def test_writer_is_readable_after_every_flush(tmp_path, messages):
    with BagWriter(tmp_path / "bag") as writer:
        assert (tmp_path / "bag/metadata.yaml").exists()
        writer.add_topic("/bench/wire/temperature", "sensor_msgs/msg/Temperature")
        for k in range(3):
            message = messages.temperature(messages.start + k, 20.0 + k)
            stamp = messages.start + k
            writer.write("/bench/wire/temperature", stamp, messages.serialise(message))
            writer.flush()
            assert len(read_record(tmp_path / "bag")["wire.temperature"]) == k + 1
    assert read_record(tmp_path / "bag").findings == ()
    with pytest.raises(InputError, match="closed"):
        writer.write("/bench/wire/temperature", 1, b"")


def test_writer_refuses_unknown_topics_and_types(tmp_path):
    with BagWriter(tmp_path / "bag") as writer:
        with pytest.raises(InputError, match="/a: not announced"):
            writer.write("/a", 1, b"")
        with pytest.raises(InputError, match="unknown message type lab_msgs/msg/Colour"):
            writer.add_topic("/a", "lab_msgs/msg/Colour")
        writer.add_topic("/a", "std_msgs/msg/String")
        writer.add_topic("/a", "std_msgs/msg/String")
        with pytest.raises(InputError, match="expected std_msgs/msg/String"):
            writer.add_topic("/a", "std_msgs/msg/Float64")
        with pytest.raises(InputError, match="expected one after 1970"):
            writer.write("/a", -1, b"")


RECORDER = """
import sys, time
from rosbags.typesys import Stores, get_typestore
from sma_bench.records.bag_writer import BagWriter
TYPES, kind = get_typestore(Stores.ROS2_JAZZY), "std_msgs/msg/String"
writer = BagWriter(sys.argv[1])
writer.add_topic("/bench/experiment/marker", kind)
count = 0
while True:
    message = TYPES.types[kind](data=str(count))
    writer.write("/bench/experiment/marker", time.time_ns(), TYPES.serialize_cdr(message, kind))
    print(count, time.monotonic(), flush=True)
    count += 1
    time.sleep(0.002)
"""


@pytest.mark.parametrize("seconds", [0.3, 1.4])
def test_killed_recorder_loses_at_most_its_last_second(tmp_path, seconds):
    process = subprocess.Popen(
        [sys.executable, "-c", RECORDER, str(tmp_path / "bag")],
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )
    assert process.stdout is not None
    lines = [process.stdout.readline()]
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        lines.append(process.stdout.readline())
    process.send_signal(signals.SIGKILL)
    lines += process.stdout.readlines()
    process.wait()
    written = [(int(n), float(t)) for n, t in (line.split() for line in lines if line.count(" "))]
    died = written[-1][1]
    safe = [number for number, at in written if at < died - 1.0]
    try:
        record = read_record(tmp_path / "bag")
    except InputError:
        assert not safe
        return
    found = [int(text) for _, text in record.markers]
    assert found == list(range(len(found)))
    assert len(found) >= len(safe)
    if seconds > 1:
        assert safe


FILLER = """
import resource, sys
from rosbags.typesys import Stores, get_typestore
from sma_bench.errors import InputError
from sma_bench.records.bag_writer import BagWriter
resource.setrlimit(resource.RLIMIT_FSIZE, (300_000, 300_000))
TYPES, kind = get_typestore(Stores.ROS2_JAZZY), "std_msgs/msg/String"
writer = BagWriter(sys.argv[1], compress=False)
writer.add_topic("/bench/experiment/marker", kind)
errors = []
for count in range(4000):
    message = TYPES.serialize_cdr(TYPES.types[kind](data=f"{count:0100}"), kind)
    try:
        writer.write("/bench/experiment/marker", 10**18 + count * 10**6, message)
        if count % 100 == 99:
            writer.flush()
    except InputError as error:
        errors.append(str(error))
try:
    writer.close()
except InputError as error:
    errors.append(str(error))
print(len(errors), errors[0])
"""


def test_full_disk_is_one_clear_line_and_what_was_written_stays_readable(tmp_path):
    """A limit on the size of files stands in for the disk."""
    bag = tmp_path / "bag"
    run = subprocess.run(
        [sys.executable, "-c", FILLER, str(bag)],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        check=True,
    )
    count, _, text = run.stdout.strip().partition(" ")
    assert int(count) > 1000
    assert text.startswith(f"{bag}: cannot be written: ") and "\n" not in text
    found = [int(text) for _, text in read_record(bag).markers]
    assert found == list(range(len(found)))
    assert 1500 < len(found) < 2300


def test_an_altered_bit_of_a_recorded_bag_is_noticed(tmp_path, messages):
    with BagWriter(tmp_path / "bag", compress=False) as bag:
        bag.add_topic("/bench/wire/temperature", TEMPERATURE)
        for k in range(500):
            message = messages.serialise(messages.temperature(messages.start + k, 20.0 + k))
            bag.write("/bench/wire/temperature", messages.start + k, message)
    file = next((tmp_path / "bag").glob("*.mcap"))
    raw = bytearray(file.read_bytes())
    message = messages.serialise(messages.temperature(messages.start + 250, 270.0))
    raw[raw.find(message) + len(message) - 12] ^= 4  # of the temperature
    file.write_bytes(bytes(raw))
    with pytest.raises(InputError, match="checksum"):
        read_record(tmp_path / "bag")


def test_a_bag_that_cannot_be_begun_leaves_no_file_open(tmp_path, monkeypatch):
    def full(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_text", full)
    with pytest.raises(InputError, match="the disk is full"):
        BagWriter(tmp_path / "bag")
    held = [os.readlink(link) for link in Path("/proc/self/fd").iterdir() if link.exists()]
    assert not [path for path in held if str(tmp_path) in path]


def test_without_mcap_a_bag_is_not_begun_and_all_others_are_read(
    tmp_path, monkeypatch, write_bag, ramp
):
    monkeypatch.setitem(sys.modules, "mcap.writer", None)
    with pytest.raises(InputError, match="mcap") as refused:
        BagWriter(tmp_path / "new")
    assert "\n" not in str(refused.value) and not (tmp_path / "new").exists()
    assert len(read_record(write_bag(tmp_path / "bag", ramp))["wire.voltage"]) == 200


def test_a_bag_that_is_still_being_recorded_is_no_dead_writers(tmp_path):
    bag, whole = tmp_path / "bag", tmp_path / "whole"
    write_record(whole, [ramp_signal()])
    with BagWriter(bag) as writer, Reader(whole) as reader:
        for connection in reader.connections:
            writer.add_topic(connection.topic, connection.msgtype)
        writer.write_many((c.topic, time, data) for c, time, data in reader.messages())
        writer.flush()
        said = {(f.severity, f.text) for f in read_record(bag).findings}
        assert ("info", "is still being recorded: what was written until now is read") in said
        assert not [text for severity, text in said if severity != "info"]
    assert "recorded" not in str(read_record(bag).findings)


def test_a_bag_that_another_program_writes_is_no_dead_writers_until_it_closes_it(tmp_path):
    bag = tmp_path / "bag"
    write_record(bag, [ramp_signal()])
    file = next(bag.glob("*.mcap"))
    with file.open("r+b") as other:  # as `ros2 bag record` does, without a lock
        other.truncate(file.stat().st_size // 2)
        said = {f.text for f in read_record(bag).findings}
        assert "is still being recorded: what was written until now is read" in said
    assert "is still being recorded" not in str(read_record(bag).findings)
