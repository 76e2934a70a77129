"""Figures: the look that all share, and those over time as data for the script that draws them."""

import base64
import hashlib
from collections.abc import Iterator
from importlib import resources
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

Array = NDArray[np.float64]


# --- The look that all figures share.

MEASURED = "#1f4e79"
SECOND = "#c0504d"
MODEL = "#e08214"
FAINT = "#8a8a8a"
_LARGEST = 1e100


def new_figure(
    rows: int = 1, height: float = 4.0, shared: bool = True
) -> tuple[Figure, list[Axes]]:
    """A figure with `rows` axes above each other that share the horizontal axis if `shared`.

    No pyplot and so no global state or display.
    """
    figure = Figure(figsize=(7.2, height), layout="constrained")
    axes = figure.subplots(rows, 1, sharex=shared, squeeze=False)[:, 0]
    for ax in axes:
        ax.grid(alpha=0.25)
        ax.spines[["top", "right"]].set_visible(False)
    return figure, list(axes)


def drawable(values: Array) -> Array:
    """Values (n,) without those so large that an axis cannot be divided."""
    return np.where(np.abs(values) < _LARGEST, values, np.nan)


def legend_above(ax: Axes) -> None:
    """Its labels in a line above the axes, where no curve can lie."""
    ax.legend(
        fontsize=8, frameon=False, loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=4,
        borderaxespad=0.2,
    )


# --- Figures over time that answer to the pointer: their lines as data, and the script.

MOST_POINTS = 1000
"""of a line, least and largest of equal parts; the CSV file beside the page has more"""


def curves_of(figure: Figure) -> list[dict[str, Any]]:
    """The lines of every axes of a figure, plain values for JSON.

    Returns:
        Of each axes `title`, `x_label`, `marks` (vertical lines) and `lines`: `label`, `colour`
        (#rrggbb), `dashed`, `x` and `y`, in which None is a gap.
    """
    curves: list[dict[str, Any]] = [
        {"title": _title(ax), "x_label": ax.get_xlabel(), "lines": list(_lines(ax)),
         "marks": list(_marks(ax))}
        for ax in figure.axes
    ]
    labels = {
        (line["colour"], line["dashed"]): line["label"]
        for part in reversed(curves) for line in part["lines"] if line["label"]
    }  # fmt: skip
    for part in curves:
        for line in part["lines"]:
            line["label"] = line["label"] or labels.get((line["colour"], line["dashed"]), "")
    return [part for part in curves if part["lines"]]


def script() -> str:
    """The script that draws them, to stand in a page."""
    return resources.files("sma_bench.report").joinpath("curves.js").read_text(encoding="utf-8")


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


def _lines(ax: Axes) -> Iterator[dict[str, Any]]:
    for line in ax.lines:
        if line.get_transform() != ax.transData:
            continue  # a mark across the axes, not a curve
        label = str(line.get_label())
        x, y = (np.asarray(values, dtype=float) for values in line.get_data())
        x, y = thinned(x, y, MOST_POINTS)
        yield {
            "label": "" if label.startswith("_") else label,
            "colour": to_hex(line.get_color()), "dashed": _is_dashed(line),
            "x": [float(f"{value:.6g}") for value in x],
            "y": [float(f"{value:.5g}") if np.isfinite(value) else None for value in y],
        }  # fmt: skip


def _marks(ax: Axes) -> Iterator[float]:
    for line in ax.lines:
        x = np.asarray(line.get_xdata(), dtype=float)
        if line.get_transform() != ax.transData and len(set(x)) == 1:
            yield float(f"{x[0]:.6g}")


def _title(ax: Axes) -> str:
    return " ".join(f"{ax.get_title(loc='left')} {ax.get_ylabel()}".split())


def _is_dashed(line: Line2D) -> bool:
    return line.get_linestyle() not in ("-", "None", "")
