"""Figures 2 to 7 of the paper, redrawn from records: the wire's heat, and its DSC."""

import re

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from sma_bench.errors import InputError
from sma_bench.identify.estimate import Array, Estimate, Experiment
from sma_bench.parameters import Parameters
from sma_bench.physics.simulate import simulate
from sma_bench.records.held_voltages import held_voltages
from sma_bench.records.record import Record
from sma_bench.report.drawing import FAINT, MEASURED, MODEL, SECOND, legend_above, new_figure
from sma_bench.report.page import Picture

# --- Figures 2 to 6 of the paper, redrawn from records.

_JUMP = 0.2  # V between two samples


def resistance_picture(e1: Experiment) -> Picture:
    """Fig. 2: current over voltage in both directions, with the fitted line."""
    estimate = e1.estimates["wire.resistance"]
    label = f"R = {estimate.value:.4f} ± {estimate.std:.4f} ohm"
    figure = _plateau_figure(e1.curves, "current", "current [A]", label)
    caption = f"Plateau means and straight line, eq. (3), as Fig. 2. {e1.source}"
    return Picture("figure_02_resistance", "Current against voltage", caption, figure)


def heat_transfer_picture(e2: Experiment) -> Picture:
    """Fig. 3: steady temperature over voltage, with eq. (4) fitted."""
    estimate = e2.estimates["wire.heat_transfer_coefficient"]
    label = f"h = {estimate.value:.2f} ± {estimate.std:.2f} W/(m² K)"
    figure = _plateau_figure(e2.curves, "temperature", "steady temperature [K]", label)
    caption = f"Plateau means and eq. (4), as Fig. 3. {e2.source}"
    return Picture("figure_03_heat_transfer", "Steady temperature against voltage", caption, figure)


def _plateau_figure(curves: dict[str, Array], quantity: str, axis: str, fitted: str) -> Figure:
    """Plateau means of a quantity over voltage, heating and cooling told apart, and its line."""
    figure, (ax,) = new_figure()
    heating = curves["heating"] > 0.5
    for chosen, marker, colour, label in (
        (heating, "+", SECOND, "heating"), (~heating, "o", MEASURED, "cooling"),
    ):
        ax.plot(
            curves["voltage"][chosen], curves[quantity][chosen], marker, ms=6, mfc="none",
            color=colour, label=label,
        )
    ax.plot(curves["line_voltage"], curves[f"line_{quantity}"], color=MODEL, label=fitted)
    ax.set(xlabel="voltage [V]", ylabel=axis)
    ax.legend()
    return figure


def ramp_picture(e3: Experiment) -> Picture:
    """Fig. 4: temperature over voltage during the ramps of E3, with the fitted response."""
    figure, (ax,) = new_figure()
    curves = e3.curves
    ax.plot(curves["voltage"], curves["temperature"], ".", ms=2, color=MEASURED, label="measured")
    # No line across the jump to 0 V at a ramp's end: nothing happens there.
    jump = np.abs(np.diff(curves["voltage"], append=curves["voltage"][-1])) > _JUMP
    model = np.where(jump, np.nan, curves["model"])
    ax.plot(curves["voltage"], model, color=MODEL, lw=1, label="eq. (2), fitted")
    ax.set(xlabel="voltage [V]", ylabel="temperature [K]")
    ax.legend()
    caption = f"Ramps and the cooling after them, eq. (2), as Fig. 4. {e3.source}"
    return Picture("figure_04_ramp", "Temperature against voltage", caption, figure)


def slope_picture(e3: Experiment) -> Picture:
    """Fig. 5: derivative of temperature over f(T, V), slope 1/c_p."""
    figure, (ax,) = new_figure()
    force, rate = e3.curves["force"], e3.curves["rate"]
    ax.plot(force, rate, ".", ms=2, color=FAINT, label="differentiator filter")
    ends = np.array([0.0, float(np.nanmax(force))])
    lines = (
        (e3.details["differentiator"], "--", SECOND, "slope as in the paper"),
        (e3.estimates["wire.specific_heat"], "-", MODEL, "most likely c_p"),
    )
    for estimate, style, colour, name in lines:
        label = f"{name}: {estimate.value:.1f} ± {estimate.std:.1f} J/(kg K)"
        ax.plot(ends, ends / estimate.value, style, color=colour, label=label)
    ax.set(xlabel="f(T, V) [W/kg]", ylabel="dT/dt [K/s]")
    ax.legend()
    caption = (
        f"Eq. (5), as Fig. 5; noise in both axes pulls the plain slope off, so c_p is fitted to "
        f"the temperature itself. {e3.source}"
    )
    return Picture("figure_05_specific_heat", "dT/dt against f(T, V)", caption, figure)


