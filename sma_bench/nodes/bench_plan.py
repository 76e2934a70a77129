"""The launch files: plans of the nodes they start, and the launch actions (these need `launch`)."""

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import jinja2

from sma_bench.border import read_yaml
from sma_bench.errors import InputError, did_you_mean
from sma_bench.hardware.thermal_image import regions_side_by_side
from sma_bench.installation import PACKAGE, share_directory
from sma_bench.nodes.start import CONTAINER
from sma_bench.parameters import Parameters, read_parameters
from sma_bench.parameters.node_tables import SIMULATOR
from sma_bench.parameters.yaml_file import read_parameter_names
from sma_bench.protocols import load_protocol
from sma_bench.records import read_record
from sma_bench.records.contract import choose_topics
from sma_bench.ros.processes import discovery_variables, parameter_arguments

if TYPE_CHECKING:
    from launch import LaunchContext, LaunchDescription
    from launch_ros.actions import Node

SWITCH = ("true", "false", "True", "False")
# Nodes that drive, or measure what a driving bench needs: when one ends, the bench ends.
VITAL = ("simulator", "serial_bridge", "experiment", "ir_camera", "synthetic_camera", CONTAINER)
# Nodes that work on records on request; the last also drives the bench, with its own recorder.
NO_NODES, SERVICES, INVESTIGATION = "none", ("identification", "diagnosis"), "investigation"

# Synthetic images, small enough for a laptop; four wires bend by 45 mm in the shipped protocols.
_WIRE_PICTURE = {"image_width": 128, "image_height": 96, "pixel_size": 0.4e-3}
_COMPOSITE_PICTURE = {"image_width": 382, "image_height": 288, "pixel_size": 2.0e-3}
_PIXEL_ERROR, _PICTURE_RATE, _CLOCK_RATE = 0.02, 25.0, "100"  # std, of the pixels' size; Hz; Hz
_EXACT = {"sensor.temperature_noise": 0.0, "sensor.temperature_resolution": 0.0}
# Recorded commands are replayed below this prefix, so that no bench obeys them.
_COMMAND, _ASIDE = "voltage_command", "replayed/"
PIECES = 12  # rigid pieces of the beam in RViz
_STANDOFF = next(p.default for p in SIMULATOR if p.name == "sensor.range_standoff")


class Argument(NamedTuple):
    """An argument of a launch file; `choices` empty for any text."""

    default: str
    description: str
    choices: tuple[str, ...] = ()


@dataclass(frozen=True)
class PlannedNode:
    """One process; `parameters` override those of the rig's `file`."""

    executable: str
    parameters: Mapping[str, Any] = field(default_factory=dict)
    remappings: Mapping[str, str] = field(default_factory=dict)
    package: str = PACKAGE
    file: str = ""
    arguments: tuple[str, ...] = ()  # of a container: its nodes, each with its own

    @property
    def vital(self) -> bool:
        """True if its end ends the bench."""
        return self.executable in VITAL


def launch_arguments(of: str, params: str, **defaults: str) -> dict[str, Argument]:
    """Arguments of a launch file; `params`: its file in config/; `defaults` override the table."""
    table = read_yaml(Path(__file__).with_name("launch_arguments.yaml"))
    defaults["params"], found = str(share_directory() / "config" / params), {}
    for name, row in {**table[of], **table["both"]}.items():
        switch = row.get("switch", False)
        default = defaults.get(name, row.get("default", "false" if switch else ""))
        choices = SWITCH if switch else tuple(row.get("choices", ()))
        found[name] = Argument(default, row["description"], choices)
    return found


class LaunchedRig(NamedTuple):
    """A bench: its parameter file in config/ and its default protocol."""

    file: str
    protocol: str
    bends: bool = False

    @property
    def arguments(self) -> dict[str, Argument]:
        found = launch_arguments("bench", self.file, protocol=self.protocol)
        if not self.bends:
            del found["description"]
        return found


WIRE = LaunchedRig("wire_rig.yaml", "staircase")
COMPOSITE = LaunchedRig("composite_rig.yaml", "composite_triangle", bends=True)
WEIGHT = LaunchedRig("weight_rig.yaml", "isobaric")
SPRING = LaunchedRig("spring_rig.yaml", "triangle")
ANTAGONIST = LaunchedRig("antagonist_rig.yaml", "composite_triangle")
REPLAY = launch_arguments("replay", COMPOSITE.file)


def filled(arguments: Mapping[str, Argument], given: Mapping[str, str]) -> dict[str, Any]:
    """All arguments, given or default: text, bool for a switch, float for `speed` and `rate`.
    InputError: an unknown one, or a value that is not allowed."""
    for name in given:
        if name not in arguments:
            raise InputError(f"unknown argument {name}{did_you_mean(name, list(arguments))}")
    values: dict[str, Any] = {}
    for name, (default, _, choices) in arguments.items():
        value = given.get(name, default)
        if choices and value not in choices:
            raise InputError(f"{name} is {value!r}, expected {', '.join(choices)}")
        values[name] = value.lower() == "true" if choices == SWITCH else value
        if name in ("speed", "rate"):
            try:
                values[name] = float(value)
            except ValueError:
                values[name] = float("nan")
            if not 0.0 < values[name] < float("inf"):
                raise InputError(f"{name} is {value!r}, expected a number above 0")
    return values


