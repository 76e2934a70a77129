# mypy: disallow-untyped-defs=False, disallow-incomplete-defs=False
"""Current through a wire: its resistance by phase and temperature, leads, contacts, the driver.

The resistance of martensite and austenite differs, and both rise with temperature (NiTi: D. C.
Lagoudas, Shape Memory Alloys, 2008, table 1.1); only the wire's own part heats it.
"""

from typing import NamedTuple

from sma_bench.blind.reality.world import World
from sma_bench.compiled import inlined

LEAST_RESISTANCE = 0.05  # of the wire's at rest
SECONDS_PER_MINUTE = 60.0


class Circuit(NamedTuple):
    """Constants: ohm, 1/K, K, ohm/s, A (0: no limit)."""

    resistance: float
    austenite_change: float
    temperature_coefficient: float
    rest_temperature: float
    supply: float
    contact_growth: float
    limit: float


def circuit(world: World) -> Circuit:
    """The circuit of a world."""
    return Circuit(
        world.parameters["wire.resistance"],
        world.feature("resistance_austenite_change"),
        world.feature("resistance_temperature_coefficient"),
        world.parameters["environment.ambient_temperature"],
        world.feature("supply_resistance"),
        world.feature("contact_growth") / SECONDS_PER_MINUTE,
        world.feature("current_limit"),
    )


@inlined
def current(circuit, voltage, temperature, martensite, driven):
    """Current [A] of one wire, and the power [W] that heats it.

    Args:
        voltage: V at the driver; temperature: K; martensite: fraction; driven: s so far.
    """
    warm = 1.0 + circuit.temperature_coefficient * (temperature - circuit.rest_temperature)
    phase = 1.0 + circuit.austenite_change * (1.0 - martensite)
    wire = circuit.resistance * max(warm * phase, LEAST_RESISTANCE)
    amperes = voltage / (wire + circuit.supply + circuit.contact_growth * driven)
    if circuit.limit > 0.0:
        amperes = min(max(amperes, -circuit.limit), circuit.limit)
    return amperes, amperes * amperes * wire
