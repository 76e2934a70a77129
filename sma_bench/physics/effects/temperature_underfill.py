"""An infrared spot larger than the wire sees the background too.

    T_read^n = (1 - m) T^n + m T_background^n,    n = 4.5

The background is the air's temperature or, with thermal mass of the matrix, the silicone's.
Source: radiance of a grey body in the 8 to 14 um band, about T^4.5 near 330 K.
"""

from sma_bench.compiled import borrowing
from sma_bench.parameters.parameter import Effect, Parameter
from sma_bench.physics import columns as at

EFFECT = Effect(
    "sensor",
    (Parameter("missing", "1", 0.0,
               "Share of the infrared spot that sees the background instead of the wire; 0 is off.",
               "assumed: wire as thin as a pixel, up to 0.6", 0.0, 0.9, uncertainty=0.2),),
    shows="all excess temperatures read low by one factor; the deflection knows nothing of it",
    acts_on=("temperature",), marks=("EVOLVES", "READ_OTHERWISE"),
    columns={"missing": "MISSING_SPOT"},
)

_EXPONENT = 4.5


@borrowing
def spot_temperature(wires, i, background):
    """What a spot on wire i reads [K]."""
    missing = wires[i, at.MISSING_SPOT]
    wire = wires[i, at.TEMPERATURE] / background
    return background * ((1.0 - missing) * wire**_EXPONENT + missing) ** (1.0 / _EXPONENT)
