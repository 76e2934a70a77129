"""The plot layouts name topics and fields that the bench publishes, and all of its readings."""

import json
import re
from pathlib import Path
from xml.etree import ElementTree as Xml

import pytest
from rosbags.typesys import Stores, get_typestore

from sma_bench.parameters import read_parameters
from sma_bench.records.contract import BATTERY_STATE, JOINT_STATE, TEMPERATURE, place_of

ROOT = Path(__file__).resolve().parents[2]
LAYOUTS = ROOT / "config" / "layouts"
NAMESPACE = "/bench"
RIGS = ("wire", "composite")
JOINTS = {"wire": "wire", "composite": "tip"}
TYPES = get_typestore(Stores.ROS2_JAZZY)
# Topics of layouts beyond the contract's: whole messages, shown by panels of their own.
WHOLE = {"/diagnostics", f"{NAMESPACE}/robot_description"}
DOCUMENTED = (ROOT / "docs" / "topics.md").read_text()


def channels(rig):
    return read_parameters(ROOT / "config" / f"{rig}_rig.yaml")["bench.channels"]


def objection(rig, topic, field):
    """Why the bench has no such field of such a topic, or ""."""
    place = place_of(topic)
    if place is None or place.namespace != NAMESPACE:
        return f"{topic} is not in the contract"
    first, _, last = place.meaning.partition("/")
    if place.type in (BATTERY_STATE, TEMPERATURE) and first not in (*channels(rig), "ambient"):
        return f"{topic}: {first} is no channel of the {rig} rig"
    spelled = {place.meaning, f"<channel>/{last}"}
    if not any(f"`{name}`" in DOCUMENTED for name in spelled):
        return f"{place.meaning} is not in docs/topics.md"
    name, index = re.fullmatch(r"(\w+)(?:\[(\d+)\])?", field).groups()
    if name not in {known for known, _ in TYPES.fielddefs[place.type][1]}:
        return f"{place.type} has no field {name}"
    if place.type == JOINT_STATE:
        return ""
    if index is not None and int(index) >= len(channels(rig)):
        return f"{topic}: the {rig} rig has no channel {index}"
    return ""


def plotjuggler(rig):
    """(topic, field) of every curve; PlotJuggler spells joints topic/joint/field."""
    root = Xml.parse(LAYOUTS / f"plotjuggler_{rig}.xml").getroot()
    found = []
    for curve in root.iter("curve"):
        topic, _, field = curve.get("name").rpartition("/")
        joint = topic.rpartition("/")[2]
        if topic.endswith(f"/joint_states/{joint}"):
            assert joint == JOINTS[rig]
            topic = topic.removesuffix(f"/{joint}")
        found.append((topic, field))
    return found


def foxglove(rig):
    panels = json.loads((LAYOUTS / f"foxglove_{rig}.json").read_text())["configById"]
    paths = [path["value"] for panel in panels.values() for path in panel.get("paths", ())]
    return [tuple(path.split(".")) for path in paths]


READERS = {"plotjuggler": plotjuggler, "foxglove": foxglove}


@pytest.mark.parametrize("rig", RIGS)
@pytest.mark.parametrize("program", READERS)
def test_a_layout_names_what_there_is(program, rig):
    found = READERS[program](rig)
    assert [text for topic, field in found if (text := objection(rig, topic, field))] == []


@pytest.mark.parametrize("rig", RIGS)
@pytest.mark.parametrize("program", READERS)
def test_a_layout_shows_every_reading_of_its_rig(program, rig):
    shown = {place_of(topic).meaning for topic, _ in READERS[program](rig)}
    wires = {f"{c}/{what}" for c in channels(rig) for what in ("power", "temperature")}
    ranges = {"front/range", "back/range"} if rig == "composite" else set()
    assert wires | ranges | {"voltage_command", "joint_states", "ambient/temperature"} <= shown


@pytest.mark.parametrize("rig", RIGS)
def test_plotjuggler_subscribes_to_the_topics_of_its_curves(rig):
    root = Xml.parse(LAYOUTS / f"plotjuggler_{rig}.xml").getroot()
    wanted = {topic for topic, _ in plotjuggler(rig)}
    chosen = [set(e.get("value").split(";")) for e in root.iter("selected_topics")]
    assert chosen == [wanted, wanted]


def panel_names(node):
    if isinstance(node, str):
        return [node]
    return panel_names(node["first"]) + panel_names(node["second"])


@pytest.mark.parametrize("rig", RIGS)
def test_every_panel_of_foxglove_has_its_place_and_its_topics_are_the_benchs(rig):
    text = (LAYOUTS / f"foxglove_{rig}.json").read_text()
    document = json.loads(text)
    assert sorted(panel_names(document["layout"])) == sorted(document["configById"])
    topics = set(re.findall(r'"(/[\w/]+)"', text))
    strange = {t for t in topics if t not in WHOLE and place_of(t) is None}
    assert strange == set() and f"{NAMESPACE}/thermal_image" in topics


@pytest.mark.parametrize(
    ("topic", "field", "said"),
    [
        ("/bench/wire/power", "volts", "no field"),
        ("/bench/front_1/power", "voltage", "no channel"),
        ("/other/wire/power", "voltage", "not in the contract"),
        ("/bench/wire/current", "data", "not in the contract"),
        ("/bench/voltage_command", "data[1]", "no channel 1"),
    ],
)
def test_a_wrong_name_would_be_found(topic, field, said):
    assert said in objection("wire", topic, field)
