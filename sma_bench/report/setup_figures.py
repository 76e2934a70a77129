"""Figs. 1 and 11 to 14 of the paper, set-ups and diagrams, drawn from the parameters of the bench;
and the linearised model beside what it is the tangent of (E11)."""

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, FancyBboxPatch, Polygon, Rectangle

from sma_bench.errors import InputError
from sma_bench.parameters import Parameters
from sma_bench.parameters.audit import wire_length
from sma_bench.physics import bending
from sma_bench.physics.bending import Beam
from sma_bench.physics.linearised import Linearised
from sma_bench.physics.operating_point import Branch, OperatingPoint, maximum_deflection
from sma_bench.report.drawing import FAINT, MEASURED, MODEL, SECOND, new_figure
from sma_bench.report.page import Picture

_NO_DATA = "Data: none, drawn from the parameters."

# --- Fig. 11: the test bench of the composite.

_LASER = "#d62728"
_STEEL = "#5b6770"
_SILICONE = "#dfe6ea"
_CLAMP = (4.6, 6.55)  # middle of the lower edge of the clamp
_LENGTH, _THICKNESS = 4.6, 0.62
_BENT = 1.15
_SENSOR_HEIGHT = 2.25


@dataclass(frozen=True)
class _Box:
    """One instrument: lower left corner, size, and two lines of text."""

    x: float
    y: float
    width: float
    height: float
    title: str
    text: str

    @property
    def middle(self) -> tuple[float, float]:
        return self.x + 0.5 * self.width, self.y + 0.5 * self.height


_SUPPLY = _Box(8.6, 6.35, 3.0, 1.0, "DC power supply", "0 to 10 V, 0 to 3 A")
_SENSOR = _Box(8.6, 4.85, 3.0, 0.95, "current sensor", "ACS712")
_CHANNELS = _Box(8.6, 3.15, 3.0, 1.15, "4 power channels", "front 1, 2   back 1, 2")
_UNO = _Box(8.6, 1.2, 3.0, 1.15, "microcontroller", "Arduino Uno, ATmega328")
_COMPUTER = _Box(5.0, -0.45, 2.9, 0.95, "computer", "ROS 2, sma_bench")


def bench_picture() -> Picture:
    """Fig. 11: clamped specimen between two triangulation sensors, and its electronics."""
    figure = Figure(figsize=(8.4, 5.9), layout="constrained")
    ax = figure.subplots()
    ax.set(xlim=(-0.2, 12.0), ylim=(-0.7, 8.0))
    ax.set_aspect("equal")
    ax.axis("off")
    _frame(ax)
    _specimen(ax)
    _range_sensor(ax, "front", 1)
    _range_sensor(ax, "back", -1)
    for box in (_SUPPLY, _SENSOR, _CHANNELS, _UNO, _COMPUTER):
        _draw(ax, box)
    _wiring(ax)
    caption = (
        "Drawing, not to scale, of what section IV and Fig. 11 describe: the composite hangs from "
        "a clamp, two wires on either side; two triangulation sensors see the deflection δ of eq. "
        "(17) at the distance l from the clamp. Drawn from the text of the paper, whose own "
        "picture was not at hand. Data: none, a drawing."
    )
    return Picture("figure_11_bench", "Test bench of the composite", caption, figure)


def _frame(ax: Axes) -> None:
    x, y = _CLAMP
    ax.add_patch(Rectangle((0.2, 0.0), 0.35, 7.6, color=_STEEL))
    ax.add_patch(Rectangle((0.2, 7.3), 5.6, 0.35, color=_STEEL))
    ax.add_patch(Rectangle((0.0, -0.25), 4.8, 0.25, color=_STEEL))
    ax.add_patch(Rectangle((x - 0.65, y), 1.3, 0.75, color=_STEEL))
    ax.text(x, y + 0.37, "clamp", ha="center", va="center", color="white", fontsize=8)


def _beam(bent: float) -> tuple[np.ndarray, np.ndarray]:
    """Middle line of the beam, constant curvature, bent to the left (the front)."""
    s = np.linspace(0.0, _LENGTH, 60)
    return _CLAMP[0] - bent * (s / _LENGTH) ** 2, _CLAMP[1] - s


