"""Figures of records, simulations, overlays and results, for `plot()` and reports."""

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
from matplotlib.colors import LogNorm
from matplotlib.container import BarContainer
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator

from sma_bench.arrays import Array
from sma_bench.diagnose import Diagnosis
from sma_bench.diagnose.result import JOIN, UNEXPLAINED
from sma_bench.diagnose.sizes import locate, sample_noise
from sma_bench.errors import InputError
from sma_bench.estimation.observation import QUANTITIES, BinnedSignal
from sma_bench.identify import Identification
from sma_bench.physics import Simulation
from sma_bench.physics.effects import EFFECTS
from sma_bench.records import Record
from sma_bench.records.overlay import Overlay
from sma_bench.report import drawing as draw
from sma_bench.report.page import Picture, pictured
from sma_bench.results import scale_of

Curves = list[tuple[str, Array, Array]]  # label, time, values

_MOST_DRAWN, _MOST_MARKERS = 3000, 40
_QUANTITIES = ("voltage_command", "voltage", "current", "temperature", "deflection", "range",
               "elongation", "force")  # from top to bottom
# States of a simulation: label and factor from SI to its unit.
_STATES = {
    "voltage": ("voltage\n[V]", 1.0), "current": ("current\n[A]", 1.0),
    "temperature": ("temperature\n[K]", 1.0), "martensite_fraction": ("martensite\nfraction", 1.0),
    "stress": ("stress\n[MPa]", 1e-6), "deflection": ("deflection\n[mm]", 1e3)}
STAGE_COLOURS = {"electrical": "#b58900", "thermal": "#c0504d", "transformation": "#7a5195",
                 "mechanical": "#2a7f62", "sensor": "#1f4e79"}
_TWO_STAGES = "#4a4a4a"
_LINEAR = 3.0  # nats: the axis of evidence is linear up to here, then logarithmic
_AS_BAD = 20.0  # nats below recalibration, at which bars are cut
PHASES = ("initial", "drive", "rest")
_LOWEST, _HIGHEST = 0.1, 30.0  # times the noise, ends of the colour scale
_DARK = 0.65  # of the colour scale: darker cells have white text
_UNSURE = 100.0  # %: larger errors do not widen the axis of differences
_MOST_SIGNALS, _WORTH_A_PICTURE = 3, 0.05  # pictures; share of the residual that is worth one


def record_picture(record: Record, name: str, what: Sequence[str] = ()) -> Picture | None:
    """All signals over time, or those in `what`, one row per quantity; None if there are none. Long
    signals are drawn by minimum and maximum of each stretch."""
    rows: list[tuple[str, Curves]] = []
    for quantity in _QUANTITIES:
        unit, factor = scale_of(quantity)
        curves: Curves = []
        for full, signal in record.signals.items():
            wanted = not what or full in what or quantity in what
            if full.rpartition(".")[2] == quantity and len(signal) and wanted:
                head = signal.name.rpartition(".")[0] or signal.name
                columns = np.atleast_2d(factor * signal.values.T)
                names = [f"{head}[{k}]" for k in range(len(columns))]
                names = names if signal.values.ndim > 1 else [head]
                curves += [(n, signal.time, v) for n, v in zip(names, columns, strict=True)]
        if curves:
            rows.append((f"{quantity.replace('_', ' ')}\n[{unit}]", curves))
    if not rows:
        return None
    return pictured("signals_over_time", _over_time(rows, record.markers), name, over_time=True,
                    which="Signals" if what else "All signals", path=record.path,
                    steps="; vertical lines: steps of the protocol" if record.markers else "")


