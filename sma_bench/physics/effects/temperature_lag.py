"""A temperature reading that lags.

    dT_read/dt = (T - T_read)/tau

Source: first-order sensor; averaging in a camera looks the same at a bench's rates.
"""

import math

from sma_bench.compiled import borrowing
from sma_bench.parameters.parameter import Effect, Parameter

EFFECT = Effect(
    "sensor",
    (Parameter("time_constant", "s", 0.0, "Time constant of the temperature reading; 0 is off.",
               "assumed: 0.05 to 2 s", 0.0, 20.0, uncertainty=0.5),),
    shows="readings round off and follow late, heating and cooling alike; the deflection is on "
    "time",
    acts_on=("temperature",), marks=("EVOLVES", "READ_OTHERWISE"),
    columns={"time_constant": "READING_LAG"}, state=("SEEN",),
)


@borrowing
def follow(reading, before, now, step, lag):
    """The reading after a step in which the temperature went straight from `before` to `now`."""
    if lag <= 0.0:
        return now
    decay = math.exp(-step / lag)
    slope = (now - before) / step
    return now - slope * lag + (reading - before + slope * lag) * decay
