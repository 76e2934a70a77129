"""Air that warms or cools while the bench runs.

    T_inf(t) = T_inf + b t + d t^2 + g [exp(-s/t_f) - exp(-s/t_r)],    s = t - t_g >= 0, t_r = 2 s

The parameter `environment.ambient_temperature` is that of the start. Source: a room, an enclosure
that warms; two terms of its series. A gust (a door, a fan, a room that settles): what two heat
capacities do after one event.
"""

import math

from sma_bench.compiled import borrowing
from sma_bench.parameters.parameter import Effect, Parameter
from sma_bench.physics import columns as at

EFFECT = Effect(
    "thermal",
    (Parameter("rate", "K/s", 0.0, "Rise of the air around the wires; 0 is off.",
               "assumed: 0.2 to 5 K in ten minutes", -0.2, 0.2, uncertainty=0.01),
     Parameter("bend", "K/s2", 0.0, "Growth of that rise.",
               "assumed: of the order of the rise over some minutes", -2e-3, 2e-3,
               uncertainty=8e-5),
     Parameter("gust", "K", 0.0, "What an event does to the air; 0 is off.",
               "assumed: a door, to 10 K", -30.0, 30.0, uncertainty=2.0),
     Parameter("instant", "s", 60.0, "When it comes, by the clock of every record.",
               "assumed: within the first minutes", 0.1, 1e5, uncertainty=180.0),
     Parameter("fading", "s", 60.0, "Time in which it fades.", "assumed: a minute", 4.0, 1e5,
               uncertainty=60.0)),
    shows="all wires' temperatures drift alike, at rest too; transformations come at a little less "
    "power",
    marks=("HEATED_OTHERWISE",),
    forms={"steady": ("rate", "bend"), "gust": ("gust", "instant", "fading")},
    columns={"rate": "AMBIENT_RATE", "bend": "AMBIENT_BEND", "gust": "GUST",
             "instant": "GUST_INSTANT", "fading": "GUST_FADING"},
)

_RISE = 2.0  # s


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