def _over_time(rows: Sequence[tuple[str, Curves]],
               markers: Sequence[tuple[float, str]] = ()) -> Figure:
    """One graph per row; long signals are thinned. `markers`: steps of the protocol."""
    figure, axes = draw.new_figure(len(rows), height=1.0 + 1.5 * len(rows))
    for ax, (label, curves) in zip(axes, rows, strict=True):
        for k, (curve, time, values) in enumerate(curves):
            t, v = draw.thinned(time, draw.drawable(values), _MOST_DRAWN)
            ax.plot(t, v, label=curve, **draw.line_style(k, len(curves), len(t)))
        ax.set_ylabel(label)
    most = max(range(len(rows)), key=lambda k: len(rows[k][1]))
    if len(rows[most][1]) > 1:
        figure.legend(*axes[most].get_legend_handles_labels(), fontsize=8, frameon=False, ncols=4,
                      loc="outside upper right")
    # Steps of the protocol; a name that would overlap the one before is left out.
    room, named = float(np.ptp(axes[0].get_xlim())) / 12.0, -np.inf
    for at, text in markers if len(markers) <= _MOST_MARKERS else ():
        for ax in axes:
            ax.axvline(at, color=draw.FAINT, lw=0.6, ls=":")
        if at - named > room:
            named = at
            axes[0].annotate(text, (at, 1.0), xycoords=("data", "axes fraction"), fontsize=6,
                             rotation=30, color=draw.FAINT, annotation_clip=True)
    axes[-1].set_xlabel("time [s]")
    return draw.plain(figure)


def simulation_picture(simulation: Simulation, what: Sequence[str] = ()) -> Picture | None:
    """Voltages, states and motion over time; None if `what` names none of them."""
    channels, rows = simulation.parameters["bench.channels"], list[tuple[str, Curves]]()
    for state, (label, factor) in _STATES.items():
        values = factor * getattr(simulation, state).reshape(len(simulation.time), -1)
        is_still = state == "deflection" and not what and not values.any()
        if (not what or state in what) and not is_still:
            names = ("deflection",) if state == "deflection" else channels
            rows.append((label, [(n, simulation.time, values[:, k]) for k, n in enumerate(names)]))
    if not rows:
        return None
    return pictured("simulation", _over_time(rows), over_time=True, channels=", ".join(channels))


def overlay_picture(found: Overlay, what: Sequence[str] = ()) -> Picture:
    """Per quantity the signal that differs most, or those in `what`: all records, and below them
    their differences from the first. Raises InputError: the records share no such signal."""
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
    figure, axes = draw.read_and_error(len(worst), 0.9 + 2.4 * len(worst))
    for (upper, lower), signal in zip(axes, worst.values(), strict=True):
        unit, factor = scale_of(signal)
        shown = {n: r[signal] for n, r in found.records.items() if signal in r.signals}
        base = next(iter(shown.values()))
        for k, (record, own) in enumerate(shown.items()):
            t, v = draw.thinned(own.time, draw.drawable(factor * own.values), _MOST_DRAWN)
            style = draw.line_style(k, len(shown), len(t))
            upper.plot(t, v, label=record, **style)
            if k:
                inside = (base.time >= own.time[0]) & (base.time <= own.time[-1])
                time = base.time[inside]
                apart = factor * (np.interp(time, own.time, own.values) - base.values[inside])
                lower.plot(*draw.thinned(time, draw.drawable(apart), _MOST_DRAWN), **style)
        for d in (d for d in found.differences if d.signal == signal):
            lower.plot([d.at], [factor * d.worst], "x", ms=7, color="black", label="_worst")
        upper.set_title(signal, loc="left", fontsize=9)
        upper.set_ylabel(f"[{unit}]")
        lower.set_ylabel(f"difference [{unit}]")
    draw.legend_above(axes[0][0])
    shifts = ", ".join(f"{n} {s:+.3g} s" for n, s in found.shifts.items() if abs(s) > 1e-3)
    return pictured("overlay", draw.plain(figure), over_time=True,
                    first=next(iter(found.records)),
                    shifts=f" Clocks shifted by the voltages: {shifts}." if shifts else "")


