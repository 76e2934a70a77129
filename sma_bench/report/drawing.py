"""The look that all figures share."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

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


def drawable(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Values (n,) without those so large that an axis cannot be divided."""
    return np.where(np.abs(values) < _LARGEST, values, np.nan)


def legend_above(ax: Axes) -> None:
    """Its labels in a line above the axes, where no curve can lie."""
    ax.legend(
        fontsize=8, frameon=False, loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=4,
        borderaxespad=0.2,
    )
