"""Bags of other programs become named signals in SI units, on one clock."""

import numpy as np
import pytest
from rosbags.rosbag2 import Reader
from rosbags.rosbag2.enums import CompressionMode

from sma_bench.errors import InputError
from sma_bench.records import read_record

FOREIGN = ("wire/staircase", "wire/ramp", "composite/triangle", "composite/step")
STORAGES = [("mcap", mode) for mode in CompressionMode] + [
    ("sqlite3", mode) for mode in CompressionMode if mode is not CompressionMode.STORAGE
]
MILLIVOLTS = np.arange(200) * 1e-3


def said(record, subject):
    """Severity and numbers of what is said of a topic, signal or file."""
    return [(f.severity, f.numbers) for f in record.findings if f.subject == subject]


def warnings(record):
    return " ".join(f.text for f in record.findings if f.severity == "warning")


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


@pytest.mark.parametrize(("storage", "mode"), STORAGES)
def test_storages_and_compressions_give_the_same_signals(tmp_path, write_bag, ramp, storage, mode):
    bag = write_bag(tmp_path / "bag", ramp, storage, mode, chunk=150 if storage == "mcap" else None)
    clock = np.arange(200) / 100
    for path in (bag, next(p for p in bag.iterdir() if p.name != "metadata.yaml")):
        record = read_record(path)
        assert record.findings == ()
        warm = record["wire.temperature"]
        np.testing.assert_allclose(record["wire.voltage"].values, MILLIVOLTS, atol=1e-8)
        np.testing.assert_allclose(warm.values, 293.15 + np.arange(200) / 10, atol=1e-9)
        np.testing.assert_allclose(record["wire.current"].time, clock, atol=1e-9)
        np.testing.assert_allclose(warm.received, clock + 0.003, atol=1e-9)
        assert record.topics["/bench/wire/power"].count == 200


@pytest.fixture
def split_bag(tmp_path, write_bag, ramp):
    """A bag of two files, bag.mcap and second.mcap."""
    bag = write_bag(tmp_path / "bag", ramp[:200])
    next(write_bag(tmp_path / "other", ramp[200:]).glob("*.mcap")).rename(bag / "second.mcap")
    metadata, listed = bag / "metadata.yaml", "  relative_file_paths:\n  - bag.mcap\n"
    text = metadata.read_text().replace("message_count: 100\n", "message_count: 200\n")
    assert listed in text
    metadata.write_text(text.replace(listed, listed + "  - second.mcap\n"))
    return bag


def test_a_split_bag_is_read_whole_with_and_without_its_metadata(split_bag):
    record = read_record(split_bag)
    assert record.findings == ()
    np.testing.assert_allclose(record["wire.voltage"].values, MILLIVOLTS, atol=1e-8)
    (split_bag / "metadata.yaml").unlink()
    with pytest.raises(InputError, match="bag.mcap, second.mcap") as refused:
        read_record(split_bag)  # two bags, for all that is known
    assert str(split_bag) in str(refused.value) and "\n" not in str(refused.value)
    (split_bag / "bag.mcap").rename(split_bag / "run_9.mcap")
    (split_bag / "second.mcap").rename(split_bag / "run_10.mcap")
    numbered = read_record(split_bag)
    assert [f.severity for f in numbered.findings] == ["info"]  # and nothing of disorder
    for name, signal in record.signals.items():
        np.testing.assert_array_equal(numbered[name].values, signal.values)


def test_a_file_that_is_missing_or_not_listed_is_said_and_the_others_read(split_bag):
    (split_bag / "second.mcap").rename(split_bag / "zz.mcap")
    record = read_record(split_bag)
    assert len(record["wire.voltage"]) == 200
    assert said(record, "zz.mcap") == said(record, "second.mcap") == [("warning", {})]
    (split_bag / "zz.mcap").unlink()
    record = read_record(split_bag)
    assert len(record["wire.voltage"]) == 100
    lost = ("warning", {"missing": 100, "announced": 200})
    assert said(record, "/bench/wire/power") == said(record, "/bench/wire/temperature") == [lost]


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


