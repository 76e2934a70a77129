"""Bags of other programs become named signals in SI units, on one clock."""

import numpy as np
import pytest
from rosbags.rosbag2 import Reader

from examination.campaign.drawn_bags import HABITS, LOSS, REFUSED, RIGHT, outcome
from examination.campaign.drawn_bags import write_bag as write_drawn
from sma_bench.errors import InputError
from sma_bench.records import read_record

FOREIGN = ("wire/staircase", "wire/ramp", "composite/triangle", "composite/step")
PLAIN = {kind: habits[0] for kind, habits in HABITS.items()}
# One habit at a time, of those that a db3 file has; what is not read whole.
OF_FILES = ("files", "metadata", "path")
IN_DB3 = {"of messages", "of files", "cut", "zeros", "garbage"}
DRAWN = [("mcap", kind, habit) for kind, habits in HABITS.items() for habit in habits[1:]]
DRAWN += [("sqlite3", k, h) for _, k, h in DRAWN if k in OF_FILES or h in IN_DB3]
LOST = {"one missing", "cut", "zeros", "bit", "garbage", "block gone", "block twice", "not cdr"}
LOST |= {"NaN", "repeated", "one far away", "some not stamped", "impossible stamps"}
LOST |= {"set while recording", "set back a little"}
NOT_READ = {"another bench", "another type"}


@pytest.mark.parametrize(("storage", "kind", "habit"), DRAWN)
def test_bags_of_every_habit_are_read_right_or_say_what_is_lost(tmp_path, storage, kind, habit):
    """Storages, compressions, damage, clocks, disorder, other traffic: each alone, by its truth."""
    bag = write_drawn(tmp_path, np.random.default_rng(3), PLAIN | {"storage": storage, kind: habit})
    is_refused = habit in NOT_READ or (storage, kind) == ("sqlite3", "end")
    end, why = outcome(bag)
    assert end == (REFUSED if is_refused else LOSS if habit in LOST else RIGHT), why


def said(record, subject):
    """Severity and numbers of what is said of a topic, signal or file."""
    return [(f.severity, f.numbers) for f in record.findings if f.subject == subject]


@pytest.mark.parametrize("name", FOREIGN)
def test_every_message_of_a_foreign_bag_is_the_one_rosbags_decodes(shared_data, messages, name):
    bag = shared_data / "foreign" / name
    record = read_record(bag)
    assert min(signal.time[0] for signal in record.signals.values()) == 0
    fields = {"temperature": "temperature", "power": "voltage", "joint_states": "position"}
    expected: dict[str, list[tuple[int, float]]] = {}
    with Reader(bag) as reader:
        for connection, _, data in reader.messages(reader.connections):
            message = messages.types.deserialize_cdr(data, connection.msgtype)
            stamp = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
            channel, kind = connection.topic.split("/")[-2:]
            value = float(np.ravel(getattr(message, fields[kind]))[0])
            signal = "deflection" if kind == "joint_states" else f"{channel}.{fields[kind]}"
            expected.setdefault(signal, []).append((stamp, value))
    assert set(expected) == {n for n in record.signals if not n.endswith(".current")}
    for name, rows in expected.items():
        signal = record[name]
        # The first of several messages with one stamp counts.
        by_stamp = dict(reversed(rows))
        stamps = sorted(by_stamp)
        times = (np.array(stamps) - record.start_ns) / 1e9
        np.testing.assert_allclose(signal.time, times, rtol=0, atol=1e-9)
        assert (np.diff(signal.time) > 0).all()
        zero = 273.15 if name.endswith("temperature") else 0.0
        values = np.array([by_stamp[stamp] for stamp in stamps]) + zero
        np.testing.assert_array_equal(signal.values, values)


def test_two_topics_for_one_meaning_are_an_error_that_names_both(tmp_path, write_bag, messages):
    power = messages.power(messages.start, 1.0)
    content = [(f"/{rig}/wire/power", power, messages.start) for rig in ("a", "b")]
    bag = write_bag(tmp_path / "bag", content)
    with pytest.raises(InputError, match="both /a/wire/power and /b/wire/power"):
        read_record(bag)
    assert read_record(bag, namespace="b")["wire.voltage"].topic == "/b/wire/power"
    # One that is declared and has no messages is no candidate.
    declare = [("/a/wire/power", "sensor_msgs/msg/BatteryState")]
    record = read_record(write_bag(tmp_path / "declared", content[1:], declare=declare))
    assert record["wire.voltage"].topic == "/b/wire/power"
    assert said(record, "/a/wire/power") == [("info", {})]


