"""Bags of other programs are read as named signals in SI units, on one clock."""

import numpy as np
import pytest
from rosbags import rosbag1, rosbag2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from examination.check.bags import HABITS, LOSS, RAISED, REFUSED, RIGHT, WRONG, outcome
from examination.check.bags import write_bag as write_drawn
from sma_bench.cli import main
from sma_bench.errors import InputError
from sma_bench.records import Signal, read_record
from sma_bench.records.bag_tables import read_bag_tables
from sma_bench.records.bag_writer import write_record

PLAIN = {kind: habits[0] for kind, habits in HABITS.items()}
# One habit at a time, also in db3 files if they can have it; LOST: habits that lose messages.
OF_FILES = ("files", "metadata", "path")
IN_DB3 = {"of messages", "of files", "cut", "zeros", "garbage"}
DRAWN = [("mcap", kind, habit) for kind, habits in HABITS.items() for habit in habits[1:]]
DRAWN += [("sqlite3", k, h) for _, k, h in DRAWN if k in OF_FILES or h in IN_DB3]
LOST = {"one missing", "cut", "zeros", "bit", "garbage", "block gone", "block twice", "not cdr"}
LOST |= {"NaN", "repeated", "one far away", "some not stamped", "impossible stamps"}
LOST |= {"set while recording", "set back a little"}
NOT_READ = {"another bench", "another type"}


@pytest.mark.parametrize(("storage", "kind", "habit"), DRAWN)
def test_bags_of_every_habit_are_read_right_or_losses_reported(tmp_path, storage, kind, habit):
    """Each storage, compression, damage, clock, disorder, other traffic alone, compared with what
    was written."""
    bag = write_drawn(tmp_path, np.random.default_rng(3), PLAIN | {"storage": storage, kind: habit})
    is_refused = habit in NOT_READ or (storage, kind) == ("sqlite3", "end")
    end, why = outcome(bag)
    assert end == (REFUSED if is_refused else LOSS if habit in LOST else RIGHT), why


@pytest.mark.parametrize("habits", [
    {"storage": "sqlite3"},
    # Combinations that were once read wrong.
    {"clock": "one never stamped, an hour apart", "stamps": "repeated"},
    {"clock": "from 0, computer's beside", "stamps": "one far away"},
    {"files": "one missing", "metadata": "missing"},
    {"files": "one missing", "metadata": "cut off"},
    {"inside": "no chunks", "end": "zeros"},
])  # fmt: skip
@pytest.mark.parametrize("seed", range(2))
def test_a_bag_of_several_habits_is_read_right_or_losses_reported(tmp_path, habits, seed):
    bag = write_drawn(tmp_path, np.random.default_rng(seed), PLAIN | habits)
    end, why = outcome(bag)
    assert end not in (WRONG, RAISED), why
    assert end in (RIGHT, LOSS) or not bag.tells, why


@pytest.mark.parametrize("cut", [1, 200, 5000])
def test_an_sqlite3_file_without_its_end_is_refused(tmp_path, cut):
    """SQLite itself would silently find fewer rows."""
    write_drawn(tmp_path, np.random.default_rng(1), PLAIN | {"storage": "sqlite3"})
    (file,) = tmp_path.rglob("*.db3")
    file.write_bytes(file.read_bytes()[:-cut])
    with pytest.raises(InputError, match="the end of the file is missing"):
        read_record(file)


def test_topics_with_different_rates_are_read_without_findings(tmp_path):
    """An ambient temperature at 1 Hz and a deflection at 10 Hz."""
    slow, fast = np.arange(40.0), np.arange(0.0, 40.0, 0.1)
    given = [Signal("ambient.temperature", "K", slow, 295.0 + slow),
             Signal("deflection", "m", fast, 1e-3 * fast)]
    write_record(tmp_path / "bag", given)
    record = read_record(tmp_path / "bag")
    assert not record.findings
    assert record["deflection"].values == pytest.approx(1e-3 * fast)


def findings(record, subject):
    """Severity and numbers of the findings about a topic, signal or file."""
    return [(f.severity, f.numbers) for f in record.findings if f.subject == subject]