@pytest.mark.parametrize("namespace", ["", "/bench", "/lab/rig_b/bench"])
def test_topics_are_found_under_any_namespace_and_no_twins(
    tmp_path, write_bag, messages, namespace
):
    measured, predicted = (messages.range(messages.start, d) for d in (0.1, 0.2))
    content = [(f"{namespace}/front/range", measured, messages.start)]
    for topic in ("front/range", "residual/back/range"):
        content.append((f"{namespace}/twin/{topic}", predicted, messages.start))
    record = read_record(write_bag(tmp_path / "bag", content))
    assert record["front.range"].values == pytest.approx([0.1])
    assert "back.range" not in record.signals


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_other_traffic_is_listed_but_not_decoded(tmp_path, write_bag, messages, ramp, storage):
    start = messages.start
    shape = {"height": 1, "width": 2, "encoding": "mono16", "is_bigendian": 0, "step": 4}
    image = messages.ros(
        "sensor_msgs/msg/Image",
        header=messages.header(start),
        data=np.zeros(4, dtype=np.uint8),
        **shape,
    )
    number = messages.ros("std_msgs/msg/Float32", data=20.0)
    foreign = {"/chatter": messages.text("hello"), "/computer/temperature": number}
    foreign |= {"/bench/thermal_image": image}
    content = [*ramp, *((topic, message, start) for topic, message in foreign.items())]
    content.append(("/bench/ambient/temperature", messages.temperature(start, 23.0), start))
    record = read_record(write_bag(tmp_path / "bag", content, storage))
    for topic, message in foreign.items():
        listed = record.topics[topic]
        assert (listed.type, listed.count, listed.signals) == (message.__msgtype__, 1, ())
    assert record.markers == () and len(record["wire.temperature"]) == 200
    # The ambient is no channel.
    assert record.channels == ("wire",)
    assert record["ambient.temperature"].values == pytest.approx([296.15])


def test_wrong_type_on_the_only_topic_for_a_meaning_is_an_error(tmp_path, write_bag, messages):
    number = messages.ros("std_msgs/msg/Float32", data=20.0)
    bag = write_bag(tmp_path / "bag", [("/bench/wire/temperature", number, messages.start)])
    said = "/wire/temperature has type std_msgs/msg/Float32, expected sensor_msgs/msg/Temperature"
    with pytest.raises(InputError, match=said):
        read_record(bag)


def test_what_is_nan_throughout_is_absent_and_said_so(tmp_path, write_bag, messages):
    stamps = [messages.start + k for k in range(10)]
    volts = [float("nan"), 1.0] * 5
    content = [
        ("/bench/wire/power", messages.power(t, v), t) for t, v in zip(stamps, volts, strict=True)
    ]
    record = read_record(write_bag(tmp_path / "bag", content))
    assert record.get("wire.current") is None
    assert len(record["wire.voltage"]) == 5
    assert said(record, "/bench/wire/power") == [("info", {"nan": 5}), ("info", {})]


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


# --- Which clock the times come from, and what is done about disorder.


def test_unsorted_messages_are_sorted_and_duplicates_dropped_and_both_said(
    tmp_path, write_bag, messages
):
    rows = [(0, 1.0), (2, 3.0), (1, 2.0), (2, 99.0)]
    content = [
        ("/x/wire/temperature", messages.temperature(messages.start + s * 10**9, v), at)
        for at, (s, v) in enumerate(rows, messages.start)
    ]
    record = read_record(write_bag(tmp_path / "bag", content))
    assert (record["wire.temperature"].values - 273.15).tolist() == pytest.approx([1, 2, 3])
    assert record["wire.temperature"].time.tolist() == [0.0, 1.0, 2.0]
    numbers = {key: n for f in record.findings for key, n in f.numbers.items()}
    assert numbers == {"backward": 1, "duplicates": 1}


def test_without_stamps_the_receive_time_counts_and_a_single_one_is_left_out(
    tmp_path, write_bag, messages, ramp
):
    bare, at = messages.temperature(0, 20.0), messages.start
    content = [("/x/wire/temperature", bare, at + k * 10**9) for k in range(3)]
    record = read_record(write_bag(tmp_path / "bare", content))
    assert record["wire.temperature"].time.tolist() == [0.0, 1.0, 2.0]
    assert "never set" in warnings(record)
    # Markers and commands have no header.
    at += 500_000_000
    others = [
        ("/bench/wire/temperature", bare, at),
        ("/bench/experiment/marker", messages.text("ramp up"), at),
        ("/bench/voltage_command", messages.command([1.5]), at),
    ]
    record = read_record(write_bag(tmp_path / "bag", [*ramp, *others]))
    assert len(record["wire.temperature"]) == 200 and record.start_ns == messages.start
    assert "1 of 201 messages have no header.stamp and are left out" in warnings(record)
    assert record.markers == ((0.5, "ramp up"),)
    assert record["voltage_command"].time.tolist() == [0.5]
    assert record["voltage_command"].values.tolist() == [[1.5]]


def test_headerless_topics_follow_the_stamps_of_a_faster_simulated_clock(
    tmp_path, write_bag, messages
):
    # Ten simulated seconds in one second of the wall's clock.
    walls = [messages.start + k * 1_000_000 for k in range(1000)]
    content = [
        ("/bench/wire/temperature", messages.temperature(k * 10_000_000, 20.0), wall)
        for k, wall in enumerate(walls)
    ]
    content.insert(701, ("/bench/voltage_command", messages.command([1.0]), walls[700]))
    record = read_record(write_bag(tmp_path / "bag", content))
    assert record.start_ns == 0
    assert record["voltage_command"].time == pytest.approx([7.0], abs=0.011)
    assert "moved onto their clock" in warnings(record)
