"""Figures of the paper's experiments, drawn from the curves of their results."""

import re
from collections.abc import Callable
from typing import Any

import numpy as np

from sma_bench.arrays import Array
from sma_bench.errors import InputError
from sma_bench.estimation.laws import predict
from sma_bench.identify.fits import SYMBOLS
from sma_bench.identify.result import Experiment
from sma_bench.identify.staircases import PARAMETER
from sma_bench.identify.tensile import SYMBOL
from sma_bench.parameters import Parameters
from sma_bench.parameters.parameters import as_recorded
from sma_bench.physics.linearised import Branch, Linearised, OperatingPoint
from sma_bench.physics.simulate import simulate
from sma_bench.records.record import Record, held_voltages
from sma_bench.report.drawing import FAINT, MEASURED, MODEL, SECOND, graph, legend_above, new_figure
from sma_bench.report.page import Picture, pictured
from sma_bench.results import scale_of, with_error

Curve = tuple[Any, Any, dict[str, Any]]

_PLATEAUS = {
    # Figs. 2 and 3: name of the figure, quantity, label of its axis, parameter, symbol, unit.
    "E1": ("figure_02_resistance", "current", "current [A]", "wire.resistance", "R", "ohm"),
    "E2": ("figure_03_heat_transfer", "temperature", "steady temperature [K]",
           "wire.heat_transfer_coefficient", "h", "W/(m² K)")}
_JUMP = 0.2  # V between two samples: more is a jump, not a ramp
# Transitions: parameter at zero stress; of the slope; colour; marker.
_AUSTENITE = ("wire.stress_influence_austenite", SECOND)
_MARTENSITE = ("wire.stress_influence_martensite", MEASURED)
_TRANSITIONS = {
    "A_s": ("wire.austenite_start_temperature", *_AUSTENITE, "o"),
    "A_f": ("wire.austenite_finish_temperature", *_AUSTENITE, "s"),
    "M_s": ("wire.martensite_start_temperature", *_MARTENSITE, "^"),
    "M_f": ("wire.martensite_finish_temperature", *_MARTENSITE, "v")}
_SEVERAL = 4  # tests; if there are more, each has its own colour
_DRAWN = 2000  # points of a curve, about
_LINE_STRAIN, _BEYOND = 0.012, 0.9  # strain, or share of the top stress, at which E's line ends
_FITTED = ("deflection", "force", "elongation", "temperature", "current")
_AROUND = 12.0  # K about the operating point, over which steady states of E11 are drawn
_ROWS = 4  # signals of a fit that are drawn, in the order of _FITTED


def _marks(marker: str, colour: str, label: str | None = None, **more: Any) -> dict[str, Any]:
    """Style of points: open markers, or small dots for marker "."."""
    size = 2.0 if marker == "." else 6.0
    look = {"marker": marker, "ls": "", "ms": size, "color": colour, "label": label, **more}
    return look if marker == "." else {"mfc": "none", **look}


def plateau_picture(experiment: Experiment) -> Picture:
    """Figs. 2 and 3: plateau means over voltage, for heating and cooling, and the fitted line."""
    name, quantity, axis, parameter, symbol, unit = _PLATEAUS[experiment.name]
    estimate, curves = experiment.estimates[parameter], experiment.curves
    up = curves["heating"] > 0.5
    label = f"{symbol} = {with_error(estimate.value, estimate.std)} {unit}"
    figure, _ = graph("voltage [V]", axis, (
        (curves["voltage"][up], curves[quantity][up], _marks("+", SECOND, "heating")),
        (curves["voltage"][~up], curves[quantity][~up], _marks("o", MEASURED, "cooling")),
        (curves["line_voltage"], curves[f"line_{quantity}"], {"color": MODEL, "label": label})))
    return pictured(name, figure, source=experiment.source)


def ramp_picture(e3: Experiment) -> Picture:
    """Fig. 4: temperature over voltage during the ramps of E3, with the fitted response."""
    volts = e3.curves["voltage"]
    # Draw no model line across the jump to 0 V at the end of a ramp.
    jump = np.abs(np.diff(volts, append=volts[-1])) > _JUMP
    figure, _ = graph("voltage [V]", "temperature [K]", (
        (volts, e3.curves["temperature"], _marks(".", MEASURED, "measured")),
        (volts, np.where(jump, np.nan, e3.curves["model"]),
         {"color": MODEL, "lw": 1, "label": "eq. (2), fitted"})))
    return pictured("figure_04_ramp", figure, source=e3.source)


