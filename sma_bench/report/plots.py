"""What records, simulations, overlays, identifications and diagnoses look like, for `plot()` and
reports; figures of a diagnosis or of an experiment are drawn in files of their own."""

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from sma_bench.diagnose import Diagnosis
from sma_bench.errors import InputError
from sma_bench.identify import Identification
from sma_bench.physics import Simulation
from sma_bench.records import DscRecord, Record, Signal
from sma_bench.records.isobaric import IsobaricRecord
from sma_bench.records.open import AnyRecord
from sma_bench.records.overlay import Overlay
from sma_bench.records.tensile import TensileRecord
from sma_bench.report.diagnosis_figures import (
    candidate_picture,
    evidence_picture,
    gap_picture,
    next_experiment_picture,
    shrinkage_picture,
    signal_pictures,
    stage_picture,
)
from sma_bench.report.drawing import (
    FAINT,
    MEASURED,
    MODEL,
    cell_texts,
    drawable,
    legend_above,
    line_style,
    named_rows,
    new_figure,
    one_panel,
    plain,
    plain_axes,
    read_and_error,
    thinned,
)
from sma_bench.report.page import Picture, pictured

Array = NDArray[np.float64]
Curves = Sequence[tuple[str, Array, Array]]
"""label, time or abscissa, values"""


# --- What `plot()` gives.


def picture_of(thing: Any, *what: str) -> Picture:
    """The figure of a thing, or that part of it.

    Raises:
        InputError: it has nothing of that name.
    """
    if isinstance(thing, Record):
        return _found(bag_picture(thing, "signals", what), what, thing.signals)
    if isinstance(thing, Simulation):
        return _found(simulation_picture(thing, what), what, _STATES)
    if isinstance(thing, Overlay):
        return overlay_picture(thing, "overlay", what)
    if isinstance(thing, Identification):
        return _chosen(what, {
            "agreement": lambda: agreement_picture(thing, "agreement"),
            "correlation": lambda: correlation_picture(thing, "correlation"),
        })  # fmt: skip
    if isinstance(thing, Diagnosis):
        return _chosen(what, {
            "signals": lambda: signal_pictures(thing)[0],
            "where": lambda: gap_picture(thing), "stages": lambda: stage_picture(thing),
            "candidates": lambda: candidate_picture(thing),
            "evidence": lambda: evidence_picture(thing),
            "shrinkage": lambda: shrinkage_picture(thing),
            "next": lambda: next_experiment_picture(thing, thing.parameters),
        })  # fmt: skip
    return _found(record_picture(thing, "record"), what, ())


def _chosen(what: tuple[str, ...], pictures: dict[str, Callable[[], Picture | None]]) -> Picture:
    name = what[0] if what else next(iter(pictures))
    if name not in pictures or len(what) > 1:
        raise InputError(f"plot: {', '.join(what)}, expected one of {', '.join(pictures)}")
    return _found(pictures[name](), what, ())


def _found(picture: Picture | None, what: Sequence[str], held: Iterable[str]) -> Picture:
    if picture is None:
        names = f": it has {', '.join(held)}" if held else ""
        raise InputError(f"plot: no {', '.join(what) or 'signal'} to draw{names}")
    return picture


# --- Records, before anything is made of them.

_MOST_DRAWN = 3000
_MOST_MARKERS = 40


# Quantities from above, with their unit on paper and the factor from SI to it.
_PRINTED = {
    "voltage_command": ("V", 1.0), "voltage": ("V", 1.0), "current": ("A", 1.0),
    "temperature": ("K", 1.0), "deflection": ("mm", 1e3), "range": ("mm", 1e3),
    "elongation": ("mm", 1e3), "force": ("N", 1.0),
}


def record_picture(record: AnyRecord, name: str) -> Picture | None:
    """What was recorded; None where that is nothing."""
    if isinstance(record, Record):
        return bag_picture(record, f"{name}_signals_over_time")
    if isinstance(record, DscRecord):
        return dsc_picture(record, f"{name}_heat_flow")
    if isinstance(record, IsobaricRecord):
        return isobaric_picture(record, f"{name}_strain")
    assert isinstance(record, TensileRecord)
    return tensile_picture(record, f"{name}_stress")


