"""Fig. 7 of the paper: all scans of a DSC run in one graph."""

import re

from matplotlib.axes import Axes

from sma_bench.identify.estimate import Estimate, Experiment
from sma_bench.report.drawing import FAINT, MEASURED, SECOND, new_figure
from sma_bench.report.page import Picture

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
