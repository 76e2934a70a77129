"""The plot layouts name topics and fields that the bench publishes, and all of its readings."""

import json
import re
from pathlib import Path
from xml.etree import ElementTree as Xml

import pytest
import yaml
from rosbags.typesys import Stores, get_typestore

from sma_bench.parameters import read_parameters
from sma_bench.records.contract import BATTERY_STATE, JOINT_STATE, TEMPERATURE, place_of

ROOT = Path(__file__).resolve().parents[2]
LAYOUTS = ROOT / "config" / "layouts"
TYPES = get_typestore(Stores.ROS2_JAZZY)
DOCUMENTED = (ROOT / "docs" / "topics.md").read_text()


def plotjuggler(rig):
    """(topic, field) of every curve; PlotJuggler spells joints topic/joint/field."""
    root = Xml.parse(LAYOUTS / f"plotjuggler_{rig}.xml").getroot()
    joint = {"wire": "wire", "composite": "tip"}[rig]
    curves = [curve.get("name").rpartition("/") for curve in root.iter("curve")]
    found = [(t.replace(f"/joint_states/{joint}", "/joint_states"), f) for t, _, f in curves]
    wanted = {topic for topic, _ in found}
    chosen = [set(e.get("value").split(";")) for e in root.iter("selected_topics")]
    assert chosen == [wanted, wanted], "it subscribes to the topics of its curves"
    return found


def foxglove(rig):
    """(topic, field) of every curve; every panel has its place, other topics are the bench's."""
    text = (LAYOUTS / f"foxglove_{rig}.json").read_text()
    document = json.loads(text)
    placed = re.findall(r'"(?:first|second)": "([^"]+)"', json.dumps(document["layout"]))
    assert sorted(placed) == sorted(document["configById"])
    topics = set(re.findall(r'"(/[\w/]+)"', text))
    whole = {"/diagnostics", "/bench/robot_description"}  # beyond the contract's
    assert {t for t in topics if place_of(t) is None} <= whole
    assert "/bench/thermal_image" in topics
    paths = [p["value"] for one in document["configById"].values() for p in one.get("paths", ())]
    return [tuple(path.split(".")) for path in paths]


@pytest.mark.parametrize("rig", ["wire", "composite"])
@pytest.mark.parametrize("program", [plotjuggler, foxglove])
def test_a_layout_names_what_there_is_and_shows_every_reading_of_its_rig(program, rig):
    channels = read_parameters(ROOT / "config" / f"{rig}_rig.yaml")["bench.channels"]
    shown = set()
    for topic, field in program(rig):
        place = place_of(topic)
        assert place is not None and place.namespace == "/bench", topic
        first, _, last = place.meaning.partition("/")
        if place.type in (BATTERY_STATE, TEMPERATURE):
            assert first in (*channels, "ambient"), topic
        spelled = {place.meaning, f"<channel>/{last}"}
        assert any(f"`{name}`" in DOCUMENTED for name in spelled), topic
        name, index = re.fullmatch(r"(\w+)(?:\[(\d+)\])?", field).groups()
        assert name in {known for known, _ in TYPES.fielddefs[place.type][1]}, (topic, field)
        assert place.type == JOINT_STATE or int(index or 0) < len(channels), (topic, field)
        shown.add(place.meaning)
    wires = {f"{c}/{what}" for c in channels for what in ("power", "temperature")}
    ranges = {"front/range", "back/range"} if rig == "composite" else set()
    assert wires | ranges | {"voltage_command", "joint_states", "ambient/temperature"} <= shown


def test_the_view_of_rviz_shows_topics_and_frames_that_are_there():
    view = yaml.safe_load((LAYOUTS / "rviz_composite.rviz").read_text())["Visualization Manager"]
    shown = {display["Name"]: display for display in view["Displays"]}
    assert shown["Beam"]["Description Topic"]["Value"] == "/bench/robot_description"
    for side in ("front", "back"):
        topic = shown[f"{side.capitalize()} range"]["Topic"]["Value"]
        assert place_of(topic).meaning == f"{side}/range"
    beam = (ROOT / "sma_bench" / "nodes" / "beam.urdf.j2").read_text()
    assert f'<link name="{view["Global Options"]["Fixed Frame"]}">' in beam