def _outline(x: np.ndarray, y: np.ndarray, thickness: float) -> np.ndarray:
    dx, dy = np.gradient(x), np.gradient(y)
    size = np.hypot(dx, dy)
    side = 0.5 * thickness * np.column_stack([-dy / size, dx / size])
    line = np.column_stack([x, y])
    return np.vstack([line + side, (line - side)[::-1]])


def _specimen(ax: Axes) -> None:
    x, y = _beam(0.0)
    ax.add_patch(Polygon(_outline(x, y, _THICKNESS), fc=_SILICONE, ec=_STEEL, lw=1.2))
    for sign, colour in ((-1.0, SECOND), (1.0, MEASURED)):
        for inset in (0.06, 0.14):
            at = x + sign * (0.5 * _THICKNESS - inset)
            ax.plot(at, y, color=colour, lw=1.4)
    bent = _beam(_BENT)
    ax.add_patch(
        Polygon(_outline(*bent, _THICKNESS), fill=False, ec=FAINT, lw=1.0, ls=(0, (4, 3)))
    )
    tip = _CLAMP[1] - _LENGTH
    ax.annotate(
        "", (bent[0][-1], tip - 0.35), (_CLAMP[0], tip - 0.35),
        arrowprops={"arrowstyle": "->", "color": MODEL, "lw": 1.6},
    )
    ax.text(
        _CLAMP[0] - 0.5 * _BENT, tip - 0.62, "deflection δ > 0", ha="center", color=MODEL,
        fontsize=9,
    )
    ax.text(_CLAMP[0] - 0.5, 5.6, "front\nwires", ha="right", fontsize=8, color=SECOND)
    ax.text(_CLAMP[0] + 0.45, 5.6, "back\nwires", ha="left", fontsize=8, color=MEASURED)
    ax.text(
        _CLAMP[0] + 0.42, 3.3, "elastomer,\nglass fibre,\nNiTi", fontsize=7.5, color=_STEEL,
        ha="left",
    )
    _dimension(ax)


def _dimension(ax: Axes) -> None:
    """l, from the clamp to the height of the sensors."""
    at = _CLAMP[0] + 1.3
    ax.annotate(
        "", (at, _SENSOR_HEIGHT + 0.25), (at, _CLAMP[1]),
        arrowprops={"arrowstyle": "<->", "color": _STEEL, "lw": 0.9},
    )
    ax.text(at + 0.12, 4.6, "l", fontsize=11, style="italic", color=_STEEL)


def _range_sensor(ax: Axes, side: str, direction: int) -> None:
    """Housing, laser spot and the light that returns at an angle."""
    left = 1.05 if direction > 0 else 6.1
    face = left + 0.85 if direction > 0 else left
    target = _CLAMP[0] - direction * 0.5 * _THICKNESS
    y = _SENSOR_HEIGHT
    ax.add_patch(FancyBboxPatch(
        (left, y - 0.5), 0.85, 1.0, boxstyle="round,pad=0.02", fc="#eeeeee", ec=_STEEL,
    ))
    ax.plot([face, target], [y + 0.25, y + 0.25], color=_LASER, lw=1.1)
    ax.plot([target, face], [y + 0.25, y - 0.3], color=_LASER, lw=0.8, ls=":")
    ax.text(
        left + 0.42, y - 0.68, f"triangulation\nsensor, {side}", ha="center", va="top",
        fontsize=8,
    )


def _draw(ax: Axes, box: _Box) -> None:
    ax.add_patch(FancyBboxPatch(
        (box.x, box.y), box.width, box.height, boxstyle="round,pad=0.05", fc="#f6f3ea", ec=_STEEL,
    ))
    x, y = box.middle
    ax.text(x, y + 0.17, box.title, ha="center", va="center", fontsize=9, weight="bold")
    ax.text(x, y - 0.2, box.text, ha="center", va="center", fontsize=8)


