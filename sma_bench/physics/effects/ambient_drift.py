"""Air that warms or cools while the bench runs.

    T_inf(t) = T_inf + b t + d t^2

The parameter `environment.ambient_temperature` is that of the start. Source: a room, an enclosure
that warms; two terms of its series.
"""

from sma_bench.compiled import borrowing
from sma_bench.parameters.parameter import Effect, Parameter
from sma_bench.physics import columns as at

EFFECT = Effect(
    "thermal",
    (Parameter("rate", "K/s", 0.0, "Rise of the air around the wires; 0 is off.",
               "assumed: 0.2 to 5 K in ten minutes", -0.2, 0.2, uncertainty=0.01),
     Parameter("bend", "K/s2", 0.0, "Growth of that rise.",
               "assumed: of the order of the rise over some minutes", -2e-3, 2e-3,
               uncertainty=8e-5)),
    shows="all wires' temperatures drift alike, at rest too; transformations come at a little less "
    "power",
    marks=("HEATED_OTHERWISE",), columns={"rate": "AMBIENT_RATE", "bend": "AMBIENT_BEND"},
)


@borrowing
def air_temperature(wires, i):
    """T_inf at the wire's clock [K]."""
    clock = wires[i, at.CLOCK]
    change = (wires[i, at.AMBIENT_RATE] + wires[i, at.AMBIENT_BEND] * clock) * clock
    return wires[i, at.AMBIENT] + change
