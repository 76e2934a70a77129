"""Figs. 15 and 16 of the paper: the composite's bench, its voltages and deflections; and two of
the errata drawn."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from sma_bench.errors import InputError
from sma_bench.estimation.observation import find_rig
from sma_bench.identify.estimate import Array
from sma_bench.parameters import Parameters
from sma_bench.parameters.table import BY_NAME
from sma_bench.physics import bending, material, simulate
from sma_bench.physics import linear_coefficients as linear
from sma_bench.physics.bending import Beam
from sma_bench.physics.linearised import Linearised
from sma_bench.physics.operating_point import Branch, OperatingPoint
from sma_bench.records.record import Record
from sma_bench.records.samples import drive_of
from sma_bench.report.drawing import FAINT, MEASURED, MODEL, SECOND, new_figure, one_panel
from sma_bench.report.page import Picture, captions, pictured

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
        lifelike: (n,) m, simulated with RESTS_BENT; None beside a measured record.
        rests: (start, stop) s of the intervals at zero voltage after a drive.
    """

    record: Record
    time: Array
    voltage: Array
    simulated: Array
    measured: tuple[Array, Array]
    rests: tuple[tuple[float, float], ...]
    lifelike: Array | None = None

    def left_over(self) -> list[tuple[float, float]]:
        """Deflection [m] measured and simulated at the end of every rest."""
        found = []
        for start, stop in self.rests:
            late = stop - _LAST_PART * (stop - start)
            found.append(
                (_mean(*self.measured, late, stop), _mean(self.time, self.simulated, late, stop))
            )
        return found


# What the paper's specimen showed and its simulation did not: it stays bent at zero voltage. Sizes
# are assumed, of the order that the effects' own pages give.
RESTS_BENT = {
    "effect.residual_strain.share": 0.1, "effect.side_heat_coupling.conductance": 0.006,
}


def composite_run(
    record: Record, parameters: Parameters, *, with_rest_deflection: bool = False
) -> CompositeRun:
    """Simulate the voltages of a record beside what it measured.

    Args:
        parameters: of the rig, bench.channels those of the record.
        with_rest_deflection: whether to simulate the specimen with RESTS_BENT beside the ideal.

    Raises:
        InputError: the record lacks the voltage of a channel, or a deflection.
    """
    rig = find_rig(record, parameters)
    driven, time, voltage = drive_of(record, parameters)
    simulated = simulate(driven, time, voltage).deflection
    lifelike = None
    if with_rest_deflection:
        lifelike = simulate(driven.replace(RESTS_BENT), time, voltage).deflection
    front = np.array(parameters["bench.channel_sides"]) == "front"
    signed = _largest(voltage[:, front]) - _largest(voltage[:, ~front])
    deflection = next(m for m in rig.measured if m.quantity == "deflection")
    return CompositeRun(
        record, time, signed, simulated, (deflection.time, deflection.values),
        _rests(time, signed), lifelike,
    )


def composite_voltage_picture(runs: Sequence[CompositeRun]) -> Picture:
    """Fig. 15: input voltages, one panel a record."""
    figure, axes = _panels(runs, "voltage [V]", 2.1)
    for ax, run in zip(axes, runs, strict=True):
        ax.plot(run.time, run.voltage, color=MEASURED, lw=1.2)
        ax.axhline(0.0, color=FAINT, lw=0.6)
    return pictured("figure_15_voltage", figure, source=_sources(runs))


def composite_deflection_picture(runs: Sequence[CompositeRun]) -> Picture:
    """Fig. 16: deflections, measured and simulated, one panel a record."""
    figure, axes = _panels(runs, "deflection [mm]", 2.4)
    for ax, run in zip(axes, runs, strict=True):
        time, deflection = run.measured
        ax.plot(time, 1e3 * deflection, color=MEASURED, lw=3, alpha=0.45, label="measured")
        ax.plot(run.time, 1e3 * run.simulated, color=MODEL, lw=1.1, label="simulated")
        if run.lifelike is not None:
            ax.plot(
                run.time, 1e3 * run.lifelike, "--", color=SECOND, lw=1.1,
                label="with residual strain and heat from the other side",
            )
        ax.axhline(0.0, color=FAINT, lw=0.6)
    axes[0].legend(loc="upper right", fontsize=8)
    if runs[0].rests:
        middle = sum(runs[0].rests[0]) / 2.0
        axes[0].text(middle, 0.97, "zero voltage", ha="center", va="top", fontsize=8, color=FAINT,
                     transform=axes[0].get_xaxis_transform())
    left_over = _left_over_text(runs)
    return pictured("figure_16_deflection", figure, left_over=left_over, source=_sources(runs))


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