def _wiring(ax: Axes) -> None:
    middle = _SUPPLY.middle[0]
    _line(ax, [(middle, _SUPPLY.y), (middle, _SENSOR.y + _SENSOR.height)], "black")
    _line(ax, [(middle, _SENSOR.y), (middle, _CHANNELS.y + _CHANNELS.height)], "black")
    _line(ax, [(middle, _UNO.y + _UNO.height), (middle, _CHANNELS.y)], FAINT, "switches")
    # Heating current: from the channels to the clamped ends of the wires.
    for height, colour in ((3.95, SECOND), (3.5, MEASURED)):
        bend = 8.0 if colour == SECOND else 8.2
        top = _CLAMP[1] + (0.5 if colour == SECOND else 0.22)
        _line(
            ax, [(_CHANNELS.x, height), (bend, height), (bend, top), (_CLAMP[0] + 0.65, top)],
            colour,
        )
    ax.text(6.1, 7.2, "heating current", fontsize=8, ha="left", va="bottom", color="black")
    side = _SENSOR.x + _SENSOR.width + 0.2
    _line(
        ax,
        [
            (_SENSOR.x + _SENSOR.width, _SENSOR.middle[1]), (side, _SENSOR.middle[1]),
            (side, _UNO.middle[1]), (_UNO.x + _UNO.width, _UNO.middle[1]),
        ],
        FAINT,
    )
    _line(ax, [(6.95, _SENSOR_HEIGHT), (7.5, _SENSOR_HEIGHT), (7.5, 1.9), (_UNO.x, 1.9)], FAINT)
    _line(ax, [(1.47, 0.95), (1.47, 0.62), (7.5, 0.62), (7.5, 1.55), (_UNO.x, 1.55)], FAINT)
    x, y = _COMPUTER.middle
    _line(ax, [(_UNO.middle[0], _UNO.y), (_UNO.middle[0], y), (_COMPUTER.x + 2.9, y)], FAINT, "USB")


def _line(ax: Axes, points: list[tuple[float, float]], colour: str, text: str = "") -> None:
    ax.plot(*zip(*points, strict=True), color=colour, lw=1.1, zorder=0)
    if text:
        (x, y), (next_x, next_y) = points[:2]
        ax.text(
            0.5 * (x + next_x) + 0.1, 0.5 * (y + next_y), text, fontsize=8, va="center",
            color=_STEEL,
        )


# --- Fig. 1: the wire rig of the identification experiments.

def _sheet(width: float, height: float) -> tuple[Figure, Axes]:
    """A blank sheet of centimetres."""
    figure = Figure(figsize=(width / 2.0, height / 2.0), layout="constrained")
    ax = figure.subplots()
    ax.set(xlim=(0.0, width), ylim=(0.0, height))
    ax.set_aspect("equal")
    ax.axis("off")
    return figure, ax


def wire_rig_picture(parameters: Parameters) -> Picture:
    """Fig. 1: clamped wire, supply, current sensor and infrared camera."""
    figure, ax = _sheet(15.0, 8.0)
    low, high = 2.4, 11.2
    for x in (low - 0.7, high):
        ax.add_patch(Rectangle((x, 3.0), 0.7, 1.4, color=_STEEL))
    ax.plot([low, high], [3.7, 3.7], color=SECOND, lw=2.2)
    length, diameter = wire_length(parameters), parameters["wire.diameter"]
    ax.annotate("", (low, 3.1), (high, 3.1), arrowprops={"arrowstyle": "<->", "color": _STEEL})
    ax.text(0.5 * (low + high), 2.8, f"{1e3 * length:.0f} mm of {1e3 * diameter:.2g} mm NiTi, "
            f"R = {parameters['wire.resistance']:.4g} Ω", ha="center", va="top", fontsize=9)
    supply = _Box(1.2, 0.4, 4.6, 1.3, "DC power supply",
                  f"0 to {parameters['bench.maximum_voltage']:g} V, to "
                  f"{parameters['bench.maximum_current']:g} A")
    sensor = _Box(7.4, 0.4, 3.0, 1.3, "current sensor", "E1: V over I")
    camera = _Box(5.2, 6.2, 3.4, 1.3, "infrared camera", "E2, E3: temperature")
    for box in (supply, sensor, camera):
        _draw(ax, box)
    for x in (6.2, 7.6):
        ax.plot([6.9, x], [6.2, 3.75], color=_LASER, lw=0.8, ls=":")
    _line(ax, [(low - 0.35, 3.0), (low - 0.35, 1.75)], "black")
    _line(ax, [(5.85, 1.05), (7.35, 1.05)], "black")
    _line(ax, [(10.45, 1.05), (high + 0.35, 1.05), (high + 0.35, 3.0)], "black")
    ax.text(12.2, 3.7, f"air at {parameters['environment.ambient_temperature']:.2f} K,\n"
            f"h = {parameters['wire.heat_transfer_coefficient']:.4g} W/(m² K)", fontsize=8,
            va="center")
    caption = (
        "Drawing, not to scale: a wire between clamps, heated by its own current, its voltage, "
        f"current and temperature measured. {_NO_DATA}"
    )
    return Picture("figure_01_wire_rig", "Set-up for the identification", caption, figure)


