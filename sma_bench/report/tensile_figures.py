"""Figs. 9 and 10 of the paper: tensile tests (E7) and the clamped staircase (E8)."""

import numpy as np
from matplotlib.axes import Axes

from sma_bench.identify.estimate import Array, Estimate, Experiment
from sma_bench.identify.instruments.tensile import MODULUS, SYMBOL
from sma_bench.identify.instruments.thermal_expansion import PARAMETER
from sma_bench.report.drawing import FAINT, MEASURED, MODEL, SECOND, new_figure
from sma_bench.report.page import Picture

_COLOURS = {"martensite": MEASURED, "austenite": SECOND}
_LINE_STRAIN = 0.012
_BEYOND = 0.9  # of the highest stress


def tensile_picture(e7: Experiment) -> Picture:
    """Fig. 9: stress over strain of both phases, the slopes that are E_M and E_A beside them."""
    figure, (ax,) = new_figure(height=4.6)
    tests = [key.rpartition("/")[0] for key in e7.curves if key.endswith("/stress")]
    seen: set[str] = set()
    for test in tests:
        phase = test.partition("/")[0]
        strain, stress = e7.curves[f"{test}/strain"], e7.curves[f"{test}/stress"]
        ax.plot(
            100.0 * strain, stress / 1e6, color=_COLOURS[phase], lw=1.1, alpha=0.7,
            label=None if phase in seen else phase,
        )
        if phase not in seen and MODULUS[phase] in e7.estimates:  # type: ignore[index]
            _draw_slope(ax, e7, phase, strain, stress)
        seen.add(phase)
    _draw_detwinning(ax, e7)
    ax.set(xlabel="strain [%]", ylabel="stress [MPa]")
    ax.legend(loc="upper left")
    caption = (
        "Tensile tests at constant temperature; the slopes drawn are the moduli of eq. (7), taken "
        f"outside toe and plateau. {e7.source}"
    )
    return Picture("figure_09_tensile", "Stress against strain", caption, figure)


def _draw_slope(ax: Axes, e7: Experiment, phase: str, strain: Array, stress: Array) -> None:
    modulus = e7.estimates[MODULUS[phase]]  # type: ignore[index]
    begins = _slope_begins(e7, phase)
    lowest = float(np.interp(begins, strain, stress))
    longest = (_BEYOND * float(stress.max()) - lowest) / modulus.value
    ends = np.array([begins, begins + min(_LINE_STRAIN, longest)])
    ax.plot(
        100.0 * ends, (lowest + modulus.value * (ends - begins)) / 1e6, "--", color=MODEL, lw=1.5,
        zorder=3, label=f"${SYMBOL[phase]}$ = {_gigapascal(modulus)}",
    )


def _gigapascal(modulus: Estimate) -> str:
    return f"{modulus.value / 1e9:.1f} ± {modulus.std / 1e9:.1f} GPa"


def _slope_begins(e7: Experiment, phase: str) -> float:
    """Strain at which the part that gave the modulus begins."""
    after = phase == "martensite" and f"{SYMBOL['martensite']} after the plateau" in e7.details
    name = f"{phase} plateau end" if after else f"{phase} toe"
    return max(e7.details[name].value, 0.0)


def _draw_detwinning(ax: Axes, e7: Experiment) -> None:
    bounds = [e7.details.get(f"martensite plateau {name}") for name in ("begin", "end")]
    begin, end = bounds
    if begin is None or end is None:
        return
    ax.axvspan(100.0 * begin.value, 100.0 * end.value, color=FAINT, alpha=0.12, lw=0)
    ax.text(
        50.0 * (begin.value + end.value), 0.02, "detwinning", ha="center", fontsize=8,
        color=FAINT, transform=ax.get_xaxis_transform(),
    )


def thermal_expansion_picture(e8: Experiment) -> Picture:
    """Fig. 10: stress of the clamped wire over temperature below A_s, with the line of eq. (8)."""
    figure, (ax,) = new_figure()
    curves = e8.curves
    used = curves["used"] > 0.5
    theta: Estimate = e8.estimates[PARAMETER]
    ax.plot(
        curves["temperature"][used], curves["stress"][used] / 1e6, "o", mfc="none", ms=6,
        color=MEASURED, label="plateaus",
    )
    if not used.all():
        ax.plot(
            curves["temperature"][~used], curves["stress"][~used] / 1e6, "x", ms=6, color=FAINT,
            label="left out",
        )
    order = np.argsort(curves["temperature"][used])
    ax.plot(
        curves["temperature"][used][order], curves["line"][used][order] / 1e6, color=MODEL,
        label=f"$\\Theta_T$ = {theta.value / 1e6:.3f} ± {theta.std / 1e6:.3f} MPa/K",
    )
    ax.set(xlabel="temperature [K]", ylabel="stress [MPa]")
    ax.legend()
    caption = (
        "Steady stress of the clamped wire below A_s and eq. (8). The wire was clamped under "
        f"tension; as it expands it loses some, so the slope is negative. {e8.source}"
    )
    return Picture(
        "figure_10_thermal_expansion", "Stress of the clamped wire against temperature", caption,
        figure,
    )
