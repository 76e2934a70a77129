"""What a launch file of a bench starts: nodes with their parameters and remappings. No ROS.

The launch files turn a plan into launch_ros actions (`bench_launch`); a test reads it, or starts
it without `launch`.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as Xml

from sma_bench.border import read_yaml
from sma_bench.errors import InputError
from sma_bench.hardware.thermal_settings import regions_side_by_side
from sma_bench.installation import share_directory
from sma_bench.parameters import Parameters, read_parameters
from sma_bench.parameters.node_tables import NODE_TABLES, SIMULATOR
from sma_bench.parameters.table import BY_NAME
from sma_bench.parameters.yaml_file import read_parameter_names
from sma_bench.records import read_record
from sma_bench.records.contract import choose_topics

PACKAGE = "sma_bench"
MODES = ("simulated", "hardware")
EMULATED = "emulated"
SWITCH = ("true", "false", "True", "False")
# These hold the outputs, or are what the outputs are judged by: without one the bench stops.
VITAL = frozenset({
    "simulator", "serial_bridge", "experiment", "ir_camera", "synthetic_camera",
})  # fmt: skip

# Work on records when asked to, and drive nothing.
NO_NODES = "none"
SERVICES = ("identification", "diagnosis")
# Has the bench driven, and a recorder of its own for each run.
INVESTIGATION = "investigation"

# Pictures of the synthetic camera, small enough for a laptop. Four wires need room to bend:
# 45 mm either way in the shipped protocols.
_WIRE_PICTURE = {"image_width": 128, "image_height": 96, "pixel_size": 0.4e-3}
_COMPOSITE_PICTURE = {"image_width": 382, "image_height": 288, "pixel_size": 2.0e-3}
_PIXEL_ERROR = 0.02
_PICTURE_RATE = 25.0
_EXACT = {"sensor.temperature_noise": 0.0, "sensor.temperature_resolution": 0.0}


@dataclass(frozen=True)
class Argument:
    """An argument of a launch file; `choices` empty for any text."""

    default: str
    description: str
    choices: tuple[str, ...] = ()


OPEN_TO_NETWORK = Argument(
    "false", "Let other machines of the network reach the bench, and drive it; else this one "
    "only, unless the environment says otherwise.", SWITCH,
)  # fmt: skip


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


@dataclass(frozen=True)
class LaunchedRig:
    """A bench: its parameter file in config/ and the protocol to begin with."""

    file: str
    protocol: str
    bends: bool

    @property
    def arguments(self) -> dict[str, Argument]:
        """Arguments of its launch file, by name."""
        found = {
            "mode": Argument(
                "simulated", f"{MODES[0]}, or {MODES[1]} (an Uno)."
            ),
            "namespace": Argument("bench", "Namespace of all topics and nodes."),
            "params": Argument(
                str(share_directory() / "config" / self.file),
                "ROS parameter file: Table I, or what an identification wrote.",
            ),
            "protocol": Argument(
                self.protocol, "Name in config/protocols, or the path of a .yaml file."
            ),
            "autostart": Argument(
                "false", "Start the protocol as soon as the bench answers; simulated only.", SWITCH
            ),
            "speed": Argument(
                "1.0", "Simulated seconds per second; above 1 the nodes run on /clock."
            ),
            "camera": Argument(
                "auto", "Temperatures by ir_camera: of the driver's pictures on hardware, of "
                "synthetic ones otherwise. auto: on hardware only.", ("auto", *SWITCH),
            ),
            "twin": Argument(
                "false", "Run the model beside the bench: predictions and residuals below twin/, "
                "and where a gap grows.", SWITCH,
            ),
            "record": Argument("true", "Record all topics of the bench.", SWITCH),
            "output": Argument("", "New folder for the bag; empty for record_<date>_<time>."),
            "nodes": Argument(
                "identification",
                f"Further nodes, separated by commas: {', '.join(SERVICES)}; {INVESTIGATION}, "
                f"which records by itself, so that no recorder is started; or {NO_NODES}.",
            ),
            "port": Argument("", "Serial port of the Uno; empty for the only one."),
            "network": OPEN_TO_NETWORK,
        }  # fmt: skip
        if self.bends:
            found["description"] = Argument(
                "false", "Publish the beam's URDF, so that RViz shows it bend.", SWITCH
            )
        return found


WIRE = LaunchedRig("wire_rig.yaml", "staircase", bends=False)
COMPOSITE = LaunchedRig("composite_rig.yaml", "composite_triangle", bends=True)
WEIGHT = LaunchedRig("weight_rig.yaml", "isobaric", bends=False)
SPRING = LaunchedRig("spring_rig.yaml", "triangle", bends=False)
ANTAGONIST = LaunchedRig("antagonist_rig.yaml", "composite_triangle", bends=False)


def plan_bench(values: Mapping[str, str]) -> list[PlannedNode]:
    """The nodes of a bench, those that others listen to first.

    Args:
        values: every argument of the rig's launch file, as text.

    Raises:
        InputError: arguments that exclude each other, or a bad parameter file; one line.
    """
    if values["mode"] == EMULATED:
        raise InputError(
            "mode is 'emulated', which is gone: in a checkout ./bench check hardware plays the "
            "firmware on an emulated Uno (test/tools/uno)"
        )
    mode = chosen(values, "mode", MODES)
    speed = number(values, "speed")
    if chosen(values, "camera", ("auto", *SWITCH)) == "auto":
        with_camera = mode == "hardware"
    else:
        with_camera = switch(values, "camera")
    if speed > 1.0 and (mode != "simulated" or with_camera):
        raise InputError(f"speed is {speed:g}, expected 1.0 on hardware or with a camera")
    if mode == "hardware" and switch(values, "autostart"):
        raise InputError("autostart: expected false, hardware is enabled by hand")
    clock = {"use_sim_time": speed > 1.0}
    nodes = _bench(values, mode, speed, with_camera)
    nodes.append(PlannedNode("experiment", {
        "protocol": values["protocol"], "autostart": switch(values, "autostart"),
        "require_recorder": switch(values, "record"), **clock,
    }))  # fmt: skip
    beside = services(values, (*SERVICES, INVESTIGATION), {INVESTIGATION: clock})
    if switch(values, "record") and INVESTIGATION not in (n.executable for n in beside):
        nodes.append(PlannedNode("recorder", {"output": values["output"], **clock}))
    if switch(values, "twin"):
        nodes.append(PlannedNode("twin", clock))
    nodes += beside
    planned = [PlannedNode(n.executable, n.parameters, n.remappings, file=values["params"])
               for n in nodes]  # fmt: skip
    if "description" in values and switch(values, "description"):
        planned.append(robot_description(values["params"], clock))
    return planned


def services(
    values: Mapping[str, str], known: tuple[str, ...] = SERVICES,
    own: Mapping[str, Mapping[str, Any]] = {},  # noqa: B006 (read only)
) -> list[PlannedNode]:
    """The nodes that the argument `nodes` names, with their own parameters; InputError for one
    that is not among the known ones."""
    if values["nodes"].strip() == NO_NODES:  # ros2 launch refuses `nodes:=`
        return []
    names = [name.strip() for name in values["nodes"].split(",") if name.strip()]
    for name in names:
        if name not in known:
            raise InputError(f"nodes: {name!r}, expected {', '.join(known)}, or {NO_NODES}")
    return [PlannedNode(name, own.get(name, {})) for name in dict.fromkeys(names)]


def robot_description(params: str, clock: Mapping[str, Any]) -> PlannedNode:
    """The node that turns the joint `tip` into frames for RViz."""
    urdf = beam_urdf(read_parameters(params, ignore=node_groups()))
    return PlannedNode(
        "robot_state_publisher", {"robot_description": urdf, **clock},
        package="robot_state_publisher",
    )


def node_groups() -> set[str]:
    """Groups of names that a rig's file may hold for single nodes, beside the contract's."""
    own = {p.name.split(".")[0] for table in NODE_TABLES.values() for p in table}
    return own - {name.split(".")[0] for name in BY_NAME}


def _bench(
    values: Mapping[str, str], mode: str, speed: float, with_camera: bool
) -> list[PlannedNode]:
    """What stands for the bench, and its camera."""
    params = values["params"]
    if mode == "hardware":
        nodes = [PlannedNode("serial_bridge", {"port": values["port"]})]
        return [*nodes, PlannedNode("ir_camera")] if with_camera else nodes
    rig = read_parameters(params, ignore=node_groups())
    aside = {f"{c}/temperature": f"{c}/true_temperature" for c in rig["bench.channels"]}
    exact, moved = (_EXACT, aside) if with_camera else ({}, {})
    nodes = [PlannedNode("simulator", {"speed": speed, **exact}, moved)]
    return nodes + (_synthetic_pictures(rig, params) if with_camera else [])


def _synthetic_pictures(rig: Parameters, params: str) -> list[PlannedNode]:
    """Synthetic camera and reader, alike; what the rig's file says of either stays."""
    channels = rig["bench.channels"]
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