def bag_picture(record: Record, name: str, what: Sequence[str] = ()) -> Picture | None:
    """Every signal over time, or those that are named, a row a quantity; None without any.

    Long signals are drawn by the least and the largest sample of each stretch of time.
    """
    rows = []
    for quantity, (unit, factor) in _PRINTED.items():
        signals = [
            s for n, s in record.signals.items()
            if n.rpartition(".")[2] == quantity and len(s)
            and (not what or n in what or quantity in what)
        ]
        curves = [curve for signal in signals for curve in _curves(signal, factor)]
        if curves:
            rows.append((f"{quantity.replace('_', ' ')}\n[{unit}]", curves))
    if not rows:
        return None
    steps = "; vertical lines: steps of the protocol" if record.markers else ""
    which = "Signals" if what else "All signals"
    figure = _over_time(rows, record.markers)
    return pictured("signals_over_time", figure, name, over_time=True, which=which,
                    path=record.path, steps=steps)


def _curves(signal: Signal, factor: float) -> Curves:
    head = signal.name.rpartition(".")[0] or signal.name
    if signal.values.ndim == 1:
        return [(head, signal.time, factor * signal.values)]
    columns = range(signal.values.shape[1])
    return [(f"{head}[{k}]", signal.time, factor * signal.values[:, k]) for k in columns]


def _over_time(
    rows: Sequence[tuple[str, Curves]], markers: Sequence[tuple[float, str]] = ()
) -> Figure:
    figure, axes = new_figure(len(rows), height=1.0 + 1.5 * len(rows))
    for ax, (label, curves) in zip(axes, rows, strict=True):
        for k, (what, time, values) in enumerate(curves):
            t, v = thinned(time, drawable(values), _MOST_DRAWN)
            ax.plot(t, v, label=what, **line_style(k, len(curves), len(t)))
        ax.set_ylabel(label)
    most = max(range(len(rows)), key=lambda k: len(rows[k][1]))
    if len(rows[most][1]) > 1:
        figure.legend(
            *axes[most].get_legend_handles_labels(), fontsize=8, frameon=False, ncols=4,
            loc="outside upper right",
        )
    _mark(axes, markers)
    axes[-1].set_xlabel("time [s]")
    return plain(figure)


def _mark(axes: Sequence[Axes], markers: Sequence[tuple[float, str]]) -> None:
    """Steps of the protocol; names that would lie over each other are left out."""
    if not 0 < len(markers) <= _MOST_MARKERS:
        return
    room = (axes[0].get_xlim()[1] - axes[0].get_xlim()[0]) / 12.0
    named = -np.inf
    for time, text in markers:
        for ax in axes:
            ax.axvline(time, color=FAINT, lw=0.6, ls=":")
        if time - named > room:
            named = time
            axes[0].annotate(
                text, (time, 1.0), xycoords=("data", "axes fraction"), fontsize=6, rotation=30,
                color=FAINT, annotation_clip=True,
            )


def dsc_picture(record: DscRecord, name: str) -> Picture | None:
    """Heat flow over temperature of every scan; None where there is none."""
    scans = [s for s in record.segments if s.kind != "isothermal"]
    if not scans:
        return None
    curves = [
        (f"{s.number} {s.kind}", s.temperature, 1e-3 * record.specific_heat_flow(s)) for s in scans
    ]
    return pictured("heat_flow", _loops(curves, "heat flow [W/g], the file's sign"), name,
                    path=record.path)


def isobaric_picture(record: IsobaricRecord, name: str) -> Picture:
    """Strain over temperature of every branch."""
    relative = record.strain_unit == "relative"
    curves = [
        (f"cycle {cycle.number} {branch.direction}", branch.temperature,
         (1.0 if relative else 100.0) * branch.strain)
        for cycle in record.cycles for branch in cycle.branches
    ]  # fmt: skip
    figure = _loops(curves, "strain over its range" if relative else "strain [%]")
    return pictured("strain", figure, name, stress=record.stress / 1e6, path=record.path)


