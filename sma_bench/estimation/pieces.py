"""A noisy voltage in straight stretches and curved ones: corners that its noise hides, and curves
that a few straight lines would miss by more than the heat of a wire forgives."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from scipy.interpolate import make_smoothing_spline

from sma_bench.arrays import Array

FEWEST_IN_LINE = 10
CLEAR = 6.0  # standard errors of a bend, or of a step
TOGGLES = 0.6  # of a converter's step: what scatters less may be two readings by turns
_CURVED, _TURNS = 3.0, 4  # standard errors by which a bow is nearer than two lines; turns one way
_FINE, _PASSED = 5e-3, 4.0  # a converter's step, of the range; steps that a curve passes
_BLOCK, _BRIEF = 0.1, 0.5  # s, means that a curve is drawn through; in which a drive goes one way
ROUNDING = 1e-6  # of the largest voltage

Span = tuple[int, int]  # first sample, and the one after the last


def straight_and_curved(time: Array, voltage: Array, spans: Sequence[tuple[int, int, bool]],
                        step: float) -> tuple[list[Span], list[Span]]:
    """Stretches of a voltage (n,) V that are straight, and those that are curved.

    Args:
        time: (n,) s; spans: first sample, the one after the last and whether it is a ramp, of what
            few lines describe, in order; those that share a sample are one stretch.
        step: V, the converter's, 0 where it has none."""
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
    _spread(time, voltage, cut, is_curved, step)

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


def _spread(time: Array, voltage: Array, spans: Sequence[Span], is_curved: list[bool],
            step: float) -> None:
    """Curved are also lines that turn the same way again and again, and straight ones between two
    curved, no longer than these, where a curve turns. Of a coarse converter a curve that passes
    few of its steps would follow them."""
    scatter = float(np.median(np.abs(np.diff(voltage, 2)))) / 0.6745 / np.sqrt(6.0)
    is_fine = step <= max(_FINE * float(np.ptp(voltage)), scatter / TOGGLES)
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
    """Whether one straight line is as near to two stretches as two are."""
    def left(begin: int, end: int) -> float:
        t, v = (x[begin:end] - x[begin:end].mean() for x in (time, voltage))
        return float(v @ v) - float(t @ v) ** 2 / max(float(t @ t), 1e-12)

    own, n = left(*one) + left(*other), other[1] - one[0]
    return (
        min(one[1] - one[0], other[1] - other[0]) >= FEWEST_IN_LINE
        and left(one[0], other[1]) - own < CLEAR**2 * own / n
    )


def _corner(time: Array, volts: Array, step: float) -> tuple[int, bool]:
    """The sample at which a straight line turns into another, 0 where none surely does; and whether
    a bow is nearer than two lines."""
    n = len(time)
    if n < 2 * FEWEST_IN_LINE:
        return 0, False
    t = time - time.mean()
    slope, level = np.polyfit(t, volts, 1)
    left, rise = volts - slope * t - level, slope * (time[-1] - time[0])
    white = float(np.median(np.abs(np.diff(left, 2)))) / 0.6745 / np.sqrt(6.0)
    least = max(white, step / np.sqrt(12.0), ROUNDING * float(np.max(np.abs(volts))))
    if np.max(np.abs(np.cumsum(left))) <= least * np.sqrt(n):
        return 0, False
    # Of a hinge at every sample what is no line's: its power, and what it explains of the rest.
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
    """How many of n samples have errors of their own, where a voltage rises (V): those on one step
    (V) of a converter that no noise (V) makes toggle have one."""
    return n if noise >= TOGGLES * step else min(n, max(abs(rise) / step, 1.0))


def smoothed(time: Array, volts: Array, step: float) -> Array:
    """(n,) V of a curve freed of noise: a smoothing spline through means of some samples, of a
    coarse converter over some of its steps (V, 0 where noise makes it toggle)."""
    usual = np.diff(time)
    way = np.arange(time[0], time[-1], max(_BRIEF, float(usual.max(initial=0.0))))
    passed = float(np.sum(np.abs(np.diff(np.interp(way, time, volts)))))
    length = _PASSED * step * float(time[-1] - time[0]) / max(passed, step, 1e-12)
    block = (time - time[0]) // max(_BLOCK, length, float(np.median(usual)))
    edges = np.flatnonzero(np.diff(block, prepend=-1.0))
    count = np.diff(np.append(edges, len(time)))
    centre, mean = np.add.reduceat(time, edges) / count, np.add.reduceat(volts, edges) / count
    exact = not step and np.median(np.abs(np.diff(volts, 2))) < 1e-5 * np.ptp(volts)
    if exact or len(centre) < FEWEST_IN_LINE:
        return volts
    return np.asarray(make_smoothing_spline(centre, mean, count / count.max())(time))
