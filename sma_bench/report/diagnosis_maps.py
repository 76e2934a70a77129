"""Heat maps of a diagnosis: the gap by signal, side and phase, and what each stage explains."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm, Normalize, SymLogNorm
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from numpy.typing import NDArray

from sma_bench.diagnose import Diagnosis
from sma_bench.diagnose.decision import UNEXPLAINED
from sma_bench.diagnose.sizes import DRIVE, INITIAL, REST, Cell, locate
from sma_bench.estimation.solver import Fit
from sma_bench.physics.effects import EFFECTS
from sma_bench.report.page import Picture

Array = NDArray[np.float64]

PHASES = (INITIAL, DRIVE, REST)
STAGES = ("electrical", "thermal", "transformation", "mechanical", "sensor")
_LOWEST, _HIGHEST = 0.1, 30.0  # of the noise
_NATS = 3.0  # within which the colours of evidence are linear


def gap_picture(result: Diagnosis) -> Picture:
    """Root mean square over noise of each cell: before, what explains it, and what is left."""
    problem = result.model.problem
    maps = (
        ("measured less simulated,\nas believed", locate(problem, result.search.nominal.left)),
        _explanation(result),
        ("left by the\nbest model", locate(problem, result.model.left)),
    )
    rows = _rows(result)
    figure = Figure(figsize=(7.8, 1.6 + 0.34 * len(rows)), layout="constrained")
    axes = figure.subplots(1, len(maps), sharey=True)
    for ax, (title, cells) in zip(axes, maps, strict=True):
        numbers = {(_row(c), c.phase): c.gap for c in cells}
        table = np.array([[numbers.get((r, p), np.nan) for p in PHASES] for r in rows])
        image = _draw(ax, table, LogNorm(_LOWEST, _HIGHEST), _HEAT)
        ax.set_title(title, fontsize=8)
        ax.set_xticks(range(len(PHASES)), PHASES, fontsize=8)
    axes[0].set_yticks(range(len(rows)), rows, fontsize=8)
    figure.colorbar(image, ax=axes, label="rms over noise", fraction=0.04)
    caption = (
        "Each signal in each phase; the deflection is counted to the side driven last. 1 is the "
        "noise of one sample, so that means of many samples may lie below it. Sensors' zeros, "
        "clock delays and the moments of the jumps are taken off first and last; the middle is "
        "between two simulations."
    )
    return Picture("diagnosis_where", "Where the gap lies", caption, figure)


def stage_picture(result: Diagnosis) -> Picture:
    """Evidence that the best effect of each stage earns, by quantity and phase."""
    best = _best_of_stages(result)
    quantities = tuple(dict.fromkeys(q for v in result.observations for q in v.quantities))
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
        image = _draw(ax, table[:, k * len(PHASES) : (k + 1) * len(PHASES)], norm, _EVIDENCE)
        ax.set_xticks(range(len(PHASES)), PHASES, fontsize=8)
        ax.set_title(quantity, fontsize=9)
    names = [f"{stage}: {name}" for stage, (name, _) in best.items()]
    axes[0].set_yticks(range(len(best)), names, fontsize=8)
    bar = figure.colorbar(image, ax=axes, label="nats over recalibration", fraction=0.04)
    bar.set_ticks([-largest, -_NATS, 0.0, _NATS, largest])
    bar.ax.set_yticklabels([_short(-largest), f"{-_NATS:g}", "0", f"{_NATS:g}", _short(largest)])
    caption = (
        "The effect with the most evidence at each stage of the chain, and where it earns it: "
        "half the drop of the whitened squared error against recalibration, all with the noise "
        "that the best model leaves. An effect of the wrong stage gains in one signal what it "
        "loses in another, or little anywhere."
    )
    return Picture("diagnosis_stages", "What each stage explains", caption, figure)


def _best_of_stages(result: Diagnosis) -> dict[str, tuple[str, Fit]]:
    found = {}
    for stage in STAGES:
        name = next((n for n in result.search.ranked if EFFECTS[n].stage == stage), None)
        if name is not None:
            found[stage] = (name, result.search.singles[name])
    return found


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


def _explanation(result: Diagnosis) -> tuple[str, list[Cell]]:
    if result.decision.verdict == UNEXPLAINED:
        cells = locate(result.model.problem, result.search.recalibrated.left)
        return "what is missing: left\nby recalibration", cells
    names = result.model.unknowns.effects
    if not names:
        return "what recalibration\nchanges", list(result.where)
    verb = "does" if len(names) == 1 else "do"
    return "what " + "\nand ".join(names) + f" {verb}", list(result.where)


def _row(cell: Cell) -> str:
    return f"{cell.signal}, {cell.side}" if cell.signal == "deflection" else cell.signal


def _rows(result: Diagnosis) -> list[str]:
    """Signals by quantity, in the order of the records; the deflection once a side."""
    rows: dict[str, None] = {}
    for quantity in dict.fromkeys(q for view in result.observations for q in view.quantities):
        for view in result.observations:
            for signal in view.signals:
                if signal.quantity != quantity:
                    continue
                sides = view.sides if quantity == "deflection" else ("",)
                rows |= dict.fromkeys(f"{signal.name}, {s}" if s else signal.name for s in sides)
    return list(rows)


class _Look(NamedTuple):
    """Colour map, and from where to where on it black letters can be read."""

    colours: str
    readable: tuple[float, float]


_HEAT = _Look("YlOrRd", (0.0, 0.65))
_EVIDENCE = _Look("RdBu_r", (0.2, 0.8))


def _draw(ax: Axes, table: Array, norm: Normalize, look: _Look) -> AxesImage:
    shown = np.clip(table, norm.vmin, norm.vmax)
    image = ax.imshow(shown, aspect="auto", cmap=look.colours, norm=norm)
    for (row, column), value in np.ndenumerate(table):
        if np.isfinite(value):
            shade = float(norm(shown[row, column]))
            dark = not look.readable[0] <= shade <= look.readable[1]
            ax.text(column, row, _short(value), ha="center", va="center", fontsize=8,
                    color="white" if dark else "black")
    ax.spines[:].set_visible(False)
    ax.tick_params(length=0)
    return image


def _short(value: float) -> str:
    if abs(value) < 0.05:
        return "0"
    if abs(value) < 9.95:
        return f"{value:.1f}"
    return f"{value:.0f}" if abs(value) < 9999.5 else f"{value / 1e3:.0f}k"
