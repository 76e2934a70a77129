"""Figures of the paper's experiments, drawn from the curves of each identified one."""

import re
from collections.abc import Callable

import numpy as np

from sma_bench.errors import InputError
from sma_bench.estimation.estimate import Estimate
from sma_bench.identify.estimate import Array
from sma_bench.identify.instruments.tensile import MODULUS, SYMBOL
from sma_bench.identify.instruments.thermal_expansion import PARAMETER
from sma_bench.identify.result import Experiment
from sma_bench.parameters import Parameters
from sma_bench.parameters.parameters import as_recorded
from sma_bench.physics.simulate import simulate
from sma_bench.records.record import Record
from sma_bench.records.samples import held_voltages
from sma_bench.report.drawing import (
    FAINT,
    MEASURED,
    MODEL,
    SECOND,
    legend_above,
    new_figure,
    one_panel,
)
from sma_bench.report.page import Picture, pictured
from sma_bench.results import with_error

# --- Figures 2 to 6 of the paper, redrawn from records.

_JUMP = 0.2  # V between two samples


# Figs. 2 and 3: name, quantity, its axis, parameter, symbol and unit.
_PLATEAUS = {
    "E1": ("figure_02_resistance", "current", "current [A]", "wire.resistance", "R", "ohm"),
    "E2": ("figure_03_heat_transfer", "temperature", "steady temperature [K]",
           "wire.heat_transfer_coefficient", "h", "W/(m² K)"),
}


def plateau_picture(experiment: Experiment) -> Picture:
    """Figs. 2 and 3: plateau means of current or steady temperature over voltage, heating and
    cooling apart, and the fitted line."""
    name, quantity, axis, parameter, symbol, unit = _PLATEAUS[experiment.name]
    estimate, curves = experiment.estimates[parameter], experiment.curves
    figure, ax = one_panel("voltage [V]", axis)
    heating = curves["heating"] > 0.5
    for chosen, marker, colour, label in (
        (heating, "+", SECOND, "heating"), (~heating, "o", MEASURED, "cooling"),
    ):
        ax.plot(
            curves["voltage"][chosen], curves[quantity][chosen], marker, ms=6, mfc="none",
            color=colour, label=label,
        )
    label = f"{symbol} = {with_error(estimate.value, estimate.std)} {unit}"
    ax.plot(curves["line_voltage"], curves[f"line_{quantity}"], color=MODEL, label=label)
    ax.legend()
    return pictured(name, figure, source=experiment.source)


def ramp_picture(e3: Experiment) -> Picture:
    """Fig. 4: temperature over voltage during the ramps of E3, with the fitted response."""
    figure, ax = one_panel("voltage [V]", "temperature [K]")
    curves = e3.curves
    ax.plot(curves["voltage"], curves["temperature"], ".", ms=2, color=MEASURED, label="measured")
    # No line across the jump to 0 V at a ramp's end: nothing happens there.
    jump = np.abs(np.diff(curves["voltage"], append=curves["voltage"][-1])) > _JUMP
    model = np.where(jump, np.nan, curves["model"])
    ax.plot(curves["voltage"], model, color=MODEL, lw=1, label="eq. (2), fitted")
    ax.legend()
    return pictured("figure_04_ramp", figure, source=e3.source)


def slope_picture(e3: Experiment) -> Picture:
    """Fig. 5: derivative of temperature over f(T, V), slope 1/c_p."""
    figure, ax = one_panel("f(T, V) [W/kg]", "dT/dt [K/s]")
    force, rate = e3.curves["force"], e3.curves["rate"]
    ax.plot(force, rate, ".", ms=2, color=FAINT, label="differentiator filter")
    ends = np.array([0.0, float(np.nanmax(force))])
    lines = (
        (e3.details["differentiator"], "--", SECOND, "slope as in the paper"),
        (e3.estimates["wire.specific_heat"], "-", MODEL, "most likely c_p"),
    )
    for estimate, style, colour, name in lines:
        label = f"{name}: {with_error(estimate.value, estimate.std)} J/(kg K)"
        ax.plot(ends, ends / estimate.value, style, color=colour, label=label)
    ax.legend()
    return pictured("figure_05_specific_heat", figure, source=e3.source)


