"""The composite beam as URDF: RViz shows it bend by the joint `tip` of `joint_states`. No ROS.

The clamped end is the frame `clamp`; the beam stands along z, x points to the front. The prismatic
joint `tip` carries the deflection itself. The beam is a chain of stiff pieces whose joints mimic
it: constant curvature, as in eq. (16), by which the angle of a piece is 2 delta / (n l).
"""

from xml.etree import ElementTree as Xml

from sma_bench.parameters import Parameters
from sma_bench.parameters.node_tables import SIMULATOR

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