def agreement_picture(result: Identification, name: str = "agreement") -> Picture | None:
    """Each estimate minus its stated value, its errors, and how far the records inform it."""
    known = {key: (n, ref) for key, n in result.estimates.items()
             if (ref := (n.stated or n).value) and np.isfinite(ref)}
    if not known:
        return None
    shown = list(known.values())
    figure = Figure(figsize=(7.2, 1.3 + 0.32 * len(shown)), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True, width_ratios=(2.6, 1.0))
    place = draw.named_rows(left, [k if n.stated else f"{k} *" for k, (n, _) in known.items()])
    scale = np.array([100.0 / abs(ref) for _, ref in shown])
    off = scale * [n.value - ref for n, ref in shown]
    parts = ([n.std for n, _ in shown], [n.statistical for n, _ in shown])
    whole, random = (scale * np.nan_to_num(np.array(part)) for part in parts)
    left.errorbar(off, place, xerr=whole, fmt="none", ecolor=draw.FAINT, elinewidth=1.2, capsize=3,
                  label="with systematic error")
    left.errorbar(off, place, xerr=random, fmt="o", color=draw.MEASURED, elinewidth=3.0, ms=4,
                  label="statistical error")
    left.axvline(0.0, color=draw.MODEL, lw=1.0, ls="--")
    reach = 1.1 * float(np.max(np.abs(off) + whole, where=whole <= _UNSURE, initial=1.0))
    left.set(ylim=(-0.6, len(shown) - 0.4), xlim=(-reach, reach))
    left.set_xlabel("difference from the stated value [%]")
    draw.legend_above(left)
    informed = np.nan_to_num([100.0 * n.informed for n, _ in shown])
    right.barh(place, informed, color=draw.MEASURED, height=0.55)
    right.set(xlabel="informed [%]", xlim=(0.0, 100.0), xticks=(0, 50, 100))
    draw.plain_axes(left, right)
    figure.get_layout_engine().set(wspace=0.06)  # type: ignore[union-attr, call-arg]
    return pictured("agreement", draw.plain(figure), name)


def signal_pictures(result: Diagnosis) -> list[Picture]:
    """Measured and simulated, before and after: one picture per quantity of the held-out data."""
    pictures = []
    for quantity, _ in result.worst_first:
        obs = next(v for v in result.held_out if quantity in v.quantities)
        unit, factor = scale_of(quantity)
        # Per side, the signal with the largest error of the stated parameters.
        both = map(obs.by_signal, obs.predict([result.parameters, result.improved]).T)
        worst: dict[str, tuple[BinnedSignal, Array, Array]] = {}
        rows = [r for r in zip(obs.signals, *both, strict=True) if r[0].quantity == quantity]
        for row in sorted(rows, key=lambda r: float(np.mean((r[0].value - r[1]) ** 2))):
            worst[obs.sides[row[0].wire]] = row
        shown = [worst[side] for side in dict.fromkeys(obs.sides[r[0].wire] for r in rows)]
        # Readings, and below them their errors with the noise band.
        figure, axes = draw.read_and_error(len(shown), 0.8 + 2.9 * len(shown))
        for (upper, lower), (signal, old, new) in zip(axes, shown, strict=True):
            time, value = signal.time, factor * signal.value
            upper.plot(time, value, color=draw.MEASURED, lw=2.6, alpha=0.45, label="measured")
            half = 2.0 * factor * sample_noise(result.model.problem, signal.name)
            lower.axhspan(-half, half, color=draw.FAINT, alpha=0.18, lw=0, gid=draw.BAND)
            for simulated, label, colour, dash in ((factor * old, "as stated", draw.FAINT, "--"),
                                                   (factor * new, "improved", draw.MODEL, "-")):
                upper.plot(time, simulated, label=label, color=colour, lw=1.0, ls=dash)
                lower.plot(time, value - simulated, color=colour, lw=1.0, ls=dash)
            upper.set_title(signal.name, loc="left", fontsize=9)
            upper.set_ylabel(f"[{unit}]")
            lower.set_ylabel(f"error [{unit}]")
        draw.legend_above(axes[0][0])
        pictures.append(pictured("diagnosis_signals", figure, f"diagnosis_{quantity}", True,
                                 quantity=quantity, path=obs.path, period=shown[0][0].period))
    return pictures