def test_two_topics_for_one_meaning_are_an_error_that_names_both(tmp_path, write_bag, messages):
    power = messages.power(messages.start, 1.0)
    content = [(f"/{rig}/wire/power", power, messages.start) for rig in ("a", "b")]
    bag = write_bag(tmp_path / "bag", content)
    with pytest.raises(InputError, match="both /a/wire/power and /b/wire/power"):
        read_record(bag)
    assert read_record(bag, namespace="b")["wire.voltage"].topic == "/b/wire/power"
    # A topic that is declared but has no messages is no candidate.
    declare = [("/a/wire/power", "sensor_msgs/msg/BatteryState")]
    record = read_record(write_bag(tmp_path / "declared", content[1:], declare=declare))
    assert record["wire.voltage"].topic == "/b/wire/power"
    assert findings(record, "/a/wire/power") == [("info", {})]


def test_commands_of_the_wrong_length_or_with_nan_are_left_out(tmp_path, write_bag, messages):
    rows = [(1, 2), (3, 4), (5,), (float("nan"), 6), (7, float("inf")), (), (8, 9)]
    kind = "std_msgs/msg/Float64MultiArray"
    made = [messages.ros(kind, data=np.array(row, dtype=float)) for row in rows]
    content = [("/bench/voltage_command", command, messages.start + k * 10**9)
               for k, command in enumerate(made)]
    record = read_record(write_bag(tmp_path / "bag", content))
    command = record["voltage_command"]
    assert command.values.tolist() == [[1, 2], [3, 4], [8, 9]]
    assert command.time.tolist() == [0, 1, 6]
    assert findings(record, "/bench/voltage_command") == [("warning", {"messages": 4})]


def test_of_a_joint_named_twice_the_first_is_used_with_one_finding(tmp_path, write_bag, messages):
    arrays = dict.fromkeys(("position", "velocity", "effort"), np.array([1.0, 2.0]))
    stamps = range(messages.start, messages.start + 3 * 10**9, 10**9)
    content = [("/bench/joint_states",
                messages.stamped("JointState", t, name=["wire", "wire"], **arrays), t)
               for t in stamps]
    record = read_record(write_bag(tmp_path / "bag", content))
    assert record["elongation"].values.tolist() == record["force"].values.tolist() == [1.0] * 3
    assert findings(record, "/bench/joint_states") == [("warning", {"messages": 3})]


def test_invalid_ranges_are_kept_and_flagged(tmp_path, write_bag, messages):
    values = [0.1, float("inf"), -float("inf"), 0.3, float("nan")]
    limits, content = {"min_range": 0.05, "max_range": 0.2}, []
    for stamp, value in enumerate(values, messages.start):
        distance = messages.stamped("Range", stamp, range=value, **limits)
        content.append(("/bench/back/range", distance, messages.start))
    record = read_record(write_bag(tmp_path / "bag", content))
    assert record["back.range"].values == pytest.approx([0.1, np.inf, -np.inf, 0.3])
    flagged = [n for severity, n in findings(record, "/bench/back/range") if severity == "warning"]
    assert flagged == [{"count": 1}] * 3  # too close, no target, outside min_range to max_range


def test_a_variance_becomes_the_std_of_readings_and_0_is_unknown(tmp_path, write_bag, messages):
    for k, (variances, std) in enumerate((((0.25, 0.25, 1.0, 0.0), [0.5, 0.5, 1.0, 0.5]),
                                          ((0.0,) * 4, None))):
        content = [("/b/wire/temperature", messages.temperature(t, 30.0, variance=v), t)
                   for t, v in enumerate(variances, messages.start)]
        signal = read_record(write_bag(tmp_path / f"{k}", content))["wire.temperature"]
        assert (None if signal.std is None else signal.std.tolist()) == std


THEIRS = "lab_msgs/msg/Wires"
DEFINED = {THEIRS: "std_msgs/Header header\nChannel[] channels\nfloat64 position_mm\nstring mode",
           "lab_msgs/msg/Channel": "string name\nfloat32 voltage_V\nuint8[2] flags"}


