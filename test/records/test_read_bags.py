"""Bags of other programs become named signals in SI units."""

import json

import numpy as np
import pytest
from rosbags.rosbag2 import Reader
from rosbags.rosbag2.enums import CompressionMode

from sma_bench.errors import InputError
from sma_bench.records import read_record

FOREIGN = ("wire/staircase", "wire/ramp", "composite/triangle", "composite/step")


def said(record, subject):
    """Severity and numbers of what is said of a topic, signal or file."""
    return [(f.severity, f.numbers) for f in record.findings if f.subject == subject]


@pytest.mark.parametrize("name", FOREIGN)
def test_every_message_of_a_foreign_bag_is_the_one_rosbags_decodes(shared_data, messages, name):
    bag = shared_data / "foreign" / name
    record = read_record(bag)
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
        np.testing.assert_allclose(
            signal.time, (np.array(stamps) - record.start_ns) / 1e9, rtol=0, atol=1e-9
        )
        zero = 273.15 if name.endswith("temperature") else 0.0
        values = np.array([by_stamp[stamp] for stamp in stamps]) + zero
        np.testing.assert_array_equal(signal.values, values)


def test_foreign_wire_bag_shows_the_resistance_it_was_made_with(shared_data):
    truth = json.loads((shared_data / "foreign/wire/truth.json").read_text())
    record = read_record(shared_data / "foreign/wire/staircase")
    assert record.channels == ("wire",)
    slope, offset = np.polyfit(record["wire.current"].values, record["wire.voltage"].values, 1)
    assert slope == pytest.approx(truth["R"], rel=0.005)
    assert -offset / slope == pytest.approx(truth["I0"], abs=1e-3)


def test_signals_have_strictly_increasing_times_from_zero(shared_data):
    record = read_record(shared_data / "foreign/composite/step")
    assert min(signal.time[0] for signal in record.signals.values()) == 0
    assert all((np.diff(signal.time) > 0).all() for signal in record.signals.values())
    assert record.duration == pytest.approx(119.98, abs=0.01)


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
@pytest.mark.parametrize("mode", list(CompressionMode))
def test_storages_and_compressions_give_the_same_signals(tmp_path, write_bag, ramp, storage, mode):
    if storage == "sqlite3" and mode is CompressionMode.STORAGE:
        pytest.skip("sqlite3 has no compression of its own")
    bag = write_bag(tmp_path / "bag", ramp, storage, mode, chunk=150 if storage == "mcap" else None)
    for path in (bag, next(p for p in bag.iterdir() if p.name != "metadata.yaml")):
        record = read_record(path)
        assert record.findings == ()
        np.testing.assert_allclose(record["wire.voltage"].values, np.arange(200) * 1e-3, atol=1e-8)
        np.testing.assert_allclose(
            record["wire.temperature"].values, 293.15 + np.arange(200) / 10, atol=1e-9
        )
        np.testing.assert_allclose(record["wire.current"].time, np.arange(200) / 100, atol=1e-9)
        received = record["wire.temperature"].received
        np.testing.assert_allclose(received, np.arange(200) / 100 + 0.003, atol=1e-9)
        assert record.topics["/bench/wire/power"].count == 200


def split_in_two(bag, other):
    """Move the storage file of `other` into `bag` as its second file."""
    second = next(other.glob("*.mcap"))
    second.rename(bag / "second.mcap")
    metadata = bag / "metadata.yaml"
    first = next(p.name for p in bag.glob("*.mcap") if p.name != "second.mcap")
    text = metadata.read_text()
    listed = f"  relative_file_paths:\n  - {first}\n"
    assert listed in text
    text = text.replace(listed, listed + "  - second.mcap\n")
    metadata.write_text(text.replace("message_count: 100\n", "message_count: 200\n"))


@pytest.fixture
def split_bag(tmp_path, write_bag, ramp):
    bag = write_bag(tmp_path / "bag", ramp[:200])
    split_in_two(bag, write_bag(tmp_path / "other", ramp[200:]))
    return bag


