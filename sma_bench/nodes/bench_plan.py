"""What the launch files start: nodes with their parameters and remappings. No ROS.

The launch files turn a plan into launch_ros actions (`bench_launch`); a test reads it, or starts
it without `launch`.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from sma_bench.border import read_yaml
from sma_bench.errors import InputError, did_you_mean
from sma_bench.hardware.thermal_settings import regions_side_by_side
from sma_bench.installation import share_directory
from sma_bench.parameters import Parameters, read_parameters
from sma_bench.parameters.node_tables import SIMULATOR, node_groups
from sma_bench.parameters.yaml_file import read_parameter_names
from sma_bench.protocols import load_protocol
from sma_bench.records import read_record
from sma_bench.records.contract import choose_topics

PACKAGE = "sma_bench"
SWITCH = ("true", "false", "True", "False")
# These hold the outputs, or are what the outputs are judged by: without one the bench stops.
VITAL = frozenset({"simulator", "serial_bridge", "experiment", "ir_camera", "synthetic_camera"})
# Work on records when asked to, and drive nothing.
NO_NODES, SERVICES = "none", ("identification", "diagnosis")
# Has the bench driven, and a recorder of its own for each run.
INVESTIGATION = "investigation"

# Pictures of the synthetic camera, small enough for a laptop. Four wires need room to bend:
# 45 mm either way in the shipped protocols.
_WIRE_PICTURE = {"image_width": 128, "image_height": 96, "pixel_size": 0.4e-3}
_COMPOSITE_PICTURE = {"image_width": 382, "image_height": 288, "pixel_size": 2.0e-3}
_PIXEL_ERROR = 0.02
_PICTURE_RATE = 25.0
_EXACT = {"sensor.temperature_noise": 0.0, "sensor.temperature_resolution": 0.0}
_GONE = {
    "managed": "managed is gone: nodes are no lifecycle nodes any more, they start active",
    "mode:=emulated": "mode:=emulated is gone: in a checkout ./bench check hardware plays the "
    "firmware on an emulated Uno (test/tools/uno)",
}


@dataclass(frozen=True)
class Argument:
    """An argument of a launch file; `choices` empty for any text."""

    default: str
    description: str
    choices: tuple[str, ...] = ()


@dataclass(frozen=True)
class PlannedNode:
    """One process: `parameters` are its own, over those of the rig's `file`."""

    executable: str
    parameters: Mapping[str, Any] = field(default_factory=dict)
    remappings: Mapping[str, str] = field(default_factory=dict)
    package: str = PACKAGE
    file: str = ""

    @property
    def vital(self) -> bool:
        """Whether its end ends the bench."""
        return self.executable in VITAL


def launch_arguments(of: str, **defaults: str) -> dict[str, Argument]:
    """Arguments of a launch file, by name, with these defaults over the table's."""
    table = read_yaml(Path(__file__).with_name("launch_arguments.yaml"))
    found = {}
    for name, row in {**table[of], **table["both"]}.items():
        switch = row.get("switch", False)
        default = defaults.get(name, row.get("default", "false" if switch else ""))
        choices = SWITCH if switch else tuple(row.get("choices", ()))
        found[name] = Argument(default, row["description"], choices)
    return found


@dataclass(frozen=True)
class LaunchedRig:
    """A bench: its parameter file in config/ and the protocol to begin with."""

    file: str
    protocol: str
    bends: bool = False

    @property
    def arguments(self) -> dict[str, Argument]:
        """Arguments of its launch file, by name."""
        params = str(share_directory() / "config" / self.file)
        found = launch_arguments("bench", params=params, protocol=self.protocol)
        if not self.bends:
            del found["description"]
        return found


WIRE = LaunchedRig("wire_rig.yaml", "staircase")
COMPOSITE = LaunchedRig("composite_rig.yaml", "composite_triangle", bends=True)
WEIGHT = LaunchedRig("weight_rig.yaml", "isobaric")
SPRING = LaunchedRig("spring_rig.yaml", "triangle")
ANTAGONIST = LaunchedRig("antagonist_rig.yaml", "composite_triangle")


def filled(arguments: Mapping[str, Argument], given: Mapping[str, str]) -> dict[str, str]:
    """All arguments as text, those not given at their default.

    Raises:
        InputError: an unknown one, or a word that is none of its choices.
    """
    for name, value in given.items():
        if gone := _GONE.get(name) or _GONE.get(f"{name}:={value}"):
            raise InputError(gone)
        if name not in arguments:
            raise InputError(f"unknown argument {name}{did_you_mean(name, list(arguments))}")
    values = {name: argument.default for name, argument in arguments.items()} | dict(given)
    for name, argument in arguments.items():
        if argument.choices and values[name] not in argument.choices:
            raise InputError(f"{name} is {values[name]!r}, expected {', '.join(argument.choices)}")
    return values


