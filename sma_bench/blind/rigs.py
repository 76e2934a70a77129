"""A lab's rig, drawn: what it truly is, and the numbers its owners believe in."""

from collections.abc import Mapping

import numpy as np

from sma_bench.parameters import Parameters

CHANNELS = ("front_1", "front_2", "back_1", "back_2")
SIDES = ("front", "front", "back", "back")

# Of two equal stiffnesses the owners know one number.
FRONT = "composite.stress_per_deflection_front"
BACK = "composite.stress_per_deflection_back"

# Middle of the population of rigs, half width of its spread (relative, or K for temperatures),
# stated standard deviation (in the same terms).
_RELATIVE: dict[str, tuple[float, float, float]] = {
    "wire.resistance": (3.05, 0.10, 0.01),
    "wire.heat_transfer_coefficient": (115.0, 0.10, 0.03),
    "wire.specific_heat": (415.0, 0.10, 0.03),
    "wire.mass": (0.091e-3, 0.05, 0.005),
    "wire.surface_area": (188.5e-6, 0.05, 0.005),
    "wire.martensite_modulus": (21.5e9, 0.10, 0.03),
    "wire.austenite_modulus": (56.0e9, 0.10, 0.03),
    "wire.maximum_recoverable_strain": (0.0385, 0.10, 0.02),
    "wire.thermal_expansion_factor": (-0.12e6, 0.10, 0.10),
    "wire.stress_influence_austenite": (7.3e6, 0.10, 0.06),
    "wire.stress_influence_martensite": (8.0e6, 0.10, 0.06),
    "composite.deflection_per_strain": (1.01, 0.10, 0.03),
    FRONT: (4.9e9, 0.10, 0.05),
}
_ABSOLUTE: dict[str, tuple[float, float, float]] = {
    "wire.austenite_start_temperature": (334.0, 4.0, 0.5),
    "wire.austenite_finish_temperature": (353.0, 4.0, 0.5),
    "wire.martensite_start_temperature": (320.0, 4.0, 0.5),
    "wire.martensite_finish_temperature": (307.5, 3.0, 0.5),
    "environment.ambient_temperature": (293.5, 2.5, 0.2),
}
BELIEVED = (*_RELATIVE, *_ABSOLUTE)
# Only together do the area and h, the mass and c_p act; the owners have weighed and measured the
# wire well, so a wrong number hides in the other one.
RECALIBRATED = tuple(n for n in BELIEVED if n not in ("wire.mass", "wire.surface_area"))
_DIGITS = 3
# How wrong a wrong number is, in its own stated standard deviations.
WRONG_BY = (2.5, 5.0)

STAGE_OF_PARAMETER = {
    "wire.resistance": "electrical",
    "wire.heat_transfer_coefficient": "thermal",
    "wire.specific_heat": "thermal",
    "wire.mass": "thermal",
    "wire.surface_area": "thermal",
    "environment.ambient_temperature": "thermal",
    "wire.austenite_start_temperature": "transformation",
    "wire.austenite_finish_temperature": "transformation",
    "wire.martensite_start_temperature": "transformation",
    "wire.martensite_finish_temperature": "transformation",
    "wire.stress_influence_austenite": "transformation",
    "wire.stress_influence_martensite": "transformation",
}


def stage_of_parameter(name: str) -> str:
    """The stage in which a wrong number of this name shows first."""
    return STAGE_OF_PARAMETER.get(name, "mechanical")


def draw_truth(rng: np.random.Generator) -> Parameters:
    """The true numbers of one composite rig of the population."""
    values: dict[str, float] = {}
    for name, (middle, spread, _) in _RELATIVE.items():
        values[name] = float(middle * (1.0 + spread * rng.uniform(-1.0, 1.0)))
    for name, (middle, spread, _) in _ABSOLUTE.items():
        values[name] = float(middle + spread * rng.uniform(-1.0, 1.0))
    return _rig(values, {})


def true_values(truth: Parameters) -> dict[str, float]:
    """The numbers that the owners of a rig have an opinion on."""
    return {name: float(truth[name]) for name in BELIEVED}


def stated_std(name: str, value: float) -> float:
    """The standard deviation that the owners state for a number that they believe in."""
    spread = abs(value) * _RELATIVE[name][2] if name in _RELATIVE else _ABSOLUTE[name][2]
    return float(f"{spread:.{_DIGITS}g}")


def draw_nominal(
    truth: Parameters, rng: np.random.Generator, wrong: Mapping[str, float] | None = None
) -> Parameters:
    """What the owners believe: the truth, wrong by one draw of the uncertainty they state.

    Args:
        truth: of the rig.
        rng: draws the errors.
        wrong: parameter -> its error in stated standard deviations, instead of a draw.
    """
    values, stds = {}, {}
    for name, true in true_values(truth).items():
        error = (wrong or {}).get(name)
        drawn = rng.standard_normal()
        sigmas = drawn if error is None else error
        values[name] = true + sigmas * stated_std(name, true)
        # From the believed number: the true one must not be told by its uncertainty.
        stds[name] = stated_std(name, values[name])
    return _rig(values, stds)


def draw_wrong(rng: np.random.Generator) -> dict[str, float]:
    """One to three parameters and their errors in stated standard deviations."""
    names = rng.choice(RECALIBRATED, size=int(rng.integers(1, 4)), replace=False)
    sizes = rng.uniform(*WRONG_BY, len(names)) * rng.choice([-1.0, 1.0], len(names))
    return {str(name): float(size) for name, size in zip(names, sizes, strict=True)}


def rig_of(values: Mapping[str, float]) -> Parameters:
    """Parameters of a composite rig with equal sides from the numbers of BELIEVED."""
    return _rig(dict(values), {})


def _rig(values: dict[str, float], stds: dict[str, float]) -> Parameters:
    both = {BACK: values[FRONT]}
    std_of_both = {BACK: stds[FRONT]} if stds else {}
    layout = {
        "bench.channels": CHANNELS,
        "bench.channel_sides": SIDES,
        "wire.diameter": 0.3e-3,
    }
    return Parameters({**layout, **values, **both}, {**stds, **std_of_both})
