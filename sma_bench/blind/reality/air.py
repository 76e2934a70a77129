"""The air around a bench: its slow temperature, its gusts, and what the film at a surface carries.

Free convection from a horizontal cylinder: S. W. Churchill and H. H. S. Chu, Int. J. Heat Mass
Transfer 18 (1975) 1049, eq. 12. Radiation to surroundings at the temperature of the air.
"""

import numpy as np
from numpy.typing import NDArray

from sma_bench.blind.reality.world import World

Array = NDArray[np.float64]

GRAVITY = 9.81
PRANDTL = 0.71
EMISSIVITY = 0.9  # silicone
STEFAN_BOLTZMANN = 5.670374e-8

REFERENCE_EXCESS = 25.0  # K above the air, at which the film is the baseline's
EXCESS_STEP = 1.0  # K, of the table that the loop reads
LARGEST_EXCESS = 400.0
LEAST_FILM = 0.05

WAVE_PERIOD = 180.0  # s
GUST_GAP = 12.0  # s, mean of an exponential distribution
GUST_LENGTH = (2.0, 8.0)  # s


def free_convection(excess: Array, air: float, diameter: float) -> Array:
    """h [W/(m2 K)] of a horizontal cylinder, Churchill and Chu (1975).

    Args:
        excess: (m,) K of the surface above the air, above 0; air: K; diameter: m.
    """
    film = air + 0.5 * excess
    conductivity = 0.0241 * (film / 273.15) ** 0.81
    viscosity = 1.33e-5 * (film / 273.15) ** 1.76  # kinematic, at sea level
    rayleigh = GRAVITY / film * excess * diameter**3 * PRANDTL / viscosity**2
    factor = (1.0 + (0.559 / PRANDTL) ** (9.0 / 16.0)) ** (8.0 / 27.0)
    nusselt = (0.60 + 0.387 * rayleigh ** (1.0 / 6.0) / factor) ** 2
    return np.asarray(nusselt * conductivity / diameter)


def radiation(excess: Array, air: float) -> Array:
    """h [W/(m2 K)] that radiation amounts to; arguments as `free_convection`."""
    surface = air + excess
    return np.asarray(
        EMISSIVITY * STEFAN_BOLTZMANN * (surface**2 + air**2) * (surface + air)
    )


def relative_film(world: World) -> Array:
    """(m,) conductance of the film over the baseline's, by excess in steps of EXCESS_STEP."""
    air = world.parameters["environment.ambient_temperature"]
    diameter = world.parameters["composite.thickness"]
    excess = np.maximum(np.arange(0.0, LARGEST_EXCESS, EXCESS_STEP), 1e-3)
    both = free_convection(excess, air, diameter) + radiation(excess, air)
    share = world.feature("convection_by_correlation")
    relative = both / np.interp(REFERENCE_EXCESS, excess, both)
    return np.asarray(np.maximum(1.0 + share * (relative - 1.0), LEAST_FILM))


def ambient(world: World, time: Array) -> Array:
    """(n,) K of the air; starts at the rig's ambient temperature."""
    passed = time - time[0]
    wave = world.feature("ambient_wave") * np.sin(2.0 * np.pi * passed / WAVE_PERIOD)
    still = world.parameters["environment.ambient_temperature"]
    return np.asarray(still + world.feature("ambient_rate") * passed + wave)


def gusts(world: World, time: Array) -> Array:
    """(n,) factor on the film's conductance, 1 in still air: a seeded train of smooth gusts."""
    factor = np.ones(len(time))
    strength = world.feature("draught")
    if strength == 0.0:
        return factor
    rng = np.random.default_rng(int(world.feature("draught_seed")))
    passed = time - time[0]
    start = rng.exponential(GUST_GAP)
    while start < passed[-1]:
        length, height = rng.uniform(*GUST_LENGTH), rng.uniform(0.5, 1.0)
        phase = np.clip((passed - start) / length, 0.0, 1.0)
        factor += strength * height * np.sin(np.pi * phase) ** 2
        start += length + rng.exponential(GUST_GAP)
    return factor
