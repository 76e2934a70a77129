# mypy: disallow-untyped-defs=False, disallow-incomplete-defs=False
"""A temperature reading that lags.

    dT_read/dt = (T - T_read)/tau

Source: first-order sensor; averaging in a camera looks the same at a bench's rates.
"""

import math

from sma_bench.compiled import borrowing
from sma_bench.physics import columns as at
from sma_bench.physics.effects.effect import Effect

EFFECT = Effect(
    "temperature_lag",
    "sensor",
    {"time_constant": at.READING_LAG},
    "readings round off and follow late, heating and cooling alike; the deflection is on time",
    ("temperature",),
)


@borrowing
def follow(reading, before, now, step, lag):
    """The reading after a step in which the temperature went straight from `before` to `now`."""
    if lag <= 0.0:
        return now
    decay = math.exp(-step / lag)
    slope = (now - before) / step
    return now - slope * lag + (reading - before + slope * lag) * decay