def test_split_bag_is_read_whole(split_bag):
    record = read_record(split_bag)
    assert record.findings == ()
    np.testing.assert_allclose(record["wire.voltage"].values, np.arange(200) * 1e-3, atol=1e-8)


def test_numbered_files_without_metadata_are_one_bag(split_bag):
    whole = read_record(split_bag)
    (split_bag / "metadata.yaml").unlink()
    first = next(p for p in split_bag.glob("*.mcap") if p.name != "second.mcap")
    first.rename(split_bag / "run_2.mcap")
    (split_bag / "second.mcap").rename(split_bag / "run_10.mcap")
    record = read_record(split_bag)
    assert [f.severity for f in record.findings] == ["info"]  # and nothing of disorder
    for name, signal in whole.signals.items():
        np.testing.assert_array_equal(record[name].values, signal.values)


def test_a_folder_of_several_bags_is_refused(split_bag):
    (split_bag / "metadata.yaml").unlink()
    with pytest.raises(InputError, match="bag.mcap, second.mcap") as refused:
        read_record(split_bag)
    assert str(split_bag) in str(refused.value) and "\n" not in str(refused.value)


def test_missing_file_of_a_split_bag_is_reported_and_the_other_read(split_bag):
    (split_bag / "second.mcap").unlink()
    record = read_record(split_bag)
    assert len(record["wire.voltage"]) == 100
    assert said(record, "second.mcap") == [("warning", {})]
    lost = ("warning", {"missing": 100, "announced": 200})
    assert said(record, "/bench/wire/power") == said(record, "/bench/wire/temperature") == [lost]


def test_storage_file_not_listed_in_the_metadata_is_read_too(tmp_path, write_bag, ramp):
    bag = write_bag(tmp_path / "bag", ramp[:200])
    next(write_bag(tmp_path / "other", ramp[200:]).glob("*.mcap")).rename(bag / "zz.mcap")
    record = read_record(bag)
    assert len(record["wire.voltage"]) == 200
    assert said(record, "zz.mcap") == [("warning", {})]


def test_two_topics_for_one_meaning_are_an_error_that_names_both(tmp_path, write_bag, messages):
    power = messages.power(messages.start, 1.0)
    content = [(f"/{rig}/wire/power", power, messages.start) for rig in ("a", "b")]
    bag = write_bag(tmp_path / "bag", content)
    with pytest.raises(InputError, match="both /a/wire/power and /b/wire/power"):
        read_record(bag)
    assert read_record(bag, namespace="b")["wire.voltage"].topic == "/b/wire/power"


def test_a_declared_topic_without_messages_is_no_candidate(tmp_path, write_bag, messages):
    content = [("/b/wire/power", messages.power(messages.start, 1.0), messages.start)]
    declare = [("/a/wire/power", "sensor_msgs/msg/BatteryState")]
    bag = write_bag(tmp_path / "bag", content, declare=declare)
    record = read_record(bag)
    assert record["wire.voltage"].topic == "/b/wire/power"
    assert said(record, "/a/wire/power") == [("info", {})]


def test_what_a_twin_predicts_is_not_taken_for_measured(tmp_path, write_bag, messages):
    measured, predicted = messages.range(messages.start, 0.1), messages.range(messages.start, 0.2)
    content = [
        ("/bench/front/range", measured, messages.start),
        ("/bench/twin/front/range", predicted, messages.start),
        ("/bench/twin/residual/back/range", predicted, messages.start),
    ]
    record = read_record(write_bag(tmp_path / "bag", content))
    assert [float(v) for v in record["front.range"].values] == pytest.approx([0.1])
    assert "back.range" not in record.signals


@pytest.mark.parametrize("namespace", ["", "/bench", "/lab/rig_b/bench"])
def test_topics_are_found_under_any_namespace(tmp_path, write_bag, messages, namespace):
    content = [(f"{namespace}/front/range", messages.range(messages.start, 0.1), messages.start)]
    record = read_record(write_bag(tmp_path / "bag", content))
    assert record["front.range"].values == pytest.approx([0.1])


