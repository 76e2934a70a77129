"""Launch and parameter files: what they start and refuse, and the beam that RViz shows.

Without ROS's `launch`, `launch_stand_in` stands in for its classes.
"""

import math
import sys
from pathlib import Path
from xml.etree import ElementTree as Xml

import numpy as np
import pytest
import yaml
from launch_stand_in import ExecuteProcess, Node, Shutdown, Text, built

from sma_bench.errors import InputError
from sma_bench.nodes.arguments import check_arguments
from sma_bench.nodes.bench_plan import (
    ANTAGONIST,
    COMPOSITE,
    PIECES,
    SPRING,
    WEIGHT,
    WIRE,
    beam_urdf,
    plan_bench,
    plan_replay,
)
from sma_bench.parameters import Parameters, read_parameters
from sma_bench.parameters.node_tables import NODE_TABLES
from sma_bench.parameters.parameters import load_kind
from sma_bench.protocols import load_protocol
from sma_bench.records import Signal
from sma_bench.records.bag_writer import write_record
from sma_bench.ros.processes import PROFILE, RANGE, USERS_VARIABLES

ROOT = Path(__file__).resolve().parents[2]
RIGS = {
    "wire_bench": WIRE, "composite_bench": COMPOSITE, "weight_bench": WEIGHT,
    "spring_bench": SPRING, "antagonist_bench": ANTAGONIST,
}
BENCHES = {
    name: ROOT / "launch" / f"{name}.launch.py" for name in ("wire_bench", "composite_bench")
}
REST = ["experiment", "recorder", "identification"]
CAMERA = ["synthetic_camera", "ir_camera"]
PATIENCE = 60.0


ARGUMENTS = [
    ({}, ["simulator", *REST]),
    ({"record": "false"}, ["simulator", "experiment", "identification"]),
    ({"camera": "true"}, ["simulator", *CAMERA, *REST]),
    ({"nodes": "identification,diagnosis"}, ["simulator", *REST, "diagnosis"]),
    ({"nodes": "none"}, ["simulator", "experiment", "recorder"]),
    ({"twin": "true"}, ["simulator", "experiment", "recorder", "twin", "identification"]),
    ({"nodes": "investigation"}, ["simulator", "experiment", "investigation"]),
    ({"mode": "hardware"}, ["serial_bridge", "ir_camera", *REST]),
    ({"mode": "hardware", "camera": "false"}, ["serial_bridge", *REST]),
]


def executables(actions):
    return [action.given.executable for action in actions if isinstance(action, Node)]


def node(actions, executable):
    return next(action.given for action in actions if action.given.executable == executable)


def own(actions, executable):
    """Parameters over the rig's file, with texts unpacked."""
    found = node(actions, executable).parameters[-1]
    return {k: v.args[0] if isinstance(v, Text) else v for k, v in found.items()}


def test_every_rig_and_the_replay_have_a_launch_file():
    names = {path.name for path in (ROOT / "launch").glob("*.py")}
    assert names == {f"{name}.launch.py" for name in (*RIGS, "replay")}


@pytest.mark.parametrize("name", RIGS)
def test_a_launch_file_simulates_its_rig_with_a_protocol_that_fits_it(name, monkeypatch):
    actions = built(ROOT / "launch" / f"{name}.launch.py", monkeypatch)
    assert executables(actions) == ["simulator", *REST]
    rig, file = RIGS[name], ROOT / "config" / RIGS[name].file
    for action in actions:
        assert (action.given.package, action.given.namespace) == ("sma_bench", "bench")
        assert action.given.parameters[0] == str(file)
    parameters = read_parameters(file)
    if name not in BENCHES:
        kind = load_kind(parameters)
        assert name.startswith({"force": "weight"}.get(kind, kind))
    assert load_protocol(rig.protocol, parameters).channels == parameters["bench.channels"]


@pytest.mark.parametrize("name", BENCHES)
@pytest.mark.parametrize(("arguments", "expected"), ARGUMENTS)
def test_a_bench_is_what_its_arguments_say_and_every_node_knows_its_parameters(
    name, arguments, expected
):
    nodes = plan_bench(RIGS[name], arguments)
    assert [planned.executable for planned in nodes] == expected
    for planned in nodes:
        known = {p.name for p in NODE_TABLES[planned.executable]} | {"use_sim_time"}
        assert set(planned.parameters) <= known
        check_arguments(planned.executable, ["--ros-args", "--params-file", planned.file])
    # The end of one that holds the outputs ends the bench.
    vital = {planned.executable for planned in nodes if planned.vital}
    beside = {"recorder", "twin", "identification", "diagnosis", "investigation"}
    assert vital == set(expected) - beside