# --- Figs. 12 and 13: the specimen, to scale, and how it bends.

def specimen_picture(parameters: Parameters) -> Picture:
    """Fig. 12: cross-section and side of the composite, in the proportions of the parameters."""
    beam = Beam.of(parameters)
    sides = parameters["bench.channel_sides"]
    figure, (section, side) = new_figure(rows=2, height=5.2, shared=False)
    width, height = 1e3 * beam.width, 1e3 * beam.thickness
    section.add_patch(
        Rectangle((-0.5 * width, -0.5 * height), width, height, fc=_SILICONE, ec=_STEEL))
    radius = 0.5e3 * parameters["wire.diameter"]
    for name, sign, colour in (("front", 1.0, SECOND), ("back", -1.0, MEASURED)):
        count = sides.count(name) * int(parameters["wire.count"])
        for x in (np.arange(count) - 0.5 * (count - 1)) * width / max(count, 1):
            section.add_patch(Circle((x, sign * 1e3 * beam.offset), radius, color=colour))
        section.text(0.5 * width + 0.6, sign * 0.45 * height, f"{name}, {count} wires",
                     color=colour, fontsize=8, va="center")
    section.annotate("", (-0.42 * width, 0.0), (-0.42 * width, 1e3 * beam.offset),
                     arrowprops={"arrowstyle": "<->", "color": _STEEL, "lw": 0.9})
    section.text(-0.41 * width, 0.5e3 * beam.offset, f"a = {1e3 * beam.offset:.3g} mm",
                 fontsize=8, va="center")
    section.axhline(0.0, color=FAINT, lw=0.6, ls="--")
    section.set_title(f"section: w_c = {width:.3g} mm, h_c = {height:.3g} mm", fontsize=9)
    section.set(xlim=(-0.6 * width, 0.85 * width), ylim=(-0.85 * height, 0.85 * height))
    length = 1e3 * beam.length
    side.add_patch(Rectangle((-0.06 * length, -height), 0.06 * length, 2.0 * height, color=_STEEL))
    side.add_patch(Rectangle((0.0, -0.5 * height), length, height, fc=_SILICONE, ec=_STEEL))
    for sign, colour in ((1.0, SECOND), (-1.0, MEASURED)):
        at = sign * 1e3 * beam.offset
        side.plot([0.0, length], [at, at], color=colour, lw=1.6)
    side.annotate("", (0.0, -1.2 * height), (length, -1.2 * height),
                  arrowprops={"arrowstyle": "<->", "color": _STEEL, "lw": 0.9})
    side.text(0.5 * length, -1.6 * height, f"l = {length:.4g} mm", ha="center", va="top",
              fontsize=8)
    side.set(xlim=(-0.08 * length, 1.05 * length), ylim=(-3.0 * height, 1.6 * height))
    for ax in (section, side):
        ax.set_aspect("equal")
        ax.axis("off")
    caption = (
        f"To scale: matrix of E_c = {beam.modulus / 1e6:.3g} MPa with wires of "
        f"{2.0 * radius:.2g} mm at the distance a from its middle. {_NO_DATA}"
    )
    return Picture("figure_12_specimen", "Specimen of the composite", caption, figure)


