"""Launch and parameter files: what they start and refuse, and the beam that RViz shows.

A stand-in of the few classes of ROS's `launch` keeps what it is given, and starts nothing.
"""

import math
import runpy
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from xml.etree import ElementTree as Xml

import numpy as np
import pytest

from sma_bench.errors import InputError
from sma_bench.nodes import bench_plan
from sma_bench.nodes.arguments import check_arguments
from sma_bench.nodes.bench_plan import COMPOSITE, PIECES, WIRE, plan_bench, plan_replay
from sma_bench.parameters import read_parameters
from sma_bench.parameters.node_tables import NODE_TABLES
from sma_bench.parameters.parameters import load_kind
from sma_bench.protocols import load_protocol
from sma_bench.records import Signal
from sma_bench.records.bag_writer import write_record
from sma_bench.ros.processes import PROFILE, RANGE, USERS_VARIABLES

ROOT = Path(__file__).resolve().parents[2]
RIGS = {
    f"{name}_bench": getattr(bench_plan, name.upper())
    for name in ("wire", "composite", "weight", "spring", "antagonist")
}
REST = ["experiment", "recorder", "identification"]
LAUNCH = {
    "launch": ("LaunchDescription", "LaunchContext"),
    "launch.actions": ("DeclareLaunchArgument", "OpaqueFunction", "ExecuteProcess", "Shutdown"),
    "launch_ros": (),
    "launch_ros.actions": ("Node",),
    "launch_ros.parameter_descriptions": ("ParameterValue",),
}


class Recorded:
    """An action with the arguments that it was made with."""

    def __init__(self, *args, **kwargs):
        self.args, self.given = args, SimpleNamespace(**kwargs)


KINDS = {name: type(name, (Recorded,), {}) for names in LAUNCH.values() for name in names}


@pytest.fixture
def built(monkeypatch):
    """What a launch file would start with some arguments."""
    ours = "sma_bench.nodes.bench_launch"
    for module, names in LAUNCH.items():
        made = ModuleType(module)
        vars(made).update({name: KINDS[name] for name in names})
        monkeypatch.setitem(sys.modules, module, made)
    monkeypatch.setitem(sys.modules, ours, None)

    def build(name, **arguments):
        sys.modules.pop(ours)
        file = runpy.run_path(str(ROOT / "launch" / f"{name}.launch.py"))
        (entities,) = file["generate_launch_description"]().args
        *declared, start = entities
        defaults = {one.args[0]: one.given.default_value for one in declared}
        context = SimpleNamespace(launch_configurations=defaults | arguments)
        return start.given.function(context)

    return build


def node(actions, executable):
    (found,) = [a.given for a in actions if getattr(a.given, "executable", "") == executable]
    return found


def own(actions, executable):
    """Parameters over the rig's file, with texts unpacked."""
    found = node(actions, executable).parameters[-1]
    return {k: v.args[0] if isinstance(v, Recorded) else v for k, v in found.items()}


def test_every_launch_file_simulates_its_rig_with_a_protocol_that_fits_it(built):
    names = {path.name for path in (ROOT / "launch").glob("*.py")}
    assert names == {f"{name}.launch.py" for name in (*RIGS, "replay")}
    for name, rig in RIGS.items():
        actions = built(name)
        assert [action.given.executable for action in actions] == ["simulator", *REST]
        file = ROOT / "config" / rig.file
        for action in actions:
            assert (action.given.package, action.given.namespace) == ("sma_bench", "bench")
            assert action.given.parameters[0] == str(file)
        parameters = read_parameters(file)
        kind = load_kind(parameters)
        if rig not in (WIRE, COMPOSITE):
            assert name.startswith({"force": "weight"}.get(kind, kind))
        assert load_protocol(rig.protocol, parameters).channels == parameters["bench.channels"]


SIMULATED = ["simulator", "experiment", "recorder"]
NODES = {  # of arguments
    "record:=false": ["simulator", "experiment", "identification"],
    "camera:=true": ["simulator", "synthetic_camera", "ir_camera", *REST],
    "nodes:=identification,diagnosis": [*SIMULATED, "identification", "diagnosis"],
    "nodes:=none": SIMULATED,
    "twin:=true": [*SIMULATED, "twin", "identification"],
    "nodes:=investigation": ["simulator", "experiment", "investigation"],
    "mode:=hardware": ["serial_bridge", "ir_camera", *REST],
    "mode:=hardware camera:=false": ["serial_bridge", *REST],
}