def chosen(values: Mapping[str, str], name: str, choices: tuple[str, ...]) -> str:
    """One of several words; InputError for any other."""
    if values[name] not in choices:
        raise InputError(f"{name} is {values[name]!r}, expected {', '.join(choices)}")
    return values[name]


def switch(values: Mapping[str, str], name: str) -> bool:
    """Whether an argument says true; InputError where it says neither."""
    return chosen(values, name, SWITCH).lower() == "true"


def number(values: Mapping[str, str], name: str) -> float:
    """A number above 0; InputError otherwise."""
    try:
        found = float(values[name])
    except ValueError:
        found = float("nan")
    if not 0.0 < found < float("inf"):
        raise InputError(f"{name} is {values[name]!r}, expected a number above 0")
    return found


# --- What `replay.launch.py` starts: `ros2 bag play` of a record, and nodes beside it. No ROS.
#
# Topics are played below one namespace, whichever they were recorded in. The recorded commands
# go to `replayed/voltage_command`: no bench, real or not, may take them for its own.

COMMAND = "voltage_command"
ASIDE = "replayed"
_CLOCK_RATE = "100"

ARGUMENTS = {
    "bag": Argument("", "Record to play: a rosbag2 folder, an .mcap or a .db3 file."),
    "namespace": Argument(
        "replay", "Namespace to play into. `bench` suits the plot layouts, where no bench runs."
    ),
    "rate": Argument("1.0", "Times real time."),
    "loop": Argument("false", "Begin again at the end.", SWITCH),
    "params": Argument(
        str(share_directory() / "config" / "composite_rig.yaml"), "ROS parameter file of the bench."
    ),
    "camera": Argument(
        "false", "Read the recorded pictures anew with ir_camera; recorded temperatures step "
        "aside.", SWITCH,
    ),
    "twin": Argument(
        "false", "Run the model of `params` beside the record, and say where a gap grows.", SWITCH
    ),
    "nodes": Argument(
        NO_NODES, f"Further nodes, separated by commas: {', '.join(SERVICES)}; or {NO_NODES}."
    ),
    "description": Argument(
        "false", "Publish the beam's URDF, so that RViz shows it bend.", SWITCH
    ),
    "network": OPEN_TO_NETWORK,
}  # fmt: skip


