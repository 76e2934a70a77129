"""The beam's URDF: RViz would show the tip where the joint says, and the beam bent to it."""

import math
from collections import Counter
from xml.etree import ElementTree as Xml

import pytest

from sma_bench.nodes.bench_plan import PIECES, beam_urdf
from sma_bench.parameters import Parameters

COMPOSITE = Parameters({
    "bench.channels": ("front_1", "front_2", "back_1", "back_2"),
    "bench.channel_sides": ("front", "front", "back", "back"),
})  # fmt: skip


@pytest.fixture(scope="module")
def beam():
    return Xml.fromstring(beam_urdf(COMPOSITE))


def joint(beam, name):
    return next(j for j in beam.findall("joint") if j.get("name") == name)


def numbers(element, attribute):
    return [float(word) for word in element.get(attribute).split()]


def bent_end(beam, deflection):
    """Where the last piece ends, in the frame of the clamp: x, z and the angle there."""
    x = z = angle = 0.0
    for k in range(1, PIECES + 1):
        bend = joint(beam, f"bend_{k}")
        assert numbers(bend.find("axis"), "xyz") == [0.0, 1.0, 0.0]
        along = numbers(bend.find("origin"), "xyz")[2]
        x, z = x + along * math.sin(angle), z + along * math.cos(angle)
        mimic = bend.find("mimic")
        assert mimic.get("joint") == "tip" and float(mimic.get("offset")) == 0.0
        angle += float(mimic.get("multiplier")) * deflection
    piece = COMPOSITE["composite.length"] / PIECES
    return x + piece * math.sin(angle), z + piece * math.cos(angle), angle


def test_it_is_a_tree_of_known_links(beam):
    links = [link.get("name") for link in beam.findall("link")]
    assert max(Counter(links).values()) == 1
    parents = [j.find("parent").get("link") for j in beam.findall("joint")]
    children = [j.find("child").get("link") for j in beam.findall("joint")]
    assert set(parents) <= set(links)
    assert sorted([*children, "clamp"]) == sorted(links)


def test_the_tip_slides_to_the_front_by_the_deflection(beam):
    tip = joint(beam, "tip")
    assert tip.get("type") == "prismatic"
    assert numbers(tip.find("axis"), "xyz") == [1.0, 0.0, 0.0]
    assert numbers(tip.find("origin"), "xyz") == [0.0, 0.0, COMPOSITE["composite.length"]]
    limit = tip.find("limit")
    assert float(limit.get("lower")) < -0.05 and float(limit.get("upper")) > 0.05


@pytest.mark.parametrize("deflection", [-0.01, 1e-4, 0.02])
def test_the_beam_ends_where_the_tip_is(beam, deflection):
    x, z, angle = bent_end(beam, deflection)
    length = COMPOSITE["composite.length"]
    assert x == pytest.approx(deflection, rel=0.02)
    # Eq. (16), constant curvature: delta = l angle / 2, here up to the half piece at the clamp.
    assert angle == pytest.approx(2.0 * deflection / length, rel=0.05)
    assert 0.95 * length < z <= length


def test_a_beam_at_rest_is_straight(beam):
    assert bent_end(beam, 0.0) == pytest.approx((0.0, COMPOSITE["composite.length"], 0.0))


def test_every_frame_of_the_messages_is_there(beam):
    links = {link.get("name") for link in beam.findall("link")}
    assert {"front_range", "back_range", *COMPOSITE["bench.channels"]} <= links
    front = joint(beam, "front_range_mount").find("origin")
    assert numbers(front, "xyz")[0] > 0.0
    # It looks back along -x: half a turn about z.
    assert numbers(front, "rpy")[2] == pytest.approx(math.pi)


def test_geometry_and_wires_are_the_rigs(beam):
    longer = COMPOSITE.replace({"composite.length": 0.2})
    tip = joint(Xml.fromstring(beam_urdf(longer)), "tip")
    assert numbers(tip.find("origin"), "xyz")[2] == pytest.approx(0.2)
    piece = next(link for link in beam.findall("link") if link.get("name") == "beam_1")
    places = [
        numbers(visual.find("origin"), "xyz")[0]
        for visual in piece.findall("visual")
        if visual.find("material").get("name") == "nitinol"
    ]
    offset = COMPOSITE["composite.wire_offset"]
    assert sorted(places) == pytest.approx([-offset, -offset, offset, offset])


def test_materials_that_are_used_are_defined(beam):
    defined = {material.get("name") for material in beam.findall("material")}
    used = {m.get("name") for m in beam.iter("material")}
    assert used == defined
    assert all(m.find("color") is not None for m in beam.findall("material"))