def validation_picture(record: Record, parameters: Parameters) -> tuple[Picture, float]:
    """Fig. 6: a triangular voltage, measured temperature and the simulation of eq. (2).

    Args:
        record: a wire-rig record that no parameter was fitted to.
        parameters: identified ones.

    Returns:
        The picture, and the root mean square error of the temperature [K].

    Raises:
        InputError: the record lacks voltage or temperature of the wire.
    """
    channel = parameters["bench.channels"][0]
    time, voltage = held_voltages(record, [channel])
    measured = record[f"{channel}.temperature"]
    simulated = simulate(parameters, time, voltage).temperature[:, 0]
    inside = (measured.time >= time[0]) & (measured.time <= time[-1])
    if not inside.any():
        raise InputError(f"{record.path}: no temperature while the voltage was measured")
    error = measured.values[inside] - np.interp(measured.time[inside], time, simulated)
    rmse = float(np.sqrt(np.mean(error**2)))
    return _validation_figure(record, channel, time, voltage, simulated, rmse), rmse


def _validation_figure(
    record: Record, channel: str, time: Array, voltage: Array, simulated: Array, rmse: float
) -> Picture:
    figure, (upper, lower) = new_figure(rows=2, height=5.0)
    measured = record[f"{channel}.temperature"]
    upper.plot(time, voltage[:, 0], color=MEASURED, lw=1)
    upper.set(ylabel="voltage [V]")
    lower.plot(
        measured.time, measured.values, ".", ms=1.5, color=MEASURED, label="measured",
        rasterized=True,
    )
    lower.plot(time, simulated, color=MODEL, lw=1, label=f"simulated, rms error {rmse:.2f} K")
    lower.set(xlabel="time [s]", ylabel="temperature [K]")
    legend_above(lower)
    caption = f"Eq. (2) with the identified parameters, as Fig. 6. {record.path}"
    return Picture("figure_06_validation", "Triangular voltage and temperature", caption, figure)


# --- Fig. 7 of the paper: heat flow of a DSC run with the tangents that give the temperatures.

_ENDS = ("start", "finish")


def dsc_pictures(e5: Experiment) -> list[Picture]:
    """One picture a scan: heat flow (transformation upward), baselines, tangents, crossings."""
    flows = [name for name in e5.curves if name.endswith("/heat_flow")]
    return [_scan_picture(e5, name.removesuffix("/heat_flow")) for name in flows]


def _scan_picture(e5: Experiment, label: str) -> Picture:
    figure, (ax,) = new_figure()
    curves = {
        name.removeprefix(f"{label}/"): curve
        for name, curve in e5.curves.items()
        if name.startswith(f"{label}/")
    }
    ax.plot(curves["temperature"], curves["heat_flow"], color=MEASURED, label="heat flow")
    ax.plot(curves["temperature"], curves["base"], ":", color=FAINT, label="baseline of the area")
    for end in _ENDS:
        _draw_onset(ax, e5, label, end, curves)
    _frame(ax, e5, label, curves)
    ax.set(xlabel="temperature [K]", ylabel="heat flow [W/kg]")
    ax.legend()
    heat = e5.details[f"{label}/latent_heat"]
    caption = (
        f"Baselines and tangents, as Fig. 7; latent heat {heat.value / 1e3:.1f} ± "
        f"{heat.std / 1e3:.1f} kJ/kg. {e5.source}"
    )
    name = label.replace("/", "_")
    return Picture(f"figure_07_dsc_{name}", f"DSC, {label.replace('_', ' ')}", caption, figure)