def tensile_picture(record: TensileRecord, name: str) -> Picture:
    """Stress over strain."""
    curves = [("test", 100.0 * record.strain, record.stress / 1e6)]
    figure = _loops(curves, "stress [MPa]", "strain [%]")
    return pictured("stress", figure, name, path=record.path)


def _loops(curves: Curves, label: str, across: str = "temperature [K]") -> Figure:
    figure, ax = one_panel(across, label, 4.2)
    for k, (what, x, y) in enumerate(curves):
        ax.plot(drawable(x), drawable(y), label=what, **line_style(k, len(curves), len(x)))
    if len(curves) > 1:
        ax.legend(fontsize=7, ncols=2)
    return plain(figure)


# --- Simulations, and records and models over each other.

_STATES: dict[str, tuple[str, float, Callable[[Simulation], Array]]] = {
    "voltage": ("voltage\n[V]", 1.0, lambda s: s.voltage),
    "current": ("current\n[A]", 1.0, lambda s: s.current),
    "temperature": ("temperature\n[K]", 1.0, lambda s: s.temperature),
    "martensite_fraction": ("martensite\nfraction", 1.0, lambda s: s.martensite_fraction),
    "stress": ("stress\n[MPa]", 1e-6, lambda s: s.stress),
    "deflection": ("deflection\n[mm]", 1e3, lambda s: s.deflection[:, np.newaxis]),
}


def simulation_picture(simulation: Simulation, what: Sequence[str] = ()) -> Picture | None:
    """Voltages, states and motion over time; None where nothing of that name is there."""
    channels, rows = simulation.parameters["bench.channels"], []
    for state, (label, factor, values_of) in _STATES.items():
        if what and state not in what:
            continue
        values = factor * values_of(simulation)
        if state == "deflection" and not what and not values.any():
            continue
        names = channels if values.shape[1] == len(channels) else ("deflection",)
        rows.append((label, [(n, simulation.time, values[:, k]) for k, n in enumerate(names)]))
    if not rows:
        return None
    return pictured("simulation", _over_time(rows), over_time=True, channels=", ".join(channels))


def overlay_picture(found: Overlay, name: str, what: Sequence[str] = ()) -> Picture:
    """Of each quantity the signal that differs most, or those that are named: all records, and
    below them the differences from the first, the largest marked.

    Raises:
        InputError: the records share nothing of that name.
    """
    worst: dict[str, str] = {}
    for d in found.differences:
        quantity = d.signal.rpartition(".")[2]
        if not what and d.rms:
            worst.setdefault(quantity, d.signal)
        if d.signal in what or quantity in what:
            worst.setdefault(d.signal, d.signal)
    if not worst:
        shared = ", ".join(dict.fromkeys(d.signal for d in found.differences))
        lack = f"no {', '.join(what)} in common" if what else "no difference"
        raise InputError(f"plot: {lack}: the records share {shared}")
    figure, axes = read_and_error(len(worst), 0.9 + 2.4 * len(worst))
    for (upper, lower), signal in zip(axes, worst.values(), strict=True):
        _overlay_signal(upper, lower, found, signal)
    legend_above(axes[0][0])
    first = next(iter(found.records))
    shifts = ", ".join(f"{n} {s:+.3g} s" for n, s in found.shifts.items() if abs(s) > 1e-3)
    said = f" Clocks shifted by the voltages: {shifts}." if shifts else ""
    return pictured("overlay", plain(figure), name, over_time=True, first=first, shifts=said)