def test_arguments_reach_the_nodes_and_a_camera_takes_the_place_of_true_temperatures(monkeypatch):
    for variable in USERS_VARIABLES:
        monkeypatch.delenv(variable, raising=False)
    actions = built(
        BENCHES["wire_bench"], monkeypatch, protocol="ramp", speed="10", output="20261121",
        autostart="True", namespace="lab", twin="true",
    )
    assert own(actions, "simulator") == {"speed": 10.0}
    assert own(actions, "experiment") == {
        "protocol": "ramp", "autostart": True, "use_sim_time": True, "require_recorder": True
    }
    assert own(actions, "recorder") == {"output": "20261121", "use_sim_time": True}
    assert own(actions, "twin") == {"use_sim_time": True}
    # Else launch_ros reads a number where the node wants a text.
    assert isinstance(node(actions, "recorder").parameters[-1]["output"], Text)
    assert {action.given.namespace for action in actions} == {"lab"}
    assert isinstance(node(actions, "simulator").on_exit, Shutdown)
    assert node(actions, "recorder").on_exit is None
    for network, expected in (("false", "SYSTEM_DEFAULT"), ("true", "SUBNET")):
        actions = built(BENCHES["composite_bench"], monkeypatch, camera="true", network=network)
        given = [action.given.additional_env for action in actions]
        assert {variables[RANGE] for variables in given} == {expected}
        assert {PROFILE in variables for variables in given} == {network == "false"}
    moved = dict(node(actions, "simulator").remappings)
    channels = read_parameters(ROOT / "config" / COMPOSITE.file)["bench.channels"]
    assert moved == {f"{c}/temperature": f"{c}/true_temperature" for c in channels}
    exact = {"sensor.temperature_noise": 0.0, "sensor.temperature_resolution": 0.0}
    assert exact.items() <= own(actions, "simulator").items()
    reader, pictures = own(actions, "ir_camera"), own(actions, "synthetic_camera")
    assert reader["read_cold_wires"] is True and len(reader["regions"]) == len(channels)
    alike = ("image_width", "image_height", "pixel_size")
    assert [reader[name] for name in alike] == [pictures[name] for name in alike]


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"speed": "fast"}, "speed is 'fast'"),
        ({"speed": "10", "mode": "hardware"}, "expected 1.0"),
        ({"mode": "hardware", "autostart": "true"}, "enabled by hand"),
        ({"mode": "real"}, "mode is 'real'"),
        ({"mode": "emulated"}, "./bench check hardware"),
        ({"record": "yes"}, "record is 'yes'"),
        ({"nodes": "twin"}, "nodes: 'twin'"),
        ({"camera": "true", "params": "none.yaml"}, "none.yaml"),
        ({"protocol": "stairs"}, "protocol stairs: not one of"),
        ({"protocl": "ramp"}, "unknown argument protocl, did you mean protocol?"),
        ({"managed": "true"}, "they start active"),
    ],
)
def test_arguments_that_cannot_be_are_one_line(changed, said):
    with pytest.raises(InputError) as refused:
        plan_bench(WIRE, changed)
    assert said in str(refused.value) and "\n" not in str(refused.value)


def test_an_unknown_argument_is_refused_unless_it_may_be_that_of_an_including_file(
    monkeypatch, tmp_path
):
    monkeypatch.setattr(sys, "argv", ["ros2", "launch", "my_lab", "lab.launch.py"])
    assert executables(built(BENCHES["wire_bench"], monkeypatch, lamp="on"))
    monkeypatch.setattr(sys, "argv", ["ros2", "launch", "sma_bench", "wire_bench.launch.py"])
    with pytest.raises(InputError, match="unknown argument lamp"):
        built(BENCHES["wire_bench"], monkeypatch, lamp="on")
    # What the rig's file says of its camera stays.
    rig = tmp_path / "rig.yaml"
    rig.write_text(
        "/**: {ros__parameters: {image_width: 200, regions: ['5 5 100 50 x'],"
        " read_cold_wires: false}}\n"
    )
    nodes = {n.executable: n for n in plan_bench(WIRE, {"params": str(rig), "camera": "true"})}
    assert nodes["synthetic_camera"].parameters["image_width"] == 200
    assert not {"image_width", "regions", "read_cold_wires"} & set(nodes["ir_camera"].parameters)


