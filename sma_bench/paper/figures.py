"""Figs. 15 and 16 of the paper: the composite's bench, its voltages and deflections; and E11."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sma_bench.arrays import Array
from sma_bench.estimation.observation import find_rig
from sma_bench.parameters import Parameters
from sma_bench.parameters.parameter import BY_NAME
from sma_bench.physics import simulate
from sma_bench.physics.linearised import Branch, Linearised, OperatingPoint
from sma_bench.records.record import Record, drive_of
from sma_bench.report.drawing import FAINT, MEASURED, MODEL, SECOND, graph, new_figure
from sma_bench.report.page import Picture, captions, pictured

# --- Figs. 15 and 16 of the paper: voltages of the composite and the deflections they lead to.

_OFF = 0.02  # of the largest voltage
_SHORTEST_REST = 1.0  # s
_LAST_PART = 0.1  # of a rest, in which what is left over is read
# What the paper's specimen showed and its simulation did not: it stays bent at zero voltage. Sizes
# are assumed, of the order that the effects' own pages give.
RESTS_BENT = {"effect.residual_strain.share": 0.1, "effect.side_heat_coupling.conductance": 0.006}


@dataclass(frozen=True)
class CompositeRun:
    """One record of the composite and its simulation."""

    record: Record  # where it comes from
    time: Array  # (n,) s
    voltage: Array  # (n,) V, front positive and back negative
    simulated: Array  # (n,) m
    measured: tuple[Array, Array]  # time (m,) s and deflection (m,) m
    # (start, stop) s of the intervals at zero voltage after a drive
    rests: tuple[tuple[float, float], ...]
    lifelike: Array | None = None  # (n,) m, simulated with RESTS_BENT; None of a measured record

    def left_over(self) -> list[tuple[float, float]]:
        """Deflection [m] measured and simulated at the end of every rest."""
        curves = (self.measured, (self.time, self.simulated))
        return [
            (_at_the_end(*curves[0], rest), _at_the_end(*curves[1], rest)) for rest in self.rests
        ]


def _at_the_end(time: Array, values: Array, rest: tuple[float, float]) -> float:
    """Mean over the last part of a rest (start, stop) s; NaN where there is no sample."""
    start, stop = rest
    inside = (time >= stop - _LAST_PART * (stop - start)) & (time <= stop)
    return float(np.mean(values[inside])) if inside.any() else float("nan")


def composite_run(
    record: Record, parameters: Parameters, *, with_rest_deflection: bool = False
) -> CompositeRun:
    """Simulate the voltages of a record next to what it measured. `parameters`: of the rig,
    bench.channels those of the record; `with_rest_deflection`: whether to simulate the specimen
    with RESTS_BENT too. Raises InputError: the record lacks the voltage of a channel, or a
    deflection."""
    measured = next(m for m in find_rig(record, parameters).measured if m.quantity == "deflection")
    driven, time, voltage, _ = drive_of(record, parameters)
    simulated, lifelike = simulate(driven, time, voltage).deflection, None
    if with_rest_deflection:
        lifelike = simulate(driven.replace(RESTS_BENT), time, voltage).deflection
    front = np.array(parameters["bench.channel_sides"]) == "front"
    forward, back = (
        voltage[:, side].max(axis=1) if side.any() else 0.0 for side in (front, ~front)
    )
    signed = np.asarray(forward - back)

    # Rests: stretches without voltage; before the first drive there is nothing to cool.
    off = np.abs(signed) < _OFF * np.abs(signed).max()
    off[: len(off) if off.all() else int(np.argmin(off))] = False
    edges = np.flatnonzero(np.diff(np.concatenate([[False], off, [False]]).astype(int)))
    spans = [(float(time[i]), float(time[k - 1])) for i, k in edges.reshape(-1, 2)]
    rests = tuple((start, stop) for start, stop in spans if stop - start > _SHORTEST_REST)
    found = (measured.time, measured.values)
    return CompositeRun(record, time, signed, simulated, found, rests, lifelike)


def composite_pictures(runs: Sequence[CompositeRun]) -> tuple[Picture, Picture]:
    """Figs. 15 and 16: input voltages, and deflections measured and simulated; a panel a record,
    its rests shaded."""
    source, text, said = "; ".join(str(run.record.path) for run in runs), captions(), ""
    volts, above = new_figure(len(runs), 1.0 + 2.1 * len(runs), shared=False)
    bent, below = new_figure(len(runs), 1.0 + 2.4 * len(runs), shared=False)
    more = "with residual strain and heat from the other side"
    for k, (run, upper, lower) in enumerate(zip(runs, above, below, strict=True)):
        time, deflection = run.measured
        upper.plot(run.time, run.voltage, color=MEASURED, lw=1.2)
        lower.plot(time, 1e3 * deflection, color=MEASURED, lw=3, alpha=0.45, label="measured")
        lower.plot(run.time, 1e3 * run.simulated, color=MODEL, lw=1.1, label="simulated")
        if run.lifelike is not None:
            lower.plot(run.time, 1e3 * run.lifelike, "--", color=SECOND, lw=1.1, label=more)
        for ax, label in ((upper, "voltage [V]"), (lower, "deflection [mm]")):
            for start, stop in run.rests:
                ax.axvspan(start, stop, color=FAINT, alpha=0.13, lw=0)
            ax.axhline(0.0, color=FAINT, lw=0.6)
            ax.set(xlabel="time [s]", ylabel=label)
            ax.set_title(f"({chr(ord('a') + k)})", loc="left", fontsize=10)
    below[0].legend(loc="upper right", fontsize=8)

    # In words: what is left at the end of the rests, and what effects would leave.
    if left := [pair for run in runs for pair in run.left_over()]:
        measured, simulated = 1e3 * np.nanmax(np.abs(left), axis=0)
        said = text["figure_16_deflection"]["left_over"]
        said = said.format(measured=measured, simulated=simulated)
    if ends := [
        abs(_at_the_end(run.time, run.lifelike, rest))
        for run in runs if run.lifelike is not None for rest in run.rests
    ]:  # fmt: skip
        sizes = ", ".join(f"{n.removeprefix('effect.')} {x:g}" for n, x in RESTS_BENT.items())
        unit = BY_NAME["effect.side_heat_coupling.conductance"].unit
        words = text["figure_16_deflection"]["bent"]
        said += " " + words.format(sizes=sizes, unit=unit, bent=1e3 * max(ends))
    return (
        pictured("figure_15_voltage", volts, source=source),
        pictured("figure_16_deflection", bent, left_over=said, source=source),
    )


# --- E11: a tangent of the steady states.

_AROUND = 12.0  # K


def operating_point_picture(model: Linearised) -> Picture:
    """Steady deflection (or its kin) over the temperature of the warmest wire, both branches, and
    the tangent of eqs. (18) to (23)."""
    point, parameters = model.point, model.point.parameters
    wire = int(np.argmax(point.temperature))
    kelvin = float(point.temperature[wire])
    together = np.isclose(point.temperature, kelvin)
    slope = float(model.deflection_per_kelvin[together].sum())
    coldest = max(kelvin - _AROUND, parameters["environment.ambient_temperature"])
    around = np.linspace(coldest, kelvin + _AROUND, 121)
    figure, ax = graph("temperature of the driven wires [K]", "deflection [mm]", height=4.2)
    branches: tuple[tuple[Branch, str], ...] = (("heating", SECOND), ("cooling", MEASURED))
    for branch, colour in branches:
        steady = [
            1e3 * OperatingPoint.at_temperature(
                parameters, np.where(together, t, point.temperature), branch
            ).deflection
            for t in around
        ]
        ax.plot(around, steady, color=colour, lw=1.6, label=f"steady, {branch}")
    drawn = 1e3 * (point.deflection + slope * (around - kelvin))
    here = np.abs(drawn - 1e3 * point.deflection) < 0.7 * max(np.ptp(drawn), 1e-9)
    ax.plot(around[here], drawn[here], "--", color=MODEL, lw=1.4, label="linearised")
    ax.plot([kelvin], [1e3 * point.deflection], "o", color=MODEL, ms=6)
    ax.legend(fontsize=8)
    return pictured(
        "linearised", figure, volts=point.voltage[wire], branch=point.branch, slope=1e3 * slope,
        kelvin=kelvin,
    )
