"""The look that all figures share."""

from matplotlib.axes import Axes
from matplotlib.figure import Figure

MEASURED = "#1f4e79"
SECOND = "#c0504d"
MODEL = "#e08214"
FAINT = "#8a8a8a"


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
