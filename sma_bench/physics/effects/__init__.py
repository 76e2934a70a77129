"""What the paper's model leaves out, one effect a file; each is off until its numbers are set.

An effect's numbers are ordinary parameters (`effect.side_heat_coupling.conductance`), off at their
defaults, so every simulation, node and file that takes parameters takes effects:

    parameters.replace(effect_values("side_heat_coupling", 0.01))
    simulate(parameters, time, voltage).temperature_reading
"""

from collections.abc import Mapping

from sma_bench.errors import InputError
from sma_bench.parameters.parameters import unknown_parameter_message
from sma_bench.physics.effects import (
    ambient_drift,
    deflection_drift,
    latent_heat,
    matrix_thermal_mass,
    opposing_wires,
    partial_transformation,
    phase_dependent_resistance,
    residual_strain,
    side_asymmetry,
    side_heat_coupling,
    slack,
    stress_dependent_transition,
    supply_drop,
    temperature_dependent_convection,
    temperature_lag,
    temperature_underfill,
    transition_drift,
    viscoelastic_matrix,
)
from sma_bench.physics.effects.effect import Effect

EFFECTS: dict[str, Effect] = {
    module.EFFECT.name: module.EFFECT
    for module in (
        phase_dependent_resistance, supply_drop,
        latent_heat, temperature_dependent_convection, matrix_thermal_mass, side_heat_coupling,
        ambient_drift,
        partial_transformation, transition_drift, stress_dependent_transition,
        residual_strain, viscoelastic_matrix, opposing_wires, side_asymmetry, slack,
        temperature_underfill, temperature_lag, deflection_drift,
    )
}  # fmt: skip


def effect_values(name: str, size: float) -> dict[str, float]:
    """Parameters that switch one effect on.

    Args:
        name: of the effect, or `effect.number` for another number than its size.
        size: in the unit of the parameter table.

    Raises:
        InputError: unknown name.
    """
    effect_name, _, number = name.partition(".")
    if effect_name not in EFFECTS:
        message = unknown_parameter_message(effect_name, EFFECTS)
        raise InputError(message.replace("parameter", "effect", 1))
    effect = EFFECTS[effect_name]
    return {(effect.named(number) if number else effect.size).name: size}


def active_effects(parameters: Mapping[str, object]) -> tuple[str, ...]:
    """Names of the effects that these parameters switch on."""
    return tuple(name for name, effect in EFFECTS.items() if effect.is_on(parameters))


__all__ = ["EFFECTS", "Effect", "active_effects", "effect_values"]
