"""Air that warms or cools while the bench runs.

    T_inf(t) = T_inf + b t + d t^2 + g [exp(-s/t_f) - exp(-s/t_r)],    s = t - t_g >= 0, t_r = 2 s

`environment.ambient_temperature` is T_inf at the start. b, d: first two terms of a series for a
room or enclosure that warms. g: a gust at t_g (a door, a fan), which rises with t_r and fades with
t_f. Source: assumed; a gust has the response of two heat capacities to one event."""

import math

from sma_bench.compiled import borrowing
from sma_bench.physics import columns as at

_RISE = 2.0  # s, t_r


@borrowing
def air_temperature(wires, i):
    """T_inf at the wire's clock [K]."""
    clock = wires[i, at.CLOCK]
    change = (wires[i, at.AMBIENT_RATE] + wires[i, at.AMBIENT_BEND] * clock) * clock
    since = clock - wires[i, at.GUST_INSTANT]
    if wires[i, at.GUST] != 0.0 and since > 0.0:
        faded = math.exp(-since / wires[i, at.GUST_FADING])
        change += wires[i, at.GUST] * (faded - math.exp(-since / _RISE))
    return wires[i, at.AMBIENT] + change
