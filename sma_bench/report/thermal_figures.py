"""Figures 2 to 6 of the paper, redrawn from records."""

import numpy as np
from matplotlib.figure import Figure

from sma_bench.errors import InputError
from sma_bench.identify.estimate import Array, Experiment
from sma_bench.parameters import Parameters
from sma_bench.physics.simulate import simulate
from sma_bench.records.held_voltages import held_voltages
from sma_bench.records.record import Record
from sma_bench.report.drawing import FAINT, MEASURED, MODEL, SECOND, legend_above, new_figure
from sma_bench.report.page import Picture

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
