# mypy: disallow-untyped-defs=False, disallow-incomplete-defs=False
"""Leads and contacts between the voltage that is measured and the wire.

    V_wire = V - I R_s,    I = V/(R + R_s)

Source: Ohm's law.
"""

from sma_bench.compiled import borrowing
from sma_bench.physics import columns as at
from sma_bench.physics.effects.effect import Effect

EFFECT = Effect(
    "supply_drop",
    "electrical",
    {"resistance": at.SUPPLY_RESISTANCE},
    "less current and less heat than V/R and V^2/R; the resistance seen from the driver is too "
    "large, while the heat says it is not",
    ("current", "temperature", "deflection"),
)


@borrowing
def power(wires, i, voltage, resistance):
    """Heat in wire i [W] when the driver reads `voltage`."""
    current = voltage / (resistance + wires[i, at.SUPPLY_RESISTANCE])
    return current * current * resistance