def moment_picture(parameters: Parameters) -> Picture:
    """Fig. 13: the composite bent by its front wires, with force, moment and deflection of the
    corrected eqs. (12) to (17)."""
    point = OperatingPoint.at_deflection(parameters, maximum_deflection(parameters), "heating")
    beam = Beam.of(parameters)
    driven = np.array(parameters["bench.channel_sides"]) == "front"
    force = float(point.stress[driven].sum()) * beam.wire_section
    moment = bending.moment(force, beam)
    x = np.linspace(0.0, beam.length, 200)
    bent = point.deflection * (x / beam.length) ** 2
    figure, (ax,) = new_figure(height=4.0)
    line = np.column_stack([1e3 * x, 1e3 * bent])
    outline = _outline(1e3 * x, 1e3 * bent, 1e3 * beam.thickness)
    ax.add_patch(Polygon(outline, fc=_SILICONE, ec=_STEEL))
    ax.plot(*line.T, "--", color=FAINT, lw=0.8)
    ax.plot([0.0, 1e3 * beam.length], [0.0, 0.0], color=FAINT, lw=0.8)
    tip = 1e3 * beam.length
    ax.annotate("", (tip, 1e3 * point.deflection), (tip, 0.0),
                arrowprops={"arrowstyle": "->", "color": MODEL, "lw": 1.6})
    ax.text(1.02 * tip, 0.5e3 * point.deflection, f"δ = {1e3 * point.deflection:.3g} mm",
            color=MODEL, fontsize=9, va="center")
    ax.text(
        0.04 * tip, 0.75e3 * point.deflection,
        f"P = A Σσ = {force:.3g} N   (12), (13)\nM = P a = {1e3 * moment:.3g} N mm\n"
        f"κ = 2δ/l² = {2.0 * point.deflection / beam.length**2:.3g} 1/m   (14)", fontsize=9,
        va="center",
    )
    ax.set_aspect("equal")
    ax.set(xlabel="from the clamp x [mm]", ylabel="deflection [mm]", xlim=(-5.0, 1.3 * tip))
    caption = (
        "To scale: the front wires just austenite. Their force at the distance a from the middle "
        f"bends the composite to a constant curvature, dφ/dx of eq. (14). {_NO_DATA}"
    )
    return Picture("figure_13_moment", "Force, moment and deflection", caption, figure)


# --- Fig. 14: the block diagram, with this bench's numbers in the blocks.