def slope_picture(e3: Experiment) -> Picture:
    """Fig. 5: derivative of temperature over f(T, V), slope 1/c_p."""
    force, rate = e3.curves["force"], e3.curves["rate"]
    ends = np.array([0.0, float(np.nanmax(force))])
    curves: list[Curve] = [(force, rate, _marks(".", FAINT, "differentiator filter"))]
    for estimate, style, colour, name in (
            (e3.details["differentiator"], "--", SECOND, "slope as in the paper"),
            (e3.estimates["wire.specific_heat"], "-", MODEL, "most likely c_p")):
        label = f"{name}: {with_error(estimate.value, estimate.std)} J/(kg K)"
        curves.append((ends, ends / estimate.value, {"ls": style, "color": colour, "label": label}))
    figure, _ = graph("f(T, V) [W/kg]", "dT/dt [K/s]", curves)
    return pictured("figure_05_specific_heat", figure, source=e3.source)


def validation_picture(record: Record, parameters: Parameters) -> Picture:
    """Fig. 6: a triangular voltage, the measured temperature and the simulation of eq. (2), for a
    hold-out record. InputError: it lacks the wire's voltage or temperature."""
    channel = parameters["bench.channels"][0]
    time, voltage = held_voltages(record, [channel])
    measured = record[f"{channel}.temperature"]
    simulated = simulate(as_recorded(parameters), time, voltage).temperature[:, 0]
    inside = (measured.time >= time[0]) & (measured.time <= time[-1])
    if not inside.any():
        raise InputError(f"{record.path}: no temperature while the voltage was measured")
    error = measured.values[inside] - np.interp(measured.time[inside], time, simulated)
    rms = float(np.sqrt(np.mean(error**2)))
    figure, (upper, lower) = new_figure(rows=2, height=5.0)
    upper.plot(time, voltage[:, 0], color=MEASURED, lw=1)
    upper.set(ylabel="voltage [V]")
    dots = _marks(".", MEASURED, "measured", ms=1.5, rasterized=True)
    lower.plot(measured.time, measured.values, **dots)
    lower.plot(time, simulated, color=MODEL, lw=1, label=f"simulated, rms error {rms:.2f} K")
    lower.set(xlabel="time [s]", ylabel="temperature [K]")
    legend_above(lower)
    return pictured("figure_06_validation", figure, source=record.path)


def dsc_picture(e5: Experiment) -> Picture:
    """Fig. 7: heat flow over temperature, endothermic up, per cycle, with tangents and onsets."""
    figure, ax = graph("temperature [K]", "heat flow, endothermic up [W/kg]", height=4.8)
    colours, counts = (MEASURED, SECOND, "#2e7d32", "#7b4ea3"), {1.0: 0, -1.0: 0}
    for scan in [m[1] for key in e5.curves if (m := re.match(r"(.*segment_\d+)/heat_flow\Z", key))]:
        of = {n.removeprefix(f"{scan}/"): curve for n, curve in e5.curves.items()}
        onsets = {end: e5.details[f"{scan}/{end}"].value for end in ("start", "finish")}
        # All curves have their peak upward; in the figure, cooling is drawn downward.
        is_cooling = onsets["start"] >= onsets["finish"]
        symbols, sign = (("M_s", "M_f"), -1.0) if is_cooling else (("A_s", "A_f"), 1.0)
        number = counts[sign] = counts[sign] + 1
        colour = colours[(number - 1) % len(colours)]
        label = f"cycle {number}" if sign > 0.0 else None
        ax.plot(of["temperature"], sign * of["heat_flow"], lw=1.2, color=colour, label=label)
        for symbol, (end, onset) in zip(symbols, onsets.items(), strict=True):
            for part in ("baseline", "tangent"):
                across, up = of[f"{end}/{part}_temperature"], sign * of[f"{end}/{part}"]
                ax.plot(across, up, color=MODEL, lw=0.8)
            # Labels in one row per cycle, because onsets of cycles may coincide.
            place = (onset, sign * float(of[f"{end}/tangent"][0]))
            ax.plot(*place, **_marks("o", colour, ms=5))
            ax.annotate(f"${symbol}$ ({number})", place, (0, -9.5 * sign * number), fontsize=8,
                        textcoords="offset points", ha="center", va="center", color=colour)
    for height, direction in ((0.93, "heating"), (0.04, "cooling")):
        ax.text(0.015, height, direction, transform=ax.transAxes, color=FAINT, fontsize=9)
    ax.legend(loc="upper right")
    return pictured("figure_07_dsc", figure, source=e5.source)


def has_diagram(e6: Experiment) -> bool:
    """True if several stresses were tested."""
    return any(len(e6.curves[f"diagram/{name}/stress"]) > 1 for name in _TRANSITIONS)