def _draw_onset(
    ax: Axes, e5: Experiment, label: str, end: str, curves: dict[str, Array]
) -> None:
    onset = e5.details[f"{label}/{end}"]
    for line in ("baseline", "tangent"):
        ax.plot(
            curves[f"{end}/{line}_temperature"], curves[f"{end}/{line}"], color=MODEL, lw=1,
        )
    ax.plot(
        curves[f"{end}/tangent_temperature"][0], curves[f"{end}/tangent"][0], "o", color=SECOND,
        ms=6, mfc="none", label=f"{end} {onset.value:.2f} ± {onset.std:.2f} K",
    )


def _frame(ax: Axes, e5: Experiment, label: str, curves: dict[str, Array]) -> None:
    """The peak and 40 K around it: a run's ends would flatten what matters."""
    ends = [e5.details[f"{label}/{end}"].value for end in _ENDS]
    low, high = min(ends) - 40.0, max(ends) + 40.0
    inside = (curves["temperature"] > low) & (curves["temperature"] < high)
    flow = curves["heat_flow"][inside]
    margin = 0.08 * (flow.max() - flow.min())
    ax.set_xlim(low, high)
    ax.set_ylim(flow.min() - margin, flow.max() + margin)


# --- Fig. 7 of the paper: all scans of a DSC run in one graph.

_COLOURS = (MEASURED, SECOND, "#2e7d32", "#7b4ea3")
_HEAT_FLOW = re.compile(r"(?P<scan>.*segment_\d+)/heat_flow\Z")
_SYMBOLS = {"heating": ("A_s", "A_f"), "cooling": ("M_s", "M_f")}


def dsc_overview_picture(e5: Experiment) -> Picture:
    """Heat flow over temperature, endothermic up: heating above, cooling below, by cycle.

    Args:
        e5: of identify_heating_rates or identify_transition_temperatures.
    """
    figure, (ax,) = new_figure(height=4.8)
    counts = {"heating": 0, "cooling": 0}
    scans = [match["scan"] for key in e5.curves if (match := _HEAT_FLOW.match(key))]
    for scan in scans:
        start, finish = (e5.details[f"{scan}/{end}"] for end in ("start", "finish"))
        direction = "heating" if start.value < finish.value else "cooling"
        counts[direction] += 1
        colour = _COLOURS[(counts[direction] - 1) % len(_COLOURS)]
        # The curves have their peaks upward; a graph of the run has cooling below.
        sign = 1.0 if direction == "heating" else -1.0
        ax.plot(
            e5.curves[f"{scan}/temperature"], sign * e5.curves[f"{scan}/heat_flow"], lw=1.2,
            color=colour, label=f"cycle {counts[direction]}" if sign > 0.0 else None,
        )
        symbols = zip(_SYMBOLS[direction], (("start", start), ("finish", finish)), strict=True)
        for symbol, (end, onset) in symbols:
            text = f"${symbol}$ ({counts[direction]})"
            # One row of labels a cycle: the onsets of cycles may coincide.
            below = -9.5 * sign * counts[direction]
            _mark(ax, e5, f"{scan}/{end}", onset, sign, colour, text, below)
    ax.set(xlabel="temperature [K]", ylabel="heat flow, endothermic up [W/kg]")
    ax.text(0.015, 0.93, "heating", transform=ax.transAxes, color=FAINT, fontsize=9)
    ax.text(0.015, 0.04, "cooling", transform=ax.transAxes, color=FAINT, fontsize=9)
    ax.legend(loc="upper right")
    caption = (
        "All scans of the run; rings and labels (symbol, cycle) where the tangents meet the "
        "baselines. Heat into the sample per mass is c_p dT/dt - Δh dξ/dt: eq. (1), with ξ of "
        f"eqs. (10), (11). {e5.source}"
    )
    return Picture("figure_07_dsc", "DSC measurement curve", caption, figure)


def _mark(
    ax: Axes, e5: Experiment, end: str, onset: Estimate, sign: float, colour: str, text: str,
    below: float,
) -> None:
    level = sign * float(e5.curves[f"{end}/tangent"][0])
    ax.plot([onset.value], [level], "o", ms=5, mfc="none", color=colour)
    ax.annotate(
        text, (onset.value, level), (0, below), textcoords="offset points", ha="center",
        va="center", fontsize=8, color=colour,
    )