def plan_replay(values: Mapping[str, str]) -> tuple[list[str], list[PlannedNode]]:
    """The command line of `ros2 bag play`, and the nodes beside it.

    Args:
        values: every one of ARGUMENTS, as text.

    Raises:
        InputError: no bag, one without a topic of the bench, or a bad argument; one line.
    """
    if not values["bag"]:
        raise InputError("bag: expected a record to play, bag:=my_record")
    topics = bench_topics(values["bag"])
    camera = switch(values, "camera")
    target = "/" + values["namespace"].strip("/")
    moved = [
        f"{topic}:={target.rstrip('/')}/{_new_name(meaning, camera)}"
        for meaning, topic in topics.items()
    ]
    command = [
        "ros2", "bag", "play", values["bag"], "--clock", _CLOCK_RATE,
        "--rate", f"{number(values, 'rate'):g}",
        *(["--loop"] if switch(values, "loop") else []),
        "--topics", *topics.values(), "--remap", *moved,
    ]  # fmt: skip
    clock = {"use_sim_time": True}
    beside = [PlannedNode("ir_camera", clock)] if camera else []
    beside += [PlannedNode("twin", clock)] if switch(values, "twin") else []
    nodes = [
        PlannedNode(n.executable, n.parameters, file=values["params"])
        for n in [*beside, *services(values)]
    ]
    if switch(values, "description"):
        nodes.append(robot_description(values["params"], clock))
    return command, nodes


