"""Common style of all figures, their curves as data for the page's script and CSV, and in print."""

import copy
import math
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from importlib import resources
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.legend import Legend
from matplotlib.lines import Line2D
from matplotlib.text import Text
from matplotlib.ticker import AutoLocator, FuncFormatter

from sma_bench.arrays import Array

MEASURED, SECOND, MODEL, FAINT = "#1f4e79", "#c0504d", "#e08214", "#8a8a8a"
BAND = "band"  # gid of noise bands, so that the page's script can draw them too
_LARGEST = 1e100  # matplotlib cannot place ticks on a longer axis
# Lines in one graph differ in lightness, dash and marker, not in hue alone.
_LINES = (("#0b3c5d", "-", "o"), ("#b5402f", "--", "s"), ("#2f8f83", "-.", "^"),
          ("#d99a2b", ":", "D"), ("#7b4ea3", (0, (6, 1.5, 1, 1.5, 1, 1.5)), "v"),
          ("#4a4a4a", (0, (1, 1)), "P"))
_MARKS_OF_A_LINE = 6
MOST_POINTS = 1000  # of a line in the page's script (see `thinned`); the CSV has all that are drawn
_DASHES = {"-": [], "None": [], "": [], "--": [6.0, 4.0], "-.": [7.0, 3.0, 1.5, 3.0],
           ":": [1.5, 3.0]}
_WIDE = 2.0  # pt: wider lines are drawn wide by the script
CURVE_HEADER = ("panel", "curve", "across", "x", "y")
_INCH = 25.4  # mm
_LEAST_FONT, _TALLEST = 5.0, 9.5  # pt; inches, height of a figure on a page


