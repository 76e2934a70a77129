"""Splits a noisy voltage into straight and curved stretches: finds corners that noise hides, and
curves that a few straight lines would approximate too badly for the heat of a wire."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from scipy.interpolate import make_smoothing_spline

from sma_bench.arrays import Array
from sma_bench.estimation.noise_model import scatter

FEWEST_IN_LINE = 10  # samples
CLEAR = 6.0  # standard errors of a bend, or of a step
TOGGLES = 0.6  # of a converter's step: a smaller scatter may be readings between two codes only
_CURVED = 3.0  # standard errors by which a cubic fits better than two lines
_TURNS = 4  # in the same direction, one after the other, make a curve
_FINE = 5e-3  # of the range: a converter with a smaller step is fine
_PASSED = 4.0  # steps of a coarse converter that a curve passes at least
_BLOCK, _BRIEF = 0.1, 0.5  # s, averaged before smoothing; in which a drive does not turn back
ROUNDING = 1e-6  # of the largest voltage

Span = tuple[int, int]  # first sample, and the one after the last


def straight_and_curved(time: Array, voltage: Array, spans: Sequence[tuple[int, int, bool]],
                        step: float) -> tuple[list[Span], list[Span]]:
    """Stretches of a voltage (n,) V that are straight, and those that are curved.

    Args:
        time: (n,) s; spans: first sample, the one after the last and whether it is a ramp, from
            `find_segments`, in order; those that share a sample belong to one stretch.
        step: V, of the converter, 0 if it has none."""
    cut: list[Span] = []
    is_curved: list[bool] = []
    for first, last, is_ramp in spans:
        parts, bends = [(first, last)], False
        while parts:
            begin, end = parts.pop()
            corner, is_bow = _corner(time[begin:end], voltage[begin:end], step)
            bends |= is_bow and is_ramp
            if corner and not is_bow:
                parts += [(begin + corner, end), (begin, begin + corner + 1)]
            else:
                cut.append((begin, end))
                is_curved.append(bends)
    _mark_curved(time, voltage, cut, is_curved, step)

    straight: list[Span] = []
    curved: list[Span] = []
    for k, (begin, end) in enumerate(cut):
        found = curved if is_curved[k] else straight
        before, last = found[-1] if found else (0, 0)
        is_next = begin < last and (not is_curved[k] or is_curved[k - 1])
        if is_next and (is_curved[k] or _is_one_line(time, voltage, (before, last), (begin, end))):
            found[-1] = (before, end)
        else:
            found.append((begin, end))
    return straight, curved


def _mark_curved(time: Array, voltage: Array, spans: Sequence[Span], is_curved: list[bool],
            step: float) -> None:
    """Also mark as curved: lines that turn the same way several times in a row, and short straight
    ones between two curved. With a coarse converter a span of few steps is never curved, because
    the curve would follow the steps."""
    is_fine = step <= max(_FINE * float(np.ptp(voltage)), scatter(voltage) / TOGGLES)
    passes = [is_fine or bool(np.ptp(voltage[a:b]) > _PASSED * step) for a, b in spans]
    is_curved[:] = [bow and enough for bow, enough in zip(is_curved, passes, strict=True)]
    slopes = [np.polyfit(time[a:b] - time[a], voltage[a:b], 1)[0] for a, b in spans]
    joined = [a[1] > b[0] for a, b in pairwise(spans)]
    run, before = 0, 0.0
    for k, is_joined in enumerate(joined):
        turn = float(np.sign(slopes[k + 1] - slopes[k])) if is_joined else 0.0
        run = run + 1 if turn == before != 0.0 else 1
        before = turn
        if run >= _TURNS:
            is_curved[k - run + 1 : k + 2] = passes[k - run + 1 : k + 2]
    length = [end - begin for begin, end in spans]
    for a, b in pairwise([k for k, bow in enumerate(is_curved) if bow]):
        if sum(length[a + 1 : b]) < length[a] + length[b] and all(joined[a:b]):
            is_curved[a + 1 : b] = [True] * (b - a - 1)


def _is_one_line(time: Array, voltage: Array, one: Span, other: Span) -> bool:
    """True if one straight line fits two stretches as well as two lines."""
    def misfit(begin: int, end: int) -> float:
        t, v = (x[begin:end] - x[begin:end].mean() for x in (time, voltage))
        return float(v @ v) - float(t @ v) ** 2 / max(float(t @ t), 1e-12)

    own, n = misfit(*one) + misfit(*other), other[1] - one[0]
    are_long = min(one[1] - one[0], other[1] - other[0]) >= FEWEST_IN_LINE
    return are_long and misfit(one[0], other[1]) - own < CLEAR**2 * own / n


def _corner(time: Array, volts: Array, step: float) -> tuple[int, bool]:
    """The sample at which a straight line turns into another, 0 without a clear corner; and whether
    a cubic fits better than two lines."""
    n = len(time)
    if n < 2 * FEWEST_IN_LINE:
        return 0, False
    t = time - time.mean()
    slope, level = np.polyfit(t, volts, 1)
    left, rise = volts - slope * t - level, slope * (time[-1] - time[0])
    least = max(scatter(left), step / np.sqrt(12.0), ROUNDING * float(np.max(np.abs(volts))))
    if np.max(np.abs(np.cumsum(left))) <= least * np.sqrt(n):
        return 0, False
    # For a hinge at each sample, without its straight part: its power, and the power it explains.
    count, s, q, r, w = (np.cumsum(x[::-1])[::-1] for x in (t**0, t, t * t, left, t * left))
    power = q - 2.0 * t * s + t * t * count - (s - t * count) ** 2 / n - (q - t * s) ** 2 / (t @ t)
    inside = slice(FEWEST_IN_LINE, n - FEWEST_IN_LINE + 1)
    explained = (w - t * r)[inside] ** 2 / power[inside]
    at = FEWEST_IN_LINE + int(np.argmax(explained))
    best = max(float(left @ left - np.max(explained)), 0.0)
    alike = n / independent(n, float(np.sqrt(best / n)), step, rise)
    if float(left @ left) - best < CLEAR**2 * alike * best / n:
        return 0, False
    bow = left - np.polyval(np.polyfit(t, left, 3), t)
    return at, best - float(bow @ bow) > _CURVED**2 * best / n


def independent(n: int, noise: float, step: float, rise: float) -> float:
    """Number of independent errors of n samples of a voltage that rises by `rise` V: without enough
    noise (V) to make the converter toggle, all samples on one of its steps (V) have the same."""
    return n if noise >= TOGGLES * step else min(n, max(abs(rise) / step, 1.0))


def smoothed(time: Array, volts: Array, step: float) -> Array:
    """(n,) V of a curve without its noise: a smoothing spline through means of blocks, which span
    some steps (V) of a coarse converter; `step` is 0 where noise makes it toggle."""
    intervals = np.diff(time)
    way = np.arange(time[0], time[-1], max(_BRIEF, float(intervals.max(initial=0.0))))
    passed = float(np.sum(np.abs(np.diff(np.interp(way, time, volts)))))
    length = _PASSED * step * float(time[-1] - time[0]) / max(passed, step, 1e-12)
    block = (time - time[0]) // max(_BLOCK, length, float(np.median(intervals)))
    edges = np.flatnonzero(np.diff(block, prepend=-1.0))
    count = np.diff(np.append(edges, len(time)))
    centre, mean = np.add.reduceat(time, edges) / count, np.add.reduceat(volts, edges) / count
    exact = not step and np.median(np.abs(np.diff(volts, 2))) < 1e-5 * np.ptp(volts)
    if exact or len(centre) < FEWEST_IN_LINE:
        return volts
    return np.asarray(make_smoothing_spline(centre, mean, count / count.max())(time))
