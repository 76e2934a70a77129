"""Figures over time that answer to the pointer: their lines as data, and the script that draws."""

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

MOST_POINTS = 1000
"""of a line, least and largest of equal parts; the CSV file beside the page has more"""


def courses_of(figure: Figure) -> list[dict[str, Any]]:
    """The lines of every axes of a figure, plain values for JSON.

    Returns:
        Of each axes `title`, `x_label`, `marks` (vertical lines) and `lines`: `label`, `colour`
        (#rrggbb), `dashed`, `x` and `y`, in which None is a gap.
    """
    courses: list[dict[str, Any]] = [
        {"title": _title(ax), "x_label": ax.get_xlabel(), "lines": list(_lines(ax)),
         "marks": list(_marks(ax))}
        for ax in figure.axes
    ]
    labels = {
        (line["colour"], line["dashed"]): line["label"]
        for course in reversed(courses) for line in course["lines"] if line["label"]
    }  # fmt: skip
    for course in courses:
        for line in course["lines"]:
            line["label"] = line["label"] or labels.get((line["colour"], line["dashed"]), "")
    return [course for course in courses if course["lines"]]


def script() -> str:
    """The script that draws them, to stand in a page."""
    return resources.files("sma_bench.report").joinpath("courses.js").read_text(encoding="utf-8")


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
            continue  # a mark across the axes, not a course
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