def plan_bench(rig: LaunchedRig, given: Mapping[str, str]) -> list[PlannedNode]:
    """The nodes of a bench, those that others listen to first.

    Args:
        given: arguments of the rig's launch file, as text.

    Raises:
        InputError: unknown arguments, or such as exclude each other, a bad parameter file, or a
            protocol that the bench cannot run; one line.
    """
    values = filled(rig.arguments, given)
    hardware, speed = values["mode"] == "hardware", _number(values, "speed")
    camera = hardware if values["camera"] == "auto" else _switch(values, "camera")
    if speed > 1.0 and (hardware or camera):
        raise InputError(f"speed is {speed:g}, expected 1.0 on hardware or with a camera")
    if hardware and _switch(values, "autostart"):
        raise InputError("autostart: expected false, hardware is enabled by hand")
    bench = read_parameters(values["params"], ignore=node_groups())
    load_protocol(values["protocol"], bench)
    clock = {"use_sim_time": speed > 1.0}

    # The bench, and what reads its temperatures.
    if hardware:
        nodes = [PlannedNode("serial_bridge", {"port": values["port"]})]
        nodes += [PlannedNode("ir_camera")] if camera else []
    elif camera:
        aside = {f"{c}/temperature": f"{c}/true_temperature" for c in bench["bench.channels"]}
        nodes = [PlannedNode("simulator", {"speed": speed, **_EXACT}, aside)]
        nodes += _synthetic_pictures(bench, values["params"])
    else:
        nodes = [PlannedNode("simulator", {"speed": speed})]

    # What drives and records it, and what works beside.
    nodes.append(PlannedNode("experiment", {
        "protocol": values["protocol"], "autostart": _switch(values, "autostart"),
        "require_recorder": _switch(values, "record"), **clock,
    }))  # fmt: skip
    beside = _services(values, (*SERVICES, INVESTIGATION), {INVESTIGATION: clock})
    if _switch(values, "record") and INVESTIGATION not in (n.executable for n in beside):
        nodes.append(PlannedNode("recorder", {"output": values["output"], **clock}))
    nodes += [PlannedNode("twin", clock)] if _switch(values, "twin") else []
    planned = [replace(node, file=values["params"]) for node in (*nodes, *beside)]
    if rig.bends and _switch(values, "description"):
        planned.append(_described(bench, clock))
    return planned


def _synthetic_pictures(bench: Parameters, params: str) -> list[PlannedNode]:
    """Synthetic camera and reader, alike; what the rig's file says of either stays."""
    channels = bench["bench.channels"]
    picture: dict[str, Any] = dict(_WIRE_PICTURE if len(channels) == 1 else _COMPOSITE_PICTURE)
    given = read_parameter_names(params, "ir_camera")
    picture |= {name: given[name] for name in picture if name in given}
    error = _PIXEL_ERROR * float(picture["pixel_size"])
    reader = {**picture, "read_cold_wires": True, "pixel_size_std": error}
    if "regions" not in given:
        reader["regions"] = regions_side_by_side(
            len(channels), picture["image_width"], picture["image_height"]
        )
    return [
        PlannedNode("synthetic_camera", {**picture, "rate": _PICTURE_RATE}),
        PlannedNode("ir_camera", {k: v for k, v in reader.items() if k not in given}),
    ]


def _services(
    values: Mapping[str, str], known: tuple[str, ...] = SERVICES,
    own: Mapping[str, Mapping[str, Any]] = {},  # noqa: B006 (read only)
) -> list[PlannedNode]:
    """The nodes that the argument `nodes` names, with their own parameters."""
    names = [name.strip() for name in values["nodes"].split(",") if name.strip()]
    if names == [NO_NODES]:  # ros2 launch refuses `nodes:=`
        return []
    for name in names:
        if name not in known:
            raise InputError(f"nodes: {name!r}, expected {', '.join(known)}, or {NO_NODES}")
    return [PlannedNode(name, own.get(name, {})) for name in dict.fromkeys(names)]


def _switch(values: Mapping[str, str], name: str) -> bool:
    return values[name].lower() == "true"


def _number(values: Mapping[str, str], name: str) -> float:
    try:
        found = float(values[name])
    except ValueError:
        found = float("nan")
    if not 0.0 < found < float("inf"):
        raise InputError(f"{name} is {values[name]!r}, expected a number above 0")
    return found


