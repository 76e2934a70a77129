"""Reference files: what a controller shall follow, with the same steps as a protocol.

    name: temperature_staircase
    unit: K                   # K: wire temperatures; m: deflection, positive toward the front
    steps:
      - {kind: staircase, name: up, start: 303.15, stop: 328.15, increment: 5.0, dwell: 10.0}

Rest is ambient temperature, or no deflection; a triangle starts and ends there. A file of
temperatures drives channels, one of deflections the tip, and has no `drive`. How far a bench can
go is not known here: controllers refuse what it cannot reach.
"""

from pathlib import Path
from typing import Any

from sma_bench.border import read_yaml
from sma_bench.errors import InputError
from sma_bench.parameters import Parameters
from sma_bench.protocols.protocol import Protocol
from sma_bench.protocols.reading import (
    PROTOCOL_KEYS,
    Quantity,
    bench_channels,
    locate,
    parse_levels,
)

TIP = "tip"


def _any_level(_key: str, _level: float, _parameters: Parameters, _where: str) -> None:
    return


TEMPERATURE = Quantity(
    what="reference",
    folder="references",
    unit="K",
    keys=("unit", *PROTOCOL_KEYS),
    targets=bench_channels,
    rest=lambda parameters: float(parameters["environment.ambient_temperature"]),
    require=_any_level,
)
DEFLECTION = Quantity(
    what="reference",
    folder="references",
    unit="m",
    keys=("unit", *PROTOCOL_KEYS),
    targets=lambda _: ((TIP,), ()),
    rest=lambda _: 0.0,
    require=_any_level,
)
QUANTITIES = {quantity.unit: quantity for quantity in (TEMPERATURE, DEFLECTION)}


def load_reference(
    name_or_path: str | Path, parameters: Parameters, quantity: Quantity
) -> Protocol:
    """Read a reference by its name (in the share folder's config/references) or by its path.

    Args:
        parameters: channels, sides and ambient temperature of the bench.
        quantity: TEMPERATURE or DEFLECTION, which the file's unit must be.

    Raises:
        InputError: as load_protocol, or another unit.
    """
    path = locate(name_or_path, quantity)
    return parse_reference(read_yaml(path), parameters, quantity, str(path), path.stem)


def parse_reference(
    document: Any,
    parameters: Parameters,
    quantity: Quantity,
    where: str = "reference",
    name: str = "reference",
) -> Protocol:
    """A reference from the plain mapping of its file; `Protocol.level` gives the levels.

    Raises:
        InputError: as load_reference.
    """
    unit = document.get("unit") if isinstance(document, dict) else quantity.unit
    if unit != quantity.unit:
        raise InputError(f"{where}: unit is {unit!r}, expected {quantity.unit}")
    return parse_levels(document, parameters, quantity, where, name)