@pytest.mark.parametrize("rig", [WIRE, COMPOSITE], ids=["wire", "composite"])
@pytest.mark.parametrize("words", NODES)
def test_a_bench_is_what_its_arguments_say_and_every_node_knows_its_parameters(rig, words):
    expected = NODES[words]
    arguments = dict(word.split(":=") for word in words.split())
    nodes = plan_bench(rig, arguments)
    assert [planned.executable for planned in nodes] == expected
    for planned in nodes:
        known = {p.name for p in NODE_TABLES[planned.executable]} | {"use_sim_time"}
        assert set(planned.parameters) <= known
        check_arguments(planned.executable, ["--ros-args", "--params-file", planned.file])
    # The end of one that holds the outputs ends the bench.
    vital = {planned.executable for planned in nodes if planned.vital}
    beside = {"recorder", "twin", "identification", "diagnosis", "investigation"}
    assert vital == set(expected) - beside


def test_arguments_reach_the_nodes_and_a_camera_takes_the_place_of_true_temperatures(
    built, monkeypatch
):
    for variable in USERS_VARIABLES:
        monkeypatch.delenv(variable, raising=False)
    actions = built(
        "wire_bench", protocol="ramp", speed="10", output="20261121", autostart="True",
        namespace="lab", twin="true",
    )  # fmt: skip
    assert own(actions, "simulator") == {"speed": 10.0}
    assert own(actions, "experiment") == {
        "protocol": "ramp", "autostart": True, "use_sim_time": True, "require_recorder": True
    }
    assert own(actions, "recorder") == {"output": "20261121", "use_sim_time": True}
    # Else launch_ros reads a number where the node wants a text.
    assert isinstance(node(actions, "recorder").parameters[-1]["output"], KINDS["ParameterValue"])
    assert {action.given.namespace for action in actions} == {"lab"}
    assert isinstance(node(actions, "simulator").on_exit, KINDS["Shutdown"])
    assert node(actions, "recorder").on_exit is None
    for network, expected in (("false", "SYSTEM_DEFAULT"), ("true", "SUBNET")):
        actions = built("composite_bench", camera="true", network=network)
        for action in actions:
            variables = action.given.additional_env
            assert (variables[RANGE], PROFILE in variables) == (expected, network == "false")
    moved = dict(node(actions, "simulator").remappings)
    channels = read_parameters(ROOT / "config" / COMPOSITE.file)["bench.channels"]
    assert moved == {f"{c}/temperature": f"{c}/true_temperature" for c in channels}
    exact = {"sensor.temperature_noise": 0.0, "sensor.temperature_resolution": 0.0}
    assert exact.items() <= own(actions, "simulator").items()
    reader, pictures = own(actions, "ir_camera"), own(actions, "synthetic_camera")
    assert reader["read_cold_wires"] is True and len(reader["regions"]) == len(channels)
    for name in ("image_width", "image_height", "pixel_size"):
        assert reader[name] == pictures[name]


@pytest.fixture
def bag(tmp_path):
    time = np.arange(0.0, 2.0, 0.05)
    quantities = (("voltage", "V"), ("current", "A"), ("temperature", "K"))
    signals = [Signal(f"wire.{q}", u, time, np.full_like(time, 300.0)) for q, u in quantities]
    path = tmp_path / "bag"
    write_record(path, [*signals, Signal("voltage_command", "V", time, np.ones((len(time), 1)))])
    return path


REFUSED = {
    "speed:=fast": "speed is 'fast'",
    "speed:=10 mode:=hardware": "expected 1.0",
    "mode:=hardware autostart:=true": "enabled by hand",
    "mode:=real": "mode is 'real'",
    "mode:=emulated": "./bench check hardware",
    "record:=yes": "record is 'yes'",
    "nodes:=twin": "nodes: 'twin'",
    "camera:=true params:=none.yaml": "none.yaml",
    "protocol:=stairs": "protocol stairs: not one of",
    "protocl:=ramp": "unknown argument protocl, did you mean protocol?",
    "managed:=true": "they start active",
    "bag:=": "expected a record",
    "bag:=nothing": "nothing",
    "bag:=bag rate:=-1": "rate is '-1'",
    "bag:=bag nodes:=experiment": "'experiment', expected identification, diagnosis",
    "bag:=bag": "list of topics",
}


@pytest.mark.parametrize("words", REFUSED)
def test_what_cannot_be_started_or_played_is_one_line(words, bag, monkeypatch):
    changed, said = dict(word.split(":=") for word in words.split()), REFUSED[words]
    monkeypatch.chdir(bag.parent)
    if said == "list of topics":
        (bag / "metadata.yaml").write_text("rosbag2_bagfile_information: {}\n")
    with pytest.raises(InputError) as refused:
        plan_replay(changed) if "bag" in changed else plan_bench(WIRE, changed)
    assert said in str(refused.value) and "\n" not in str(refused.value)


def test_an_unknown_argument_is_refused_unless_it_may_be_that_of_an_including_file(
    built, monkeypatch
):
    monkeypatch.setattr(sys, "argv", ["ros2", "launch", "my_lab", "lab.launch.py"])
    assert built("wire_bench", lamp="on")
    monkeypatch.setattr(sys, "argv", ["ros2", "launch", "sma_bench", "wire_bench.launch.py"])
    with pytest.raises(InputError, match="unknown argument lamp"):
        built("wire_bench", lamp="on")


