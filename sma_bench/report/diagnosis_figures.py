"""Figures of a diagnosis: signals, where the gap lies, candidates, evidence, what is missing."""

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm, Normalize, SymLogNorm
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.ticker import LogLocator, NullFormatter, NullLocator, StrMethodFormatter
from numpy.typing import NDArray

from sma_bench.diagnose import Diagnosis
from sma_bench.diagnose.decision import JOIN, NO_GAP, RECALIBRATION, UNEXPLAINED
from sma_bench.diagnose.result import DiagnosisResult
from sma_bench.diagnose.sizes import DRIVE, INITIAL, REST, locate, sample_noise
from sma_bench.estimation.observation import QUANTITIES, BinnedSignal
from sma_bench.estimation.solver import Fit
from sma_bench.parameters import Parameters
from sma_bench.physics.effects import EFFECTS
from sma_bench.protocols import parse_protocol
from sma_bench.report.drawing import (
    FAINT,
    MEASURED,
    MODEL,
    SECOND,
    cell_texts,
    legend_above,
    named_rows,
    new_figure,
    noise_band,
    one_panel,
    plain,
    plain_axes,
    read_and_error,
)
from sma_bench.report.page import Picture, pictured
from sma_bench.report.tables import LEAST_SHOWN
from sma_bench.results import scale_of

Array = NDArray[np.float64]

STAGE_COLOURS = {
    "electrical": "#b58900", "thermal": "#c0504d", "transformation": "#7a5195",
    "mechanical": "#2a7f62", "sensor": "#1f4e79",
}
_TWO_STAGES = "#4a4a4a"
_RIVALS = (RECALIBRATION, NO_GAP, UNEXPLAINED)
_MOST_BARS = 10
_LINEAR = 3.0  # nats, within which the axis of evidence is linear
_FEW_DECADES = 200.0  # nats up to which there is a tick every half decade
_AS_BAD = 20.0  # nats below recalibration, where bars are cut
_PROTOCOL_STEP = 0.05  # s


def signal_pictures(result: Diagnosis) -> list[Picture]:
    """Measured against simulated, before and after: a picture a quantity of the held-out data."""
    pictures = []
    for quantity, _ in result.worst_first:
        obs = next(v for v in result.held_out if quantity in v.quantities)
        unit, factor = scale_of(quantity)

        # Of each side the signal that the belief misses most.
        before = obs.readings(obs.simulate(result.parameters))
        after = obs.readings(obs.simulate(result.improved))
        worst: dict[str, tuple[BinnedSignal, Array, Array]] = {}
        every = zip(obs.signals, before, after, strict=True)
        rows = [row for row in every if row[0].quantity == quantity]
        for row in sorted(rows, key=lambda r: float(np.mean((r[0].value - r[1]) ** 2))):
            worst[obs.sides[row[0].wire]] = row
        shown = [worst[side] for side in dict.fromkeys(obs.sides[r[0].wire] for r in rows)]

        # Readings, and below them their errors with the band of the noise.
        figure, axes = read_and_error(len(shown), 0.8 + 2.9 * len(shown))
        for (upper, lower), (signal, old, new) in zip(axes, shown, strict=True):
            time, value = signal.time, factor * signal.value
            upper.plot(time, value, color=MEASURED, lw=2.6, alpha=0.45, label="measured")
            noise_band(lower, 2.0 * factor * sample_noise(result.model.problem, signal.name))
            for simulated, label, colour, dash in (
                (factor * old, "as believed", FAINT, "--"), (factor * new, "improved", MODEL, "-"),
            ):
                upper.plot(time, simulated, label=label, color=colour, lw=1.0, ls=dash)
                lower.plot(time, value - simulated, color=colour, lw=1.0, ls=dash)
            upper.set_ylabel(f"[{unit}]")
            upper.set_title(signal.name, loc="left", fontsize=9)
            lower.set_ylabel(f"error [{unit}]")
        legend_above(axes[0][0])
        pictures.append(pictured(
            "diagnosis_signals", figure, f"diagnosis_{quantity}", over_time=True,
            quantity=quantity, path=obs.path, period=shown[0][0].period,
        ))
    return pictures