def bench_topics(bag: str) -> dict[str, str]:
    """Topic by its meaning (`wire/power`), of what the bag holds of a bench.

    Raises:
        InputError: not a bag, nothing of the contract in it, or two benches.
    """
    chosen, _ = choose_topics(bag, _counts(bag))
    if not chosen:
        raise InputError(f"{bag}: no topic of a bench in it")
    return chosen


def _counts(bag: str) -> dict[tuple[str, str], int]:
    """Messages by topic and type: as metadata.yaml says, or counted where there is none."""
    metadata = Path(bag) / "metadata.yaml"
    if not metadata.is_file():
        return {(name, t.type): t.count for name, t in read_record(bag).topics.items()}
    document: Any = read_yaml(metadata, aliases=True)  # rosbags writes some
    try:
        entries = document["rosbag2_bagfile_information"]["topics_with_message_count"]
        counts: dict[tuple[str, str], int] = {}
        for entry in entries:
            topic, count = entry["topic_metadata"], entry["message_count"]
            name, kind = topic["name"], topic["type"]
            if not (isinstance(name, str) and isinstance(kind, str) and isinstance(count, int)):
                raise TypeError
            counts[name, kind] = count
        return counts
    except (KeyError, TypeError, ValueError):
        raise InputError(f"{metadata}: expected rosbag2's list of topics") from None


def _new_name(meaning: str, camera: bool) -> str:
    aside = meaning == COMMAND or (
        camera and meaning.endswith("/temperature") and not meaning.startswith("ambient/")
    )
    return f"{ASIDE}/{meaning}" if aside else meaning



# --- The composite beam as URDF: RViz shows it bend by the joint `tip` of `joint_states`. No ROS.
#
# The clamped end is the frame `clamp`; the beam stands along z, x points to the front. The
# prismatic joint `tip` carries the deflection itself. The beam is a chain of stiff pieces whose
# joints mimic it: constant curvature, as in eq. (16), by which the angle of a piece is
# 2 delta / (n l).


TIP = "tip"
PIECES = 12
_STANDOFF = next(float(p.default) for p in SIMULATOR if p.name == "sensor.range_standoff")  # type: ignore[arg-type]
_SENSOR = 0.02
_COLOURS = {
    "silicone": "0.75 0.78 0.80 0.9", "nitinol": "0.80 0.25 0.15 1", "mark": "0.12 0.35 0.65 1",
}
_FASTEST = 1.0
_STRONGEST = 10.0


def beam_urdf(parameters: Parameters) -> str:
    """URDF of the beam with the rig's geometry (`composite.`, m).

    The frames of the messages are in it: `front_range`, `back_range`, and every channel.
    """
    length = float(parameters["composite.length"])
    robot = Xml.Element("robot", name="composite_beam")
    for name, colour in _COLOURS.items():
        Xml.SubElement(Xml.SubElement(robot, "material", name=name), "color", rgba=colour)
    width, thickness = parameters["composite.width"], parameters["composite.thickness"]
    clamp = Xml.SubElement(robot, "link", name="clamp")
    _box(clamp, (4.0 * thickness, 1.5 * width, 0.02), (0.0, 0.0, -0.01), "mark")
    _chain(robot, parameters, length)
    _tip(robot, length, thickness)
    for side, sign in (("front", 1.0), ("back", -1.0)):
        sensor = Xml.SubElement(robot, "link", name=f"{side}_range")
        _box(sensor, (_SENSOR, _SENSOR, _SENSOR), (-0.5 * _SENSOR, 0.0, 0.0), "mark")
        # A range points along x of its frame: from the front sensor back to the beam.
        turned = "0 0 3.141592653589793" if sign > 0.0 else "0 0 0"
        _fixed(robot, f"{side}_range", (sign * _STANDOFF, 0.0, length), turned)
    for channel in parameters["bench.channels"]:
        Xml.SubElement(robot, "link", name=channel)
        _fixed(robot, channel, (0.0, 0.0, 0.0), "0 0 0")
    Xml.indent(robot)
    return '<?xml version="1.0"?>\n' + Xml.tostring(robot, encoding="unicode") + "\n"


