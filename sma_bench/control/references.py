"""What a controller may be asked for: one line for a reference that the bench cannot follow."""

import math
from collections.abc import Sequence

from sma_bench.control.heating import Heating
from sma_bench.parameters import Parameters
from sma_bench.physics.operating_point import maximum_deflection


def temperature_reference_fault(reference: Sequence[float], parameters: Parameters) -> str:
    """Why wire temperatures [K], one a channel, cannot be followed, or "".

    Ambient temperature or less only means that a wire is not heated.
    """
    channels = len(parameters["bench.channels"])
    if len(reference) != channels:
        return f"reference has {len(reference)} temperatures, expected {channels}"
    highest = Heating.of(parameters).maximum_temperature
    for kelvin in reference:
        if not math.isfinite(kelvin):
            return f"reference has {kelvin} K, expected finite temperatures"
        if not 0.0 < kelvin <= highest:
            return f"reference has {kelvin:g} K, expected above 0 and at most {highest:g} K"
    return ""


def deflection_reference_fault(reference: Sequence[float], parameters: Parameters) -> str:
    """Why a deflection [m], the only element, cannot be followed, or ""."""
    (metres,) = reference
    if not math.isfinite(metres):
        return f"reference is {metres} m, expected a finite deflection"
    side = "front" if metres > 0.0 else "back"
    if metres == 0.0:
        return ""
    if side not in parameters["bench.channel_sides"]:
        return f"reference is {metres:g} m, but there is no wire on the {side}"
    largest = maximum_deflection(parameters, side)
    if abs(metres) > largest:
        return f"reference is {metres:g} m, expected at most {largest:.4g} m to the {side}"
    return ""
