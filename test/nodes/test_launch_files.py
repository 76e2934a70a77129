"""Launch and parameter files: they are valid, and the launch files start what they should.

`launch` is not among the wheels: without it, `launch_stand_in` stands in for its classes.
"""

import os
import signal
import sys
import threading
from pathlib import Path

import pytest
from launch_stand_in import INSTALLED, Node, Shutdown, Text, built
from sensor_msgs.msg import BatteryState, Temperature
from std_msgs.msg import String

from sma_bench.errors import InputError
from sma_bench.nodes.arguments import check_arguments
from sma_bench.nodes.bench_plan import ANTAGONIST, COMPOSITE, SPRING, WEIGHT, WIRE, plan_bench
from sma_bench.parameters import Parameters, read_parameters
from sma_bench.parameters.node_tables import NODE_TABLES
from sma_bench.parameters.parameters import load_kind
from sma_bench.protocols import load_protocol
from sma_bench.ros.processes import PROFILE, RANGE, USERS_VARIABLES

ROOT = Path(__file__).resolve().parents[2]
RIGS = {"wire_bench": WIRE, "composite_bench": COMPOSITE}
LOADS = {"weight_bench": WEIGHT, "spring_bench": SPRING, "antagonist_bench": ANTAGONIST}
BENCHES = {name: ROOT / "launch" / f"{name}.launch.py" for name in RIGS}
REST = ["experiment", "recorder", "identification"]
CAMERA = ["synthetic_camera", "ir_camera"]
PATIENCE = 60.0


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
    assert names == {f"{name}.launch.py" for name in (*RIGS, *LOADS, "replay")}


@pytest.mark.parametrize("name", LOADS)
def test_the_launch_file_of_a_load_simulates_its_rig(name, monkeypatch):
    actions = built(ROOT / "launch" / f"{name}.launch.py", monkeypatch)
    assert executables(actions) == ["simulator", *REST]
    rig = str(ROOT / "config" / LOADS[name].file)
    assert node(actions, "simulator").parameters[0] == rig
    assert name.startswith({"force": "weight"}.get(kind := load_kind(read_parameters(rig)), kind))


@pytest.mark.parametrize("rig", [*RIGS.values(), *LOADS.values()], ids=[*RIGS, *LOADS])
def test_a_rig_names_an_existing_file_and_a_protocol_that_fits_it(rig):
    parameters = read_parameters(ROOT / "config" / rig.file)
    assert rig.arguments["params"].default == str(ROOT / "config" / rig.file)
    assert load_protocol(rig.protocol, parameters).channels == parameters["bench.channels"]


@pytest.mark.parametrize("name", BENCHES)
@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        ({}, ["simulator", *REST]),
        ({"record": "false"}, ["simulator", "experiment", "identification"]),
        ({"camera": "true"}, ["simulator", *CAMERA, *REST]),
        ({"nodes": "identification,diagnosis"}, ["simulator", *REST, "diagnosis"]),
        ({"nodes": "", "record": "false"}, ["simulator", "experiment"]),
        ({"nodes": "none"}, ["simulator", "experiment", "recorder"]),
        ({"twin": "true"}, ["simulator", "experiment", "recorder", "twin", "identification"]),
        ({"nodes": "investigation"}, ["simulator", "experiment", "investigation"]),
        ({"mode": "hardware"}, ["serial_bridge", "ir_camera", *REST]),
        ({"mode": "hardware", "camera": "false"}, ["serial_bridge", *REST]),
    ],
)
def test_a_launch_file_starts_what_its_arguments_say(name, arguments, expected, monkeypatch):
    actions = built(BENCHES[name], monkeypatch, **arguments)
    assert executables(actions) == expected
    rig = str(ROOT / "config" / RIGS[name].file)
    for action in actions:
        assert action.given.package == "sma_bench"
        assert action.given.namespace == "bench"
        assert action.given.parameters[0] == rig


def test_the_end_of_a_node_that_holds_the_outputs_ends_the_bench(monkeypatch):
    actions = built(BENCHES["composite_bench"], monkeypatch, camera="true")
    ending = {a.given.executable for a in actions if isinstance(a.given.on_exit, Shutdown)}
    assert ending == {"simulator", *CAMERA, "experiment"}
    hardware = built(BENCHES["wire_bench"], monkeypatch, mode="hardware")
    assert isinstance(node(hardware, "serial_bridge").on_exit, Shutdown)
    simulated = built(BENCHES["wire_bench"], monkeypatch)
    assert isinstance(node(simulated, "simulator").on_exit, Shutdown)
    assert node(simulated, "recorder").on_exit is None
    beside = built(BENCHES["composite_bench"], monkeypatch, twin="true", nodes="diagnosis")
    going_on = {a.given.executable for a in beside if a.given.on_exit is None}
    assert going_on == {"recorder", "twin", "diagnosis"}


def test_arguments_reach_the_nodes(monkeypatch):
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


@pytest.mark.parametrize("name", list(BENCHES))
def test_nodes_are_bound_to_this_machine_unless_the_network_is_asked_for(name, monkeypatch):
    for variable in USERS_VARIABLES:
        monkeypatch.delenv(variable, raising=False)
    for network, expected in (("false", "SYSTEM_DEFAULT"), ("true", "SUBNET")):
        actions = built(BENCHES[name], monkeypatch, network=network)
        given = [action.given.additional_env for action in actions]
        assert {variables[RANGE] for variables in given} == {expected}
        assert {PROFILE in variables for variables in given} == {network == "false"}


