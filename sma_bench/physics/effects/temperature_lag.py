"""A temperature reading that lags.

    T_read = (1 - s) L(tau) T + s L(tau_s) T,    L(tau): dT_L/dt = (T - T_L)/tau

Source: first-order sensor; a slow share s if leads and glue warm the junction too (Moffat 1988).
With an exposure t_e the reading goes through L(t_e/6) three more times, which gives the mean delay
and the width of an average over t_e."""

import math

from sma_bench.compiled import borrowing
from sma_bench.physics import columns as at


@borrowing
def follow(reading, before, now, step, lag):
    """Lagged reading after a step with a temperature linear from `before` to `now`."""
    if lag <= 0.0:
        return now
    decay = math.exp(-step / lag)
    slope = (now - before) / step
    return now - slope * lag + (reading - before + slope * lag) * decay


@borrowing
def read(wires, i, seen, step):
    """Reading of wire i after a step, whose end temperature at the sensor is `seen` [K]."""
    before = wires[i, at.FAST]
    fast = follow(before, wires[i, at.SEEN], seen, step, wires[i, at.READING_LAG])
    wires[i, at.FAST], reading = fast, fast
    if wires[i, at.SLOW_SHARE] > 0.0:
        slow = follow(wires[i, at.SLOW], wires[i, at.SEEN], seen, step, wires[i, at.SLOW_TIME])
        before += wires[i, at.SLOW_SHARE] * (wires[i, at.SLOW] - before)
        reading += wires[i, at.SLOW_SHARE] * (slow - fast)
        wires[i, at.SLOW] = slow
    wires[i, at.SEEN] = seen
    if wires[i, at.EXPOSURE] > 0.0:
        lag = wires[i, at.EXPOSURE] / 6.0
        for k in (at.EXPOSED, at.EXPOSED_TWICE, at.READING):
            own = wires[i, k]
            wires[i, k] = follow(own, before, reading, step, lag)
            before, reading = own, wires[i, k]
    return reading
