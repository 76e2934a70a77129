"""Launch files, parameter files and command lines of nodes: what they start and refuse, and the
beam that RViz shows.

Fakes of the few classes of ROS's `launch` store their arguments and start nothing.
"""

import re
import runpy
import sys
from itertools import pairwise
from pathlib import Path
from types import ModuleType, SimpleNamespace
from xml.etree import ElementTree as Xml

import numpy as np
import pytest
import yaml

from sma_bench.errors import InputError
from sma_bench.nodes import bench_plan
from sma_bench.nodes.bench_plan import COMPOSITE, PIECES, WIRE, plan_bench, plan_replay
from sma_bench.nodes.start import check_arguments, contained, start
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
CASES = yaml.safe_load(Path(__file__).with_name("launch.yaml").read_text())
LAUNCH = CASES["imported"]


class Recorded:
    """An action that stores its arguments."""

    def __init__(self, *args, **kwargs):
        self.args, self.given = args, SimpleNamespace(**kwargs)


KINDS = {name: type(name, (Recorded,), {}) for name in " ".join(LAUNCH.values()).split()}


@pytest.fixture
def built(monkeypatch):
    """What a launch file would start with some arguments."""
    for module, names in LAUNCH.items():
        made = ModuleType(module)
        vars(made).update({name: KINDS[name] for name in names.split()})
        monkeypatch.setitem(sys.modules, module, made)

    def build(name, **arguments):
        file = runpy.run_path(str(ROOT / "launch" / f"{name}.launch.py"))
        *declared, start = file["generate_launch_description"]().args[0]
        defaults = {one.args[0]: one.given.default_value for one in declared}
        context = SimpleNamespace(launch_configurations=defaults | arguments)
        return start.given.function(context)

    return build


def node(actions, executable):
    (found,) = [a.given for a in actions if getattr(a.given, "executable", "") == executable]
    return found


def own(actions, executable):
    """Parameters that override the rig's file, as plain values."""
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


@pytest.mark.parametrize("rig", [WIRE, COMPOSITE], ids=["wire", "composite"])
@pytest.mark.parametrize("words", CASES["nodes"])
def test_arguments_choose_the_nodes_of_a_bench_and_every_node_knows_its_parameters(rig, words):
    expected = CASES["nodes"][words].replace("rest", " ".join(REST)).split()
    arguments = dict(word.split(":=") for word in words.split())
    nodes = plan_bench(rig, arguments)
    assert [planned.executable for planned in nodes] == expected
    for planned in nodes:
        known = {p.name for p in NODE_TABLES[planned.executable]} | {"use_sim_time"}
        assert set(planned.parameters) <= known
        check_arguments(planned.executable, ["--ros-args", "--params-file", planned.file])
    # When a node that drives ends, the bench ends.
    vital = {planned.executable for planned in nodes if planned.vital}
    beside = {"recorder", "twin", "identification", "diagnosis", "investigation"}
    assert vital == set(expected) - beside


def test_arguments_reach_the_nodes_and_a_camera_takes_the_place_of_true_temperatures(
    built, monkeypatch
):
    for variable in USERS_VARIABLES:
        monkeypatch.delenv(variable, raising=False)
    actions = built("wire_bench", protocol="ramp", speed="10", output="20261121", autostart="True",
                    namespace="lab", twin="true")  # fmt: skip
    assert own(actions, "simulator") == {"speed": 10.0}
    assert own(actions, "experiment") == {
        "protocol": "ramp", "autostart": True, "use_sim_time": True, "require_recorder": True
    }  # fmt: skip
    assert own(actions, "recorder") == {"output": "20261121", "use_sim_time": True}
    # Otherwise launch_ros reads a number for a text parameter.
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


def test_the_same_bench_in_one_process_has_the_same_nodes_with_the_same_arguments(built):
    given = {"camera": "true", "twin": "true", "namespace": "lab", "nodes": "diagnosis"}
    (one,) = built("composite_bench", container="true", **given)
    assert (one.given.executable, one.given.name, one.given.namespace) == ("bench", None, "lab")
    assert one.given.parameters == [str(ROOT / "config" / COMPOSITE.file)]
    assert isinstance(one.given.on_exit, KINDS["Shutdown"])
    nodes, _ = contained([*one.given.arguments, "--ros-args"])
    planned = plan_bench(COMPOSITE, given)
    assert [*nodes] == [node.executable for node in planned]
    for node in planned:
        words = nodes[node.executable]
        taken = check_arguments(node.executable, words)
        assert taken.keys() == node.parameters.keys() - {"use_sim_time"}
        moved = {f"{old}:={new}" for old, new in node.remappings.items()}
        assert {w for option, w in pairwise(words) if option == "-r"} == moved


@pytest.fixture
def bag(tmp_path):
    time = np.arange(0.0, 2.0, 0.05)
    quantities = (("voltage", "V"), ("current", "A"), ("temperature", "K"))
    signals = [Signal(f"wire.{q}", u, time, np.full_like(time, 300.0)) for q, u in quantities]
    path = tmp_path / "bag"
    write_record(path, [*signals, Signal("voltage_command", "V", time, np.ones((len(time), 1)))])
    return path


@pytest.mark.parametrize("words", CASES["refused"])
def test_a_bench_or_replay_that_cannot_start_is_refused_in_one_line(words, bag, monkeypatch):
    changed, said = dict(word.split(":=") for word in words.split()), CASES["refused"][words]
    monkeypatch.chdir(bag.parent)
    with pytest.raises(InputError, match=f"^[^\n]*{re.escape(said)}[^\n]*$"):
        plan_replay(changed) if "bag" in changed else plan_bench(WIRE, changed)