def candidate_picture(result: DiagnosisResult, name: str = "diagnosis_candidates") -> Picture:
    """Probabilities of the candidates."""
    shown = [
        c for k, c in enumerate(result.candidates)
        if c.name in _RIVALS or (k < _MOST_BARS and c.probability >= LEAST_SHOWN)
    ]
    figure, (ax,) = new_figure(height=1.2 + 0.32 * len(shown))
    place = named_rows(ax, [f"{c.name} *" if c.name in result.credible else c.name for c in shown])
    stages = [[part for part in c.stage.split(JOIN) if part] for c in shown]
    ax.barh(place, [c.probability for c in shown], color=list(map(_colour, stages)), height=0.7)
    for y, c in zip(place, shown, strict=True):
        ax.text(c.probability + 0.01, y, f"{c.probability:.3f}", va="center", fontsize=8)
    ax.set(xlabel="probability", xlim=(0.0, 1.12))
    _stage_legend(ax, filter(None, stages))
    return pictured("diagnosis_candidates", plain(figure), name)


def chain_picture(result: DiagnosisResult, name: str) -> Picture:
    """The gap of every block of the chain."""
    chain = result.where.chain
    figure, (ax,) = new_figure(height=1.2 + 0.4 * len(chain))
    place = named_rows(ax, [link.block for link in chain])
    gap = np.array([link.gap for link in chain])
    low, high = np.array([link.ci90 for link in chain]).T
    ax.errorbar(gap, place, xerr=np.maximum([gap - low, high - gap], 0.0), fmt="o", color=MEASURED,
                capsize=4)  # fmt: skip
    ax.axvline(0.0, color=FAINT, lw=0.8)
    ax.axvline(1.0, color=SECOND, lw=0.8, ls="--")
    ax.set_ylim(-0.6, len(chain) - 0.4)
    ax.set_xlabel("gap over noise, 90 % interval")
    return pictured("chain", plain(figure), name)


def evidence_picture(result: Diagnosis) -> Picture:
    """What each effect alone, and the best pairs, would explain."""
    search = result.search
    base = search.recalibrated.evidence
    gains = {name: search.gain(name) for name in search.ranked}
    gains |= {
        JOIN.join(pair): fit.evidence - base for pair, fit in search.pairs.items()
        if fit.evidence - base > max(gains.values(), default=0.0)
    }
    gains["response of free form"] = search.flexible.gain
    ranked = sorted(gains, key=lambda name: gains[name], reverse=True)
    figure, (ax,) = new_figure(height=1.2 + 0.28 * len(ranked))
    place = named_rows(ax, ranked)
    stages = [
        list(dict.fromkeys(EFFECTS[e].stage for e in n.split(JOIN) if e in EFFECTS)) for n in ranked
    ]
    ax.barh(place, [gains[n] for n in ranked], color=list(map(_colour, stages)), height=0.7)
    _stage_legend(ax, filter(None, stages))
    left, right = max(min(gains.values()), -_AS_BAD), 1.5 * max(*gains.values(), _LINEAR)
    ax.set_xscale("symlog", linthresh=_LINEAR)
    ax.set_xlim(left, right)
    decades = 10.0 ** np.arange(1, 8)
    steps = np.sort(np.append(decades, 0.3 * decades)) if right < _FEW_DECADES else decades
    ticks = [t for t in (*-steps[::-1], 0.0, *steps) if left <= t <= right]
    ax.set_xticks(ticks, [f"{t:g}" for t in ticks])
    ax.xaxis.set_minor_locator(NullLocator())
    ax.axvline(0.0, color=FAINT, lw=0.8)
    ax.set_xlabel("log evidence over recalibration alone [nats]")
    return pictured("diagnosis_evidence", figure, cut=-_AS_BAD)


