"""What a wire's grains are: classes with transition temperatures of their own, and their ramps."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sma_bench.blind.reality.world import World

Array = NDArray[np.float64]

GRAIN_CLASSES = 7

# A ramp's table reaches so many of its widths beyond either end; the nodes hit 0 and 1.
BEYOND = 1.0
PER_WIDTH = 512

# Standard deviation of the cosine ramp, taken as a distribution over its width: 1/4 - 2/pi^2.
COSINE_DEVIATION = math.sqrt(0.25 - 2.0 / math.pi**2)

# The R-phase: narrow, little hysteresis, little strain per stress (so large C), between the
# martensite's start and the austenite's (S. Miyazaki and K. Otsuka, Metall. Trans. A 17, 1986).
R_WIDTH = 8.0  # K
R_HYSTERESIS = 3.0  # K
R_STRESS = 0.4  # of the martensite's shift with stress


class Classes(NamedTuple):
    """Grain classes of every wire, each an array (c,).

    Attributes:
        weight: share of the transformation strain, in sum 1.
        austenite_finish, martensite_finish: K.
        austenite_rate, martensite_rate: 1/K, one over the width of the range.
        austenite_shift, martensite_shift: K/Pa.
    """

    weight: Array
    austenite_finish: Array
    austenite_rate: Array
    austenite_shift: Array
    martensite_finish: Array
    martensite_rate: Array
    martensite_shift: Array


def grain_classes(world: World) -> Classes:
    """The grains of a world; one class where they are all alike."""
    p = world.parameters
    starts = p["wire.austenite_start_temperature"], p["wire.martensite_start_temperature"]
    finishes = p["wire.austenite_finish_temperature"], p["wire.martensite_finish_temperature"]
    shifts = (
        world.feature("stress_influence_factor_austenite") / p["wire.stress_influence_austenite"],
        world.feature("stress_influence_factor_martensite")
        / p["wire.stress_influence_martensite"],
    )
    spread, r_share = world.feature("grain_spread"), world.feature("r_phase")
    offsets, weights = _normal(spread)
    rows = [
        (
            (1.0 - r_share) * weight,
            finishes[0] + offset, 1.0 / (finishes[0] - starts[0]), shifts[0],
            finishes[1] + offset, 1.0 / (starts[1] - finishes[1]), shifts[1],
        )
        for offset, weight in zip(offsets, weights, strict=True)
    ]
    if r_share > 0.0:
        middle = 0.5 * (starts[0] + starts[1])
        hot, cold = middle + 0.5 * (R_WIDTH + R_HYSTERESIS), middle - 0.5 * R_HYSTERESIS
        rate = 1.0 / R_WIDTH
        rows.append(
            (
                r_share, hot, rate, R_STRESS * shifts[0],
                cold - 0.5 * R_WIDTH, rate, R_STRESS * shifts[1],
            )
        )
    return Classes(*(np.ascontiguousarray(column) for column in np.array(rows).T))


def _normal(deviation: float) -> tuple[Array, Array]:
    """Gauss-Hermite nodes and weights of a normal distribution; one node if it has no width."""
    if deviation == 0.0:
        return np.zeros(1), np.ones(1)
    nodes, weights = np.polynomial.hermite_e.hermegauss(GRAIN_CLASSES)
    return deviation * nodes, weights / np.sum(weights)


def ramp_table(smoothness: float) -> Array:
    """(m, 2) ramp from 0 to 1 over positions 0 to 1, and its slope per table step.

    From (1 - cos(pi x))/2 of the contract, smoothness 0, to the normal distribution function of
    the same mean and deviation, 1.
    """
    steps = round((1.0 + 2.0 * BEYOND) * PER_WIDTH)
    position = np.arange(steps + 1) / PER_WIDTH - BEYOND
    angle = 0.5 * np.pi * np.clip(position, 0.0, 1.0)
    cosine, cosine_slope = np.sin(angle) ** 2, np.pi * np.sin(angle) * np.cos(angle)
    scaled = (position - 0.5) / COSINE_DEVIATION
    normal = np.array([0.5 * math.erfc(-x / math.sqrt(2.0)) for x in scaled])
    density = np.exp(-0.5 * scaled**2) / (math.sqrt(2.0 * math.pi) * COSINE_DEVIATION)
    # Hermite interpolation meets the plateaus without a step.
    normal[0], normal[-1], density[0], density[-1] = 0.0, 1.0, 0.0, 0.0
    value = (1.0 - smoothness) * cosine + smoothness * normal
    slope = (1.0 - smoothness) * cosine_slope + smoothness * density
    return np.ascontiguousarray(np.column_stack([value, slope / PER_WIDTH]))
