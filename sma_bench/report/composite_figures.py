"""Figs. 11, 15 and 16 of the paper: the composite's bench, its voltages and deflections; and two of
the errata drawn."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch, Polygon, Rectangle

from sma_bench.estimation.observation import find_rig
from sma_bench.identify.estimate import Array
from sma_bench.parameters import Parameters
from sma_bench.parameters.parameters import as_recorded
from sma_bench.physics import bending, phase, simulate
from sma_bench.physics import linear_coefficients as linear
from sma_bench.physics.bending import Beam
from sma_bench.records.record import Record
from sma_bench.records.samples import held_voltages
from sma_bench.report.drawing import FAINT, MEASURED, MODEL, SECOND, new_figure
from sma_bench.report.page import Picture

# --- Fig. 11 of the paper as a drawing: the test bench of the composite.

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


# --- Figs. 15 and 16 of the paper: voltages of the composite and the deflections they lead to.

_OFF = 0.02  # of the largest voltage
_SHORTEST_REST = 1.0  # s
_LAST_PART = 0.1


@dataclass(frozen=True)
class CompositeRun:
    """One record of the composite and its simulation.

    Attributes:
        record: where it comes from.
        time: (n,) s; voltage: (n,) V, front positive and back negative; simulated: (n,) m.
        measured: time (m,) s and deflection (m,) m.
        rests: (start, stop) s of the intervals at zero voltage after a drive.
    """

    record: Record
    time: Array
    voltage: Array
    simulated: Array
    measured: tuple[Array, Array]
    rests: tuple[tuple[float, float], ...]

    def left_over(self) -> list[tuple[float, float]]:
        """Deflection [m] measured and simulated at the end of every rest."""
        found = []
        for start, stop in self.rests:
            late = stop - _LAST_PART * (stop - start)
            found.append(
                (_mean(*self.measured, late, stop), _mean(self.time, self.simulated, late, stop))
            )
        return found


def composite_run(record: Record, parameters: Parameters) -> CompositeRun:
    """Simulate the voltages of a record beside what it measured.

    Args:
        parameters: of the rig, bench.channels those of the record.

    Raises:
        InputError: the record lacks the voltage of a channel, or a deflection.
    """
    rig = find_rig(record, parameters)
    time, voltage = held_voltages(record, parameters["bench.channels"])
    simulated = simulate(as_recorded(parameters), time, voltage).deflection
    front = np.array(parameters["bench.channel_sides"]) == "front"
    signed = _largest(voltage[:, front]) - _largest(voltage[:, ~front])
    deflection = next(m for m in rig.measured if m.quantity == "deflection")
    return CompositeRun(
        record, time, signed, simulated, (deflection.time, deflection.values),
        _rests(time, signed),
    )


def composite_voltage_picture(runs: Sequence[CompositeRun]) -> Picture:
    """Fig. 15: input voltages, one panel a record."""
    figure, axes = new_figure(len(runs), 1.0 + 2.1 * len(runs), shared=False)
    for letter, ax, run in zip("abcdefgh", axes, runs, strict=False):
        _shade(ax, run)
        ax.plot(run.time, run.voltage, color=MEASURED, lw=1.2)
        ax.axhline(0.0, color=FAINT, lw=0.6)
        ax.set(xlabel="time [s]", ylabel="voltage [V]")
        ax.set_title(f"({letter})", loc="left", fontsize=10)
        _label_sides(ax)
    caption = (
        "Input of eq. (2): positive voltages drive the front wires, negative ones stand for the "
        f"back wires; shaded: zero voltage, the wires cool. {_sources(runs)}"
    )
    return Picture("figure_15_voltage", "Input voltage of the composite", caption, figure)


def composite_deflection_picture(runs: Sequence[CompositeRun]) -> Picture:
    """Fig. 16: deflections, measured and simulated, one panel a record."""
    figure, axes = new_figure(len(runs), 1.0 + 2.4 * len(runs), shared=False)
    for letter, ax, run in zip("abcdefgh", axes, runs, strict=False):
        _shade(ax, run)
        time, deflection = run.measured
        ax.plot(time, 1e3 * deflection, color=MEASURED, lw=3, alpha=0.45, label="measured")
        ax.plot(run.time, 1e3 * run.simulated, color=MODEL, lw=1.1, label="simulated")
        ax.axhline(0.0, color=FAINT, lw=0.6)
        ax.set(xlabel="time [s]", ylabel="deflection [mm]")
        ax.set_title(f"({letter})", loc="left", fontsize=10)
        _label_sides(ax)
    axes[0].legend(loc="upper right", fontsize=8)
    _annotate_rest(axes[0], runs[0])
    caption = (
        "Eqs. (2), (6), (7), (9) to (11) of every wire, bent together by the corrected eqs. (15) "
        f"and (17). {_left_over_text(runs)} {_sources(runs)}"
    )
    return Picture("figure_16_deflection", "Deflection of the composite", caption, figure)


def _largest(voltage: Array) -> Array:
    return voltage.max(axis=1) if voltage.shape[1] else np.zeros(len(voltage))


def _rests(time: Array, voltage: Array) -> tuple[tuple[float, float], ...]:
    off = np.abs(voltage) < _OFF * np.abs(voltage).max()
    if off.all():
        return ()
    off[: int(np.argmin(off))] = False  # before the first drive there is nothing to cool
    edges = np.flatnonzero(np.diff(np.concatenate([[False], off, [False]]).astype(int)))
    spans = [
        (float(time[first]), float(time[last - 1]))
        for first, last in zip(edges[::2], edges[1::2], strict=True)
    ]
    return tuple((a, b) for a, b in spans if b - a > _SHORTEST_REST)


def _mean(time: Array, values: Array, start: float, stop: float) -> float:
    inside = (time >= start) & (time <= stop)
    return float(np.mean(values[inside])) if inside.any() else float("nan")


def _shade(ax: Axes, run: CompositeRun) -> None:
    for start, stop in run.rests:
        ax.axvspan(start, stop, color=FAINT, alpha=0.13, lw=0)


def _label_sides(ax: Axes) -> None:
    for text, height, align in (("front", 0.97, "top"), ("back", 0.03, "bottom")):
        ax.text(
            0.008, height, text, transform=ax.transAxes, fontsize=8, color=FAINT, va=align,
        )


def _annotate_rest(ax: Axes, run: CompositeRun) -> None:
    if not run.rests:
        return
    start, stop = run.rests[0]
    ax.annotate(
        "zero voltage", (0.5 * (start + stop), 0.97), xycoords=("data", "axes fraction"),
        xytext=(0, 0), textcoords="offset points", ha="center", va="top", fontsize=8,
        color=FAINT,
    )


def _left_over_text(runs: Sequence[CompositeRun]) -> str:
    left = np.array([pair for run in runs for pair in run.left_over()])
    if not len(left):
        return ""
    measured, simulated = 1e3 * np.nanmax(np.abs(left), axis=0)
    return (
        f"At the end of the zero-voltage intervals up to {measured:.2g} mm are left in the record "
        f"and {simulated:.2g} mm in the simulation. The paper saw its simulation return to zero "
        "there and its specimen not."
    )


def _sources(runs: Sequence[CompositeRun]) -> str:
    return "; ".join(str(run.record.path) for run in runs)


# --- What the slips of eqs. (17) and (20) do, drawn.

def errata_picture(parameters: Parameters | None = None) -> Picture:
    """Eq. (20) as a tangent of eq. (10), and eq. (17) against eq. (16) integrated twice."""
    paper = parameters or Parameters.defaults()
    figure, (kinetics, deflection) = new_figure(rows=2, height=6.4, shared=False)
    start = paper["wire.austenite_start_temperature"]
    finish = paper["wire.austenite_finish_temperature"]
    at, kelvin = 0.5 * (start + finish), np.linspace(start - 8.0, finish + 8.0, 400)
    here = float(phase.heated_fraction(at, 0.0, paper))
    kinetics.plot(
        kelvin, phase.heated_fraction(kelvin, 0.0, paper), color=MEASURED, lw=2, label="eq. (10)"
    )
    for slope, colour, label in (
        (linear.b1_as_printed, SECOND, "eq. (20) as printed"),
        (linear.b1, MODEL, "eq. (20) corrected"),
    ):
        line = here - float(slope(at, 0.0, paper)) * (kelvin - at)
        kinetics.plot(kelvin, line, "--", color=colour, label=label)
    kinetics.plot([at], [here], "o", color=FAINT, ms=5)
    kinetics.set(xlabel="temperature [K]", ylabel="martensite fraction ξ", ylim=(-0.15, 1.15))
    kinetics.legend(fontsize=8)
    beam = Beam.of(paper)
    strain = np.linspace(0.0, paper["wire.maximum_recoverable_strain"], 9)
    for law, style, colour, label in (
        (bending.deflection_as_printed, "--", SECOND, "eq. (17) as printed"),
        (bending.deflection, "-", MODEL, "eq. (17) corrected"),
    ):
        bent = [1e3 * law(float(e), beam) for e in strain]
        deflection.plot(100.0 * strain, bent, style, color=colour, label=label)
    twice = [1e3 * _integrated_twice(float(e), beam) for e in strain]
    deflection.plot(
        100.0 * strain, twice, "o", mfc="none", color=MEASURED, label="eq. (16) integrated twice"
    )
    deflection.set(xlabel="contraction of the active layer [%]", ylabel="deflection [mm]")
    deflection.legend(fontsize=8)
    caption = (
        "Errata 6 and 2: the tangent that eq. (20) is meant to be, at no stress and half of the "
        "transformation; and eq. (17). Data: none, evaluated from the equations with Table II and "
        "an assumed geometry."
    )
    return Picture("errata", "Two of the errata", caption, figure)


def _integrated_twice(strain: float, beam: Beam) -> float:
    x = np.linspace(0.0, beam.length, 401)
    slope = bending.curvature(strain, beam) * x
    return float(np.sum(0.5 * (slope[1:] + slope[:-1]) * np.diff(x)))
