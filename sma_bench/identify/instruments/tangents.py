"""Tangent method on one calorimetry scan: baselines, onset and finish, peaks, latent heat."""

import math
from dataclasses import dataclass

import numpy as np

from sma_bench.errors import InputError
from sma_bench.identify.estimate import Array

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
        line = _fit(scan, 0, count)
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
    return Line(
        float(scan.temperature[touch]), float(smooth[touch]), float(slope[touch]) / step
    )


def _fit(scan: Scan, first: int, last: int) -> Line:
    t, y = scan.temperature[first:last], scan.flow[first:last]
    slope = float(np.polyfit(t - t.mean(), y, 1)[0])
    return Line(float(t.mean()), float(y.mean()), slope)


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