def shrinkage_picture(result: Diagnosis) -> Picture:
    """Errors before and after against the noise, and the share of the gap that is gone."""
    names, found = zip(*result.worst_first, strict=True)
    figure = Figure(figsize=(7.2, 1.4 + 0.6 * len(names)), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    place = named_rows(left, names)
    before = [s.rmse_before / s.noise_floor for s in found]
    after = [s.rmse_after / s.noise_floor for s in found]
    left.barh(place + 0.18, before, height=0.34, color=FAINT, label="as believed")
    left.barh(place - 0.18, after, height=0.34, color=MODEL, label="improved")
    left.axvline(1.0, color=MEASURED, lw=1.2, ls="--", label="noise floor")
    left.set_xscale("log")
    left.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    left.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    left.xaxis.set_minor_formatter(NullFormatter())
    left.set_xlabel("rms error over the sensor's noise")
    left.legend(fontsize=8)
    left.set_xlim(left=0.7)
    for y, s in zip(place, found, strict=True):
        if s.at_noise:
            right.text(50.0, y, "was at its noise", ha="center", va="center", fontsize=8)
            continue
        ends = np.abs(np.array(s.ci90) - s.fraction)[:, np.newaxis]
        right.errorbar(
            [100.0 * s.fraction], [y], xerr=100.0 * ends, fmt="o", color=MODEL, capsize=4, ms=5
        )
    right.axvline(100.0, color=MEASURED, lw=1.2, ls="--")
    right.axvline(0.0, color=FAINT, lw=0.8)
    right.set_xlabel("gap that is gone [%], 90 % interval")
    plain_axes(left, right)
    return pictured("diagnosis_shrinkage", figure)


def next_experiment_picture(result: Diagnosis, parameters: Parameters) -> Picture | None:
    """Voltages of the proposed protocol; None where there is none.

    Raises:
        InputError: the protocol cannot be run on this rig.
    """
    if result.next_experiment is None or not result.next_experiment.protocol:
        return None
    protocol = parse_protocol(dict(result.next_experiment.protocol), parameters)
    time, voltage = protocol.sample(_PROTOCOL_STEP)
    sides = np.array(parameters["bench.channel_sides"])
    figure, ax = one_panel("time [s]", "voltage [V]", 2.8)
    for side, colour in zip(dict.fromkeys(sides), (MEASURED, MODEL), strict=False):
        ax.plot(time, voltage[:, sides == side].max(axis=1), color=colour, lw=1.2, label=side)
    ax.legend(fontsize=8)
    separates = ", ".join(result.next_experiment.separates)
    return pictured("diagnosis_next_experiment", figure, separates=separates)


def _colour(stages: Sequence[str]) -> str:
    if not stages:
        return FAINT
    return STAGE_COLOURS[stages[0]] if len(stages) == 1 else _TWO_STAGES


def _stage_legend(ax: Axes, stages: Iterable[Sequence[str]]) -> None:
    shown = {" and ".join(own): _colour(own) for own in stages}
    for label, colour in shown.items():
        ax.barh([0.0], [0.0], color=colour, label=label)
    if shown:
        ax.legend(fontsize=8, loc="lower right", title="stage", title_fontsize=8)


# --- Heat maps of a diagnosis: the gap by signal, side and phase, and what each stage explains.

PHASES = (INITIAL, DRIVE, REST)
_LOWEST, _HIGHEST = 0.1, 30.0  # of the noise
_NATS = 3.0  # within which the colours of evidence are linear


def gap_picture(result: Diagnosis) -> Picture:
    """Root mean square over noise of each cell: before, what explains it, and what is left."""
    problem = result.model.problem
    names, middle = result.model.unknowns.effects, list(result.where.table)
    if result.decision.verdict == UNEXPLAINED:
        head = "what is missing: left\nby recalibration"
        middle = locate(problem, result.search.recalibrated.left)
    elif names:
        head = "what " + "\nand ".join(names) + f" {'does' if len(names) == 1 else 'do'}"
    else:
        head = "what recalibration\nchanges"
    maps = (
        ("measured less simulated,\nas believed", locate(problem, result.search.nominal.left)),
        (head, middle),
        ("left by the\nbest model", locate(problem, result.model.left)),
    )

    # Signals by quantity, the worst first; the deflection once a side.
    rows = list(dict.fromkeys(
        f"{signal.name}, {side}" if side else signal.name
        for quantity in _quantities(result) for view in result.observations
        for signal in view.signals if signal.quantity == quantity
        for side in (view.sides if quantity == "deflection" else ("",))
    ))  # fmt: skip
    figure = Figure(figsize=(7.8, 1.6 + 0.34 * len(rows)), layout="constrained")
    axes = figure.subplots(1, len(maps), sharey=True)
    for ax, (title, cells) in zip(axes, maps, strict=True):
        numbers = {
            (f"{c.signal}, {c.side}" if c.signal == "deflection" else c.signal, c.phase): c.gap
            for c in cells
        }
        table = np.array([[numbers.get((r, p), np.nan) for p in PHASES] for r in rows])
        image = _draw(ax, table, LogNorm(_LOWEST, _HIGHEST), "YlOrRd")
        ax.set_title(title, fontsize=8)
        ax.set_xticks(range(len(PHASES)), PHASES, fontsize=8)
    axes[0].set_yticks(range(len(rows)), rows, fontsize=8)
    figure.colorbar(image, ax=axes, label="rms over noise", fraction=0.04, format="%g")
    return pictured("diagnosis_where", figure)


def stage_picture(result: Diagnosis) -> Picture:
    """Evidence that the best effect of each stage earns, by quantity and phase."""
    best: dict[str, tuple[str, Fit]] = {}
    for name in result.search.ranked:
        best.setdefault(EFFECTS[name].stage, (name, result.search.singles[name]))
    best = {stage: best[stage] for stage in STAGE_COLOURS if stage in best}
    quantities = _quantities(result)
    columns = [(q, p) for q in quantities for p in PHASES]
    whole = _power(result, result.search.recalibrated)
    table = np.array(
        [
            [0.5 * (whole.get(c, 0.0) - own.get(c, 0.0)) if c in whole else np.nan
             for c in columns]
            for own in (_power(result, fit) for _, fit in best.values())
        ]
    ).reshape(len(best), len(columns))
    figure = Figure(figsize=(7.8, 1.4 + 0.4 * len(best)), layout="constrained")
    axes = figure.subplots(1, len(quantities), sharey=True, squeeze=False)[0]
    largest = max(float(np.nanmax(np.abs(table), initial=0.0)), 2.0 * _NATS)
    norm = SymLogNorm(_NATS, vmin=-largest, vmax=largest)
    for k, (ax, quantity) in enumerate(zip(axes, quantities, strict=True)):
        image = _draw(ax, table[:, k * len(PHASES) : (k + 1) * len(PHASES)], norm, "RdBu_r")
        ax.set_xticks(range(len(PHASES)), PHASES, fontsize=8)
        ax.set_title(quantity, fontsize=9)
    names = [f"{stage}: {name}" for stage, (name, _) in best.items()]
    axes[0].set_yticks(range(len(best)), names, fontsize=8)
    bar = figure.colorbar(image, ax=axes, label="nats over recalibration", fraction=0.04)
    bar.set_ticks([-largest, -_NATS, 0.0, _NATS, largest])
    most = _short(largest).removesuffix(".0")
    bar.ax.set_yticklabels([f"-{most}", f"{-_NATS:g}", "0", f"{_NATS:g}", most])
    return pictured("diagnosis_stages", figure)


def _power(result: Diagnosis, fitted: Fit) -> Mapping[tuple[str, str], float]:
    """Whitened squared residual by quantity and phase."""
    noise = result.model.problem.noise
    found: dict[tuple[str, str], float] = {}
    for block in fitted.problem.blocks:
        white = noise[block.signal.name].whiten(fitted.left[block.rows]) ** 2
        phases = block.observation.phase_of(block.signal.time)
        for phase in PHASES:
            key = (block.signal.quantity, phase)
            here = phases == phase
            if here.any():
                found[key] = found.get(key, 0.0) + float(white[here].sum())
    return found


def _quantities(result: Diagnosis) -> list[str]:
    """Those that were compared, the worst first."""
    compared = {quantity for view in result.observations for quantity in view.quantities}
    held_out = [quantity for quantity, _ in result.worst_first]
    return [q for q in dict.fromkeys((*held_out, *QUANTITIES)) if q in compared]


# Colour maps, and from where to where on them black letters can be read.
_READABLE = {"YlOrRd": (0.0, 0.65), "RdBu_r": (0.2, 0.8)}


def _draw(ax: Axes, table: Array, norm: Normalize, colours: str) -> AxesImage:
    shown = np.clip(table, norm.vmin, norm.vmax)
    image = ax.imshow(shown, aspect="auto", cmap=colours, norm=norm)
    vars(image)["table"] = table
    low, high = _READABLE[colours]
    cell_texts(ax, {
        cell: (_short(value), not low <= float(norm(shown[cell])) <= high)
        for cell, value in np.ndenumerate(table) if np.isfinite(value)
    }, 8)
    ax.tick_params(length=0)
    return image


def _short(value: float) -> str:
    if abs(value) < 0.05:
        return "0"
    if abs(value) < 9.95:
        return f"{value:.1f}"
    return f"{value:.0f}" if abs(value) < 9999.5 else f"{value / 1e3:.0f}k"


# --- The shape of what no effect explains: against time, simulated temperature and voltage.

_MOST_SIGNALS = 3
_WORTH_A_PICTURE = 0.05  # of all that is missing
_COLOURS = dict(zip(PHASES, (FAINT, MODEL, MEASURED), strict=True))


def missing_pictures(result: Diagnosis) -> list[Picture]:
    """A picture for each signal that most of what is missing lies in."""
    cells = locate(result.model.problem, result.search.recalibrated.left)
    shares: dict[str, float] = {}
    for cell in cells:
        shares[cell.signal] = shares.get(cell.signal, 0.0) + cell.share
    ranked = sorted(shares, key=lambda name: shares[name], reverse=True)
    worth = [name for name in ranked if shares[name] > _WORTH_A_PICTURE]
    return [_missing(result, name) for name in worth[:_MOST_SIGNALS]]


def _missing(result: Diagnosis, name: str) -> Picture:
    unit, factor = scale_of(name)
    figure, (over_time, temperature, voltage) = new_figure(3, 8.0, shared=False)
    model = result.search.recalibrated
    shown = ""
    response = free_form(result)
    for block in model.problem.of_signal(name):
        obs, time = block.observation, block.signal.time
        left, smooth = model.left[block.rows], response[block.rows]
        if not shown:
            shown = obs.path
            over_time.plot(time, factor * left, color=FAINT, lw=1.0, label="left by recalibration")
            if smooth.any():
                over_time.plot(time, factor * smooth, color=SECOND, lw=1.2,
                            label="of it a smooth response of free form")
        # What the term may depend on: of a wire, or of the sides' warmest and highest.
        at = np.clip(np.searchsorted(obs.grid, time), 0, len(obs.grid) - 1)
        causes = (obs.simulate(model.parameters).temperature[at], obs.voltage[at])
        if block.signal.quantity == "deflection":
            front = np.array(obs.sides) == obs.sides[0]
            warm, volts = (
                values[:, front].max(axis=1) - values[:, ~front].max(axis=1)
                if (~front).any() else values[:, front].max(axis=1) for values in causes
            )
        else:
            warm, volts = (values[:, block.signal.wire] for values in causes)
        phases = obs.phase_of(time)
        for phase, colour in _COLOURS.items():
            here = phases == phase
            for ax, x in ((temperature, warm), (voltage, volts)):
                ax.plot(x[here], factor * left[here], ".", ms=2.5, color=colour)
    for phase, colour in _COLOURS.items():
        temperature.plot([], [], ".", ms=8, color=colour, label=phase)
    legend_above(over_time)
    legend_above(temperature)
    over_time.set(xlabel="time [s]")
    bends = name == "deflection"
    temperature.set(
        xlabel="simulated temperature, front less back [K]" if bends
        else "simulated temperature of the wire [K]"
    )
    voltage.set(
        xlabel="voltage, back counted negative [V]" if bends else "voltage of the wire [V]"
    )
    for ax in (over_time, temperature, voltage):
        ax.set_ylabel(f"missing [{unit}]")
    return pictured("diagnosis_missing", figure, f"diagnosis_missing_{name.replace('.', '_')}",
                    signal=name, shown=shown)


# --- The response of free form, as far as the records separate it from wrong parameters.

def free_form(result: Diagnosis) -> Array:
    """The response of free form beyond recalibration, (n,) on the rows of the records.

    The part that moved parameters, sensors' zeros and clocks would take up again is taken off:
    with P the projection on their directions in whitened rows, (1 - P) of the response.
    """
    fitted = result.search.recalibrated
    problem, response = fitted.problem, result.search.flexible.response
    directions = np.hstack([fitted.derivatives, problem.nuisance_rows])
    rows = problem.whiten(directions)
    normal = rows.T @ rows + np.eye(rows.shape[1])
    moved = np.linalg.solve(normal, rows.T @ problem.whiten(response))
    return np.asarray(response - directions @ moved, dtype=np.float64)
