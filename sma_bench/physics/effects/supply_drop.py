"""Voltage drop of leads, contacts and supply between the measured voltage and the wire.

    V_wire = V - u - I R_s - max(I - I_k, 0) R_o,    I = (V - u)/(R + R_s) below I_k
    tau du/dt = R_b I - u

R_s: leads and contacts; R_o: a supply or driver whose voltage drops above I_k; R_b, tau: a battery.
Source: Ohm's law; Thevenin's model of batteries (Plett, Battery Management Systems 1, 2015)."""

import math

from sma_bench.compiled import borrowing
from sma_bench.physics import columns as at


@borrowing
def power(wires, i, voltage, resistance, step):
    """Heat in wire i [W] in a step at `voltage`; sources keep current V/R or power V^2/R."""
    if wires[i, at.SOURCE] > 1.0:
        return voltage * voltage / wires[i, at.RESISTANCE]
    if wires[i, at.SOURCE] > 0.0:
        current = voltage / wires[i, at.RESISTANCE]
        return current * current * resistance
    resists = resistance + wires[i, at.SUPPLY_RESISTANCE]
    if wires[i, at.BATTERY] > 0.0:
        voltage = max(voltage - wires[i, at.SAG], 0.0)
    current = voltage / resists
    if current > wires[i, at.KNEE]:
        overload = wires[i, at.OVERLOAD]
        current = (voltage + overload * wires[i, at.KNEE]) / (resists + overload)
    if wires[i, at.BATTERY] > 0.0:
        sags = wires[i, at.BATTERY] * current - wires[i, at.SAG]
        wires[i, at.SAG] -= sags * math.expm1(-step / wires[i, at.BATTERY_TIME])
    return current * current * resistance
