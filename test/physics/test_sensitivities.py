"""Derivatives carried along with a simulation: against differences, at random parameters."""

import numpy as np
import pytest
from stiff_solver import triangle
from test_loads import RIGS

from sma_bench.parameters import Parameters
from sma_bench.parameters.parameter import EFFECTS
from sma_bench.parameters.table import BY_NAME
from sma_bench.physics import simulate
from sma_bench.physics.sensitivities import Sensitivities, carries

EFFECT_NUMBERS = [
    f"effect.{effect.name}.{number}" for effect in EFFECTS.values() for number in effect.carried
]
WIRE = [
    "wire.resistance", "wire.heat_transfer_coefficient", "wire.specific_heat",
    "environment.ambient_temperature", "wire.austenite_start_temperature",
    "wire.austenite_finish_temperature", "wire.martensite_start_temperature",
    "wire.martensite_finish_temperature", "wire.martensite_modulus", "wire.austenite_modulus",
    "wire.maximum_recoverable_strain", "wire.thermal_expansion_factor",
    "wire.stress_influence_austenite", "wire.stress_influence_martensite",
    "wire.transition_spread", "wire.transition_tail",
]  # fmt: skip
BEAM = [
    "composite.deflection_per_strain", "composite.stress_per_deflection_front",
    "composite.stress_per_deflection_back",
]
LOADS = {
    "clamped": [], "force": ["load.force", "wire.diameter"],
    "spring": ["load.stiffness", "load.preload", "wire.mass"],
    "antagonist": ["load.stiffness", "load.preload"], "composite": BEAM,
}
TIME = np.cumsum(np.tile([0.02, 0.02, 0.035], 700)) - 0.02
TINY = 2e-6  # of a number's standard deviation
STEPS = (1e-4, 1e-5)  # near a kink, or a snap, only the second is small enough


def random_bench(kind, seed, composite_rig):
    """Within a third of what is believed; steps up and down, so that inner loops are among it."""
    rng = np.random.default_rng(seed)
    rig = {"clamped": Parameters.of_paper(), "composite": composite_rig, **RIGS}[kind]
    names = [*WIRE, *LOADS[kind], *EFFECT_NUMBERS]
    if kind != "composite":
        names.remove("effect.side_asymmetry.ratio")
    scales = {name: spread_of(name, rig) for name in names}
    lifted = {"wire.transition_spread": 2.5, "wire.transition_tail": 0.4,
              "effect.latent_heat.heat": 12e3, "effect.partial_transformation.memory": 0.3}
    drawn = {
        n: lifted.get(n, float(rig[n])) + 0.3 * scales[n] * rng.uniform(-1.0, 1.0) for n in names
    }
    wires = len(rig["bench.channels"])
    heights = [triangle(TIME, rng.uniform(6.0, 7.5), rng.uniform(9.0, 14.0)) for _ in range(wires)]
    return rig.replace(drawn), scales, np.column_stack(heights)


def spread_of(name, rig):
    limits = {"wire.transition_spread": 1.5, "wire.transition_tail": 0.3,
              "effect.partial_transformation.memory": 0.4}
    return limits.get(name) or float(BY_NAME[name].uncertainty or 0.0) or 0.1 * float(rig[name])


@pytest.mark.parametrize("seed", [3, 4])
@pytest.mark.parametrize("kind", list(LOADS))
def test_derivatives_are_those_that_differences_tend_to(kind, seed, composite_rig):
    bench, scales, volts = random_bench(kind, seed, composite_rig)
    names, here = list(scales), simulate(bench, TIME, volts)
    assert carries(bench)
    assert np.ptp(here.martensite_fraction) > 0.2
    moved = [bench.replace({n: bench[n] + TINY * scales[n]}) for n in names]
    found = Sensitivities.of(here, moved, np.full(len(names), TINY))
    for k, name in enumerate(names):
        pairs = []
        for step in STEPS:
            up, down = bench[name] + step * scales[name], bench[name] - step * scales[name]
            pairs.append([simulate(bench.replace({name: x}), TIME, volts) for x in (up, down)])
        for part in ("temperature", "stress", "contraction"):
            least = 1e-4 * np.linalg.norm(getattr(here, part))
            carried, off = getattr(found, part)[:, :, k].T, []
            for step, (up, down) in zip(STEPS, pairs, strict=True):
                difference = (getattr(up, part) - getattr(down, part)) / (2.0 * step)
                size = np.linalg.norm(difference) + least
                off.append(np.linalg.norm(carried - difference) / size if size else 0.0)
            assert min(off) < 1e-6, (name, part, off)


@pytest.mark.parametrize("effect", [e for e in EFFECTS.values() if e.not_carried])
def test_other_effects_are_not_carried_unless_behind_the_core(effect):
    bench = Parameters.of_paper()
    switched = [n for n in effect.not_carried if BY_NAME[n].default == 0.0]
    for name in switched:
        assert carries(bench.replace({name: BY_NAME[name].uncertainty})) == (
            effect.name == "deflection_drift"
        )
