"""Fig. 8 of the paper and the stress-temperature diagram, from E6."""

import numpy as np
from matplotlib.axes import Axes

from sma_bench.identify.estimate import Array, Experiment
from sma_bench.report.drawing import FAINT, MEASURED, MODEL, SECOND, new_figure
from sma_bench.report.page import Picture

_DIRECTIONS = {"heating": (SECOND, "-"), "cooling": (MEASURED, "--")}
_TRANSITIONS = {
    # name: (parameter at zero stress, parameter of its line, colour, marker)
    "A_s": ("wire.austenite_start_temperature", "wire.stress_influence_austenite", SECOND, "o"),
    "A_f": ("wire.austenite_finish_temperature", "wire.stress_influence_austenite", SECOND, "s"),
    "M_s": ("wire.martensite_start_temperature", "wire.stress_influence_martensite", MEASURED, "^"),
    "M_f": ("wire.martensite_finish_temperature", "wire.stress_influence_martensite", MEASURED,
            "v"),
}
_SEVERAL = 4
_DRAWN = 2000


def isobaric_pictures(e6: Experiment) -> list[Picture]:
    """Contraction over temperature; the diagram too where several stresses were tested."""
    pictures = [upfr_picture(e6)]
    if any(len(e6.curves[f"diagram/{name}/stress"]) > 1 for name in _TRANSITIONS):
        pictures.append(stress_temperature_picture(e6))
    return pictures


def upfr_picture(e6: Experiment) -> Picture:
    """Fig. 8: contraction over temperature under a held load, with tangents and their crossings."""
    figure, (ax,) = new_figure(height=4.6)
    branches = _branches(e6)
    tests = list(dict.fromkeys(test for test, _, _ in branches))
    zeros = {test: _zero(branches, test) for test in tests}
    seen: set[str] = set()
    for (test, _, direction), curves in branches.items():
        colour, style = _DIRECTIONS[direction]
        if len(tests) > _SEVERAL:
            colour = f"C{tests.index(test) % 10}"
        label = direction if len(tests) <= _SEVERAL else test.rpartition("/")[2]
        ax.plot(
            *_thinned(curves["temperature"], 100.0 * (zeros[test] - curves["strain"])), style,
            color=colour, lw=1.2, alpha=0.75, label=None if label in seen else label,
        )
        seen.add(label)
    _draw_tangents(ax, branches, zeros)
    _mark_temperatures(ax, e6)
    relative = any(e.unit == "relative" for e in e6.details.values())
    of = "% of its range" if relative else "%"
    ax.set(xlabel="temperature [K]", ylabel=f"contraction [{of}]")
    ax.legend(loc="center left", fontsize=8)
    strain = e6.estimates.get("wire.maximum_recoverable_strain")
    told = f"; ε_L = {strain.value:.2%} ± {strain.std:.2%}" if strain else ""
    caption = (
        f"Contraction under a held load: eqs. (6), (9), (10) and, on cooling, (11), with the "
        f"tangents whose crossings are start and finish{told}. {e6.source}"
    )
    return Picture("figure_08_upfr", "Contraction against temperature (UPFR)", caption, figure)


def _branches(e6: Experiment) -> dict[tuple[str, str, str], dict[str, Array]]:
    """Curves by test, cycle and direction."""
    found: dict[tuple[str, str, str], dict[str, Array]] = {}
    for key, values in e6.curves.items():
        if key.startswith("diagram/"):
            continue
        test, cycle, direction, quantity = key.rsplit("/", 3)
        found.setdefault((test, cycle, direction), {})[quantity] = values
    return found


def _zero(branches: dict[tuple[str, str, str], dict[str, Array]], test: str) -> float:
    """Strain of a test where it is coldest: contraction counts from there."""
    mine = [curves for (name, _, _), curves in branches.items() if name == test]
    temperature = np.concatenate([curves["temperature"] for curves in mine])
    strain = np.concatenate([curves["strain"] for curves in mine])
    cold = temperature < np.quantile(temperature, 0.1)
    return float(np.median(strain[cold]))


def _thinned(x: Array, y: Array) -> tuple[Array, Array]:
    step = max(len(x) // _DRAWN, 1)
    return x[::step], y[::step]


def _draw_tangents(
    ax: Axes, branches: dict[tuple[str, str, str], dict[str, Array]], zeros: dict[str, float]
) -> None:
    """Tangents of the test in the middle: those of all would hide the curves."""
    tests = list(zeros)
    shown = tests[len(tests) // 2]
    first = next(cycle for test, cycle, _ in branches if test == shown)
    for (test, cycle, _), curves in branches.items():
        if (test, cycle) == (shown, first):
            tangents = curves["tangents"]
            ax.plot(
                tangents[:, 0], 100.0 * (zeros[test] - tangents[:, 1]), color=MODEL, lw=1.2,
                marker="o", markevery=[1, 2], ms=4, mfc="none", zorder=3,
            )


def _mark_temperatures(ax: Axes, e6: Experiment) -> None:
    """A_s and A_f under the load, where one load was tested."""
    for name, height in (("A_s", 0.3), ("A_f", 0.7)):
        found = [e for key, e in e6.details.items() if key.startswith(f"{name} (tangent) at ")]
        if len(found) != 1:
            continue
        (mean,) = found
        ax.axvline(mean.value, color=FAINT, lw=0.8, ls=":")
        ax.annotate(
            f"${name}$ = {mean.value:.2f} ± {mean.std:.2f} K",
            (mean.value, height), (28, 0),
            xycoords=("data", "axes fraction"), textcoords="offset points", fontsize=8,
            va="center", color=SECOND, arrowprops={"arrowstyle": "->", "color": FAINT, "lw": 0.7},
        )


def stress_temperature_picture(e6: Experiment) -> Picture:
    """Transition temperatures over stress with the lines whose slopes are 1/C_A and 1/C_M."""
    figure, (ax,) = new_figure(height=4.6)
    for name, (at_zero, influence, colour, marker) in _TRANSITIONS.items():
        points = {
            quantity: e6.curves[f"diagram/{name}/{quantity}"]
            for quantity in ("stress", "temperature", "std")
        }
        ax.errorbar(
            points["temperature"], points["stress"] / 1e6, xerr=points["std"], fmt=marker,
            color=colour, mfc="none", ms=6, capsize=2, label=f"${name}$",
        )
        if {at_zero, influence} <= set(e6.estimates) and len(points["stress"]):
            stress = np.array([0.0, float(points["stress"].max())])
            line = e6.estimates[at_zero].value + stress / e6.estimates[influence].value
            ax.plot(line, stress / 1e6, color=colour, lw=1)
    ax.set(xlabel="temperature [K]", ylabel="stress [MPa]")
    ax.set_ylim(bottom=0.0)
    ax.legend()
    told = [
        f"{symbol} = {e.value / 1e6:.2f} ± {e.std / 1e6:.2f} MPa/K"
        for symbol, name in (
            ("C_A", "wire.stress_influence_austenite"), ("C_M", "wire.stress_influence_martensite")
        )
        if (e := e6.estimates.get(name)) is not None
    ]
    caption = (
        "Transition temperatures at held stresses and lines of one slope a direction, the "
        f"influence of stress in eqs. (10), (11): {', '.join(told) or 'none told'}. {e6.source}"
    )
    return Picture("stress_temperature", "Stress-temperature diagram", caption, figure)