def validation_picture(record: Record, parameters: Parameters) -> Picture:
    """Fig. 6: a triangular voltage, measured temperature and the simulation of eq. (2).

    Args:
        record: a wire-rig record that no parameter was fitted to.
        parameters: identified ones.

    Raises:
        InputError: the record lacks voltage or temperature of the wire.
    """
    channel = parameters["bench.channels"][0]
    time, voltage = held_voltages(record, [channel])
    measured = record[f"{channel}.temperature"]
    simulated = simulate(as_recorded(parameters), time, voltage).temperature[:, 0]
    inside = (measured.time >= time[0]) & (measured.time <= time[-1])
    if not inside.any():
        raise InputError(f"{record.path}: no temperature while the voltage was measured")
    error = measured.values[inside] - np.interp(measured.time[inside], time, simulated)
    rmse = float(np.sqrt(np.mean(error**2)))

    figure, (upper, lower) = new_figure(rows=2, height=5.0)
    upper.plot(time, voltage[:, 0], color=MEASURED, lw=1)
    upper.set(ylabel="voltage [V]")
    lower.plot(
        measured.time, measured.values, ".", ms=1.5, color=MEASURED, label="measured",
        rasterized=True,
    )
    lower.plot(time, simulated, color=MODEL, lw=1, label=f"simulated, rms error {rmse:.2f} K")
    lower.set(xlabel="time [s]", ylabel="temperature [K]")
    legend_above(lower)
    return pictured("figure_06_validation", figure, source=record.path)


# --- Fig. 7 of the paper: heat flow of a DSC run with the tangents that give the temperatures.

def dsc_pictures(e5: Experiment) -> list[Picture]:
    """One picture a scan: heat flow (transformation upward), baselines, tangents, crossings."""
    pictures = []
    for label in [n.removesuffix("/heat_flow") for n in e5.curves if n.endswith("/heat_flow")]:
        figure, ax = one_panel("temperature [K]", "heat flow [W/kg]")
        prefix = f"{label}/"
        curves = {
            name.removeprefix(prefix): curve
            for name, curve in e5.curves.items() if name.startswith(prefix)
        }  # fmt: skip
        temperature, flow = curves["temperature"], curves["heat_flow"]
        ax.plot(temperature, flow, color=MEASURED, label="heat flow")
        ax.plot(temperature, curves["base"], ":", color=FAINT, label="baseline of the area")

        # Baseline and tangent of each end, and where they meet.
        onsets = {end: e5.details[f"{label}/{end}"] for end in ("start", "finish")}
        for end, onset in onsets.items():
            for line in ("baseline", "tangent"):
                across = curves[f"{end}/{line}_temperature"]
                ax.plot(across, curves[f"{end}/{line}"], color=MODEL, lw=1)
            ax.plot(
                curves[f"{end}/tangent_temperature"][0], curves[f"{end}/tangent"][0], "o",
                color=SECOND, ms=6, mfc="none",
                label=f"{end} {onset.value:.2f} ± {onset.std:.2f} K",
            )

        # The peak and 40 K around it: a run's ends would flatten what matters.
        ends = [onset.value for onset in onsets.values()]
        low, high = min(ends) - 40.0, max(ends) + 40.0
        near = flow[(temperature > low) & (temperature < high)]
        margin = 0.08 * (near.max() - near.min())
        ax.set_xlim(low, high)
        ax.set_ylim(near.min() - margin, near.max() + margin)
        ax.legend()
        heat = e5.details[f"{label}/latent_heat"]
        name = f"figure_07_dsc_{label.replace('/', '_')}"
        pictures.append(pictured(
            "figure_07_dsc_scan", figure, name, scan=label.replace("_", " "),
            heat=heat.value / 1e3, error=heat.std / 1e3, source=e5.source,
        ))
    return pictures


# --- Fig. 7 of the paper: all scans of a DSC run in one graph.

_CYCLE_COLOURS = (MEASURED, SECOND, "#2e7d32", "#7b4ea3")
_HEAT_FLOW = re.compile(r"(?P<scan>.*segment_\d+)/heat_flow\Z")
_SYMBOLS = {"heating": ("A_s", "A_f"), "cooling": ("M_s", "M_f")}