def plan_bench(rig: LaunchedRig, given: Mapping[str, str]) -> list[PlannedNode]:
    """The nodes of a bench; publishers come before their subscribers. `given`: launch arguments.
    InputError: unknown or contradictory arguments, an unsuitable file or protocol."""
    values = filled(rig.arguments, given)
    hardware, speed = values["mode"] == "hardware", values["speed"]
    camera = hardware if values["camera"] == "auto" else values["camera"].lower() == "true"
    if speed > 1.0 and (hardware or camera):
        raise InputError(f"speed is {speed:g}, expected 1.0 on hardware or with a camera")
    if hardware and values["container"]:
        raise InputError("container: expected false, on hardware nodes have a process each")
    if hardware and values["autostart"]:
        raise InputError("autostart: expected false, hardware is enabled by hand")
    bench = read_parameters(values["params"])
    load_protocol(values["protocol"], bench)
    clock = {"use_sim_time": speed > 1.0}
    # The bench, and the cameras.
    if hardware:
        nodes = [PlannedNode("serial_bridge", {"port": values["port"]})]
        nodes += [PlannedNode("ir_camera")] if camera else []
    elif camera:
        channels = bench["bench.channels"]
        aside = {f"{c}/temperature": f"{c}/true_temperature" for c in channels}
        # Synthetic camera and reader get the same numbers, unless the rig's file states them.
        above = ("/" + values["namespace"].strip("/")).rstrip("/")
        stated = read_parameter_names(values["params"], f"{above}/ir_camera")
        picture: dict[str, Any] = dict(_WIRE_PICTURE if len(channels) == 1 else _COMPOSITE_PICTURE)
        picture |= {name: stated[name] for name in picture if name in stated}
        width, height, pixel = picture.values()
        read = {**picture, "read_cold_wires": True, "pixel_size_std": _PIXEL_ERROR * float(pixel),
                "regions": regions_side_by_side(len(channels), width, height)}
        nodes = [PlannedNode("simulator", {"speed": speed, **_EXACT}, aside),
                 PlannedNode("synthetic_camera", {**picture, "rate": _PICTURE_RATE}),
                 PlannedNode("ir_camera", {n: v for n, v in read.items() if n not in stated})]
    else:
        nodes = [PlannedNode("simulator", {"speed": speed})]
    # Experiment, recorder, twin and further nodes.
    record, further = values["record"], _named(values, (*SERVICES, INVESTIGATION))
    driver = {name: values[name] for name in ("protocol", "autostart")}
    nodes.append(PlannedNode("experiment", {**driver, "require_recorder": record, **clock}))
    if record and INVESTIGATION not in further:
        nodes.append(PlannedNode("recorder", {"output": values["output"], **clock}))
    nodes += [PlannedNode("twin", clock)] if values["twin"] else []
    nodes += [PlannedNode(name, clock if name == INVESTIGATION else {}) for name in further]
    if values["container"]:
        words: list[str] = []
        for node in nodes:
            words += [node.executable, *parameter_arguments(node.parameters)]
            for old, new in node.remappings.items():
                words += ["-r", f"{old}:={new}"]
        nodes = [PlannedNode(CONTAINER, arguments=tuple(words))]
    planned = [replace(node, file=values["params"]) for node in nodes]
    return [*planned, *([_described(bench, clock)] if values.get("description") else [])]


def plan_replay(given: Mapping[str, str]) -> tuple[list[str], list[PlannedNode]]:
    """The command line of `ros2 bag play` for a record in one namespace, and its nodes.
    `given`: of REPLAY. InputError: no bag, no topic of a bench in it, a bad argument."""
    values = filled(REPLAY, given)
    if not (bag := values["bag"]):
        raise InputError("bag: expected a record to play, bag:=my_record")
    counts = {(name, topic.type): topic.count for name, topic in read_record(bag).topics.items()}
    topics, _ = choose_topics(bag, counts)
    if not topics:
        raise InputError(f"{bag}: no topic of a bench in it")
    target, moved = ("/" + values["namespace"].strip("/")).rstrip("/"), []
    for meaning, topic in topics.items():
        read_anew = meaning.endswith("/temperature") and not meaning.startswith("ambient/")
        aside = _ASIDE if meaning == _COMMAND or (values["camera"] and read_anew) else ""
        moved.append(f"{topic}:={target}/{aside}{meaning}")
    command = ["ros2", "bag", "play", bag, "--clock", _CLOCK_RATE, "--rate", f"{values['rate']:g}",
               *(["--loop"] if values["loop"] else []), "--topics", *topics.values(), "--remap",
               *moved]
    clock, file = {"use_sim_time": True}, values["params"]
    nodes = [PlannedNode(name, clock, file=file)
             for name, switch in (("ir_camera", "camera"), ("twin", "twin")) if values[switch]]
    nodes += [PlannedNode(name, file=file) for name in _named(values, SERVICES)]
    if values["description"]:
        nodes.append(_described(read_parameters(file), clock))
    return command, nodes