def _overlay_signal(upper: Axes, lower: Axes, found: Overlay, signal: str) -> None:
    quantity = signal.rpartition(".")[2]
    unit, factor = _PRINTED.get(quantity, ("", 1.0))
    shown = {n: r[signal] for n, r in found.records.items() if signal in r.signals}
    first, *others = shown
    base = shown[first]
    for k, (name, own) in enumerate(shown.items()):
        t, v = thinned(own.time, drawable(factor * own.values), _MOST_DRAWN)
        style = line_style(k, len(shown), len(t))
        upper.plot(t, v, label=name, **style)
        if name in others:
            inside = (base.time >= own.time[0]) & (base.time <= own.time[-1])
            time = base.time[inside]
            apart = factor * (np.interp(time, own.time, own.values) - base.values[inside])
            lower.plot(*thinned(time, drawable(apart), _MOST_DRAWN), **style)
    for d in found.differences:
        if d.signal == signal:
            lower.plot([d.at], [factor * d.worst], "x", ms=7, color="black", label="_worst")
    upper.set_title(signal, loc="left", fontsize=9)
    upper.set_ylabel(f"[{unit}]")
    lower.set_ylabel(f"difference [{unit}]")


# --- Results of `identify` and `diagnose`.

_FEW, _MOST_NUMBERS = 8, 14  # of a correlation map, in whose cells numbers can be read


def agreement_picture(result: Identification, name: str) -> Picture | None:
    """How far each number is off what the parameter file states, with its errors, and the share of
    its information that the records gave; of what it does not state the errors alone. None where
    there is no number."""
    known = {key: (n, (n.stated or n).value) for key, n in result.estimates.items()}
    names = [key for key, (_, value) in known.items() if value and np.isfinite(value)]
    if not names:
        return None
    shown = [known[name] for name in names]
    figure = Figure(figsize=(7.2, 1.3 + 0.32 * len(shown)), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True, width_ratios=(2.6, 1.0))
    place = named_rows(left, [n if known[n][0].stated else f"{n} *" for n in names])
    scale = np.array([100.0 / abs(ref) for _, ref in shown])
    off = scale * [n.value - ref for n, ref in shown]
    parts = ([n.std for n, _ in shown], [n.statistical for n, _ in shown])
    whole, random = (scale * np.nan_to_num(np.array(part)) for part in parts)
    left.errorbar(off, place, xerr=whole, fmt="none", ecolor=FAINT, elinewidth=1.2, capsize=3,
                  label="with the systematic error")
    left.errorbar(off, place, xerr=random, fmt="o", color=MEASURED, elinewidth=3.0, ms=4,
                  label="statistical error")
    left.axvline(0.0, color=MODEL, lw=1.0, ls="--")
    left.set_ylim(-0.6, len(shown) - 0.4)
    left.set_xlabel("off what was stated [%]")
    legend_above(left)
    informed = [100.0 * n.informed for n, _ in shown]
    right.barh(place, np.nan_to_num(informed), color=MEASURED, height=0.55)
    right.set(xlabel="informed [%]", xlim=(0.0, 100.0), xticks=(0, 50, 100))
    plain_axes(left, right)
    figure.get_layout_engine().set(wspace=0.06)  # type: ignore[union-attr, call-arg]
    return pictured("agreement", plain(figure), name)


def correlation_picture(result: Identification, name: str) -> Picture | None:
    """The correlation matrix as a map; None where it is not known or all stand alone."""
    names, matrix = result.correlation.names, result.correlation.matrix
    if len(names) < 2:
        return None
    short = [n.partition(".")[2] or n for n in names]
    size = 2.2 + 0.26 * len(names)
    figure = Figure(figsize=(size + 1.6, size), layout="constrained")
    ax = figure.subplots()
    image = ax.imshow(matrix, cmap="RdBu_r", vmin=-1.0, vmax=1.0)
    ax.set_xticks(range(len(names)), short, rotation=45, ha="right", fontsize=7)
    ax.set_yticks(range(len(names)), short, fontsize=7)
    form = ".2f" if len(names) <= _FEW else ".1f"
    cell_texts(ax, {
        (row, column): (format(value, form), bool(abs(value) > 0.6))
        for (row, column), value in np.ndenumerate(matrix)
        if row != column and np.isfinite(value) and len(names) <= _MOST_NUMBERS
    }, 6)
    figure.colorbar(image, ax=ax, label="correlation of the errors", fraction=0.04)
    return pictured("correlation", plain(figure), name)
