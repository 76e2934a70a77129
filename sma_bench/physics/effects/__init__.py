"""What the paper's model leaves out, one effect a file; each is off until its numbers are set.

An effect's numbers (parameters/effects.yaml) are ordinary parameters, which every simulation, node
and file takes:

    parameters.replace(effect_values("side_heat_coupling", 0.01))
    simulate(parameters, time, voltage).temperature_reading
"""

from collections.abc import Mapping

from sma_bench.errors import InputError
from sma_bench.parameters.parameter import EFFECTS as EFFECTS
from sma_bench.parameters.parameters import unknown_parameter_message


def effect_values(name: str, size: float) -> dict[str, float]:
    """Parameters that switch one effect on. `name`: of the effect, or `effect.number` for another
    number than its size; `size`: in the unit of the parameter table. InputError: unknown name."""
    effect_name, _, number = name.partition(".")
    if effect_name not in EFFECTS:
        message = unknown_parameter_message(effect_name, EFFECTS)
        raise InputError(message.replace("parameter", "effect", 1))
    effect = EFFECTS[effect_name]
    return {(effect.named(number) if number else effect.size).name: size}


def active_effects(parameters: Mapping[str, object]) -> tuple[str, ...]:
    """Names of the effects that these parameters switch on."""
    return tuple(name for name, effect in EFFECTS.items() if effect.is_on(parameters))
