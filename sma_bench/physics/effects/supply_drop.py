"""Voltage drop of leads, contacts and supply between the measured voltage and the wire.

    V_wire = V - V_0 - u - I R_s - max(I - I_k, 0) R_o,    I = (V - V_0 - u)/(R + R_s) below I_k
    tau du/dt = R_b I - u

V_0: transistors or diodes, without current below V_0; R_s: leads and contacts; R_o: a supply or
driver whose voltage drops above I_k; R_b, tau: a battery. A transistor that switches a duty keeps a
share of the voltage, as R_s does, not V_0.
Source: Ohm's law; Thevenin's model of batteries (Plett, Battery Management Systems 1, 2015)."""

import math

from sma_bench.compiled import borrowing
from sma_bench.physics import columns as at


@borrowing
def current(wires, i, voltage, resistance):
    """Current [A] through wire i at `voltage`; a source keeps V/R, or the power V^2/R."""
    if wires[i, at.SOURCE] > 1.0:
        return voltage / math.sqrt(wires[i, at.RESISTANCE] * resistance)
    if wires[i, at.SOURCE] > 0.0:
        return voltage / wires[i, at.RESISTANCE]
    resists = resistance + wires[i, at.SUPPLY_RESISTANCE]
    lost = wires[i, at.THRESHOLD] + wires[i, at.SAG]
    if lost > 0.0:
        voltage = max(voltage - lost, 0.0)
    amperes = voltage / resists
    if amperes > wires[i, at.KNEE]:
        overload = wires[i, at.OVERLOAD]
        amperes = (voltage + overload * wires[i, at.KNEE]) / (resists + overload)
    return amperes


@borrowing
def power(wires, i, voltage, resistance, step):
    """Heat in wire i [W] in a step at `voltage`; the battery sags by its current."""
    amperes = current(wires, i, voltage, resistance)
    if wires[i, at.BATTERY] > 0.0 and wires[i, at.SOURCE] == 0.0:
        sags = wires[i, at.BATTERY] * amperes - wires[i, at.SAG]
        wires[i, at.SAG] -= sags * math.expm1(-step / wires[i, at.BATTERY_TIME])
    return amperes * amperes * resistance
