"""How an effect shows: the same record with it and without it."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from sma_bench.blind.cases import ALL, QUANTITIES, SINGLE, Card, Case, draw_case
from sma_bench.blind.reality import BY_NAME, World
from sma_bench.blind.rigs import CHANNELS
from sma_bench.blind.sensors import UNITS, measure
from sma_bench.blind.stage import COARSE, RECORDS, Stage, gaps, largest, quantity_of
from sma_bench.blind.symptoms import EFFECTS, OUTSIDE, Draw, amount_for, draw
from sma_bench.records import Signal
from sma_bench.report.drawing import FAINT, MEASURED, SECOND, new_figure

Array = npt.NDArray[np.float64]

NAMES = (*EFFECTS, *OUTSIDE)
# Gap over noise that the eye sees beside the whole stroke, where the effect can be so large.
_TARGET = 120.0
_DPI = 80
_COLOURS = 64
_EVERY = 3  # samples: enough for the eye, a third of the file
_PANELS = 2
_SCALE = {"deflection": (1e3, "mm"), "temperature": (1.0, "K"), "current": (1.0, "A")}


@dataclass(frozen=True)
class Seen:
    """A figure and the numbers of its title.

    Attributes:
        name: of the effect; file: of the figure.
        features: what the effect moved, by name.
        gap: over noise, by signal.
    """

    name: str
    file: str
    features: dict[str, float]
    gap: dict[str, float]


def write_symptom(folder: Path, name: str, seed: int = 1) -> Seen:
    """Draw one effect into `folder`.

    Args:
        folder: exists.
        name: one of NAMES.
        seed: of the rig and its drive; every effect of a seed acts on the same rig.
    """
    case = draw_case(seed, 0, Card(SINGLE, (name,), (_TARGET,), ALL, "white"), name)
    stage = Stage(case.truth, case.sensors, case.drives)
    symptom = {**EFFECTS, **OUTSIDE}[name]
    drawn = draw(symptom, case.stream("effect"), stage.peak_current())
    features = drawn.features({}, _amount(stage, drawn))
    without, with_effect = (stage.read(f, RECORDS[0]) for f in ({}, features))
    gap = gaps(with_effect, without, stage.sensors, QUANTITIES[ALL])
    figure = _draw(case, stage, name, features, gap)
    file = f"{name}.png"
    _save(figure, folder / file)
    return Seen(name, file, features, gap)


def _save(figure: Figure, path: Path) -> None:
    """As a PNG of few colours: a fifth of the bytes."""
    canvas = FigureCanvasAgg(figure)
    figure.set_dpi(_DPI)
    canvas.draw()
    picture = Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3])
    picture.quantize(_COLOURS).save(path, optimize=True)


def _amount(stage: Stage, drawn: Draw) -> float:
    def gap(amount: float) -> float:
        with_effect = stage.read(drawn.features({}, amount), RECORDS[0], COARSE)
        without = stage.read({}, RECORDS[0], COARSE)
        return largest(gaps(with_effect, without, stage.sensors, QUANTITIES[ALL]))

    return amount_for(drawn, _TARGET, gap)


def _draw(
    case: Case, stage: Stage, name: str, features: dict[str, float], gap: dict[str, float]
) -> Figure:
    """The signals that show it best over time, measured, and the difference over the noise."""
    with_effect, without = (_measured(case, stage, f) for f in (features, {}))
    shown = _shown(gap)
    figure, axes = new_figure(_PANELS + 1, height=5.4)
    for ax, signal in zip(axes, shown, strict=False):
        _compare(ax, with_effect[signal], without[signal])
    _difference(axes[-1], stage, features, shown)
    axes[0].legend(loc="lower right", bbox_to_anchor=(1, 1), frameon=False, fontsize=8)
    axes[0].set_title(_title(name, features, gap), fontsize=9, loc="left")
    axes[-1].set_xlabel("time / s")
    for ax in axes:
        _shade(ax, stage)
    return figure


def _shown(gap: dict[str, float]) -> list[str]:
    """The best signal of each of the quantities that show most."""
    best = [max((n for n in gap if quantity_of(n) == q), key=lambda n: gap[n]) for q in _SCALE]
    return sorted(best, key=lambda n: -gap[n])[:_PANELS]


def _measured(case: Case, stage: Stage, features: dict[str, float]) -> dict[str, Signal]:
    outcome, world = stage.play(features, RECORDS[0]), World(case.truth, features)
    rng = case.stream(RECORDS[0])
    return {s.name: s for s in measure(outcome, world, case.sensors, CHANNELS, rng)}


def _compare(ax: Axes, with_effect: Signal, without: Signal) -> None:
    scale, unit = _SCALE[quantity_of(with_effect.name)]
    curves = ((without, MEASURED, 1.6, "without"), (with_effect, SECOND, 0.9, "with"))
    for signal, colour, width, label in curves:
        time, values = signal.time[::_EVERY], signal.values[::_EVERY]
        ax.plot(time, scale * values, color=colour, linewidth=width, label=label)
    ax.set_ylabel(f"{with_effect.name}\n/ {unit}", fontsize=8)


def _difference(
    ax: Axes, stage: Stage, features: dict[str, float], shown: Sequence[str]
) -> None:
    one, two = (stage.read(f, RECORDS[0]) for f in (features, {}))
    time = stage.drives[RECORDS[0]].grid(0.02)
    for name, colour in zip(shown, (SECOND, FAINT), strict=False):
        over_noise = (one[name] - two[name]) / stage.sensors.std(quantity_of(name))
        ax.plot(time[::5], over_noise[::5], color=colour, linewidth=0.9, label=name)
    ax.set_ylabel("with - without\n/ noise", fontsize=8)
    ax.legend(
        loc="lower right", bbox_to_anchor=(1, 0.92), frameon=False, ncols=2, fontsize=8
    )


def _shade(ax: Axes, stage: Stage) -> None:
    """Where a side is driven: front darker than back."""
    for pulse in stage.drives[RECORDS[0]].pulses:
        grey = "0.88" if pulse.side == "front" else "0.95"
        ax.axvspan(pulse.times[0], pulse.times[-1], color=grey, linewidth=0.0, zorder=0)


def _title(name: str, features: dict[str, float], gap: dict[str, float]) -> str:
    best = max(gap, key=lambda signal: gap[signal])
    return f"{name}\n{_settings(features)}\ngap {gap[best]:.0f} x noise in {best}"


def _settings(features: dict[str, float]) -> str:
    parts = [f"{n} {v:.3g} {BY_NAME[n].unit}".removesuffix(" 1") for n, v in features.items()]
    return ", ".join(sorted(parts))


def write_page(folder: Path, seen: Sequence[Seen], seed: int) -> None:
    """An index of the figures, README.md."""
    lines = [
        "# How every effect shows",
        "",
        f"Made by `sma-bench blind figures --seed {seed}`: one rig and one drive, each effect in a "
        "size that the eye sees. Measured records with (red) and without (blue) the effect; below, "
        "the difference without noise, over the noise. Grey: front (darker) or back driven.",
        "",
    ]
    for group, names in (("The contract's effects", EFFECTS), ("Outside of it", OUTSIDE)):
        lines += [f"## {group}", ""]
        for one in (s for s in seen if s.name in names):
            lines += [f"### {one.name}", "", f"![{one.name}]({one.file})", ""]
            lines += [_table(one.gap), ""]
    (folder / "README.md").write_text("\n".join(lines).rstrip() + "\n", encoding="utf-8")


def _table(gap: dict[str, float]) -> str:
    parts = [
        f"{quantity} {max(v for n, v in gap.items() if quantity_of(n) == quantity):.1f}"
        for quantity in UNITS
        if any(quantity_of(n) == quantity for n in gap)
    ]
    return f"Gap over noise: {', '.join(parts)}."
