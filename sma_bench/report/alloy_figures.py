"""Figures 8 to 10 of the paper (E6 to E8), and the fits of the whole model (E9, E10)."""

import numpy as np
from matplotlib.axes import Axes

from sma_bench.identify.estimate import Array, Estimate, Experiment
from sma_bench.identify.instruments.tensile import MODULUS, SYMBOL
from sma_bench.identify.instruments.thermal_expansion import PARAMETER
from sma_bench.report.drawing import FAINT, MEASURED, MODEL, SECOND, new_figure
from sma_bench.report.page import Picture

# --- Fig. 8 of the paper and the stress-temperature diagram, from E6.

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


# --- Figs. 9 and 10 of the paper: tensile tests (E7) and the clamped staircase (E8).

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


# --- E9 and E10: what was measured, and the model that was fitted to all of it.

_ROWS = 4
_FIRST = ("deflection", "force", "elongation", "temperature", "current")
_UNITS = {"deflection": "m", "force": "N", "elongation": "m", "temperature": "K", "current": "A"}


def constitutive_picture(e9: Experiment) -> Picture:
    """Strain over temperature of every loop with the fitted law."""
    figure, (ax,) = new_figure(height=4.6)
    loops = [key.removesuffix("/model") for key in e9.curves if key.endswith("/model")]
    for k, loop in enumerate(loops):
        temperature = e9.curves[f"{loop}/temperature"]
        ax.plot(
            temperature, 100.0 * e9.curves[f"{loop}/strain"], ".", ms=2, color=f"C{k % 10}",
            label=loop, rasterized=True,
        )
        ax.plot(temperature, 100.0 * e9.curves[f"{loop}/model"], color="black", lw=0.8)
    ax.set(xlabel="temperature [K]", ylabel="strain [%]")
    ax.legend(fontsize=7, markerscale=4, ncols=2 if len(loops) > 6 else 1)
    caption = (
        f"Strain under held stress, measured (points) and eqs. (6), (7), (9) to (11) fitted to all "
        f"loops at once (lines). {e9.source}"
    )
    return Picture("constitutive_fit", "Joint fit of the constitutive law", caption, figure)


def bench_fit_pictures(e10: Experiment) -> list[Picture]:
    """Signals of the rig over time with the fitted simulation, one picture a record."""
    signals = [key.removesuffix(".model") for key in e10.curves if key.endswith(".model")]
    records: dict[str, list[str]] = {}
    for signal in signals:
        head, _, rest = signal.partition(".")
        records.setdefault(head if head.isdecimal() and rest else "", []).append(signal)
    return [_bench_fit_picture(e10, head, chosen) for head, chosen in records.items()]


def _bench_fit_picture(e10: Experiment, head: str, signals: list[str]) -> Picture:
    shown = sorted(signals, key=lambda s: _FIRST.index(_quantity(s)))[:_ROWS]
    figure, axes = new_figure(rows=len(shown), height=1.2 + 1.9 * len(shown))
    for ax, signal in zip(axes, shown, strict=True):
        time, measured, model = (
            e10.curves[f"{signal}.{part}"] for part in ("time", "measured", "model")
        )
        rms = float(np.sqrt(np.nanmean((measured - model) ** 2)))
        unit = _UNITS[_quantity(signal)]
        ax.plot(time, measured, ".", ms=1.5, color=MEASURED, label="measured", rasterized=True)
        ax.plot(time, model, color=MODEL, lw=1, label=f"model, rms {rms:.2g} {unit}")
        ax.set(ylabel=f"{signal.removeprefix(f'{head}.')}\n[{unit}]")
        ax.legend(fontsize=8)
    axes[-1].set(xlabel="time [s]")
    number = f"_{head}" if head else ""
    caption = (
        "The baseline model, eqs. (2), (6), (7), (9) to (11), (22), (23), simulated on the "
        f"measured voltages with the fitted parameters. {e10.source}"
    )
    return Picture(f"bench_fit{number}", "Measured and fitted signals", caption, figure)


def _quantity(signal: str) -> str:
    name = signal.rpartition(".")[2]
    return name if name in _FIRST else _FIRST[-1]
