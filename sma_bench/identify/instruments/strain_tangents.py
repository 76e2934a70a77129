"""Tangent method on a strain-temperature branch (practice of ASTM F2082 and E3097).

Three straight lines are drawn: along the branch before it transforms, along its steepest part and
along the branch after it has transformed. Their crossings are the start and the finish.
"""

import math
from dataclasses import dataclass

import numpy as np

from sma_bench.errors import InputError
from sma_bench.identify.estimate import Array
from sma_bench.identify.instruments.outer_lines import OuterLine, outer_lines, scatter
from sma_bench.identify.instruments.tangents import Line
from sma_bench.records.thermal_cycles import Branch

# Of a cosine ramp the steepest tangent takes 2/pi of its width (eqs. 10, 11).
COSINE_WIDTH = 0.5 * math.pi
_BINS = 200
_FEWEST_BINS = 30
# The first choices are the ones reported, the others tell their error.
_STRAIGHT = (0.015, 0.010, 0.025)
_STEEP = (0.4, 0.3, 0.6)
_SMALLEST_STEP = 12.0


@dataclass(frozen=True)
class StrainTangents:
    """What the tangents of one branch give.

    Attributes:
        start, finish: (value, std) in K, in the order of transformation (on cooling the start is
            the higher one). std holds the scatter of the points and what other choices of the
            stretches on which the lines are drawn would give.
        step: (value, std) of the strain by which the two outer lines differ half-way.
        cold, hot, steep: the lines, strain against K.
        cold_end, hot_end: K; the outer lines were fitted below and above them.
        cold_is_short, hot_is_short: the straight stretch is so short, or so steep, that the
            branch may not have been complete.
        widest_gap: largest step of temperature within the transformation, K.
    """

    start: tuple[float, float]
    finish: tuple[float, float]
    step: tuple[float, float]
    cold: Line
    hot: Line
    steep: Line
    cold_end: float
    hot_end: float
    cold_is_short: bool
    hot_is_short: bool
    widest_gap: float

    def polyline(self, branch: Branch) -> Array:
        """(4, 2) K and strain: the three tangents from the branch's cold end to its hot one."""
        low, high = sorted((self.start[0], self.finish[0]))
        ends = np.array([min(branch.temperature.min(), low), max(branch.temperature.max(), high)])
        t = np.array([ends[0], low, high, ends[1]])
        return np.column_stack([t, np.concatenate([self.cold(t[:2]), self.hot(t[2:])])])

    def cosine_ends(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Start and finish (value, std) of the cosine of eqs. (10), (11) with the same tangent."""
        middle = 0.5 * (self.start[0] + self.finish[0])
        half = 0.5 * COSINE_WIDTH * (self.finish[0] - self.start[0])
        # An error of one tangent temperature moves both ends.
        near, far = 0.5 * (1.0 + COSINE_WIDTH), 0.5 * (1.0 - COSINE_WIDTH)
        stds = (
            math.hypot(near * self.start[1], far * self.finish[1]),
            math.hypot(far * self.start[1], near * self.finish[1]),
        )
        return (middle - half, stds[0]), (middle + half, stds[1])


@dataclass(frozen=True)
class _Drawn:
    """One way to draw the three lines; (cold, hot) each."""

    crossings: tuple[float, float]
    variances: tuple[float, float]
    step: float
    step_variance: float
    outer: tuple[OuterLine, OuterLine]
    steep: Line


def strain_tangents(branch: Branch, companion: Branch | None = None) -> StrainTangents:
    """Start, finish and transformation strain of one branch.

    Args:
        branch: heating or cooling.
        companion: the other branch of the cycle. Where this branch has no straight stretch at one
            of its ends, as when it was turned round before it had transformed, the line there
            goes through its end with the companion's slope.

    Raises:
        InputError: too few points, or no transformation stands out of the scatter.
    """
    t, strain = _binned(branch)
    if len(t) < _FEWEST_BINS:
        raise InputError(
            f"{branch.direction} has {len(t)} distinct temperatures, "
            f"expected {_FEWEST_BINS} or more for tangents"
        )
    _check_step(branch.direction, strain)
    other = _binned(companion) if companion is not None else None
    drawn: list[_Drawn] = []
    for straight in _STRAIGHT:
        outer = outer_lines(t, strain, other, straight)
        tries = (_draw(t, strain, outer, width) for width in _STEEP)
        drawn.extend(lines for lines in tries if lines is not None)
    if not drawn:
        raise InputError(
            f"{branch.direction} between {t[0]:.1f} and {t[-1]:.1f} K: no transformation between "
            "two straight stretches"
        )
    best = drawn[0]
    cold, hot = (
        _summary([d.crossings[k] for d in drawn], best.variances[k]) for k in (0, 1)
    )
    gaps = [_gap(t, crossing[0]) for crossing in (cold, hot)]
    cold, hot = (
        (value, math.hypot(std, gap / math.sqrt(12.0)))
        for (value, std), gap in zip((cold, hot), gaps, strict=True)
    )
    start, finish = (cold, hot) if branch.direction == "heating" else (hot, cold)
    inside = (t[1:] > cold[0]) & (t[:-1] < hot[0])
    return StrainTangents(
        start=start,
        finish=finish,
        step=_summary([d.step for d in drawn], best.step_variance),
        cold=best.outer[0].line, hot=best.outer[1].line, steep=best.steep,
        cold_end=best.outer[0].end, hot_end=best.outer[1].end,
        cold_is_short=best.outer[0].is_short, hot_is_short=best.outer[1].is_short,
        widest_gap=float(np.max(np.diff(t)[inside], initial=0.0)),
    )


def _binned(branch: Branch) -> tuple[Array, Array]:
    """Means over narrow intervals of temperature, rising."""
    t, strain = branch.temperature, branch.strain
    width = float(np.ptp(t)) / _BINS
    index = np.floor((t - t.min()) / width).astype(int)
    kinds, index = np.unique(index, return_inverse=True)
    count = np.bincount(index, minlength=len(kinds))
    return np.bincount(index, t) / count, np.bincount(index, strain) / count


def _gap(t: Array, where: float) -> float:
    """By how much the two points around a crossing lie further apart than points usually do."""
    steps = np.diff(t)
    here = steps[(t[:-1] <= where) & (t[1:] >= where)]
    return max(float(np.max(here, initial=0.0)) - 2.0 * float(np.median(steps)), 0.0)


def _check_step(direction: str, strain: Array) -> None:
    noise = scatter(strain)
    if float(np.ptp(strain)) < _SMALLEST_STEP * noise:
        raise InputError(
            f"{direction}: strain changes by {np.ptp(strain):.3g} with a scatter of {noise:.3g}, "
            "no transformation stands out"
        )


def _draw(
    t: Array, strain: Array, outer: tuple[OuterLine, OuterLine], width: float
) -> _Drawn | None:
    cold, hot = outer
    steep = _steep(t, strain, cold.line, hot.line, width)
    if steep is None:
        return None
    line, line_cov = steep
    crossings = (line.crossing(cold.line), line.crossing(hot.line))
    if not t[0] - np.ptp(t) < crossings[0] < crossings[1] < t[-1] + np.ptp(t):
        return None
    middle = 0.5 * (crossings[0] + crossings[1])
    variances = [
        (_variance(line_cov, line.at, x) + _variance(side.covariance, side.line.at, x))
        / (line.slope - side.line.slope) ** 2
        for x, side in zip(crossings, (cold, hot), strict=True)
    ]
    return _Drawn(
        crossings=crossings,
        variances=(variances[0], variances[1]),
        step=float(cold.line(np.array(middle)) - hot.line(np.array(middle))),
        step_variance=sum(_variance(s.covariance, s.line.at, middle) for s in (cold, hot)),
        outer=outer,
        steep=line,
    )


def _steep(
    t: Array, strain: Array, cold: Line, hot: Line, width: float
) -> tuple[Line, Array] | None:
    """Line through the steepest stretch in which the given share of the material transforms."""
    gap = cold(t) - hot(t)
    share = np.divide(strain - hot(t), gap, out=np.full_like(gap, np.nan), where=gap != 0.0)
    best, steepest = None, 0.0
    for first in np.flatnonzero((share < 1.0) & (share > width)):
        done = np.flatnonzero(share[first:] <= share[first] - width)
        if not len(done):
            continue
        last = first + int(done[0])
        steepness = (share[first] - share[last]) / (t[last] - t[first])
        if steepness > steepest:
            best, steepest = slice(int(first), last + 1), float(steepness)
    return _steep_line(t[best], strain[best]) if best else None


def _steep_line(t: Array, strain: Array) -> tuple[Line, Array] | None:
    # Where the curve is steep the error is in temperature: regress it on strain.
    centred = strain - strain.mean()
    power = float(centred @ centred)
    inverse = float(centred @ (t - t.mean())) / power
    if inverse == 0.0:
        return None
    left = t - t.mean() - inverse * centred
    # Two points leave no scatter: a third of their distance stands for it.
    variance = float(left @ left) / (len(t) - 2) if len(t) > 3 else float(np.ptp(t) / 3.0) ** 2
    slope = 1.0 / inverse
    covariance = np.diag([variance * slope**2 / len(t), variance / power * slope**4])
    return Line(float(t.mean()), float(strain.mean()), slope), covariance


def _variance(covariance: Array, at: float, where: float) -> float:
    return float(covariance[0, 0] + covariance[1, 1] * (where - at) ** 2)


def _summary(values: list[float], variance: float) -> tuple[float, float]:
    """The first choice, and the error from its scatter and from the other choices."""
    spread = float(np.std(values)) if len(values) > 1 else 0.0
    return values[0], math.hypot(spread, math.sqrt(variance))