def _panels(
    runs: Sequence[CompositeRun], label: str, height: float
) -> tuple[Figure, Sequence[Axes]]:
    """A panel a record, its rests shaded, the sides named where they are drawn."""
    figure, axes = new_figure(len(runs), 1.0 + height * len(runs), shared=False)
    for letter, ax, run in zip("abcdefgh", axes, runs, strict=False):
        for start, stop in run.rests:
            ax.axvspan(start, stop, color=FAINT, alpha=0.13, lw=0)
        ax.set(xlabel="time [s]", ylabel=label)
        ax.set_title(f"({letter})", loc="left", fontsize=10)
        for text, place, align in (("front", 0.97, "top"), ("back", 0.03, "bottom")):
            ax.text(0.008, place, text, transform=ax.transAxes, fontsize=8, color=FAINT, va=align)
    return figure, axes


def _left_over_text(runs: Sequence[CompositeRun]) -> str:
    left = np.array([pair for run in runs for pair in run.left_over()])
    if not len(left):
        return ""
    measured, simulated = 1e3 * np.nanmax(np.abs(left), axis=0)
    bent = [
        abs(_mean(run.time, run.lifelike, stop - _LAST_PART * (stop - start), stop))
        for run in runs if run.lifelike is not None for start, stop in run.rests
    ]
    text = captions()["figure_16_deflection"]
    said = text["left_over"].format(measured=measured, simulated=simulated)
    if not bent:
        return said
    sizes = ", ".join(f"{name.removeprefix('effect.')} {x:g}" for name, x in RESTS_BENT.items())
    unit = BY_NAME["effect.side_heat_coupling.conductance"].unit
    return f"{said} {text['bent'].format(sizes=sizes, unit=unit, bent=1e3 * max(bent))}"


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
    here = float(material.heated_fraction(at, 0.0, paper))
    fraction = material.heated_fraction(kelvin, 0.0, paper)
    kinetics.plot(kelvin, fraction, color=MEASURED, lw=2, label="eq. (10)")
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
    return pictured("errata", figure)


def _integrated_twice(strain: float, beam: Beam) -> float:
    x = np.linspace(0.0, beam.length, 401)
    slope = bending.curvature(strain, beam) * x
    return float(np.sum(0.5 * (slope[1:] + slope[:-1]) * np.diff(x)))


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
    figure, ax = one_panel("temperature of the driven wires [K]", "deflection [mm]", 4.2)
    branches: tuple[tuple[Branch, str], ...] = (("heating", SECOND), ("cooling", MEASURED))
    for branch, colour in branches:
        steady = [_steady(point, together, t, branch) for t in around]
        ax.plot(around, 1e3 * np.array(steady), color=colour, lw=1.6, label=f"steady, {branch}")
    drawn = 1e3 * (point.deflection + slope * (around - kelvin))
    here = np.abs(drawn - 1e3 * point.deflection) < 0.7 * max(np.ptp(drawn), 1e-9)
    ax.plot(around[here], drawn[here], "--", color=MODEL, lw=1.4, label="linearised")
    ax.plot([kelvin], [1e3 * point.deflection], "o", color=MODEL, ms=6)
    ax.legend(fontsize=8)
    return pictured(
        "linearised", figure, volts=point.voltage[wire], branch=point.branch, slope=1e3 * slope,
        kelvin=kelvin,
    )


def _steady(point: OperatingPoint, together: np.ndarray, kelvin: float, branch: Branch) -> float:
    temperature = np.where(together, kelvin, point.temperature)
    try:
        at = OperatingPoint.at_temperature(point.parameters, temperature, branch)
    except InputError:
        return float("nan")
    return at.deflection