def played(**given):
    """Command of the player, where it moves its topics, and the nodes beside it."""
    command, nodes = plan_replay(given)
    topics = command[command.index("--topics") + 1 : command.index("--remap")]
    moved = dict(pair.split(":=") for pair in command[command.index("--remap") + 1 :])
    assert sorted(topics) == sorted(moved)
    return command, moved, nodes


def test_a_record_is_played_below_the_namespace_and_its_commands_never_reach_a_bench(bag, built):
    command, moved, nodes = played(bag=str(bag), rate="2")
    assert command[:4] == ["ros2", "bag", "play", str(bag)]
    assert command[command.index("--rate") + 1] == "2"
    assert "--loop" not in command and nodes == []
    assert {"/replay/wire/power", "/replay/wire/temperature"} <= set(moved.values())
    assert played(bag=str(next(bag.glob("*.mcap"))))[1] == moved
    _, moved, _ = played(bag=str(bag), namespace="bench")
    commands = {moved[topic] for topic in moved if topic.endswith("voltage_command")}
    assert commands == {"/bench/replayed/voltage_command"}
    # Beside it on its clock: the twin, the camera's reader and the services.
    _, _, (twin,) = played(bag=str(bag), twin="true", params="lab.yaml")
    assert (twin.executable, twin.file, twin.vital) == ("twin", "lab.yaml", False)
    assert twin.parameters == {"use_sim_time": True}
    command, moved, (camera,) = played(bag=str(bag), camera="true", loop="true")
    assert "/replay/replayed/wire/temperature" in moved.values() and "--loop" in command
    assert camera.executable == "ir_camera" and camera.parameters["use_sim_time"] is True
    _, _, services = played(bag=str(bag), nodes="diagnosis, identification")
    assert [n.executable for n in services] == ["diagnosis", "identification"]
    twin, player = built("replay", bag=str(bag), twin="true")
    assert twin.given.executable == "twin"
    assert isinstance(player.given.on_exit, KINDS["Shutdown"])
    assert player.given.cmd[:3] == ["ros2", "bag", "play"]


def test_the_beam_is_described_when_asked_with_the_frames_of_the_messages_and_ends_at_the_tip(
    built, monkeypatch, tmp_path
):
    installed = tmp_path / "share/ament_index/resource_index/packages/robot_state_publisher"
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path))
    with pytest.raises(InputError, match="apt install ros-jazzy-robot-state-publisher"):
        built("composite_bench", description="true")
    installed.parent.mkdir(parents=True)
    installed.touch()
    actions = built("composite_bench", description="true")
    described = node(actions, "robot_state_publisher")
    assert described.package == "robot_state_publisher" and described.on_exit is None
    beam = Xml.fromstring(own(actions, "robot_state_publisher")["robot_description"])
    joints = {found.get("name"): found for found in beam.findall("joint")}
    rig = read_parameters(ROOT / "config" / COMPOSITE.file)
    length = rig["composite.length"]

    def numbers(joint, element, attribute):
        return [float(word) for word in joints[joint].find(element).get(attribute).split()]

    links = [link.get("name") for link in beam.findall("link")]
    children = [joint.find("child").get("link") for joint in joints.values()]
    assert {joint.find("parent").get("link") for joint in joints.values()} <= set(links)
    assert sorted([*children, "clamp"]) == sorted(set(links))
    assert {"front_range", "back_range", *rig["bench.channels"]} <= set(links)
    assert numbers("front_range_mount", "origin", "xyz")[0] > 0.0
    assert numbers("front_range_mount", "origin", "rpy")[2] == pytest.approx(math.pi)  # looks back
    assert joints["tip"].get("type") == "prismatic"
    assert numbers("tip", "axis", "xyz") == [1.0, 0.0, 0.0]
    assert numbers("tip", "origin", "xyz") == [0.0, 0.0, length]
    for deflection in (-0.01, 0.0, 1e-4, 0.02):
        x = z = angle = 0.0
        for k in range(1, PIECES + 1):
            assert numbers(f"bend_{k}", "axis", "xyz") == [0.0, 1.0, 0.0]
            along = numbers(f"bend_{k}", "origin", "xyz")[2]
            x, z = x + along * math.sin(angle), z + along * math.cos(angle)
            mimic = joints[f"bend_{k}"].find("mimic")
            assert mimic.get("joint") == "tip" and float(mimic.get("offset")) == 0.0
            angle += float(mimic.get("multiplier")) * deflection
        x, z = x + length / PIECES * math.sin(angle), z + length / PIECES * math.cos(angle)
        assert x == pytest.approx(deflection, rel=0.02)
        # Eq. (16), constant curvature: delta = l angle / 2, but for the half piece at the clamp.
        assert angle == pytest.approx(2.0 * deflection / length, rel=0.05)
        assert 0.95 * length < z <= length * (1.0 + 1e-12)
