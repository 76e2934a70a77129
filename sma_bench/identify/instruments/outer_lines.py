"""The outer lines of the tangent method: along a branch before and after it transforms."""

import math
from dataclasses import dataclass

import numpy as np

from sma_bench.identify.estimate import Array
from sma_bench.identify.instruments.tangents import Line

_SHORTEST_LINE = 5
_SHORT_SHARE = 0.10
_STEEP_SHARE = 0.10
_LAG_SHARE = 0.10
_LAG_STRAIN = 0.05


@dataclass(frozen=True)
class OuterLine:
    """One outer line; `end` is where its straight stretch ends, K."""

    line: Line
    covariance: Array
    end: float
    is_short: bool


def outer_lines(
    t: Array, strain: Array, other: tuple[Array, Array] | None, straight: float
) -> tuple[OuterLine, OuterLine]:
    """Cold and hot line of a rising branch.

    Args:
        t: (n,) K, rising; strain: (n,).
        other: the same of the other branch of the cycle.
        straight: how far, over the range of strain, points may lie off a straight line.
    """
    cold = _cold_line(t, strain, straight)
    hot = _mirrored(_cold_line(-t[::-1], strain[::-1], straight))
    if other is not None:
        if cold.is_short:
            cold = _through_end(cold, t, strain, _cold_line(*other, straight))
        if hot.is_short:
            beside = _mirrored(_cold_line(-other[0][::-1], other[1][::-1], straight))
            hot = _through_end(hot, t[::-1], strain[::-1], beside)
    return cold, hot


def scatter(strain: Array) -> float:
    """Standard deviation of the points about a smooth curve, by second differences."""
    return 1.4826 * float(np.median(np.abs(np.diff(strain, 2)))) / math.sqrt(6.0)


def _cold_line(t: Array, strain: Array, straight: float) -> OuterLine:
    """Line along the beginning of a rising branch, as far as it is straight."""
    # Where points are few, second differences are bends, not scatter: hence the limit.
    span = float(np.ptp(strain))
    tolerance = max(straight * span, min(3.0 * scatter(strain), 2.0 * straight * span))
    first = _first_settled(t, strain)
    t, strain = t[first:], strain[first:]
    count = _straight_count(t, strain, tolerance)
    line, covariance = fit_line(t[:count], strain[:count])
    share = float(np.ptp(t[:count])) / float(np.ptp(t))
    is_short = share < _SHORT_SHARE or abs(line.slope) > _STEEP_SHARE * _steepness(t, strain)
    return OuterLine(line, covariance, float(t[count - 1]), is_short)


def _mirrored(side: OuterLine) -> OuterLine:
    """The line of a branch whose temperature was negated."""
    line = Line(-side.line.at, side.line.value, -side.line.slope)
    return OuterLine(line, side.covariance, -side.end, side.is_short)


def _through_end(side: OuterLine, t: Array, strain: Array, beside: OuterLine) -> OuterLine:
    """The companion's slope through this branch's end, if less steep; still marked as short."""
    if abs(beside.line.slope) >= abs(side.line.slope):
        return side
    last = slice(0, _SHORTEST_LINE)
    line = Line(float(t[last].mean()), float(strain[last].mean()), beside.line.slope)
    own = float(strain[last].var()) / _SHORTEST_LINE
    return OuterLine(line, np.diag([own, beside.covariance[1, 1]]), float(t[last][-1]), True)


def _first_settled(t: Array, strain: Array) -> int:
    """First point to use: after a reversal a lagging specimen goes on the old way for a while."""
    near = np.flatnonzero(t <= t[0] + _LAG_SHARE * (t[-1] - t[0]))
    middle = 0.5 * (strain[0] + strain[-1])
    furthest = int(np.argmax(np.abs(strain[near] - middle)))
    lags = abs(strain[furthest] - strain[0]) > _LAG_STRAIN * float(np.ptp(strain))
    return min(furthest, len(t) // 4) if lags else 0


def _steepness(t: Array, strain: Array) -> float:
    """Largest slope over a few points."""
    windows = range(len(t) - _SHORTEST_LINE)
    pieces = (slice(first, first + _SHORTEST_LINE) for first in windows)
    return max(abs(fit_line(t[piece], strain[piece])[0].slope) for piece in pieces)


def _straight_count(t: Array, strain: Array, tolerance: float) -> int:
    """How many points from the beginning one straight line describes."""
    longest = _SHORTEST_LINE
    for count in range(_SHORTEST_LINE, len(t) - _SHORTEST_LINE):
        line, _ = fit_line(t[:count], strain[:count])
        left = strain[:count] - line(t[:count])
        # A run of points on one side tells a bend long before the largest residual does.
        run = abs(float(np.mean(left[-max(count // 5, 3) :])))
        if run < 0.5 * tolerance and np.max(np.abs(left)) < 2.0 * tolerance:
            longest = count
        elif count > 3 * longest:
            break
    return longest


def fit_line(t: Array, strain: Array) -> tuple[Line, Array]:
    """Least-squares line and the covariance (2, 2) of its value and slope."""
    centred = t - t.mean()
    power = float(centred @ centred)
    slope = float(centred @ strain) / power
    left = strain - strain.mean() - slope * centred
    variance = float(left @ left) / max(len(t) - 2, 1)
    return (
        Line(float(t.mean()), float(strain.mean()), slope),
        np.diag([variance / len(t), variance / power]),
    )