@pytest.mark.parametrize("storage", ["MCAP", "SQLITE3", "ROS 1"])
def test_their_own_message_types_are_imported_as_the_bag_defines_them(tmp_path, capsys, storage):
    """Voltages of two channels in a sequence of messages, and a position in mm."""
    is_old = storage == "ROS 1"
    types = get_typestore(Stores.ROS1_NOETIC if is_old else Stores.ROS2_JAZZY)
    for name, text in reversed(DEFINED.items()):
        types.register(get_types_from_msg(text, name))
    made, old = types.types, {"seq": 7} if is_old else {}
    path = tmp_path / ("their.bag" if is_old else "their")
    writer = rosbag1.Writer(path) if is_old else rosbag2.Writer(
        path, version=9, storage_plugin=rosbag2.StoragePlugin[storage])
    with writer:
        connection = writer.add_connection("/rig/wires", THEIRS, typestore=types)
        for k in range(60):
            stamp = made["builtin_interfaces/msg/Time"](sec=1_700_000_000 + k, nanosec=0)
            header = made["std_msgs/msg/Header"](stamp=stamp, frame_id="ab"[: k % 3], **old)
            channels = [made["lab_msgs/msg/Channel"](name, volts, np.zeros(2, np.uint8))
                        for name, volts in (("left", 0.1 * (k > 9)), ("right", 0.2 * (k > 9)))]
            given = made[THEIRS](header, channels, 40.0 - 0.1 * max(k - 9, 0), "auto")
            pack = types.serialize_ros1 if is_old else types.serialize_cdr
            writer.write(connection, (1_700_000_100 + k) * 10**9, bytes(pack(given, THEIRS)))
    rig = tmp_path / "rig.yaml"
    rig.write_text("/**: {ros__parameters: {bench: {channels: [left, right], channel_sides: [front,"
                   " front]}, load: {kind: force, force: 1.0}, wire: {length: 0.2}}}")
    words = [str(path), "--params", str(rig), "--out", str(tmp_path / "bag")]
    assert main(["import", *words]) == 0
    record = read_record(tmp_path / "bag")
    assert record.start_ns == 1_700_000_000 * 10**9 and record.duration == 59.0
    tops = {name: s.values[-1] - s.values[0] for name, s in record.signals.items()}
    assert tops == pytest.approx(
        {"left.voltage": 0.1, "right.voltage": 0.2, "elongation": -0.005}, rel=1e-6)
    assert main(["info", str(path)]) == 2
    assert "sma-bench import" in capsys.readouterr().err


def test_numbers_of_standard_messages_have_names_and_units(tmp_path, messages, write_bag):
    """By the type, the names of joints and the labels of an array; images are left out."""
    ros, start = messages.ros, messages.start
    labels = [ros("std_msgs/msg/MultiArrayDimension", label=text) for text in ("U [V]", "T [C]")]
    layout = ros("std_msgs/msg/MultiArrayLayout", dim=labels)
    arrays = {"position": np.array([0.01]), "effort": np.array([5.0])}
    sent = {
        "/psu": (messages.power(start, 2.0, 0.5),
                 {"/psu/voltage": ("V", 2), "/psu/current": ("A", 0.5)}),
        "/slide": (messages.stamped("JointState", start, name=["cart"], **arrays),
                   {"/slide/cart/position": ("m", 0.01), "/slide/cart/effort": ("N", 5)}),
        "/daq": (ros("std_msgs/msg/Float64MultiArray", layout=layout, data=np.array([3.0, 25.0])),
                 {"/daq/U [V]": ("V", 3), "/daq/T [C]": ("C", 25)}),
        "/pair": (ros("std_msgs/msg/Float64MultiArray", data=np.array([3.0, 25.0])),
                  {"/pair/1": ("", 3), "/pair/2": ("", 25)}),
        "/x_mm": (ros("std_msgs/msg/Float32", data=7.0), {"/x_mm": ("mm", 7)}),
        "/cell": (ros("geometry_msgs/msg/Wrench", force=ros("geometry_msgs/msg/Vector3", z=4.0)),
                  {f"/cell/force.{c}": ("N", 4 * (c == "z")) for c in "xyz"}),
        "/camera": (messages.stamped("Image", start, data=np.zeros(1, np.uint8)), {}),
        "/lab/note": (messages.text("hello"), {})}
    content = [(topic, given, start + k * 10**9) for k in range(3)
               for topic, (given, _) in sent.items()]
    file = read_bag_tables(write_bag(tmp_path / "bag", content))
    found = {c.name: (c.unit, c.values[-1]) for c in file.columns if not c.name.endswith(" stamp")}
    assert found == {name: pair for _, named in sent.values() for name, pair in named.items()}
    assert [line.split()[0] for line in file.outside] == ["/camera", "/lab/note"]
