"""Response of eq. (2) to a sampled voltage, exact for straight lines between the samples."""

from dataclasses import dataclass

import numpy as np

from sma_bench.identify.estimate import Array, Indices

# exp() of the elapsed time over tau must stay finite within a block.
_LONGEST_BLOCK = 200.0
# Samples on either side of a jump that tell how the voltage runs up to it.
_TREND = 8


@dataclass(frozen=True)
class VoltageCourse:
    """A voltage in straight pieces: piece k runs from start[k] to start[k] + length[k] in s.

    It begins at `voltage[k]` V and changes by `slope[k]` V/s; (p,) arrays, pieces adjoin.
    """

    start: Array
    length: Array
    voltage: Array
    slope: Array


def course_from_samples(
    time: Array, voltage: Array, edges: Indices, edge_times: Array
) -> VoltageCourse:
    """Straight lines between the samples; at an edge either side runs on to the jump.

    Args:
        time: (n,) s, increasing; voltage: (n,) V.
        edges: (e,) indices k of samples after which the voltage jumps before sample k + 1.
        edge_times: (e,) s of the jumps, each between its two samples.
    """
    lines = np.ones(len(time) - 1, dtype=bool)
    lines[edges] = False
    start = np.concatenate([time[:-1][lines], time[edges], edge_times])
    stop = np.concatenate([time[1:][lines], edge_times, time[edges + 1]])
    # A trend ends at the neighbouring jumps.
    behind = np.concatenate([[-1], edges, [len(time) - 1]]) + 1
    first = np.maximum(edges - _TREND, behind[:-2])
    last = np.minimum(edges + 2 + _TREND, behind[2:])
    before = np.array([_trend(time, voltage, f, k + 1) for f, k in zip(first, edges, strict=True)])
    after = np.array([_trend(time, voltage, k + 1, n) for n, k in zip(last, edges, strict=True)])
    landing = voltage[edges + 1] - after * (time[edges + 1] - edge_times)
    value = np.concatenate([voltage[:-1][lines], voltage[edges], landing])
    slope = np.concatenate([np.diff(voltage)[lines] / np.diff(time)[lines], before, after])
    order = np.argsort(start, kind="stable")
    return VoltageCourse(start[order], (stop - start)[order], value[order], slope[order])


def _trend(time: Array, voltage: Array, first: int, last: int) -> float:
    """Slope in V/s through samples first .. last - 1, 0 for a single one."""
    t, v = time[first:last], voltage[first:last]
    if len(t) < 2:
        return 0.0
    centred = t - t.mean()
    return float(centred @ v) / float(centred @ centred)


def temperature_rise(
    course: VoltageCourse, gain: float, tau: float, initial: float, at: Array
) -> Array:
    """Temperature above ambient in K: tau dx/dt = -x + gain V(t)^2, x = initial at the start.

    Within a piece V = a + b s and x = gain [V^2 - 2 b tau V + 2 b^2 tau^2] + c exp(-s/tau).

    Args:
        course: the voltage.
        gain: 1/(R h A_c) in K/V^2.
        tau: m c_p/(h A_c) in s.
        initial: K above ambient when the course begins.
        at: (m,) s, any order; earlier than the course gives `initial`.
    """
    end_voltage = course.voltage + course.slope * course.length
    begin = _particular(course.voltage, course.slope, gain, tau)
    end = _particular(end_voltage, course.slope, gain, tau)
    decay = course.length / tau
    state = _propagate(decay, end - begin * np.exp(-decay), initial)
    piece = np.clip(np.searchsorted(course.start, at, side="right") - 1, 0, None)
    since = np.maximum(at - course.start[piece], 0.0)
    local = _particular(
        course.voltage[piece] + course.slope[piece] * since, course.slope[piece], gain, tau
    )
    return np.asarray(local + (state[piece] - begin[piece]) * np.exp(-since / tau))


def _particular(voltage: Array, slope: Array, gain: float, tau: float) -> Array:
    lag = slope * tau
    return np.asarray(gain * (voltage**2 - 2.0 * lag * voltage + 2.0 * lag**2))


def _propagate(decay: Array, forcing: Array, initial: float) -> Array:
    """x[k+1] = exp(-decay[k]) x[k] + forcing[k], x[0] = initial; returns x at each piece's start.

    Blocks of a running sum replace the loop.
    """
    elapsed = np.concatenate([[0.0], np.cumsum(decay)])
    state = np.empty(len(decay) + 1)
    state[0] = initial
    first = 0
    while first < len(decay):
        stop = int(np.searchsorted(elapsed, elapsed[first] + _LONGEST_BLOCK, side="right"))
        last = max(min(stop, len(decay)), first + 1)
        since = elapsed[first + 1 : last + 1] - elapsed[first]
        if last == first + 1:
            state[last] = np.exp(-since[0]) * state[first] + forcing[first]
        else:
            grown = np.cumsum(forcing[first:last] * np.exp(since))
            state[first + 1 : last + 1] = np.exp(-since) * (state[first] + grown)
        first = last
    return state[:-1]