def block_diagram_picture(parameters: Parameters) -> Picture:
    """Fig. 14: from voltage to deflection; stress acts back on the transformation."""
    alpha, front, back = bending.bending_coefficients(parameters)
    capacity = parameters["wire.mass"] * parameters["wire.specific_heat"]
    tau = capacity / (
        parameters["wire.heat_transfer_coefficient"] * parameters["wire.surface_area"])
    blocks = (
        _Box(1.6, 3.2, 3.3, 1.5, "heat, eq. (2)", f"m c_p/(h A_c) = {tau:.3g} s"),
        _Box(6.3, 3.2, 3.6, 1.5, "phase, (10), (11)",
             f"C_A {parameters['wire.stress_influence_austenite'] / 1e6:.3g}, C_M "
             f"{parameters['wire.stress_influence_martensite'] / 1e6:.3g} MPa/K"),
        _Box(11.3, 3.2, 3.6, 1.5, "stress, (6), (7), (9)",
             f"ε_L = {parameters['wire.maximum_recoverable_strain']:.2%}"),
        _Box(16.3, 3.2, 3.4, 1.5, "bending, (15), (17)", f"α = {alpha:.3g} m"),
    )
    figure, ax = _sheet(22.0, 6.6)
    for box in blocks:
        _draw(ax, box)
    middle = blocks[0].middle[1]
    ends = [0.2, *(x for box in blocks for x in (box.x, box.x + box.width)), 21.6]
    for (start, stop), label in zip(
        zip(ends[::2], ends[1::2], strict=True), ("V_i", "T_i", "ξ_i", "σ_i", "δ"), strict=True
    ):
        ax.annotate("", (stop, middle), (start, middle),
                    arrowprops={"arrowstyle": "->", "color": "black"})
        ax.text(0.5 * (start + stop), middle + 0.2, label, ha="center", fontsize=10)
    stress_out, bent = blocks[2].x + blocks[2].width + 0.6, blocks[3].x + blocks[3].width + 0.6
    for start, target, depth, label in (
        (stress_out, blocks[1].middle[0], 2.0, "σ_i shifts the ranges by σ/C"),
        (bent, blocks[2].middle[0], 0.9, "ε = -δ/α"),
    ):
        ax.plot([start, start, target], [middle, depth, depth], color=FAINT, lw=1.1)
        ax.annotate("", (target, blocks[1].y - 0.06), (target, depth),
                    arrowprops={"arrowstyle": "->", "color": FAINT})
        ax.text(target + 0.2, depth - 0.15, label, va="top", fontsize=8)
    caption = (
        "Each wire by itself to its stress; those of a side bend together, δ = δ_front - δ_back, "
        f"β = {front / 1e6:.4g} and {back / 1e6:.4g} MPa/m. {_NO_DATA}"
    )
    return Picture("figure_14_block_diagram", "Block diagram of the composite", caption, figure)


def setup_pictures(parameters: Parameters) -> dict[int, Picture]:
    """Figs. 1 and 11 to 14 of a composite and its wire."""
    return {
        1: wire_rig_picture(parameters), 11: bench_picture(), 12: specimen_picture(parameters),
        13: moment_picture(parameters), 14: block_diagram_picture(parameters),
    }


# --- E11: the linearised model, a tangent of the steady states of its branch.

_AROUND = 12.0  # K


def operating_point_picture(model: Linearised) -> Picture:
    """Steady deflection (or its kin) over the temperature of the warmest wire, both branches, and
    the tangent of eqs. (18) to (23)."""
    point = model.point
    wire = int(np.argmax(point.temperature))
    kelvin = float(point.temperature[wire])
    together = np.isclose(point.temperature, kelvin)
    slope = float(model.deflection_per_kelvin[together].sum())
    around = np.linspace(max(kelvin - _AROUND, point.parameters[
        "environment.ambient_temperature"]), kelvin + _AROUND, 121)
    figure, (ax,) = new_figure(height=4.2)
    branches: tuple[tuple[Branch, str], ...] = (("heating", SECOND), ("cooling", MEASURED))
    for branch, colour in branches:
        steady = [_steady(point, together, t, branch) for t in around]
        ax.plot(around, 1e3 * np.array(steady), color=colour, lw=1.6, label=f"steady, {branch}")
    drawn = 1e3 * (point.deflection + slope * (around - kelvin))
    here = np.abs(drawn - 1e3 * point.deflection) < 0.7 * max(np.ptp(drawn), 1e-9)
    ax.plot(around[here], drawn[here], "--", color=MODEL, lw=1.4, label="linearised")
    ax.plot([kelvin], [1e3 * point.deflection], "o", color=MODEL, ms=6)
    ax.set(xlabel="temperature of the driven wires [K]", ylabel="deflection [mm]")
    ax.legend(fontsize=8)
    caption = (
        f"About {point.voltage[wire]:.4g} V on the {point.branch} branch: "
        f"{1e3 * slope:.4g} mm per kelvin of the wires that share {kelvin:.2f} K. "
        "Data: none, computed from the parameters."
    )
    return Picture("linearised", "Steady states and their tangent", caption, figure)


def _steady(point: OperatingPoint, together: np.ndarray, kelvin: float, branch: Branch) -> float:
    temperature = np.where(together, kelvin, point.temperature)
    try:
        at = OperatingPoint.at_temperature(point.parameters, temperature, branch)
    except InputError:
        return float("nan")
    return at.deflection
