"""Leads and contacts between the voltage that is measured and the wire.

    V_wire = V - I R_s - max(I - I_k, 0) R_o,    I = V/(R + R_s) below I_k

Source: Ohm's law; R_o, I_k: a supply or a driver that gives way beyond a current.
"""

from sma_bench.compiled import borrowing
from sma_bench.physics import columns as at


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