def test_a_bad_protocol_or_argument_is_refused_unless_it_may_be_that_of_an_including_file(
    built, monkeypatch
):
    for name in RIGS:
        with pytest.raises(InputError, match="protocol bogus: not one of"):
            built(name, protocol="bogus", autostart="true")
    monkeypatch.setattr(sys, "argv", ["ros2", "launch", "my_lab", "lab.launch.py"])
    assert built("wire_bench", lamp="on")
    monkeypatch.setattr(sys, "argv", ["ros2", "launch", "sma_bench", "wire_bench.launch.py"])
    with pytest.raises(InputError, match="unknown argument lamp"):
        built("wire_bench", lamp="on")


def played(**given):
    """The player's command, its topic remappings, and the nodes that run with it."""
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
    # Beside it, on its clock: the twin, `ir_camera` and the services.
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

    links = {link.get("name") for link in beam.findall("link")}
    children = [joint.find("child").get("link") for joint in joints.values()]
    assert {joint.find("parent").get("link") for joint in joints.values()} <= links
    assert sorted([*children, "clamp"]) == sorted(links)
    assert {"front_range", "back_range", *rig["bench.channels"]} <= links
    assert joints["tip"].get("type") == "prismatic"
    assert numbers("tip", "axis", "xyz") == [1.0, 0.0, 0.0]
    bends = [f"bend_{k}" for k in range(1, PIECES + 1)]
    mimics = [joints[bend].find("mimic") for bend in bends]
    assert {m.get("joint") for m in mimics} == {"tip"}
    along = [numbers(bend, "origin", "xyz")[2] for bend in bends] + [length / PIECES]
    turns = np.cumsum([0.0, *(float(m.get("multiplier")) for m in mimics)])  # rad a metre
    for deflection in (-0.01, 0.0, 1e-4, 0.02):
        assert along @ np.sin(turns * deflection) == pytest.approx(deflection, rel=0.02)
        # Eq. (16), constant curvature: delta = l angle / 2, but for the half piece at the clamp.
        assert turns[-1] * deflection == pytest.approx(2.0 * deflection / length, rel=0.05)


# --- Command lines of nodes, checked before ROS starts.


@pytest.fixture
def given(tmp_path):
    """Arguments with a parameter file."""

    def given(text, *more):
        path = tmp_path / "rig.yaml"
        path.write_text(f"/**:\n  ros__parameters:\n    {text}\n")
        return ["--ros-args", "--params-file", str(path), *more]

    return given


SLIPS = CASES["parameters"]


@pytest.mark.parametrize("text", SLIPS)
def test_a_slip_in_a_parameter_file_is_one_line_with_the_file(given, text):
    with pytest.raises(InputError, match=f"^[^\n]*rig.yaml[^\n]*{re.escape(SLIPS[text])}[^\n]*$"):
        check_arguments("simulator", given(text))


def test_a_node_reads_its_own_section_and_later_sources_win(given):
    others = "wire.resistance: 2.0\n/**/experiment:\n  ros__parameters: {speeed: 1}"
    check_arguments("simulator", given(others))
    as_launch_writes = "feedback: !!python/tuple [power]"
    check_arguments("experiment", given(as_launch_writes))
    two = given("bench: {channels: [a, b], channel_sides: [front, back]}")
    check_arguments("simulator", [*two, "-p", "bench.channel_sides:=[back, front]"])
    of_others = "use_sim_time: true\n    protocol: ramp"
    sources = check_arguments("simulator", given(of_others, "-p", "wire.resistance:=3.0"))
    assert sources == {"wire.resistance": "-p"}
    for arguments, said in (
        (given(others, "-p", "wire.resistance:=-1.0"), "wire.resistance is -1"),
        (["--ros-args", "-p", "bench.chanels:=[a]"], "unknown parameter bench.chanels"),
        # ROS would ignore these.
        (["--ros-args", "-p", "gain:=2"], "unknown parameter gain"),
        (["--ros-args", "-p", "wires:=['']"], "-p: unknown parameter wires"),  # another node's
        (["--ros-args", "-r", "__ns:=/bench", "--", "x"], "unknown argument 'x'"),
        (["speed:=2.0"], "after --ros-args"),
        (["--ros-args", "--params-file", "none.yaml"], "none.yaml: cannot read"),
    ):
        with pytest.raises(InputError, match=said):
            check_arguments("simulator", arguments)


@pytest.mark.parametrize(("text", "said"), CASES["sections"])
def test_a_parameter_file_is_obeyed_or_refused(tmp_path, text, said):
    path = tmp_path / "limits.yaml"
    path.write_text(text)
    given = ["--ros-args", "-r", "__ns:=/bench", "--params-file", str(path)]
    if not said:
        assert check_arguments("serial_bridge", given) == {"bench.maximum_voltage": str(path)}
        return
    with pytest.raises(InputError, match=f"^[^\n]*limits.yaml: [^\n]*{said}[^\n]*$"):
        check_arguments("serial_bridge", given)


@pytest.mark.parametrize("node", sorted(NODE_TABLES))
def test_help_ends_at_once_and_lists_the_nodes_own_parameters(node, capsys):
    assert start(node, ["--help"]) == 0
    printed = capsys.readouterr().out
    assert printed.startswith(f"usage: {node} ")
    assert [p.name for p in NODE_TABLES[node] if f"  {p.name} " not in printed] == []