def test_a_synthetic_camera_takes_the_place_of_the_true_temperatures(monkeypatch):
    actions = built(BENCHES["composite_bench"], monkeypatch, camera="true")
    moved = dict(node(actions, "simulator").remappings)
    channels = read_parameters(ROOT / "config" / COMPOSITE.file)["bench.channels"]
    assert moved == {f"{c}/temperature": f"{c}/true_temperature" for c in channels}
    exact = {"sensor.temperature_noise": 0.0, "sensor.temperature_resolution": 0.0}
    assert exact.items() <= own(actions, "simulator").items()
    reader, pictures = own(actions, "ir_camera"), own(actions, "synthetic_camera")
    assert reader["read_cold_wires"] is True and len(reader["regions"]) == len(channels)
    alike = ("image_width", "image_height", "pixel_size")
    assert [reader[name] for name in alike] == [pictures[name] for name in alike]


def test_what_the_rig_file_says_of_its_camera_stays(tmp_path):
    rig = tmp_path / "rig.yaml"
    rig.write_text(
        "/**:\n  ros__parameters:\n    image_width: 200\n    regions: ['5 5 100 50 x']\n"
        "    read_cold_wires: false\n"
    )
    nodes = {n.executable: n for n in plan_bench(WIRE, {"params": str(rig), "camera": "true"})}
    assert nodes["synthetic_camera"].parameters["image_width"] == 200
    assert not {"image_width", "regions", "read_cold_wires"} & set(nodes["ir_camera"].parameters)


@pytest.mark.parametrize("rig", RIGS.values(), ids=RIGS)
@pytest.mark.parametrize("mode", ["simulated", "hardware"])
@pytest.mark.parametrize("camera", ["true", "false"])
def test_every_node_knows_its_parameters(rig, mode, camera):
    for planned in plan_bench(rig, {"mode": mode, "camera": camera}):
        known = {p.name for p in NODE_TABLES[planned.executable]} | {"use_sim_time"}
        assert set(planned.parameters) <= known
        check_arguments(planned.executable, ["--ros-args", "--params-file", planned.file])


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"speed": "fast"}, "speed is 'fast'"),
        ({"speed": "0"}, "above 0"),
        ({"speed": "10", "camera": "true"}, "expected 1.0"),
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


def test_an_unknown_argument_is_refused_unless_it_may_be_that_of_an_including_file(monkeypatch):
    monkeypatch.setattr(sys, "argv", ["ros2", "launch", "my_lab", "lab.launch.py"])
    assert executables(built(BENCHES["wire_bench"], monkeypatch, lamp="on"))
    monkeypatch.setattr(sys, "argv", ["ros2", "launch", "sma_bench", "wire_bench.launch.py"])
    assert executables(built(BENCHES["wire_bench"], monkeypatch, speed="2"))
    with pytest.raises(InputError, match="unknown argument lamp"):
        built(BENCHES["wire_bench"], monkeypatch, lamp="on")


def test_the_planned_nodes_work_together(bench, tmp_path):
    """A simulated wire before the synthetic camera, started as the launch file would."""
    power = bench.listen("wire/power", BatteryState)
    read = bench.listen("wire/temperature", Temperature)
    states = bench.latched("experiment/state", String)
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
    assert bench.trigger("experiment/stop").success
    bench.until(lambda: power[-1].voltage < 0.1, PATIENCE)


@pytest.mark.slow
def test_launch_ends_the_bench_with_its_experiment(ros_domain):
    if not INSTALLED:
        pytest.skip("launch and launch_ros are not installed")
    from launch import LaunchDescription, LaunchService
    from launch.actions import IncludeLaunchDescription, RegisterEventHandler
    from launch.event_handlers import OnProcessExit, OnProcessStart
    from launch.launch_description_sources import PythonLaunchDescriptionSource

    ended = []

    def started(event, _context):
        if "experiment" in event.process_name:
            threading.Timer(10.0, os.kill, (event.pid, signal.SIGKILL)).start()

    service = LaunchService(noninteractive=True)
    watchdog = threading.Timer(PATIENCE, service.shutdown)
    service.include_launch_description(LaunchDescription([
        RegisterEventHandler(OnProcessStart(on_start=started)),
        RegisterEventHandler(OnProcessExit(
            on_exit=lambda event, _context: ended.append(event.process_name)
        )),
        IncludeLaunchDescription(
            PythonLaunchDescriptionSource(str(BENCHES["wire_bench"])),
            launch_arguments=[("record", "false")],
        ),
    ]))
    watchdog.start()
    service.run()
    assert watchdog.is_alive(), "the bench went on without its experiment"
    watchdog.cancel()
    assert any("simulator" in name for name in ended)


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
def test_a_rig_file_carries_table_i_and_differs_from_the_table_in_its_channels_only(rig):
    parameters = read_parameters(ROOT / "config" / f"{rig}.yaml")
    defaults = Parameters.defaults()
    different = {name for name in defaults if parameters[name] != defaults[name]}
    assert different <= {"bench.channels", "bench.channel_sides"}
    assert {"wire.resistance", "wire.specific_heat"} <= parameters.given


@pytest.mark.parametrize("rig", ["wire_rig", "composite_rig"])
def test_every_number_of_a_rig_file_is_a_double_to_ros(rig):
    import yaml

    body = yaml.safe_load((ROOT / "config" / f"{rig}.yaml").read_text())["/**"]["ros__parameters"]
    numbers = [value for group in body.values() for value in group.values()]
    assert all(isinstance(value, (float, list)) for value in numbers)


