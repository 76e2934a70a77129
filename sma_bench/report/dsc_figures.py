"""Fig. 7 of the paper: heat flow of a DSC run with the tangents that give the temperatures."""

from matplotlib.axes import Axes

from sma_bench.identify.estimate import Array, Experiment
from sma_bench.report.drawing import FAINT, MEASURED, MODEL, SECOND, new_figure
from sma_bench.report.page import Picture

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