def evidence_picture(result: Diagnosis) -> Picture:
    """Evidence of each effect alone and of the best pairs, in the colours of their stages."""
    search = result.search
    base, gains = search.recalibrated.evidence, {n: search.gain(n) for n in search.ranked}
    gains |= {JOIN.join(pair): fit.evidence - base for pair, fit in search.pairs.items()
              if fit.evidence - base > max(gains.values(), default=0.0)}
    gains["free-form response"] = search.flexible.gain
    ranked = sorted(gains, key=gains.__getitem__, reverse=True)
    figure, (ax,) = draw.new_figure(height=1.2 + 0.28 * len(ranked))
    legend = dict[str, BarContainer]()
    for y, name in zip(draw.named_rows(ax, ranked), ranked, strict=True):
        stages = list(dict.fromkeys(EFFECTS[e].stage for e in name.split(JOIN) if e in EFFECTS))
        several = _TWO_STAGES if stages else draw.FAINT
        colour = STAGE_COLOURS[stages[0]] if len(stages) == 1 else several
        bar = ax.barh(y, gains[name], color=colour, height=0.7)
        if stages:
            legend.setdefault(" and ".join(stages), bar)
    ax.legend(legend.values(), legend.keys(), fontsize=8, loc="lower right", title="stage",
              title_fontsize=8)
    left, right = max(min(gains.values()), -_AS_BAD), 1.5 * max(*gains.values(), _LINEAR)
    ax.set_xscale("symlog", linthresh=_LINEAR)
    ax.set_xlim(left, right)
    ticks = [t for t in (-10, -3, 0, 3, 10, 30, 100, 300, 1000, 1e4, 1e5) if left <= t <= right]
    ax.set_xticks(ticks, [f"{t:g}" for t in ticks])
    ax.xaxis.set_minor_locator(NullLocator())
    ax.axvline(0.0, color=draw.FAINT, lw=0.8)
    ax.set_xlabel("log evidence over recalibration alone [nats]")
    return pictured("diagnosis_evidence", figure, cut=-_AS_BAD)


def gap_picture(result: Diagnosis) -> Picture:
    """Maps of rms over noise: the gap as stated, the explanation, and the residual."""
    problem = result.model.problem
    names, middle = result.model.unknowns.effects, list(result.where.table)
    if result.verdict == UNEXPLAINED:
        head = "residual of\nrecalibration"
        middle = locate(problem, result.search.recalibrated.residual)
    elif names:
        head = "change by\n" + "\nand ".join(names)
    else:
        head = "change by\nrecalibration"
    maps = (("measured - simulated,\nas stated", locate(problem, result.search.nominal.residual)),
            (head, middle), ("residual of the\nbest model", locate(problem, result.model.residual)))
    # Signals by quantity, the worst first; the deflection once per side.
    quantities = dict.fromkeys([*(quantity for quantity, _ in result.worst_first), *QUANTITIES])
    rows = list(dict.fromkeys(f"{signal.name}, {side}" if side else signal.name
                              for quantity in quantities for view in result.observations
                              for signal in view.signals if signal.quantity == quantity
                              for side in (view.sides if quantity == "deflection" else ("",))))
    # Maps side by side with the phases across, one colour bar for all; numbers in their cells.
    norm = LogNorm(_LOWEST, _HIGHEST)
    figure = Figure(figsize=(7.8, 1.6 + 0.34 * len(rows)), layout="constrained")
    axes = figure.subplots(1, len(maps), sharey=True, squeeze=False)[0]
    for ax, (title, found) in zip(axes, maps, strict=True):
        numbers = {(f"{c.signal}, {c.side}" if c.signal == "deflection" else c.signal, c.phase):
                   c.gap for c in found}
        table = np.array([[numbers.get((r, p), np.nan) for p in PHASES] for r in rows])
        shown = np.clip(table, norm.vmin, norm.vmax)
        image = ax.imshow(shown, aspect="auto", cmap="YlOrRd", norm=norm)
        for (row, column), value in np.ndenumerate(table):
            if not np.isfinite(value):
                continue
            dark = float(norm(shown[row, column])) > _DARK
            ax.text(column, row, _short(value), ha="center", va="center", fontsize=8,
                    color="white" if dark else "black")
        ax.spines[:].set_visible(False)
        ax.tick_params(length=0)
        ax.set_title(title, fontsize=8)
        ax.set_xticks(range(len(PHASES)), PHASES, fontsize=8)
    axes[0].set_yticks(range(len(rows)), rows, fontsize=8)
    figure.colorbar(image, ax=axes, label="rms over noise", fraction=0.04, format="%g")
    return pictured("diagnosis_where", figure)


