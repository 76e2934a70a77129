"""Leads and contacts between the voltage that is measured and the wire.

    V_wire = V - I R_s,    I = V/(R + R_s)

Source: Ohm's law.
"""

from sma_bench.compiled import borrowing
from sma_bench.parameters.parameter import Effect, Parameter
from sma_bench.physics import columns as at

EFFECT = Effect(
    "electrical",
    (Parameter("resistance", "ohm", 0.0,
               "R_s of leads and contacts between the measured voltage and the wire; 0 is off.",
               "assumed: thin leads and crimps", 0.0, 5.0, uncertainty=0.2),),
    shows="less current and less heat than V/R and V^2/R; the resistance seen from the driver is "
    "too large, while the heat says it is not",
    acts_on=("current", "temperature", "deflection"), marks=("HEATED_OTHERWISE",),
    columns={"resistance": "SUPPLY_RESISTANCE"},
)


@borrowing
def power(wires, i, voltage, resistance):
    """Heat in wire i [W] when the driver reads `voltage`; a current source holds voltage / R."""
    if wires[i, at.CURRENT_DRIVEN] > 0.0:
        current = voltage / wires[i, at.RESISTANCE]
        return current * current * resistance
    current = voltage / (resistance + wires[i, at.SUPPLY_RESISTANCE])
    return current * current * resistance
