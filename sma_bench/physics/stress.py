"""Stress of one wire: the constitutive law of Liang and Rogers, eqs. (6) to (9)."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sma_bench.parameters import Parameters

Array = NDArray[np.float64]


def modulus(martensite_fraction: ArrayLike, parameters: Parameters) -> Array:
    """E(xi) [Pa], eq. (7)."""
    austenite = parameters["wire.austenite_modulus"]
    change = parameters["wire.martensite_modulus"] - austenite
    return np.asarray(austenite + np.asarray(martensite_fraction, float) * change)


def transformation_coefficient(martensite_fraction: ArrayLike, parameters: Parameters) -> Array:
    """Omega [Pa], eq. (9)."""
    return -parameters["wire.maximum_recoverable_strain"] * modulus(
        martensite_fraction, parameters
    )


def clamped_stress(temperature: ArrayLike, parameters: Parameters) -> Array:
    """Stress [Pa] of a clamped wire at T [K] before it transforms, eq. (8)."""
    rise = np.asarray(temperature, float) - parameters["environment.ambient_temperature"]
    return np.asarray(parameters["wire.thermal_expansion_factor"] * rise)


def stress(
    temperature: ArrayLike,
    martensite_fraction: ArrayLike,
    contraction: ArrayLike,
    parameters: Parameters,
) -> Array:
    """sigma [Pa], eq. (6) from sigma = 0, xi = 1 and ambient temperature at rest.

    Args:
        temperature: T [K]; martensite_fraction: xi; broadcast against each other.
        contraction: -(eps - eps_0), positive when the wire is shorter than at rest.
    """
    xi = np.asarray(martensite_fraction, float)
    elastic = -modulus(xi, parameters) * np.asarray(contraction, float)
    transformed = transformation_coefficient(xi, parameters) * (xi - 1.0)
    return np.asarray(elastic + clamped_stress(temperature, parameters) + transformed)
