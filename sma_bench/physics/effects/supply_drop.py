"""Leads and contacts between the voltage that is measured and the wire.

    V_wire = V - I R_s - max(I - I_k, 0) R_o,    I = V/(R + R_s) below I_k

Source: Ohm's law; R_o, I_k: a supply or a driver that gives way beyond a current.
"""

from sma_bench.compiled import borrowing
from sma_bench.parameters.parameter import Effect, Parameter
from sma_bench.physics import columns as at

EFFECT = Effect(
    "electrical",
    (Parameter("resistance", "ohm", 0.0,
               "R_s of leads and contacts between the measured voltage and the wire; 0 is off.",
               "assumed: thin leads and crimps", 0.0, 5.0, uncertainty=0.2),
     Parameter("overload", "ohm", 0.0, "R_o of a supply beyond the current I_k; 0 is off.",
               "assumed: small supplies, thin transistors", 0.0, 20.0, uncertainty=0.5),
     Parameter("knee", "A", 1.0, "I_k through a channel, beyond which the supply gives way.",
               "assumed: below the largest current", 1e-3, 100.0, uncertainty=0.7)),
    shows="less current and less heat than V/R and V^2/R; the resistance seen from the driver is "
    "too large, while the heat says it is not",
    acts_on=("current", "temperature", "deflection"), marks=("HEATED_OTHERWISE",),
    forms={"leads": ("resistance",), "overload": ("overload", "knee")},
    columns={"resistance": "SUPPLY_RESISTANCE", "overload": "OVERLOAD", "knee": "KNEE"},
)


@borrowing
def power(wires, i, voltage, resistance):
    """Heat in wire i [W] when the driver reads `voltage`; a source of current holds voltage / R,
    one of power voltage^2 / R."""
    if wires[i, at.SOURCE] > 1.0:
        return voltage * voltage / wires[i, at.RESISTANCE]
    if wires[i, at.SOURCE] > 0.0:
        current = voltage / wires[i, at.RESISTANCE]
        return current * current * resistance
    resists = resistance + wires[i, at.SUPPLY_RESISTANCE]
    current = voltage / resists
    if current > wires[i, at.KNEE]:
        overload = wires[i, at.OVERLOAD]
        current = (voltage + overload * wires[i, at.KNEE]) / (resists + overload)
    return current * current * resistance