def test_wrong_type_on_the_only_topic_for_a_meaning_is_an_error(tmp_path, write_bag, messages):
    number = messages.ros("std_msgs/msg/Float32", data=20.0)
    bag = write_bag(tmp_path / "bag", [("/bench/wire/temperature", number, messages.start)])
    with pytest.raises(
        InputError,
        match="/bench/wire/temperature has type std_msgs/msg/Float32, expected "
        "sensor_msgs/msg/Temperature",
    ):
        read_record(bag)


def test_wrong_type_elsewhere_is_other_traffic(tmp_path, write_bag, messages, ramp):
    number = messages.ros("std_msgs/msg/Float32", data=20.0)
    content = [*ramp, ("/computer/temperature", number, messages.start)]
    record = read_record(write_bag(tmp_path / "bag", content))
    assert len(record["wire.temperature"]) == 200
    assert record.topics["/computer/temperature"].signals == ()


def test_unknown_topics_are_listed_but_not_decoded(tmp_path, write_bag, messages, ramp):
    for storage in ("mcap", "sqlite3"):
        content = [*ramp, ("/chatter", messages.text("hello"), messages.start)]
        record = read_record(write_bag(tmp_path / storage, content, storage))
        chatter = record.topics["/chatter"]
        assert (chatter.type, chatter.count, chatter.signals) == ("std_msgs/msg/String", 1, ())
        assert record.markers == ()


def test_bag_without_contract_topics_lists_what_it_has(tmp_path, write_bag, messages):
    bag = write_bag(tmp_path / "bag", [("/chatter", messages.text("hello"), messages.start)])
    record = read_record(bag)
    assert record.signals == {} and record.duration == 0
    assert said(record, "record") == [("error", {})] and "/chatter" in str(record.findings)
    with pytest.raises(InputError, match="wire.voltage"):
        record["wire.voltage"]


def test_what_is_nan_throughout_is_absent_and_said_so(tmp_path, write_bag, messages):
    content = []
    for k in range(10):
        stamp = messages.start + k
        voltage = 1.0 if k % 2 else float("nan")
        content.append(("/bench/wire/power", messages.power(stamp, voltage), stamp))
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
    flagged = [numbers for severity, numbers in said(record, "/bench/back/range")
               if severity == "warning"]  # fmt: skip
    assert flagged == [{"count": 1}] * 3  # too close, too far, outside what it says it measures


def test_images_are_counted_not_decoded(tmp_path, write_bag, messages, ramp):
    image = messages.ros(
        "sensor_msgs/msg/Image",
        header=messages.header(messages.start),
        height=1,
        width=2,
        encoding="mono16",
        is_bigendian=0,
        step=4,
        data=np.zeros(4, dtype=np.uint8),
    )
    content = [*ramp, ("/bench/thermal_image", image, messages.start)]
    record = read_record(write_bag(tmp_path / "bag", content, "sqlite3"))
    assert record.topics["/bench/thermal_image"].count == 1
    assert record.topics["/bench/thermal_image"].signals == ()


def test_channels_leave_out_the_ambient(tmp_path, write_bag, messages, ramp):
    ambient = messages.temperature(messages.start, 23.0)
    content = [*ramp, ("/bench/ambient/temperature", ambient, messages.start)]
    record = read_record(write_bag(tmp_path / "bag", content))
    assert record.channels == ("wire",)
    assert record["ambient.temperature"].values == pytest.approx([296.15])


def test_variance_of_a_camera_comes_with_its_readings_and_none_is_none(
    tmp_path, write_bag, messages
):
    stamps = [messages.start + k * 10**8 for k in range(4)]
    for name, variances in (("stated", (0.25, 0.25, 1.0, 0.0)), ("silent", (0.0,) * 4)):
        content = [
            ("/b/wire/temperature", messages.temperature(t, 30.0, variance=v), t)
            for t, v in zip(stamps, variances, strict=True)
        ]
        signal = read_record(write_bag(tmp_path / name, content))["wire.temperature"]
        if name == "stated":
            assert signal.std.tolist() == [0.5, 0.5, 1.0, 0.0]
        else:
            assert signal.std is None