def upfr_picture(e6: Experiment) -> Picture:
    """Fig. 8: contraction over temperature under constant load, with tangents and crossings."""
    branches: dict[tuple[str, str, str], dict[str, Array]] = {}  # by test, cycle, direction
    for key, values in e6.curves.items():
        if not key.startswith("diagram/"):
            test, cycle, direction, quantity = key.rsplit("/", 3)
            branches.setdefault((test, cycle, direction), {})[quantity] = values
    # Contraction is measured from the strain of the coldest tenth of a test.
    tests, zeros = list(dict.fromkeys(test for test, _, _ in branches)), {}
    for one in tests:
        mine = [curves for (test, _, _), curves in branches.items() if test == one]
        temperature, strain = (np.concatenate([curves[name] for curves in mine])
                               for name in ("temperature", "strain"))
        zeros[one] = float(np.median(strain[temperature < np.quantile(temperature, 0.1)]))
    relative = any(e.unit == "relative" for e in e6.details.values())
    up = f"contraction [{'% of its range' if relative else '%'}]"
    figure, ax = graph("temperature [K]", up, height=4.6)
    styles = {"heating": (SECOND, "-"), "cooling": (MEASURED, "--")}
    labelled: set[str] = set()
    for (test, _, direction), curves in branches.items():
        (colour, style), label = styles[direction], direction
        if len(tests) > _SEVERAL:
            colour, label = f"C{tests.index(test) % 10}", test.rpartition("/")[2]
        step = max(len(curves["strain"]) // _DRAWN, 1)
        ax.plot(curves["temperature"][::step], 100.0 * (zeros[test] - curves["strain"][::step]),
                style, color=colour, lw=1.2, alpha=0.75, label=None if label in labelled else label)
        labelled.add(label)
    # Tangents and cosines of one test only, the middle one: those of all would hide the curves.
    shown = tests[len(tests) // 2]
    first = next(cycle for test, cycle, _ in branches if test == shown)
    tangents = {**_marks("o", FAINT, ms=4), "ls": ":", "markevery": [1, 2], "zorder": 3}
    looks: dict[str, dict[str, Any]] = {"cosine": {"color": MODEL}, "tangents": tangents}
    for (test, cycle, _), curves in branches.items():
        for part, look in looks.items() if (test, cycle) == (shown, first) else ():
            kelvin, strain = curves[part].T
            ax.plot(kelvin, 100.0 * (zeros[shown] - strain), lw=1.2, **look)
    # A_s and A_f under the load, if only one load was tested.
    for name, style in (("A_s", ":"), ("A_f", "-.")):
        means = [e for key, e in e6.details.items() if key.startswith(f"{name} (tangent) at ")]
        if len(means) == 1:
            label = f"${name}$ = {with_error(means[0].value, means[0].std)} K"
            ax.axvline(means[0].value, color=FAINT, lw=0.8, ls=style, label=label)
    ax.legend(loc="center left", fontsize=8)
    most = e6.estimates.get("wire.maximum_recoverable_strain")
    limit = f"; ε_L = {most.value:.2%} ± {most.std:.2%}" if most else ""
    return pictured("figure_08_upfr", figure, limit=limit, source=e6.source)


def stress_temperature_picture(e6: Experiment) -> Picture:
    """Transition temperatures and stresses, with lines of the slopes C_A and C_M."""
    figure, ax = graph("temperature [K]", "stress [MPa]", height=4.6)
    for name, (at_zero, influence, colour, marker) in _TRANSITIONS.items():
        stress, kelvin, std = (e6.curves[f"diagram/{name}/{quantity}"]
                               for quantity in ("stress", "temperature", "std"))
        ax.errorbar(kelvin, stress / 1e6, xerr=std, fmt=marker, color=colour, mfc="none", ms=6,
                    capsize=2, label=f"${name}$")
        if {at_zero, influence} <= set(e6.estimates) and len(stress):
            ends = np.array([0.0, float(stress.max())])
            line = e6.estimates[at_zero].value + ends / e6.estimates[influence].value
            ax.plot(line, ends / 1e6, color=colour, lw=1)
    ax.set_ylim(bottom=0.0)
    ax.legend()
    slopes = ", ".join(f"{symbol} = {with_error(e.value / 1e6, e.std / 1e6)} MPa/K"
                       for symbol, (name, _) in (("C_A", _AUSTENITE), ("C_M", _MARTENSITE))
                       if (e := e6.estimates.get(name)) is not None) or "none found"
    return pictured("stress_temperature", figure, slopes=slopes, source=e6.source)


def tensile_picture(e7: Experiment) -> Picture:
    """Fig. 9: stress over strain of both phases, with lines of the slopes E_M and E_A."""
    curves: list[Curve] = []
    seen: set[str] = set()
    for test in [key.rpartition("/")[0] for key in e7.curves if key.endswith("/stress")]:
        phase: Any = test.partition("/")[0]
        strain, stress = e7.curves[f"{test}/strain"], e7.curves[f"{test}/stress"]
        colour, symbol = MEASURED if phase == "martensite" else SECOND, SYMBOL[phase]
        look = {"color": colour, "lw": 1.1, "alpha": 0.7, "label": phase}
        curves.append((100.0 * strain, stress / 1e6, look))
        if phase in seen:
            del look["label"]
        elif SYMBOLS[symbol] in e7.estimates:
            # The line begins where the fitted part of the curve begins.
            modulus = e7.estimates[SYMBOLS[symbol]]
            after = phase == "martensite" and f"{symbol} after the plateau" in e7.details
            begins = max(e7.details[f"{phase} {'plateau end' if after else 'toe'}"].value, 0.0)
            lowest = float(np.interp(begins, strain, stress))
            longest = (_BEYOND * float(stress.max()) - lowest) / modulus.value
            ends = np.array([begins, begins + min(_LINE_STRAIN, longest)])
            label = f"${symbol}$ = {modulus.value / 1e9:.1f} ± {modulus.std / 1e9:.1f} GPa"
            curves.append((100.0 * ends, (lowest + modulus.value * (ends - begins)) / 1e6,
                           {"ls": "--", "color": MODEL, "lw": 1.5, "zorder": 3, "label": label}))
        seen.add(phase)
    figure, ax = graph("strain [%]", "stress [MPa]", curves, 4.6, loc="upper left")
    begin, end = (e7.details.get(f"martensite plateau {name}") for name in ("begin", "end"))
    if begin is not None and end is not None:
        ax.axvspan(100.0 * begin.value, 100.0 * end.value, color=FAINT, alpha=0.12, lw=0)
        ax.text(50.0 * (begin.value + end.value), 0.02, "detwinning", ha="center", fontsize=8,
                color=FAINT, transform=ax.get_xaxis_transform())
    return pictured("figure_09_tensile", figure, source=e7.source)


def thermal_expansion_picture(e8: Experiment) -> Picture:
    """Fig. 10: stress of the clamped wire over temperature below A_s, with the line of eq. (8)."""
    curves, theta = e8.curves, e8.estimates[PARAMETER]
    used, kelvin, stress = curves["used"] > 0.5, curves["temperature"], curves["stress"] / 1e6
    order = np.argsort(kelvin[used])
    label = f"$\\Theta_T$ = {theta.value / 1e6:.3f} ± {theta.std / 1e6:.3f} MPa/K"
    drawn = ((used, _marks("o", MEASURED, "plateaus")), (~used, _marks("x", FAINT, "left out")))
    figure, _ = graph("temperature [K]", "stress [MPa]", (
        *((kelvin[chosen], stress[chosen], style) for chosen, style in drawn if chosen.any()),
        (kelvin[used][order], curves["line"][used][order] / 1e6, {"color": MODEL, "label": label})))
    return pictured("figure_10_thermal_expansion", figure, source=e8.source)


def constitutive_picture(e9: Experiment) -> Picture:
    """Strain over temperature of every loop, with the fitted law."""
    curves: list[Curve] = []
    loops = [key.removesuffix("/model") for key in e9.curves if key.endswith("/model")]
    for k, loop in enumerate(loops):
        kelvin = e9.curves[f"{loop}/temperature"]
        strain, model = (100.0 * e9.curves[f"{loop}/{part}"] for part in ("strain", "model"))
        curves.append((kelvin, strain, _marks(".", f"C{k % 10}", loop, rasterized=True)))
        curves.append((kelvin, model, {"color": "black", "lw": 0.8}))
    figure, _ = graph("temperature [K]", "strain [%]", curves, 4.6, fontsize=7, markerscale=4,
                      ncols=2 if len(loops) > 6 else 1)
    return pictured("constitutive_fit", figure, source=e9.source)


def bench_fit_pictures(e10: Experiment) -> list[Picture]:
    """Signals over time, the fitted simulation, and limits for 90 % of a new run's readings."""
    observations = e10.laws[0].fit.problem.observations if e10.laws else ()
    bands = [predict(e10.laws, one) for one in observations]
    records: dict[str, list[tuple[str, str]]] = {}  # (quantity, signal), by number of the record
    for signal in (key.removesuffix(".model") for key in e10.curves if key.endswith(".model")):
        head, _, rest = signal.partition(".")
        quantity = last if (last := signal.rpartition(".")[2]) in _FITTED else "current"
        records.setdefault(head if head.isdecimal() and rest else "", []).append((quantity, signal))
    pictures = []
    for head, signals in records.items():
        shown = sorted(signals, key=lambda of: _FITTED.index(of[0]))[:_ROWS]
        figure, axes = new_figure(rows=len(shown), height=1.2 + 1.9 * len(shown))
        for ax, (quantity, signal) in zip(axes, shown, strict=True):
            time, unit, factor = e10.curves[f"{signal}.time"], *scale_of(quantity)
            measured, model = (factor * e10.curves[f"{signal}.{p}"] for p in ("measured", "model"))
            rms = float(np.sqrt(np.nanmean((measured - model) ** 2)))
            ax.plot(time, measured, **_marks(".", MEASURED, "measured", ms=1.5, rasterized=True))
            ax.plot(time, model, color=MODEL, lw=1, label=f"model, rms {rms:.2g} {unit}")
            name = signal.removeprefix(f"{head}.")
            if bands:
                band = bands[int(head or 0)][name]
                limits: dict[str, Any] = {"color": FAINT, "lw": 0.8, "ls": "--"}
                ax.plot(band.time, factor * band.low, **limits, label="90 % of a new run")
                ax.plot(band.time, factor * band.high, **limits)
            ax.set(ylabel=f"{name}\n[{unit}]")
            ax.legend(fontsize=8)
        axes[-1].set(xlabel="time [s]")
        name = f"bench_fit_{head}" if head else "bench_fit"
        pictures.append(pictured("bench_fit", figure, name, source=e10.source))
    return pictures


def operating_point_picture(model: Linearised) -> Picture:
    """Steady states over the warmest wire's temperature, and the tangent of eqs. (18) to (23)."""
    point, parameters = model.point, model.point.parameters
    wire = int(np.argmax(point.temperature))
    kelvin = float(point.temperature[wire])
    together = np.isclose(point.temperature, kelvin)
    slope = float(model.deflection_per_kelvin[together].sum())
    coldest = max(kelvin - _AROUND, parameters["environment.ambient_temperature"])
    around = np.linspace(coldest, kelvin + _AROUND, 121)
    figure, ax = graph("temperature of the driven wires [K]", "deflection [mm]", height=4.2)
    branches: dict[Branch, str] = {"heating": SECOND, "cooling": MEASURED}
    kelvins = [np.where(together, t, point.temperature) for t in around]
    for branch, colour in branches.items():
        steady = [1e3 * OperatingPoint.at_temperature(parameters, own, branch).deflection
                  for own in kelvins]
        ax.plot(around, steady, color=colour, lw=1.6, label=f"steady, {branch}")
    drawn = 1e3 * (point.deflection + slope * (around - kelvin))
    here = np.abs(drawn - 1e3 * point.deflection) < 0.7 * max(np.ptp(drawn), 1e-9)
    ax.plot(around[here], drawn[here], "--", color=MODEL, lw=1.4, label="linearised")
    ax.plot([kelvin], [1e3 * point.deflection], "o", color=MODEL, ms=6)
    ax.legend(fontsize=8)
    return pictured("linearised", figure, volts=point.voltage[wire], branch=point.branch,
                    slope=1e3 * slope, kelvin=kelvin)


# Experiment and picture by figure of the paper.
PAPERS_FIGURES: dict[int, tuple[str, Callable[[Experiment], Picture]]] = {
    2: ("E1", plateau_picture), 3: ("E2", plateau_picture), 4: ("E3", ramp_picture),
    5: ("E3", slope_picture), 7: ("E5", dsc_picture), 8: ("E6", upfr_picture),
    9: ("E7", tensile_picture), 10: ("E8", thermal_expansion_picture)}


def experiment_pictures(experiment: Experiment) -> list[Picture]:
    """Pictures of one identified experiment, drawn from its curves."""
    if experiment.name == "E9" and any(name.endswith("/model") for name in experiment.curves):
        return [constitutive_picture(experiment)]
    if experiment.name in ("E0", "E9", "E10"):  # signals over time; E9: from bags of a load frame
        return bench_fit_pictures(experiment)
    found = [draw(experiment) for name, draw in PAPERS_FIGURES.values() if name == experiment.name]
    if experiment.name == "E6" and has_diagram(experiment):
        found.append(stress_temperature_picture(experiment))
    return found
