"""Effects that the paper's model leaves out, one per file; each is off until its numbers are set.

An effect's numbers (parameters/effects.yaml) are ordinary parameters, which every simulation, node
and file accepts:

    parameters = with_effect(parameters, "side_heat_coupling", 0.01)
    simulate(parameters, time, voltage).temperature_reading"""

from collections.abc import Mapping
from typing import Any

from sma_bench.errors import InputError
from sma_bench.parameters.parameter import EFFECTS as EFFECTS
from sma_bench.parameters.parameters import Parameters, idle_effects, unknown_parameter_message


def with_effect(parameters: Parameters, name: str, size: Any) -> Parameters:
    """Parameters with an effect on. `name`: the effect, or `effect.number` for a number other than
    its size; `size`: in the table's unit. InputError: unknown, not a number, or idle here."""
    effect_name, _, number = name.partition(".")
    if (effect := EFFECTS.get(effect_name)) is None:
        message = unknown_parameter_message(effect_name, EFFECTS)
        raise InputError(message.replace("parameter", "effect", 1))
    entry = effect.named(number) if number else effect.size
    try:
        value = float(size)
    except (TypeError, ValueError):
        raise InputError(f"{size!r} is not a number") from None
    found = parameters.replace({entry.name: value})
    if fault := idle_effects(found).get(effect_name):
        raise InputError(fault)
    return found


def active_effects(parameters: Mapping[str, object]) -> tuple[str, ...]:
    """Names of the effects that these parameters switch on."""
    return tuple(name for name, effect in EFFECTS.items() if effect.is_on(parameters))