def _short(value: float) -> str:
    if value < 9.95:
        return "0" if value < 0.05 else f"{value:.1f}"
    return f"{value:.0f}" if value < 9999.5 else f"{value / 1e3:.0f}k"


def missing_pictures(result: Diagnosis) -> list[Picture]:
    """The residual of recalibration over time, for the signals in which most of it lies."""
    model = result.search.recalibrated
    shares: dict[str, float] = {}
    for cell in locate(result.model.problem, model.residual):
        shares[cell.signal] = shares.get(cell.signal, 0.0) + cell.share
    ranked = sorted(shares, key=lambda name: shares[name], reverse=True)[:_MOST_SIGNALS]
    pictures = []
    for name in (name for name in ranked if shares[name] > _WORTH_A_PICTURE):
        unit, factor = scale_of(name)
        block = next(iter(model.problem.of_signal(name)))
        obs, time = block.observation, block.signal.time
        look = {"color": draw.FAINT, "lw": 1.0, "label": "residual"}
        curves = [(time, factor * model.residual[block.rows], look)]
        if found := result.missed:
            response = factor * result.search.inputs[found.stage].response[block.rows]
            label = f"unknown input to the {found.stage} stage"
            curves.append((time, response, {"color": draw.MODEL, "lw": 1.2, "label": label}))
        figure, ax = draw.graph("time [s]", f"residual [{unit}]", curves, 3.2, fontsize=8)
        if found and found.record == obs.path:
            ax.axvspan(found.start, found.stop, color=draw.FAINT, alpha=0.2)
        pictures.append(pictured("diagnosis_missing", figure,
                                 f"diagnosis_missing_{name.replace('.', '_')}", signal=name,
                                 shown=obs.path))
    return pictures


def picture_of(thing: Any, *what: str) -> Picture:
    """The figure of a thing, or of its parts `what`. Raises InputError: it has no such part."""
    held: Iterable[str] = ()
    if isinstance(thing, Identification | Diagnosis):
        parts: dict[str, Callable[[Any], Picture | None]] = {"agreement": agreement_picture}
        if isinstance(thing, Diagnosis):  # the first is the default
            parts = {"signals": lambda result: signal_pictures(result)[0], "where": gap_picture,
                     "evidence": evidence_picture}
        name = what[0] if what else next(iter(parts))
        if name not in parts or len(what) > 1:
            raise InputError(f"plot: {', '.join(what)}, expected one of {', '.join(parts)}")
        picture = parts[name](thing)
    elif isinstance(thing, Record):
        picture, held = record_picture(thing, "signals", what), thing.signals
    elif isinstance(thing, Simulation):
        picture, held = simulation_picture(thing, what), _STATES
    else:
        picture = overlay_picture(thing, what)
    if picture is None:
        names = f": it has {', '.join(held)}" if held else ""
        raise InputError(f"plot: no {', '.join(what) or 'signal'} to draw{names}")
    return picture