# --- What `replay.launch.py` starts: `ros2 bag play` of a record, and nodes beside it.
#
# Topics are played below one namespace, whichever they were recorded in. The recorded commands
# go to `replayed/voltage_command`: no bench, real or not, may take them for its own.

COMMAND, ASIDE = "voltage_command", "replayed"
_CLOCK_RATE = "100"  # Hz

ARGUMENTS = launch_arguments(
    "replay", params=str(share_directory() / "config" / "composite_rig.yaml")
)


def plan_replay(given: Mapping[str, str]) -> tuple[list[str], list[PlannedNode]]:
    """The command line of `ros2 bag play`, and the nodes beside it.

    Args:
        given: of ARGUMENTS, as text.

    Raises:
        InputError: no bag, one without a topic of the bench, or a bad argument; one line.
    """
    values = filled(ARGUMENTS, given)
    if not (bag := values["bag"]):
        raise InputError("bag: expected a record to play, bag:=my_record")
    topics, _ = choose_topics(bag, _counts(bag))
    if not topics:
        raise InputError(f"{bag}: no topic of a bench in it")
    camera, target = _switch(values, "camera"), "/" + values["namespace"].strip("/")
    moved = []
    for meaning, topic in topics.items():
        read_anew = meaning.endswith("/temperature") and not meaning.startswith("ambient/")
        aside = f"{ASIDE}/" if meaning == COMMAND or (camera and read_anew) else ""
        moved.append(f"{topic}:={target.rstrip('/')}/{aside}{meaning}")
    command = [
        "ros2", "bag", "play", bag, "--clock", _CLOCK_RATE,
        "--rate", f"{_number(values, 'rate'):g}",
        *(["--loop"] if _switch(values, "loop") else []),
        "--topics", *topics.values(), "--remap", *moved,
    ]  # fmt: skip
    clock = {"use_sim_time": True}
    nodes = [PlannedNode("ir_camera", clock)] if camera else []
    nodes += [PlannedNode("twin", clock)] if _switch(values, "twin") else []
    planned = [replace(node, file=values["params"]) for node in (*nodes, *_services(values))]
    if _switch(values, "description"):
        bench = read_parameters(values["params"], ignore=node_groups())
        planned.append(_described(bench, clock))
    return command, planned


def _counts(bag: str) -> dict[tuple[str, str], int]:
    """Messages by topic and type: as metadata.yaml says, or counted where there is none."""
    metadata = Path(bag) / "metadata.yaml"
    if not metadata.is_file():
        return {(name, t.type): t.count for name, t in read_record(bag).topics.items()}
    document: Any = read_yaml(metadata, aliases=True)  # rosbags writes some
    try:
        counts: dict[tuple[str, str], int] = {}
        for entry in document["rosbag2_bagfile_information"]["topics_with_message_count"]:
            topic, count = entry["topic_metadata"], entry["message_count"]
            name, kind = topic["name"], topic["type"]
            if not (isinstance(name, str) and isinstance(kind, str) and isinstance(count, int)):
                raise TypeError
            counts[name, kind] = count
        return counts
    except (KeyError, TypeError, ValueError):
        raise InputError(f"{metadata}: expected rosbag2's list of topics") from None


# --- The composite beam as URDF: RViz shows it bend by the joint `tip` of `joint_states`.

PIECES = 12
_STANDOFF = next(p.default for p in SIMULATOR if p.name == "sensor.range_standoff")


def beam_urdf(bench: Parameters) -> str:
    """URDF of the beam with the rig's geometry (`composite.`, m).

    The frames of the messages are in it: `front_range`, `back_range`, and every channel.
    """
    import jinja2

    wires = []  # of both sides, across the beam, at the offset `a` from its middle
    for side, sign in (("front", 1.0), ("back", -1.0)):
        count = bench["bench.channel_sides"].count(side)
        across = [bench["composite.width"] * ((k + 0.5) / count - 0.5) for k in range(count)]
        wires += [(sign * bench["composite.wire_offset"], place) for place in across]
    template = Path(__file__).with_name("beam.urdf.j2").read_text()
    return jinja2.Template(template, undefined=jinja2.StrictUndefined).render(
        pieces=PIECES, length=bench["composite.length"], thickness=bench["composite.thickness"],
        width=bench["composite.width"], diameter=bench["wire.diameter"], standoff=_STANDOFF,
        wires=wires, channels=bench["bench.channels"],
    )  # fmt: skip


def _described(bench: Parameters, clock: Mapping[str, Any]) -> PlannedNode:
    """The node that turns the joint `tip` into frames for RViz."""
    name = "robot_state_publisher"
    return PlannedNode(name, {"robot_description": beam_urdf(bench), **clock}, package=name)