def dsc_overview_picture(e5: Experiment) -> Picture:
    """Heat flow over temperature, endothermic up: heating above, cooling below, by cycle."""
    figure, ax = one_panel("temperature [K]", "heat flow, endothermic up [W/kg]", 4.8)
    counts = {"heating": 0, "cooling": 0}
    scans = [match["scan"] for key in e5.curves if (match := _HEAT_FLOW.match(key))]
    for scan in scans:
        start, finish = (e5.details[f"{scan}/{end}"] for end in ("start", "finish"))
        direction = "heating" if start.value < finish.value else "cooling"
        counts[direction] += 1
        colour = _CYCLE_COLOURS[(counts[direction] - 1) % len(_CYCLE_COLOURS)]
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
            level = sign * float(e5.curves[f"{scan}/{end}/tangent"][0])
            ax.plot([onset.value], [level], "o", ms=5, mfc="none", color=colour)
            ax.annotate(
                text, (onset.value, level), (0, below), textcoords="offset points", ha="center",
                va="center", fontsize=8, color=colour,
            )
    ax.text(0.015, 0.93, "heating", transform=ax.transAxes, color=FAINT, fontsize=9)
    ax.text(0.015, 0.04, "cooling", transform=ax.transAxes, color=FAINT, fontsize=9)
    ax.legend(loc="upper right")
    return pictured("figure_07_dsc", figure, source=e5.source)


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


def has_diagram(e6: Experiment) -> bool:
    """Whether several stresses were tested."""
    return any(len(e6.curves[f"diagram/{name}/stress"]) > 1 for name in _TRANSITIONS)


