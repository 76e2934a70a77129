"""Tangent method on one calorimetry scan: baselines, onset and finish, peaks, latent heat."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from sma_bench.errors import InputError
from sma_bench.identify.estimate import Array
from sma_bench.records.isobaric import Branch

GRID = 0.05
# A ruler follows the flank over a few kelvins, not at a point: kinks of 1 K do not turn it.
SMOOTHING = 4.0
_BASELINE = 5.0
_LONGEST_START_UP = 180.0
_STRAIGHT = 0.0015
_ON_BASELINE = 0.003
_FLANK_HEIGHT = 0.05
_FLANK_PROMINENCE = 0.05
_PEAK_PROMINENCE = 0.002
_SMOOTHINGS = (2.0, 4.0, 6.0)
_BASELINES = (0.3, 1.0, 3.0)
_SIGMOID_PASSES = 8
_SMALLEST_PEAK = 20.0


@dataclass(frozen=True)
class Line:
    """Straight line y = value + slope (T - at): K, W/kg, W/(kg K)."""

    at: float
    value: float
    slope: float

    def __call__(self, temperature: Array) -> Array:
        return np.asarray(self.value + self.slope * (temperature - self.at))

    def crossing(self, other: "Line") -> float:
        """Temperature in K where two lines meet."""
        if self.slope == other.slope:
            return math.nan
        at_zero = other.value - self.value + self.slope * self.at - other.slope * other.at
        return at_zero / (self.slope - other.slope)


@dataclass(frozen=True)
class Scan:
    """One heating or cooling scan in the order it happened, peak upward.

    `temperature` (n,) K, monotonic on a grid; `flow` (n,) W/kg; `rate` K/s, positive.
    """

    temperature: Array
    flow: Array
    rate: float

    def flipped(self) -> "Scan":
        """The scan run backwards, so that its finish becomes its onset."""
        return Scan(self.temperature[::-1], self.flow[::-1], self.rate)


@dataclass(frozen=True)
class Onset:
    """Where the outermost flank's tangent meets the baseline: `temperature` and `std` in K.

    The baseline was fitted to the outermost `extent` K of the scan.
    """

    temperature: float
    std: float
    baseline: Line
    tangent: Line
    extent: float


@dataclass(frozen=True)
class Transformation:
    """What the tangent method reads off a scan: K, J/kg; `peaks` K, the largest first."""

    start: Onset
    finish: Onset
    peaks: tuple[float, ...]
    latent_heat: float
    latent_heat_std: float
    base: Array


def make_scan(time: Array, temperature: Array, flow: Array) -> Scan:
    """A scan on an even grid of temperature, without its start-up transient.

    Args:
        time: (n,) s; temperature: (n,) K of the sample; flow: (n,) W/kg, transformation upward.

    Raises:
        InputError: too short, or nothing straight at its beginning.
    """
    if len(time) < 100 or np.ptp(temperature) < 4.0 * _BASELINE:
        raise InputError(
            f"DSC scan of {len(time)} points over {np.ptp(temperature):.1f} K, "
            f"expected 100 points and {4.0 * _BASELINE:g} K or more"
        )
    heating = temperature[-1] > temperature[0]
    # The furthest temperature so far: an instrument's start and noise turn back a little.
    reached = np.maximum.accumulate(temperature if heating else -temperature)
    keep = np.concatenate([[True], np.diff(reached) > 0.0])
    steps = np.arange(reached[0], reached[-1], GRID)
    even = np.interp(steps, reached[keep], flow[keep])
    begin = _start_up(np.interp(steps, reached[keep], time[keep]), even)
    rate = float((reached[-1] - reached[0]) / (time[-1] - time[0]))
    steps = steps[begin:]
    return Scan(steps if heating else -steps, even[begin:], rate)


def find_transformation(scan: Scan) -> Transformation:
    """Onset and finish by tangents, peaks, and the area over a baseline.

    The tangents touch the outermost flank on either side: where a transformation goes in steps
    (an R-phase, a mixed powder) it starts with the first and ends with the last of them.

    Raises:
        InputError: no peak stands out of the scan.
    """
    height = float(np.ptp(scan.flow))
    noise = float(np.std(np.diff(scan.flow, 2))) / math.sqrt(6.0)
    if height < _SMALLEST_PEAK * noise or height <= 0.0:
        raise InputError(f"DSC scan: no peak, its {height:.3g} W/kg are noise")
    start, finish = _onset(scan), _onset(scan.flipped())
    first, last = (start.temperature, finish.temperature)
    if (last - first) * (scan.temperature[-1] - scan.temperature[0]) <= 0.0:
        raise InputError(
            f"DSC scan: the tangents cross at {first:.1f} K and {last:.1f} K in the wrong order, "
            "expected one peak between two flat stretches"
        )
    from scipy.signal import find_peaks  # half a second to load

    base, chord = _bases(scan, start, finish)
    heat, plain = (float(np.sum(scan.flow - b)) * GRID / scan.rate for b in (base, chord))
    peaks, _ = find_peaks(scan.flow - base, prominence=_PEAK_PROMINENCE * height)
    between = (scan.temperature[peaks] - first) * (scan.temperature[peaks] - last) < 0.0
    ordered = peaks[between][np.argsort(-(scan.flow - base)[peaks[between]])]
    return Transformation(
        start, finish, tuple(float(scan.temperature[k]) for k in ordered),
        heat, max(abs(heat - plain), 0.01 * heat), base,
    )


def _start_up(time: Array, flow: Array) -> int:
    """First index from which the next kelvins are straight, as only a settled instrument draws."""
    width = round(_BASELINE / GRID)
    core = flow[len(flow) // 10 : -len(flow) // 10]
    limit = _STRAIGHT * float(np.ptp(core))
    last = int(np.searchsorted(time, time[0] + _LONGEST_START_UP))
    x = np.arange(width)
    for first in range(0, min(last, len(flow) - width), round(0.5 / GRID)):
        piece = flow[first : first + width]
        if np.max(np.abs(piece - np.polyval(np.polyfit(x, piece, 1), x))) < limit:
            return first
    raise InputError(
        f"DSC scan: no straight {_BASELINE:g} K within {_LONGEST_START_UP:g} s of its start"
    )


def _onset(scan: Scan) -> Onset:
    """Onset at the beginning of the scan; its error from other smoothings and baselines."""
    height = float(np.ptp(scan.flow))
    baseline, extent = _baseline(scan, _ON_BASELINE * height)
    tangent = _tangent(scan, baseline, SMOOTHING)
    temperature = tangent.crossing(baseline)
    others = [_tangent(scan, baseline, s).crossing(baseline) for s in _SMOOTHINGS]
    others += [
        tangent.crossing(_baseline(scan, factor * _ON_BASELINE * height)[0])
        for factor in _BASELINES
    ]
    spread = float(np.max(np.abs(np.array(others) - temperature)))
    return Onset(temperature, max(spread, 2.0 * GRID), baseline, tangent, extent)


def _baseline(scan: Scan, tolerance: float) -> tuple[Line, float]:
    """Line through the scan's beginning, extended while the scan stays on it; its extent in K."""
    count = shortest = round(_BASELINE / GRID)
    for _ in range(10):
        t, y = scan.temperature[0:count], scan.flow[0:count]
        slope = float(np.polyfit(t - t.mean(), y, 1)[0])
        line = Line(float(t.mean()), float(y.mean()), slope)
        away = np.abs(scan.flow - line(scan.temperature)) > tolerance
        reach = int(np.argmax(away)) if away.any() else len(away)
        longer = max(min(reach, len(away) // 2), shortest)
        if longer <= count:
            break
        count = longer
    return line, count * GRID


def _tangent(scan: Scan, baseline: Line, smoothing: float) -> Line:
    """Tangent at the first inflection met on the way up from the baseline."""
    from scipy.signal import find_peaks, savgol_filter  # half a second to load

    window = 2 * round(0.5 * smoothing / GRID) + 1
    smooth = savgol_filter(scan.flow, window, 2)
    slope = savgol_filter(scan.flow, window, 2, deriv=1)
    above = smooth - baseline(scan.temperature)
    top = int(np.argmax(above))
    steepest = float(np.max(slope[: top + 1]))
    inflections, _ = find_peaks(slope[: top + 1], prominence=_FLANK_PROMINENCE * steepest)
    high = inflections[above[inflections] > _FLANK_HEIGHT * above[top]]
    if not len(high):
        raise InputError("DSC scan: no flank between baseline and peak, expected a whole peak")
    touch = int(high[0])
    step = float(scan.temperature[1] - scan.temperature[0])
    return Line(float(scan.temperature[touch]), float(smooth[touch]), float(slope[touch]) / step)


def _bases(scan: Scan, start: Onset, finish: Onset) -> tuple[Array, Array]:
    """Base under the peak: by share of the area done (sigmoid), and by a straight chord.

    Outside the peak both are the scan itself, so that they add no area there.
    """
    n = len(scan.flow)
    first = min(round(start.extent / GRID), n - 2)
    last = max(n - 1 - round(finish.extent / GRID), first + 1)
    inside = slice(first, last + 1)
    before, after = start.baseline(scan.temperature), finish.baseline(scan.temperature)
    ends = (before[first], after[last])
    chord, sigmoid = scan.flow.copy(), scan.flow.copy()
    chord[inside] = np.linspace(*ends, last + 1 - first)
    share = np.linspace(0.0, 1.0, last + 1 - first)
    for _ in range(_SIGMOID_PASSES):
        base = before[inside] * (1.0 - share) + after[inside] * share
        area = np.cumsum(np.maximum(scan.flow[inside] - base, 0.0))
        share = area / area[-1]
    sigmoid[inside] = base
    return sigmoid, chord


# --- The outer lines of the tangent method: along a branch before and after it transforms.

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
    # First point to use: after a reversal a lagging specimen goes on the old way for a while.
    near = np.flatnonzero(t <= t[0] + _LAG_SHARE * (t[-1] - t[0]))
    middle = 0.5 * (strain[0] + strain[-1])
    furthest = int(np.argmax(np.abs(strain[near] - middle)))
    lags = abs(strain[furthest] - strain[0]) > _LAG_STRAIN * float(np.ptp(strain))
    first = min(furthest, len(t) // 4) if lags else 0
    t, strain = t[first:], strain[first:]
    # How many points from the beginning one straight line describes.
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
    line, covariance = fit_line(t[:longest], strain[:longest])
    share = float(np.ptp(t[:longest])) / float(np.ptp(t))
    # The largest slope over a few points.
    times, strains = (sliding_window_view(values, _SHORTEST_LINE)[:-1] for values in (t, strain))
    centred = times - times.mean(axis=1, keepdims=True)
    slopes = np.sum(centred * strains, axis=1) / np.sum(centred**2, axis=1)
    is_steep = abs(line.slope) > _STEEP_SHARE * float(np.max(np.abs(slopes)))
    is_short = share < _SHORT_SHARE or is_steep
    return OuterLine(line, covariance, float(t[longest - 1]), is_short)


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


# --- Tangent method on a strain-temperature branch (practice of ASTM F2082 and E3097).
#
# Three straight lines are drawn: along the branch before it transforms, along its steepest part
# and along the branch after it has transformed. Their crossings are the start and the finish.

# Of a cosine ramp the steepest tangent takes 2/pi of its width (eqs. 10, 11).
COSINE_WIDTH = 0.5 * math.pi
_FEWEST_BINS = 30
# The first choices are the ones reported, the others tell their error.
_STRAIGHT_STRAIN = (0.015, 0.010, 0.025)
_STEEP = (0.4, 0.3, 0.6)
_SMALLEST_STEP = 12.0


@dataclass(frozen=True)
class Bins:
    """Even intervals of a branch's temperature: `index` (n,) of each reading's. Dwells do not
    outweigh the rest, and a law is averaged as the data are: the mean of a bend is not the bend of
    the mean."""

    index: NDArray[np.intp]

    @classmethod
    def of(cls, t: Array, most: int = 200, rising: bool = True) -> "Bins":
        """At most `most` of t (n,) K, numbered from the cold end, or from the hot one."""
        width = float(np.ptp(t)) / most
        index = np.floor((t - t.min() if rising else t.max() - t) / width).astype(int)
        return cls(np.unique(index, return_inverse=True)[1])

    def mean(self, values: Array) -> Array:
        """(m,) means of (n,) values."""
        return np.asarray(np.bincount(self.index, values) / np.bincount(self.index))


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
    noise = scatter(strain)
    if float(np.ptp(strain)) < _SMALLEST_STEP * noise:
        raise InputError(
            f"{branch.direction}: strain changes by {np.ptp(strain):.3g} with a scatter of "
            f"{noise:.3g}, no transformation stands out"
        )
    other = _binned(companion) if companion is not None else None
    drawn: list[_Drawn] = []
    for straight in _STRAIGHT_STRAIN:
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
    gaps = [gap_at(t, crossing[0]) for crossing in (cold, hot)]
    cold, hot = (
        (value, math.hypot(std, gap / math.sqrt(12.0)))
        for (value, std), gap in zip((cold, hot), gaps, strict=True)
    )
    start, finish = (cold, hot) if branch.direction == "heating" else (hot, cold)
    inside = (t[1:] > cold[0]) & (t[:-1] < hot[0])
    return StrainTangents(
        start=start, finish=finish, step=_summary([d.step for d in drawn], best.step_variance),
        cold=best.outer[0].line, hot=best.outer[1].line, steep=best.steep,
        cold_end=best.outer[0].end, hot_end=best.outer[1].end,
        cold_is_short=best.outer[0].is_short, hot_is_short=best.outer[1].is_short,
        widest_gap=float(np.max(np.diff(t)[inside], initial=0.0)),
    )


def _binned(branch: Branch) -> tuple[Array, Array]:
    """Means over narrow intervals of temperature, rising."""
    bins = Bins.of(branch.temperature)
    return bins.mean(branch.temperature), bins.mean(branch.strain)


def gap_at(t: Array, where: float) -> float:
    """By how much the two points around a crossing lie further apart than points usually do."""
    steps = np.diff(t)
    here = steps[(t[:-1] <= where) & (t[1:] >= where)]
    return max(float(np.max(here, initial=0.0)) - 2.0 * float(np.median(steps)), 0.0)


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
        crossings=crossings, variances=(variances[0], variances[1]),
        step=float(cold.line(np.array(middle)) - hot.line(np.array(middle))),
        step_variance=sum(_variance(s.covariance, s.line.at, middle) for s in (cold, hot)),
        outer=outer, steep=line,
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
    if best is None:
        return None
    t, strain = t[best], strain[best]
    # Where the curve is steep the error is in temperature: regress it on strain.
    centred = strain - strain.mean()
    power = float(centred @ centred)
    if not power > 0.0:  # strains too small for their squares
        return None
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