def _named(values: Mapping[str, Any], known: Sequence[str]) -> list[str]:
    """The nodes that the argument `nodes` lists, without duplicates."""
    names = [name.strip() for name in values["nodes"].split(",") if name.strip()]
    if names == [NO_NODES]:  # ros2 launch refuses `nodes:=`
        return []
    for name in names:
        if name not in known:
            raise InputError(f"nodes: {name!r}, expected {', '.join(known)}, or {NO_NODES}")
    return list(dict.fromkeys(names))


def _described(bench: Parameters, clock: Mapping[str, Any]) -> PlannedNode:
    """The node that turns the joint `tip` into frames for RViz, by a URDF of the rig's geometry; it
    contains the messages' frames `front_range`, `back_range` and every channel."""
    wires = []  # of both sides, across the beam, at the offset `a` from its middle
    for side, sign in (("front", 1.0), ("back", -1.0)):
        count = bench["bench.channel_sides"].count(side)
        across = [bench["composite.width"] * ((k + 0.5) / count - 0.5) for k in range(count)]
        wires += [(sign * bench["composite.wire_offset"], place) for place in across]
    template = Path(__file__).with_name("beam.urdf.j2").read_text()
    beam = jinja2.Template(template, undefined=jinja2.StrictUndefined).render(
        pieces=PIECES, length=bench["composite.length"], thickness=bench["composite.thickness"],
        width=bench["composite.width"], diameter=bench["wire.diameter"], standoff=_STANDOFF,
        wires=wires, channels=bench["bench.channels"])
    name = "robot_state_publisher"
    return PlannedNode(name, {"robot_description": beam, **clock}, package=name)


def bench_launch(rig: LaunchedRig) -> "LaunchDescription":
    return _description(rig.arguments, lambda given: _nodes(plan_bench(rig, given), given))


def replay_launch() -> "LaunchDescription":
    """Launch description of a replay; it ends with the record."""
    from launch.actions import ExecuteProcess, Shutdown

    def actions(given: Mapping[str, str]) -> list[Any]:
        command, nodes = plan_replay(given)
        player = ExecuteProcess(
            cmd=command, name="player", output="screen",
            additional_env=discovery_variables(given["network"].lower() == "true"),
            on_exit=Shutdown(reason="the record is over"))
        return [*_nodes(nodes, given), player]

    return _description(REPLAY, actions)


def _description(arguments: Mapping[str, Argument],
                 actions: Callable[[Mapping[str, str]], list[Any]]) -> "LaunchDescription":
    from launch import LaunchDescription
    from launch.actions import DeclareLaunchArgument, OpaqueFunction

    def start(context: "LaunchContext") -> list[Any]:
        given = dict(context.launch_configurations)
        # Included by another launch file, ours gets that file's arguments, too: keep our own.
        ours = {path.name for path in (share_directory() / "launch").iterdir()}
        if not any(Path(word).name in ours for word in sys.argv):
            given = {name: given[name] for name in arguments}
        return actions(given)

    declared = [DeclareLaunchArgument(name, default_value=default, description=text + (
                    f" One of {', '.join(choices)}." if choices else ""))
                for name, (default, text, choices) in arguments.items()]
    return LaunchDescription([*declared, OpaqueFunction(function=start)])


def _nodes(planned: Sequence[PlannedNode], given: Mapping[str, str]) -> "list[Node]":
    """The launch actions; InputError if a package is missing, before any node has started."""
    from ament_index_python.packages import get_package_prefix
    from launch.actions import Shutdown
    from launch_ros.actions import Node
    from launch_ros.parameter_descriptions import ParameterValue

    for package in {node.package for node in planned} - {PACKAGE}:
        try:
            get_package_prefix(package)
        except (LookupError, OSError):
            raise InputError(f"the ROS package {package} is not installed: "
                             f"apt install ros-jazzy-{package.replace('_', '-')}") from None
    nodes = []
    for node in planned:
        # Keep text as text: launch_ros would read '10' as a number and '' as nothing.
        own = {name: ParameterValue(value, value_type=str) if isinstance(value, str) else value
               for name, value in node.parameters.items()}
        nodes.append(Node(
            package=node.package, executable=node.executable, arguments=list(node.arguments),
            name=None if node.arguments else node.executable, namespace=given["namespace"],
            parameters=[part for part in (node.file, own) if part],
            remappings=list(node.remappings.items()), output="screen",
            on_exit=Shutdown(reason=f"{node.executable} has ended") if node.vital else None,
            additional_env=discovery_variables(given["network"].lower() == "true")))
    return nodes
