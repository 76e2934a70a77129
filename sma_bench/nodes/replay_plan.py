"""What `replay.launch.py` starts: `ros2 bag play` of a record, and nodes beside it. No ROS.

Topics are played below one namespace, whichever they were recorded in. The recorded commands go to
`replayed/voltage_command`: no bench, real or not, may take them for its own.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from sma_bench.border import read_yaml
from sma_bench.errors import InputError
from sma_bench.nodes.bench_plan import (
    NO_NODES,
    OPEN_TO_NETWORK,
    SERVICES,
    SWITCH,
    Argument,
    PlannedNode,
    number,
    services,
    switch,
)
from sma_bench.nodes.bench_plan import robot_description as description_of
from sma_bench.records import read_record
from sma_bench.records.contract import choose_topics
from sma_bench.share import share_directory

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
        nodes.append(description_of(values["params"], clock))
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