def test_the_planned_nodes_work_together_until_the_camera_freezes(bench, tmp_path):
    """A simulated wire before the synthetic camera, started as the launch file would."""
    power, read, states = bench.hear("wire/power", "wire/temperature", "experiment/state")
    protocol = tmp_path / "hold.yaml"
    protocol.write_text("steps: [{kind: hold, level: 3.0, duration: 60.0}]\n")
    given = {"camera": "true", "record": "false", "protocol": str(protocol)}
    for planned in plan_bench(WIRE, given):
        if planned.executable == "identification":
            continue
        parameters = {k.replace(".", "__"): v for k, v in planned.parameters.items()}
        bench.start(
            planned.executable, planned.file, remap=dict(planned.remappings), **parameters
        )
    bench.until(lambda: states and states[-1].data == "idle" and len(read) > 20, PATIENCE)
    bench.until(lambda: bench.trigger("experiment/start").success, PATIENCE)
    bench.until(lambda: power and power[-1].voltage > 0.2, PATIENCE)
    # The camera's readings carry their uncertainty; the simulator's own have none.
    assert read[-1].variance > 0.0
    assert bench.set_parameter("synthetic_camera", "fault", "frozen").successful
    bench.until(lambda: "stale feedback" in states[-1].data, PATIENCE)
    assert "temperature" in states[-1].data
    bench.until(lambda: power[-1].voltage < 0.1, PATIENCE)


def test_the_beam_is_described_when_asked(monkeypatch, tmp_path):
    installed = tmp_path / "share/ament_index/resource_index/packages/robot_state_publisher"
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path))
    with pytest.raises(InputError, match="apt install ros-jazzy-robot-state-publisher"):
        built(BENCHES["composite_bench"], monkeypatch, description="true")
    installed.parent.mkdir(parents=True)
    installed.touch()
    actions = built(BENCHES["composite_bench"], monkeypatch, description="true")
    described = node(actions, "robot_state_publisher")
    assert described.package == "robot_state_publisher" and described.namespace == "bench"
    assert "<robot" in own(actions, "robot_state_publisher")["robot_description"]
    assert described.on_exit is None
    assert "description" not in WIRE.arguments


@pytest.mark.parametrize("rig", ["wire_rig", "composite_rig"])
def test_a_rig_file_carries_table_i_and_is_of_doubles_to_ros(rig):
    parameters = read_parameters(ROOT / "config" / f"{rig}.yaml")
    defaults = Parameters.defaults()
    different = {name for name in defaults if parameters[name] != defaults[name]}
    assert different <= {"bench.channels", "bench.channel_sides"}
    assert {"wire.resistance", "wire.specific_heat"} <= parameters.given
    body = yaml.safe_load((ROOT / "config" / f"{rig}.yaml").read_text())["/**"]["ros__parameters"]
    numbers = [value for group in body.values() for value in group.values()]
    assert all(isinstance(value, (float, list)) for value in numbers)


@pytest.fixture
def bag(tmp_path):
    time = np.arange(0.0, 2.0, 0.05)
    quantities = (("voltage", "V"), ("current", "A"), ("temperature", "K"))
    signals = [Signal(f"wire.{q}", u, time, np.full_like(time, 300.0)) for q, u in quantities]
    path = tmp_path / "bag"
    write_record(path, [*signals, Signal("voltage_command", "V", time, np.ones((len(time), 1)))])
    return path


def played(**given):
    """Command of the player, its topics and where they go, and the nodes beside it."""
    command, nodes = plan_replay(given)
    topics = command[command.index("--topics") + 1 : command.index("--remap")]
    pairs = command[command.index("--remap") + 1 :]
    return command, topics, dict(pair.split(":=") for pair in pairs), nodes


def test_a_record_is_played_below_the_namespace_and_its_commands_never_reach_a_bench(bag):
    command, topics, moved, nodes = played(bag=str(bag), rate="2")
    assert command[:4] == ["ros2", "bag", "play", str(bag)]
    assert command[command.index("--rate") + 1] == "2"
    assert "--loop" not in command and nodes == [] and set(topics) == set(moved)
    assert {"/replay/wire/power", "/replay/wire/temperature"} <= set(moved.values())
    _, _, moved, _ = played(bag=str(bag), namespace="bench")
    commands = {moved[topic] for topic in moved if topic.endswith("voltage_command")}
    assert commands == {"/bench/replayed/voltage_command"}
    assert sorted(played(bag=str(next(bag.glob("*.mcap"))))[1]) == sorted(topics)