def line_style(k: int, of: int, points: int) -> dict[str, Any]:
    """Style of line `k` of `of` in the same axes, `points` long; a single line is plain."""
    colour, dash, mark = _LINES[k % len(_LINES)]
    if of == 1:
        return {"color": colour, "lw": 0.9}
    # Markers of different lines are staggered, so that coinciding lines can be seen.
    every = max(points // _MARKS_OF_A_LINE, 1)
    first = min((every * (2 * k + 1)) // (2 * of), max(points - 1, 0))
    return {"color": colour, "lw": 1.1, "ls": dash, "marker": mark, "ms": 4, "mfc": "white",
            "mew": 1.0, "markevery": (first, every)}


def new_figure(rows: int = 1, height: float = 4.0, shared: bool = True,
               heights: Sequence[float] | None = None) -> tuple[Figure, list[Axes]]:
    """A figure (without pyplot) of `rows` axes above each other, with relative `heights`."""
    figure = Figure(figsize=(7.2, height), layout="constrained")
    axes = figure.subplots(rows, 1, sharex=shared, squeeze=False, height_ratios=heights)[:, 0]
    plain_axes(*axes)
    return figure, list(axes)


def graph(across: str, up: str, curves: Iterable[tuple[Any, Any, Mapping[str, Any]]] = (),
          height: float = 4.0, **legend: Any) -> tuple[Figure, Axes]:
    """A figure of one graph: labels of its axes, curves as (x, y, style), options of the legend."""
    figure, (ax,) = new_figure(height=height)
    ax.set(xlabel=across, ylabel=up)
    for x, y, style in curves:
        ax.plot(x, y, **style)
    if ax.lines:
        ax.legend(**legend)
    return figure, ax


def read_and_error(signals: int, height: float) -> tuple[Figure, list[tuple[Axes, Axes]]]:
    """A figure over time with two graphs per signal, the lower one for differences."""
    figure, axes = new_figure(2 * signals, height, heights=(1.6, 1.0) * signals)
    axes[-1].set_xlabel("time [s]")
    return figure, list(zip(axes[::2], axes[1::2], strict=True))


def named_rows(ax: Axes, names: Sequence[str]) -> Array:
    """Label rows with names, from the top; their positions (n,) on the y axis."""
    place = np.arange(len(names), dtype=np.float64)[::-1]
    ax.set_yticks(place, names, fontsize=8)
    return place


def plain_axes(*axes: Axes) -> None:
    """A faint grid; no frame at the top and right."""
    for ax in axes:
        ax.grid(alpha=0.25)
        ax.spines[["top", "right"]].set_visible(False)


def drawable(values: Array) -> Array:
    """Values (n,), NaN where they are too large for an axis."""
    return np.where(np.abs(values) < _LARGEST, values, np.nan)


def legend_above(ax: Axes) -> None:
    """The legend in a line above the axes, where it hides no curve."""
    ax.legend(fontsize=8, frameon=False, loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=4,
              borderaxespad=0.2)


def plain(figure: Figure) -> Figure:
    """Texts without math: a dollar sign in a name from a file stays a dollar sign."""
    for text in figure.findobj(Text):
        text.set_parse_math(False)  # type: ignore[attr-defined]
    return figure


def thinned(x: Array, y: Array, most: int) -> tuple[Array, Array]:
    """At most `most` points that keep every peak: minimum and maximum of equal stretches."""
    if len(x) <= most:
        return x, y
    kept: list[int] = []
    for part in np.array_split(np.arange(len(x)), most // 2):
        values, ends = y[part], {0}
        if not np.isnan(values).all():
            ends = {int(np.nanargmin(values)), int(np.nanargmax(values))}
        kept += [int(part[end]) for end in sorted(ends)]
    return x[kept], y[kept]


def curves_of(figure: Figure) -> list[dict[str, Any]]:
    """The curves of each axes, for JSON: `title`, `x_label`, `marks` (vertical lines), `bands`
    (low, high), `lines`: `label`, `colour` (#rrggbb), `dash` (px), `wide`, `x`, `y` (None: gap)."""
    curves: list[dict[str, Any]] = []
    labels: dict[str, str] = {}  # by style; lines without label take that of the axes above
    for ax in figure.axes:
        lines, marks, bands = [], [], []
        for line in ax.lines:
            x, y = (np.asarray(values, dtype=float) for values in line.get_data())
            if line.get_transform() != ax.transData:  # a line across the whole axes
                marks += [float(f"{x[0]:.6g}")] if len(set(x)) == 1 else []
            elif len(x) > 1:  # a single point is a marker on another line
                x, y = thinned(x, y, MOST_POINTS)
                style, colour = str(line.get_linestyle()), to_hex(line.get_color())
                label = _label(line)
                labels.setdefault(colour + style, label)
                lines.append({
                    "label": label or labels[colour + style], "colour": colour,
                    "dash": _DASHES.get(style, [2.0, 2.0]), "wide": line.get_linewidth() > _WIDE,
                    "x": [float(f"{value:.6g}") for value in x],
                    "y": [float(f"{value:.5g}") if np.isfinite(value) else None for value in y]})
        for patch in ax.patches:
            if patch.get_gid() == BAND:
                up = patch.get_patch_transform().transform(patch.get_path().vertices)[:, 1]
                bands.append([float(f"{end:.5g}") for end in (up.min(), up.max())])
        if lines:
            curves.append({"title": _title(ax), "x_label": ax.get_xlabel(), "lines": lines,
                           "marks": marks, "bands": bands})
    return curves


@cache
def script() -> str:
    """The page's script that draws the curves: uPlot, as in the dashboard, and curves.js."""
    own = resources.files("sma_bench.report").joinpath("curves.js").read_text(encoding="utf-8")
    plot = resources.files("sma_bench.dashboard").joinpath("uPlot.min.js").read_text("utf-8")
    return f"{plot}\n{own}"


def _label(line: Line2D) -> str:
    label = str(line.get_label())
    return "" if label.startswith("_") else label


def _title(ax: Axes) -> str:
    return " ".join(f"{ax.get_title(loc='left')} {ax.get_ylabel()}".split())


def curve_rows(figure: Figure) -> list[tuple[str, ...]]:
    """The curves as rows of `CURVE_HEADER`, one per point; an empty y is a gap."""
    across = next((ax.get_xlabel() for ax in reversed(figure.axes) if ax.get_xlabel()), "")
    rows: list[tuple[str, ...]] = []
    for ax in figure.axes:
        names = dict[float, str]()  # of rows
        if isinstance(ax.yaxis.get_major_formatter(), FuncFormatter):
            texts = (tick.get_text() for tick in ax.get_yticklabels())
            names = dict(zip(map(float, ax.get_yticks()), texts, strict=False))
        for line in ax.lines:
            # Leave out lines across the axes and caps of error bars.
            if line.get_transform() == ax.transData and line.get_marker() not in ("|", "_"):
                head = _title(ax), _label(line), ax.get_xlabel() or across
                xs, ys = (np.asarray(values, dtype=float) for values in line.get_data())
                rows += [(*head, f"{x:.8g}", names.get(y, f"{y:.8g}" if np.isfinite(y) else ""))
                         for x, y in zip(xs, ys, strict=True)]
    return rows


class PaperColumn(NamedTuple):
    """A printed column: width [mm] and font size [pt]."""

    width: float = 183.0
    font: float = 8.0


COLUMNS = {"single": PaperColumn(89.0, 7.0), "double": PaperColumn()}


def in_column(figure: Figure, column: PaperColumn) -> Figure:
    """A copy in the column's width and font; its height shrinks less, to leave room for text."""
    shown = copy.deepcopy(figure)
    width, height = (float(length) for length in shown.get_size_inches())
    new = column.width / _INCH
    shown.set_size_inches(new, min(height * max(new / width, 0.62), _TALLEST))
    texts = [text for text in shown.findobj(Text) if isinstance(text, Text)]
    sizes = [float(text.get_fontsize()) for text in texts]
    middle = float(np.median(sizes)) if sizes else column.font
    for text, size in zip(texts, sizes, strict=True):
        text.set_fontsize(max(_LEAST_FONT, column.font * min(size / middle, 1.2)))
    for legend in shown.findobj(Legend):
        assert isinstance(legend, Legend)
        legend.set_ncols(max(1, min(int(vars(legend)["_ncols"]), math.floor(new / 1.6))))
    for ax in shown.axes:
        if isinstance(ax.xaxis.get_major_locator(), AutoLocator):
            ax.locator_params(axis="x", nbins=max(3, min(9, math.floor(new * 1.6))))
    return shown
