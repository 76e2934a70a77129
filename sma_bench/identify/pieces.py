"""Straight pieces of a curve, with as many pieces as the curve is worth."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sma_bench.identify.estimate import Array

_MOST = 9
_SHORTEST = 4


@dataclass(frozen=True)
class Piece:
    """Points first..last (included), y = value + slope (x - at)."""

    first: int
    last: int
    at: float
    value: float
    slope: float

    def crossing(self, other: "Piece") -> float:
        """x where two lines meet."""
        at_zero = self.value - self.slope * self.at - other.value + other.slope * other.at
        return at_zero / (other.slope - self.slope)


def straight_pieces(x: Array, y: Array, tolerance: float) -> list[Piece]:
    """Best straight pieces by dynamic programming (Bellman, 1961).

    Args:
        x: (n,) increasing; y: (n,).
        tolerance: rms distance in the unit of y below which more pieces are not worth having.

    Returns:
        The smallest number of pieces whose rms distance is below the tolerance, at most nine.
    """
    n = len(x)
    cost = _costs(x, y)
    best = np.full((_MOST + 1, n + 1), np.inf)
    best[0, 0] = 0.0
    origin = np.zeros((_MOST + 1, n + 1), dtype=int)
    for count in range(1, _MOST + 1):
        for end in range(_SHORTEST, n + 1):
            totals = best[count - 1, : end - _SHORTEST + 1] + cost[: end - _SHORTEST + 1, end]
            origin[count, end] = int(np.argmin(totals))
            best[count, end] = totals[origin[count, end]]
        if best[count, n] <= n * tolerance**2:
            break
    ends = [n]
    for k in range(count, 0, -1):
        ends.append(int(origin[k, ends[-1]]))
    bounds = ends[::-1]
    return [fit_piece(x, y, a, b - 1) for a, b in zip(bounds[:-1], bounds[1:], strict=True)]


def fit_piece(x: Array, y: Array, first: int, last: int) -> Piece:
    """Least-squares line through points first..last."""
    part = slice(first, last + 1)
    centred = x[part] - x[part].mean()
    slope = float(centred @ y[part]) / float(centred @ centred)
    return Piece(first, last, float(x[part].mean()), float(y[part].mean()), slope)


def _costs(x: Array, y: Array) -> Array:
    """(n + 1, n + 1) sum of squared distances from the line through points first..end - 1."""
    def running(values: Array) -> Array:
        return np.concatenate([[0.0], np.cumsum(values)])

    x, y = x - x.mean(), y - y.mean()
    sums: Sequence[Array] = [running(v) for v in (np.ones_like(x), x, y, x * x, x * y, y * y)]
    m, sx, sy, sxx, sxy, syy = (s[None, :] - s[:, None] for s in sums)
    with np.errstate(divide="ignore", invalid="ignore"):
        vxx, vxy, vyy = sxx - sx * sx / m, sxy - sx * sy / m, syy - sy * sy / m
        cost = np.maximum(vyy - np.where(vxx > 0.0, vxy * vxy / vxx, 0.0), 0.0)
    cost[m < _SHORTEST] = np.inf
    return np.asarray(cost)