def test_twin_camera_and_services_run_beside_a_record_on_its_clock(bag, monkeypatch):
    _, _, _, (twin,) = played(bag=str(bag), twin="true", params="lab.yaml")
    assert (twin.executable, twin.file, twin.vital) == ("twin", "lab.yaml", False)
    assert twin.parameters == {"use_sim_time": True}
    command, _, moved, (camera,) = played(bag=str(bag), camera="true", loop="true")
    assert "/replay/replayed/wire/temperature" in moved.values() and "--loop" in command
    assert camera.executable == "ir_camera" and camera.parameters["use_sim_time"] is True
    nodes = played(bag=str(bag), nodes="diagnosis, identification")[3]
    assert [n.executable for n in nodes] == ["diagnosis", "identification"]
    actions = built(ROOT / "launch" / "replay.launch.py", monkeypatch, bag=str(bag), twin="true")
    (player,) = [a.given for a in actions if isinstance(a, ExecuteProcess)]
    assert executables(actions) == ["twin"] and isinstance(player.on_exit, Shutdown)
    assert player.cmd[:3] == ["ros2", "bag", "play"]


@pytest.mark.parametrize(
    ("changed", "said"),
    [({"bag": ""}, "expected a record"), ({"bag": "nothing"}, "nothing"),
     ({"rate": "-1"}, "rate is '-1'"), ({}, "list of topics"),
     ({"nodes": "experiment"}, "'experiment', expected identification, diagnosis")],
)  # fmt: skip
def test_what_cannot_be_played_is_one_line(changed, said, bag):
    if not changed:
        (bag / "metadata.yaml").write_text("rosbag2_bagfile_information: {}\n")
    with pytest.raises(InputError) as refused:
        plan_replay({"bag": str(bag), **changed})
    assert said in str(refused.value) and "\n" not in str(refused.value)


BEAM_RIG = Parameters({
    "bench.channels": ("front_1", "front_2", "back_1", "back_2"),
    "bench.channel_sides": ("front", "front", "back", "back"),
})  # fmt: skip


@pytest.fixture(scope="module")
def beam():
    return Xml.fromstring(beam_urdf(BEAM_RIG))


def joint(beam, name):
    return next(j for j in beam.findall("joint") if j.get("name") == name)


def numbers(element, attribute):
    return [float(word) for word in element.get(attribute).split()]


def test_the_beam_is_a_tree_of_known_links_with_every_frame_of_the_messages(beam):
    links = [link.get("name") for link in beam.findall("link")]
    parents = {j.find("parent").get("link") for j in beam.findall("joint")}
    children = [j.find("child").get("link") for j in beam.findall("joint")]
    assert parents <= set(links) and sorted([*children, "clamp"]) == sorted(set(links))
    assert {"front_range", "back_range", *BEAM_RIG["bench.channels"]} <= set(links)
    front = joint(beam, "front_range_mount").find("origin")
    assert numbers(front, "xyz")[0] > 0.0
    # It looks back along -x: half a turn about z.
    assert numbers(front, "rpy")[2] == pytest.approx(math.pi)
    defined = {material.get("name") for material in beam.findall("material")}
    assert {m.get("name") for m in beam.iter("material")} == defined
    tip = joint(beam, "tip")
    assert tip.get("type") == "prismatic"
    assert numbers(tip.find("axis"), "xyz") == [1.0, 0.0, 0.0]
    assert numbers(tip.find("origin"), "xyz") == [0.0, 0.0, BEAM_RIG["composite.length"]]
    limit = tip.find("limit")
    assert float(limit.get("lower")) < -0.05 and float(limit.get("upper")) > 0.05
    piece = next(link for link in beam.findall("link") if link.get("name") == "beam_1")
    places = [
        numbers(visual.find("origin"), "xyz")[0] for visual in piece.findall("visual")
        if visual.find("material").get("name") == "nitinol"
    ]
    offset = BEAM_RIG["composite.wire_offset"]
    assert sorted(places) == pytest.approx([-offset, -offset, offset, offset])


@pytest.mark.parametrize("deflection", [-0.01, 0.0, 1e-4, 0.02])
def test_the_beam_ends_where_the_tip_is(beam, deflection):
    x = z = angle = 0.0
    for k in range(1, PIECES + 1):
        bend = joint(beam, f"bend_{k}")
        assert numbers(bend.find("axis"), "xyz") == [0.0, 1.0, 0.0]
        along = numbers(bend.find("origin"), "xyz")[2]
        x, z = x + along * math.sin(angle), z + along * math.cos(angle)
        mimic = bend.find("mimic")
        assert mimic.get("joint") == "tip" and float(mimic.get("offset")) == 0.0
        angle += float(mimic.get("multiplier")) * deflection
    length = BEAM_RIG["composite.length"]
    x, z = x + length / PIECES * math.sin(angle), z + length / PIECES * math.cos(angle)
    assert x == pytest.approx(deflection, rel=0.02)
    # Eq. (16), constant curvature: delta = l angle / 2, here up to the half piece at the clamp.
    assert angle == pytest.approx(2.0 * deflection / length, rel=0.05)
    assert 0.95 * length < z <= length * (1.0 + 1e-12)