def _chain(robot: Xml.Element, parameters: Parameters, length: float) -> None:
    """Pieces from the clamp on; the first joint turns by half, so that the chord is exact."""
    piece = length / PIECES
    angle = 2.0 / (PIECES * length)
    for k in range(PIECES):
        link = Xml.SubElement(robot, "link", name=f"beam_{k + 1}")
        thickness, width = parameters["composite.thickness"], parameters["composite.width"]
        _box(link, (thickness, width, piece), (0.0, 0.0, 0.5 * piece), "silicone")
        for x, y in _wires(parameters):
            diameter = parameters["wire.diameter"]
            _box(link, (4.0 * diameter, 4.0 * diameter, piece), (x, y, 0.5 * piece), "nitinol")
        joint = Xml.SubElement(robot, "joint", name=f"bend_{k + 1}", type="revolute")
        Xml.SubElement(joint, "parent", link=f"beam_{k}" if k else "clamp")
        Xml.SubElement(joint, "child", link=f"beam_{k + 1}")
        Xml.SubElement(joint, "origin", xyz=_numbers(0.0, 0.0, piece if k else 0.0), rpy="0 0 0")
        Xml.SubElement(joint, "axis", xyz="0 1 0")
        _limit(joint, 1.0)
        share = angle if k else 0.5 * angle
        Xml.SubElement(joint, "mimic", joint=TIP, multiplier=f"{share:.9g}", offset="0")


def _tip(robot: Xml.Element, length: float, thickness: float) -> None:
    mark = Xml.SubElement(robot, "link", name="tip_mark")
    visual = Xml.SubElement(mark, "visual")
    Xml.SubElement(Xml.SubElement(visual, "geometry"), "sphere", radius=f"{0.7 * thickness:.6g}")
    Xml.SubElement(visual, "material", name="mark")
    joint = Xml.SubElement(robot, "joint", name=TIP, type="prismatic")
    Xml.SubElement(joint, "parent", link="clamp")
    Xml.SubElement(joint, "child", link="tip_mark")
    Xml.SubElement(joint, "origin", xyz=_numbers(0.0, 0.0, length), rpy="0 0 0")
    Xml.SubElement(joint, "axis", xyz="1 0 0")
    _limit(joint, length)


def _wires(parameters: Parameters) -> list[tuple[float, float]]:
    """Where the wires of both sides lie across the beam, at the offset `a` from its middle."""
    places = []
    sides = parameters["bench.channel_sides"]
    for side, sign in (("front", 1.0), ("back", -1.0)):
        count = sides.count(side)
        for k in range(count):
            across = parameters["composite.width"] * ((k + 0.5) / count - 0.5)
            places.append((sign * float(parameters["composite.wire_offset"]), float(across)))
    return places


def _box(
    link: Xml.Element, size: tuple[float, ...], place: tuple[float, ...], material: str
) -> None:
    visual = Xml.SubElement(link, "visual")
    Xml.SubElement(visual, "origin", xyz=_numbers(*place), rpy="0 0 0")
    Xml.SubElement(Xml.SubElement(visual, "geometry"), "box", size=_numbers(*size))
    Xml.SubElement(visual, "material", name=material)


def _fixed(robot: Xml.Element, child: str, place: tuple[float, ...], rpy: str) -> None:
    joint = Xml.SubElement(robot, "joint", name=f"{child}_mount", type="fixed")
    Xml.SubElement(joint, "parent", link="clamp")
    Xml.SubElement(joint, "child", link=child)
    Xml.SubElement(joint, "origin", xyz=_numbers(*place), rpy=rpy)


def _limit(joint: Xml.Element, most: float) -> None:
    Xml.SubElement(
        joint, "limit", lower=f"{-most:.6g}", upper=f"{most:.6g}",
        velocity=f"{_FASTEST:g}", effort=f"{_STRONGEST:g}",
    )


def _numbers(*values: float) -> str:
    return " ".join(f"{value:.9g}" for value in values)