def upfr_picture(e6: Experiment) -> Picture:
    """Fig. 8: contraction over temperature under a held load, with tangents and their crossings."""
    figure, (ax,) = new_figure(height=4.6)
    branches: dict[tuple[str, str, str], dict[str, Array]] = {}  # by test, cycle, direction
    for key, values in e6.curves.items():
        if not key.startswith("diagram/"):
            test, cycle, direction, quantity = key.rsplit("/", 3)
            branches.setdefault((test, cycle, direction), {})[quantity] = values

    # Contraction counts from the strain of a test where it is coldest.
    tests = list(dict.fromkeys(test for test, _, _ in branches))
    zeros = {}
    for one in tests:
        mine = [curves for (test, _, _), curves in branches.items() if test == one]
        temperature = np.concatenate([curves["temperature"] for curves in mine])
        strain = np.concatenate([curves["strain"] for curves in mine])
        zeros[one] = float(np.median(strain[temperature < np.quantile(temperature, 0.1)]))
    seen: set[str] = set()
    for (test, _, direction), curves in branches.items():
        colour, style = _DIRECTIONS[direction]
        if len(tests) > _SEVERAL:
            colour = f"C{tests.index(test) % 10}"
        label = direction if len(tests) <= _SEVERAL else test.rpartition("/")[2]
        step = max(len(curves["strain"]) // _DRAWN, 1)
        ax.plot(
            curves["temperature"][::step], 100.0 * (zeros[test] - curves["strain"][::step]), style,
            color=colour, lw=1.2, alpha=0.75, label=None if label in seen else label,
        )
        seen.add(label)

    # Tangents and cosine of the test in the middle: those of all would hide the curves.
    shown = tests[len(tests) // 2]
    first = next(cycle for test, cycle, _ in branches if test == shown)
    for (test, cycle, _), curves in branches.items():
        if (test, cycle) == (shown, first):
            cosine, tangents = curves["cosine"], curves["tangents"]
            ax.plot(cosine[:, 0], 100.0 * (zeros[test] - cosine[:, 1]), color=MODEL, lw=1.2)
            ax.plot(
                tangents[:, 0], 100.0 * (zeros[test] - tangents[:, 1]), ":", color=FAINT, lw=1.2,
                marker="o", markevery=[1, 2], ms=4, mfc="none", zorder=3,
            )

    # A_s and A_f under the load, where one load was tested.
    for name, height in (("A_s", 0.3), ("A_f", 0.7)):
        means = [e for key, e in e6.details.items() if key.startswith(f"{name} (tangent) at ")]
        if len(means) == 1:
            (mean,) = means
            ax.axvline(mean.value, color=FAINT, lw=0.8, ls=":")
            ax.annotate(
                f"${name}$ = {with_error(mean.value, mean.std)} K",
                (mean.value, height), (28, 0), xycoords=("data", "axes fraction"),
                textcoords="offset points", fontsize=8, va="center", color=SECOND,
                arrowprops={"arrowstyle": "->", "color": FAINT, "lw": 0.7},
            )
    relative = any(e.unit == "relative" for e in e6.details.values())
    of = "% of its range" if relative else "%"
    ax.set(xlabel="temperature [K]", ylabel=f"contraction [{of}]")
    ax.legend(loc="center left", fontsize=8)
    most = e6.estimates.get("wire.maximum_recoverable_strain")
    limit = f"; ε_L = {most.value:.2%} ± {most.std:.2%}" if most else ""
    return pictured("figure_08_upfr", figure, limit=limit, source=e6.source)


def stress_temperature_picture(e6: Experiment) -> Picture:
    """Transition temperatures over stress with the lines whose slopes are 1/C_A and 1/C_M."""
    figure, ax = one_panel("temperature [K]", "stress [MPa]", 4.6)
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
    ax.set_ylim(bottom=0.0)
    ax.legend()
    slopes = [
        f"{symbol} = {with_error(e.value / 1e6, e.std / 1e6)} MPa/K"
        for symbol, name in (
            ("C_A", "wire.stress_influence_austenite"), ("C_M", "wire.stress_influence_martensite")
        )
        if (e := e6.estimates.get(name)) is not None
    ]
    found = ", ".join(slopes) or "none found"
    return pictured("stress_temperature", figure, slopes=found, source=e6.source)


# --- Figs. 9 and 10 of the paper: tensile tests (E7) and the clamped staircase (E8).

_PHASE_COLOURS = {"martensite": MEASURED, "austenite": SECOND}
_LINE_STRAIN = 0.012
_BEYOND = 0.9  # of the highest stress


def tensile_picture(e7: Experiment) -> Picture:
    """Fig. 9: stress over strain of both phases, the slopes that are E_M and E_A beside them."""
    figure, ax = one_panel("strain [%]", "stress [MPa]", 4.6)
    tests = [key.rpartition("/")[0] for key in e7.curves if key.endswith("/stress")]
    seen: set[str] = set()
    for test in tests:
        phase = test.partition("/")[0]
        strain, stress = e7.curves[f"{test}/strain"], e7.curves[f"{test}/stress"]
        ax.plot(
            100.0 * strain, stress / 1e6, color=_PHASE_COLOURS[phase], lw=1.1, alpha=0.7,
            label=None if phase in seen else phase,
        )
        if phase not in seen and MODULUS[phase] in e7.estimates:  # type: ignore[index]
            # The line begins where the part that gave the modulus does.
            modulus, symbol = e7.estimates[MODULUS[phase]], SYMBOL[phase]  # type: ignore[index]
            after = phase == "martensite" and f"{symbol} after the plateau" in e7.details
            part = "plateau end" if after else "toe"
            begins = max(e7.details[f"{phase} {part}"].value, 0.0)
            lowest = float(np.interp(begins, strain, stress))
            longest = (_BEYOND * float(stress.max()) - lowest) / modulus.value
            ends = np.array([begins, begins + min(_LINE_STRAIN, longest)])
            ax.plot(
                100.0 * ends, (lowest + modulus.value * (ends - begins)) / 1e6, "--", color=MODEL,
                lw=1.5, zorder=3,
                label=f"${symbol}$ = {modulus.value / 1e9:.1f} ± {modulus.std / 1e9:.1f} GPa",
            )
        seen.add(phase)
    begin, end = (e7.details.get(f"martensite plateau {name}") for name in ("begin", "end"))
    if begin is not None and end is not None:
        ax.axvspan(100.0 * begin.value, 100.0 * end.value, color=FAINT, alpha=0.12, lw=0)
        ax.text(
            50.0 * (begin.value + end.value), 0.02, "detwinning", ha="center", fontsize=8,
            color=FAINT, transform=ax.get_xaxis_transform(),
        )
    ax.legend(loc="upper left")
    return pictured("figure_09_tensile", figure, source=e7.source)


def thermal_expansion_picture(e8: Experiment) -> Picture:
    """Fig. 10: stress of the clamped wire over temperature below A_s, with the line of eq. (8)."""
    figure, ax = one_panel("temperature [K]", "stress [MPa]")
    curves = e8.curves
    used = curves["used"] > 0.5
    theta: Estimate = e8.estimates[PARAMETER]
    for chosen, marker, colour, label in (
        (used, "o", MEASURED, "plateaus"), (~used, "x", FAINT, "left out"),
    ):
        if chosen.any():
            ax.plot(curves["temperature"][chosen], curves["stress"][chosen] / 1e6, marker,
                    mfc="none", ms=6, color=colour, label=label)
    order = np.argsort(curves["temperature"][used])
    ax.plot(
        curves["temperature"][used][order], curves["line"][used][order] / 1e6, color=MODEL,
        label=f"$\\Theta_T$ = {theta.value / 1e6:.3f} ± {theta.std / 1e6:.3f} MPa/K",
    )
    ax.legend()
    return pictured("figure_10_thermal_expansion", figure, source=e8.source)


# --- E9 and E10: what was measured, and the model that was fitted to all of it.

_ROWS = 4
_UNITS = {"deflection": "m", "force": "N", "elongation": "m", "temperature": "K", "current": "A"}
_FIRST = tuple(_UNITS)


def constitutive_picture(e9: Experiment) -> Picture:
    """Strain over temperature of every loop with the fitted law."""
    figure, ax = one_panel("temperature [K]", "strain [%]", 4.6)
    loops = [key.removesuffix("/model") for key in e9.curves if key.endswith("/model")]
    for k, loop in enumerate(loops):
        temperature = e9.curves[f"{loop}/temperature"]
        ax.plot(
            temperature, 100.0 * e9.curves[f"{loop}/strain"], ".", ms=2, color=f"C{k % 10}",
            label=loop, rasterized=True,
        )
        ax.plot(temperature, 100.0 * e9.curves[f"{loop}/model"], color="black", lw=0.8)
    ax.legend(fontsize=7, markerscale=4, ncols=2 if len(loops) > 6 else 1)
    return pictured("constitutive_fit", figure, source=e9.source)


def bench_fit_pictures(e10: Experiment) -> list[Picture]:
    """Signals of the rig over time with the fitted simulation, one picture a record."""
    records: dict[str, list[str]] = {}
    for signal in (key.removesuffix(".model") for key in e10.curves if key.endswith(".model")):
        head, _, rest = signal.partition(".")
        records.setdefault(head if head.isdecimal() and rest else "", []).append(signal)
    pictures = []
    for head, signals in records.items():
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
        name = f"bench_fit_{head}" if head else "bench_fit"
        pictures.append(pictured("bench_fit", figure, name, source=e10.source))
    return pictures


def _quantity(signal: str) -> str:
    name = signal.rpartition(".")[2]
    return name if name in _FIRST else _FIRST[-1]


# --- Which pictures belong to which experiment.

_PICTURES: dict[str, Callable[[Experiment], list[Picture]]] = {
    "E1": lambda e1: [plateau_picture(e1)],
    "E2": lambda e2: [plateau_picture(e2)],
    "E3": lambda e3: [ramp_picture(e3), slope_picture(e3)],
    "E5": dsc_pictures,
    "E6": lambda e6: [upfr_picture(e6), *(
        [stress_temperature_picture(e6)] if has_diagram(e6) else []
    )],
    "E7": lambda e7: [tensile_picture(e7)],
    "E8": lambda e8: [thermal_expansion_picture(e8)],
    # Loops of isobaric tests, or the signals of the load frame's bags.
    "E9": lambda e9: (
        [constitutive_picture(e9)] if any(name.endswith("/model") for name in e9.curves)
        else bench_fit_pictures(e9)
    ),
    "E0": bench_fit_pictures, "E10": bench_fit_pictures,
}


def experiment_pictures(experiment: Experiment) -> list[Picture]:
    """Pictures of one identified experiment, drawn from its curves."""
    draw = _PICTURES.get(experiment.name)
    return draw(experiment) if draw else []
