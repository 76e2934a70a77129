"""What the demo's bench hides: an effect drawn at random, and parameters a little off."""

from collections.abc import Mapping

import numpy as np

from sma_bench.estimation.unknowns import BACK, FRONT
from sma_bench.parameters import Parameters
from sma_bench.parameters.effect_table import EFFECT_PREFIX
from sma_bench.physics.effects import active_effects

# Lowest and highest of each number, drawn evenly in its logarithm: sizes to be met at a bench of
# config/demo_rig.yaml, of effects that currents, temperatures and deflection together tell apart.
HIDEABLE: dict[str, dict[str, tuple[float, float]]] = {
    "phase_dependent_resistance": {"austenite_change": (0.05, 0.2)},
    "supply_drop": {"resistance": (0.25, 0.5)},
    "latent_heat": {"heat": (6e3, 25e3)},
    "side_heat_coupling": {"conductance": (1e-3, 6e-3)},
    "residual_strain": {"share": (0.04, 0.25)},
    "viscoelastic_matrix": {"relaxation": (0.08, 0.3), "time_constant": (4.0, 15.0)},
    "slack": {"strain": (2e-3, 8e-3)},
    "temperature_lag": {"time_constant": (0.15, 1.5)},
}
_EITHER_SIGN = ("phase_dependent_resistance",)
_FARTHEST = 2.0  # standard errors


def hidden_bench(lab: Parameters, seed: int) -> Parameters:
    """The bench as it is: its parameters off by the lab's standard errors, one effect on.

    Args:
        lab: parameters as believed, with the uncertainties that were stated.
        seed: draws everything.
    """
    rng = np.random.default_rng(seed)
    effect = str(rng.choice(list(HIDEABLE)))
    sign = rng.choice((-1.0, 1.0)) if effect in _EITHER_SIGN else 1.0
    numbers = {
        f"{EFFECT_PREFIX}{effect}.{number}": float(sign * np.exp(rng.uniform(*np.log(ends))))
        for number, ends in HIDEABLE[effect].items()
    }
    errors = np.clip(rng.standard_normal(len(lab.given_uncertainty)), -_FARTHEST, _FARTHEST)
    off = {
        name: float(lab[name] + error * std)
        for (name, std), error in zip(lab.given_uncertainty.items(), errors, strict=True)
    }
    if lab[FRONT] == lab[BACK]:  # sides that are built alike are off alike
        off[BACK] = off[FRONT]
    return Parameters({name: lab[name] for name in lab.given} | off | numbers)


def hidden_effect(bench: Parameters) -> str:
    """The one effect of a bench that hides one."""
    (effect,) = active_effects(bench)
    return effect


def hidden_numbers(bench: Parameters) -> Mapping[str, float]:
    """Its numbers, by their full names."""
    effect = hidden_effect(bench)
    names = (f"{EFFECT_PREFIX}{effect}.{number}" for number in HIDEABLE[effect])
    return {name: bench[name] for name in names}
