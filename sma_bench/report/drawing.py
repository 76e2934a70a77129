"""Figures: the look that all share, as data for the page's script and for a table, and in the width
of a paper's column."""

import base64
import hashlib
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache
from importlib import resources
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.legend import Legend
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from matplotlib.text import Text
from matplotlib.ticker import FixedFormatter, FuncFormatter
from numpy.typing import NDArray

Array = NDArray[np.float64]


# --- The look that all figures share.

MEASURED = "#1f4e79"
SECOND = "#c0504d"
MODEL = "#e08214"
FAINT = "#8a8a8a"
_LARGEST = 1e100

# Lines side by side, told apart by lightness, dash and mark, not by hue alone.
_LINES = (
    ("#0b3c5d", "-", "o"), ("#b5402f", "--", "s"), ("#2f8f83", "-.", "^"), ("#d99a2b", ":", "D"),
    ("#7b4ea3", (0, (6, 1.5, 1, 1.5, 1, 1.5)), "v"), ("#4a4a4a", (0, (1, 1)), "P"),
)
_MARKS_OF_A_LINE = 6
_BAND = "band"


def line_style(k: int, of: int, points: int) -> dict[str, Any]:
    """Look of line `k` of `of` that share axes, `points` long; a line alone is plain."""
    colour, dash, mark = _LINES[k % len(_LINES)]
    if of == 1:
        return {"color": colour, "lw": 0.9}
    # Marks of different lines lie beside each other, also where the lines coincide.
    every = max(points // _MARKS_OF_A_LINE, 1)
    first = min((every * (2 * k + 1)) // (2 * of), max(points - 1, 0))
    return {
        "color": colour, "lw": 1.1, "ls": dash, "marker": mark, "ms": 4, "mfc": "white",
        "mew": 1.0, "markevery": (first, every),
    }


def noise_band(ax: Axes, half: float) -> None:
    """What lies within it may be noise; the page's script draws it too."""
    ax.axhspan(-half, half, color=FAINT, alpha=0.18, lw=0, gid=_BAND)


def new_figure(
    rows: int = 1, height: float = 4.0, shared: bool = True, heights: Sequence[float] | None = None
) -> tuple[Figure, list[Axes]]:
    """A figure with `rows` axes above each other, `heights` in proportion, that share the
    horizontal axis if `shared`.

    No pyplot and so no global state or display.
    """
    figure = Figure(figsize=(7.2, height), layout="constrained")
    axes = figure.subplots(rows, 1, sharex=shared, squeeze=False, height_ratios=heights)[:, 0]
    plain_axes(*axes)
    return figure, list(axes)


def one_panel(across: str, up: str, height: float = 4.0) -> tuple[Figure, Axes]:
    """A figure of one graph, and what is drawn along its two axes."""
    figure, (ax,) = new_figure(height=height)
    ax.set(xlabel=across, ylabel=up)
    return figure, ax


def read_and_error(signals: int, height: float) -> tuple[Figure, list[tuple[Axes, Axes]]]:
    """A figure over time with two graphs a signal, the lower one for differences."""
    figure, axes = new_figure(2 * signals, height, heights=(1.6, 1.0) * signals)
    axes[-1].set_xlabel("time [s]")
    return figure, list(zip(axes[::2], axes[1::2], strict=True))


def named_rows(ax: Axes, names: Sequence[str]) -> Array:
    """A row a name, from above: (n,) where they are."""
    place = np.arange(len(names), dtype=np.float64)[::-1]
    ax.set_yticks(place, names, fontsize=8)
    return place


def cell_texts(ax: Axes, texts: Mapping[tuple[int, int], tuple[str, bool]], size: float) -> None:
    """Numbers in the cells of a map, by row and column: text, and whether its colour is dark."""
    for (row, column), (text, is_dark) in texts.items():
        ax.text(column, row, text, ha="center", va="center", fontsize=size,
                color="white" if is_dark else "black")  # fmt: skip
    ax.spines[:].set_visible(False)


def plain_axes(*axes: Axes) -> None:
    """A faint grid and no lines above and to the right."""
    for ax in axes:
        ax.grid(alpha=0.25)
        ax.spines[["top", "right"]].set_visible(False)


def drawable(values: Array) -> Array:
    """Values (n,) without those so large that an axis cannot be divided."""
    return np.where(np.abs(values) < _LARGEST, values, np.nan)


def legend_above(ax: Axes) -> None:
    """Its labels in a line above the axes, where no curve can lie."""
    ax.legend(
        fontsize=8, frameon=False, loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=4,
        borderaxespad=0.2,
    )


def plain(figure: Figure) -> Figure:
    """Names from files are no formulas: a dollar sign stays one."""
    for text in figure.findobj(Text):
        assert isinstance(text, Text)
        text.set_parse_math(False)
    return figure


# --- Figures over time that answer to the pointer: their lines as data, and the script.

MOST_POINTS = 1000
"""of a line, least and largest of equal parts; the CSV file beside the page has more"""


def curves_of(figure: Figure) -> list[dict[str, Any]]:
    """The lines of every axes of a figure, plain values for JSON.

    Returns:
        Of each axes `title`, `x_label`, `marks` (vertical lines), `bands` (lowest and highest) and
        `lines`: `label`, `colour` (#rrggbb), `dash` (pixels), `wide`, `x` and `y`, in which None is
        a gap.
    """
    curves: list[dict[str, Any]] = []
    labels: dict[str, str] = {}  # of lines alike in the axes above
    for ax in figure.axes:
        lines, marks = [], []
        for line in ax.lines:
            x, y = (np.asarray(values, dtype=float) for values in line.get_data())
            if line.get_transform() != ax.transData:
                marks += [float(f"{x[0]:.6g}")] if len(set(x)) == 1 else []
            if len(x) < 2 or line.get_transform() != ax.transData:
                continue  # a mark on another line, or across the axes
            x, y = thinned(x, y, MOST_POINTS)
            style, colour = str(line.get_linestyle()), to_hex(line.get_color())
            look = colour + style
            labels.setdefault(look, _label(line))
            lines.append({
                "label": _label(line) or labels[look], "colour": colour,
                "dash": [] if style in ("-", "None", "") else _DASHES.get(style, [2.0, 2.0]),
                "wide": line.get_linewidth() > _WIDE, "x": [float(f"{value:.6g}") for value in x],
                "y": [float(f"{value:.5g}") if np.isfinite(value) else None for value in y],
            })  # fmt: skip
        if lines:
            curves.append({
                "title": _title(ax), "x_label": ax.get_xlabel(), "lines": lines, "marks": marks,
                "bands": list(_bands(ax)),
            })  # fmt: skip
    return curves


@cache
def script() -> str:
    """The script that draws them, to stand in a page: the dashboard's own uPlot, and its use."""
    own = resources.files("sma_bench.report").joinpath("curves.js").read_text(encoding="utf-8")
    return f"{_of_dashboard('uPlot.min.js')}\n{own}"


def plot_style() -> str:
    """The style sheet of uPlot."""
    return _of_dashboard("uPlot.min.css")


def _of_dashboard(name: str) -> str:
    return resources.files("sma_bench.dashboard").joinpath(name).read_text(encoding="utf-8")


def policy() -> str:
    """Content security policy of a page: nothing from elsewhere, and no other script than this."""
    digest = base64.b64encode(hashlib.sha256(script().encode()).digest()).decode("ascii")
    return (
        "default-src 'none'; img-src data:; style-src 'unsafe-inline'; "
        f"script-src 'sha256-{digest}'; base-uri 'none'; form-action 'none'"
    )


def thinned(x: Array, y: Array, most: int) -> tuple[Array, Array]:
    """At most `most` points with every peak: least and largest of equal parts."""
    if len(x) <= most:
        return x, y
    kept: list[int] = []
    for part in np.array_split(np.arange(len(x)), most // 2):
        values = y[part]
        if np.isnan(values).all():
            kept.append(int(part[0]))
            continue
        kept += sorted({int(part[np.nanargmin(values)]), int(part[np.nanargmax(values)])})
    return x[kept], y[kept]


_DASHES = {"--": [6.0, 4.0], "-.": [7.0, 3.0, 1.5, 3.0], ":": [1.5, 3.0]}
_WIDE = 2.0


def _label(line: Line2D) -> str:
    label = str(line.get_label())
    return "" if label.startswith("_") else label


def _bands(ax: Axes) -> Iterator[list[float]]:
    for patch in ax.patches:
        if patch.get_gid() == _BAND:
            heights = patch.get_patch_transform().transform(patch.get_path().vertices)[:, 1]
            yield [float(f"{edge:.5g}") for edge in (heights.min(), heights.max())]


def _title(ax: Axes) -> str:
    return " ".join(f"{ax.get_title(loc='left')} {ax.get_ylabel()}".split())


# --- A figure as a table: everything that is drawn, in plain numbers.

TABLE_HEADER = ("panel", "curve", "across", "x", "y", "value")


def drawn_rows(figure: Figure) -> list[tuple[str, ...]]:
    """Lines point by point, bars, error bars and cells of maps, a row each, as `TABLE_HEADER`."""
    rows: list[tuple[str, ...]] = []
    across = next((ax.get_xlabel() for ax in reversed(figure.axes) if ax.get_xlabel()), "")
    for k, ax in enumerate(figure.axes, 1):
        if ax.get_label() == "<colorbar>":
            continue
        head = (_plain(_title(ax) or ax.get_title()) or f"{k}", ax.get_xlabel() or across)
        rows += [
            (head[0], name, head[1], *map(_plain, (x, y, *(value or [""]))))
            for name, x, y, *value in _points(ax)
        ]
    return rows


def _points(ax: Axes) -> Iterator[tuple[Any, ...]]:
    """Curve, x, y, and of a map the value there."""
    wide = _categories(ax.xaxis)
    shared = [ax, *ax.get_shared_y_axes().get_siblings(ax)]
    high = next((names for own in shared if (names := _categories(own.yaxis))), {})
    for line in ax.lines:
        if line.get_transform() != ax.transData or line.get_marker() in ("|", "_"):
            continue  # a mark across the axes, or the end of an error bar
        for x, y in zip(*map(np.asarray, line.get_data()), strict=True):
            yield _label(line), wide.get(float(x), x), high.get(float(y), y)
    for bars in ax.containers:
        for bar in bars.patches if hasattr(bars, "patches") else ():
            if isinstance(bar, Rectangle) and bar.get_x() + bar.get_width():
                middle = bar.get_y() + bar.get_height() / 2.0
                near = min(high, key=lambda y: abs(y - middle), default=None)
                label = str(bars.get_label())
                yield (
                    "" if label.startswith("_") else label, bar.get_width(),
                    middle if near is None else high[near],
                )
    for found in ax.collections:
        if isinstance(found, LineCollection):
            for ends in found.get_segments():
                for x, y in ends:
                    yield "error bar", x, high.get(float(y), y)
    for image in ax.images:
        # Colours may be cut where numbers are not.
        table = np.asarray(vars(image).get("table", image.get_array()), dtype=float)
        for (row, column), value in np.ndenumerate(table):
            yield "", wide.get(column, column), high.get(row, row), value


def _categories(axis: Any) -> Mapping[float, str]:
    """Names of places on an axis that has names in place of numbers."""
    if not isinstance(axis.get_major_formatter(), FixedFormatter | FuncFormatter):
        return {}
    texts = [tick.get_text() for tick in axis.get_ticklabels()]
    return dict(zip(map(float, axis.get_ticklocs()), texts, strict=False)) if any(texts) else {}


def _plain(value: float | str) -> str:
    if isinstance(value, str):
        return " ".join(value.split())
    return f"{float(value):.8g}" if np.isfinite(value) else ""


# --- The same figure for a column of print.

_INCH = 25.4  # mm
_LEAST_FONT = 5.0
_TALLEST = 9.5  # inches, of a page


class PaperColumn(NamedTuple):
    """Where a figure is to stand in print: width [mm] and size of its letters [pt]."""

    width: float = 183.0
    font: float = 8.0


COLUMNS = {"single": PaperColumn(89.0, 7.0), "double": PaperColumn()}


@contextmanager
def in_column(figure: Figure, column: PaperColumn) -> Iterator[None]:
    """The figure in another width, as high in proportion but no less than its letters need."""
    width, height = (float(length) for length in figure.get_size_inches())
    texts = [text for text in figure.findobj(Text) if isinstance(text, Text)]
    sizes = [float(text.get_fontsize()) for text in texts]
    middle = float(np.median(sizes)) if sizes else column.font
    legends = [found for found in figure.findobj(Legend) if isinstance(found, Legend)]
    columns = [int(vars(legend)["_ncols"]) for legend in legends]
    new = column.width / _INCH
    ratio = max(new / width, 0.62)
    try:
        figure.set_size_inches(new, min(height * ratio, _TALLEST))
        for text, size in zip(texts, sizes, strict=True):
            text.set_fontsize(max(_LEAST_FONT, column.font * min(size / middle, 1.2)))
        for legend, own in zip(legends, columns, strict=True):
            legend.set_ncols(max(1, min(own, math.floor(new / 1.6))))
        for ax in figure.axes:
            if not _categories(ax.xaxis) and ax.get_xscale() == "linear":
                ax.locator_params(axis="x", nbins=max(3, min(9, math.floor(new * 1.6))))
        yield
    finally:
        figure.set_size_inches(width, height)
        for text, size in zip(texts, sizes, strict=True):
            text.set_fontsize(size)
        for legend, own in zip(legends, columns, strict=True):
            legend.set_ncols(own)