def test_wrong_type_on_the_only_topic_for_a_meaning_is_an_error(tmp_path, write_bag, messages):
    number = messages.ros("std_msgs/msg/Float32", data=20.0)
    bag = write_bag(tmp_path / "bag", [("/bench/wire/temperature", number, messages.start)])
    said = "/wire/temperature has type std_msgs/msg/Float32, expected sensor_msgs/msg/Temperature"
    with pytest.raises(InputError, match=said):
        read_record(bag)


def test_joints_are_found_by_name_whatever_their_order(tmp_path, write_bag, messages):
    s = messages.start
    rows = [
        messages.joints(s, ["tip", "motor"], [0.001, 9.0]),
        messages.joints(s + 10, ["motor", "tip"], [9.0, 0.002]),
        messages.joints(s + 20, ["motor"], [9.0]),
        messages.joints(s + 30, ["wire", "tip"], [0.004, 0.003], [7.0, 8.0]),
    ]
    content = [("/bench/joint_states", row, s) for row in rows]
    record = read_record(write_bag(tmp_path / "bag", content))
    assert record["deflection"].values.tolist() == [0.001, 0.002, 0.003]
    assert record["deflection"].unit == "m"
    assert record["elongation"].values.tolist() == [0.004]
    assert record["force"].values.tolist() == [7.0]
    np.testing.assert_allclose(record["force"].time, [30e-9], atol=1e-12)


def test_commands_of_the_wrong_length_or_with_nan_are_left_out(tmp_path, write_bag, messages):
    rows = [(1, 2), (3, 4), (5,), (float("nan"), 6), (7, float("inf")), (), (8, 9)]
    content = [
        ("/bench/voltage_command", messages.command(row), messages.start + k * 10**9)
        for k, row in enumerate(rows)
    ]
    record = read_record(write_bag(tmp_path / "bag", content))
    command = record["voltage_command"]
    assert command.values.tolist() == [[1, 2], [3, 4], [8, 9]]
    assert command.time.tolist() == [0, 1, 6]
    assert said(record, "/bench/voltage_command") == [("warning", {"messages": 4})]


def test_invalid_ranges_are_kept_and_flagged(tmp_path, write_bag, messages):
    values = [0.1, float("inf"), -float("inf"), 0.3, float("nan")]
    content = [
        ("/bench/back/range", messages.range(messages.start + k, value), messages.start)
        for k, value in enumerate(values)
    ]
    record = read_record(write_bag(tmp_path / "bag", content))
    assert record["back.range"].values == pytest.approx([0.1, np.inf, -np.inf, 0.3])
    flagged = [n for severity, n in said(record, "/bench/back/range") if severity == "warning"]
    assert flagged == [{"count": 1}] * 3  # too close, too far, outside what it says it measures


@pytest.mark.parametrize(
    ("variances", "std"), [((0.25, 0.25, 1.0, 0.0), [0.5, 0.5, 1.0, 0.0]), ((0.0,) * 4, None)]
)
def test_variance_of_a_camera_comes_with_its_readings_and_none_is_none(
    tmp_path, write_bag, messages, variances, std
):
    stamps = [messages.start + k * 10**8 for k in range(4)]
    content = [
        ("/b/wire/temperature", messages.temperature(t, 30.0, variance=v), t)
        for t, v in zip(stamps, variances, strict=True)
    ]
    signal = read_record(write_bag(tmp_path / "bag", content))["wire.temperature"]
    assert (None if signal.std is None else signal.std.tolist()) == std


def test_markers_and_commands_without_a_header_are_on_the_clock_of_the_stamps(
    tmp_path, write_bag, messages, ramp
):
    at, ambient = messages.start + 500_000_000, messages.temperature(messages.start, 23.0)
    others = [
        ("/bench/wire/temperature", messages.temperature(0, 20.0), at),
        ("/bench/experiment/marker", messages.text("ramp up"), at),
        ("/bench/voltage_command", messages.command([1.5]), at),
        ("/bench/ambient/temperature", ambient, messages.start),
    ]
    record = read_record(write_bag(tmp_path / "bag", [*ramp, *others]))
    assert record.channels == ("wire",)
    assert record["ambient.temperature"].values == pytest.approx([296.15])
    assert len(record["wire.temperature"]) == 200 and record.start_ns == messages.start
    told = " ".join(f.text for f in record.findings if f.severity == "warning")
    assert "1 of 201 messages have no header.stamp and are left out" in told
    assert record.markers == ((0.5, "ramp up"),)
    assert record["voltage_command"].time.tolist() == [0.5]
    assert record["voltage_command"].values.tolist() == [[1.5]]
