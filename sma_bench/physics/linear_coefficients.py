"""Coefficients of eqs. (18) to (23), corrected, each beside its printed form.

The derivation, from rest (sigma_0 = 0, xi_0 = 1, T_0 = T_inf) and about a point *:

    sigma = E(xi)(eps - eps_0) + Theta_T (T - T_0) - eps_L E(xi)(xi - xi_0)           (6), (7), (9)
    dsigma/deps = E(xi*) = a_1,    dsigma/dT = Theta_T,    dsigma/dxi = -eps_L E_A + a_2,

so that a_2 = (E_M - E_A) [eps_L (xi_0 - 2 xi*) + eps* - eps_0], and a_3 makes the line pass through
the point. xi = b_1 (T* - T + (sigma - sigma*)/C_A) + b_2 is eq. (10) to first order, eq. (21)
likewise with C_M. `strain` below is eps* - eps_0, the negative of the contraction.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sma_bench.parameters import Parameters
from sma_bench.physics import bending, material
from sma_bench.physics.bending import Beam

Array = NDArray[np.float64]

FRACTION_AT_REST = 1.0  # xi_0


def a1(martensite_fraction: ArrayLike, parameters: Parameters) -> Array:
    """dsigma/deps [Pa] of eq. (18), printed right: E(xi*)."""
    return material.modulus(martensite_fraction, parameters)


def a2(martensite_fraction: ArrayLike, strain: ArrayLike, parameters: Parameters) -> Array:
    """a_2 [Pa] of eq. (18), corrected: dsigma/dxi is -eps_L E_A + a_2.

    Args:
        martensite_fraction: xi*; strain: eps* - eps_0; broadcast against each other.
    """
    return _a2(martensite_fraction, strain, parameters, 1.0)


def a2_as_printed(
    martensite_fraction: ArrayLike, strain: ArrayLike, parameters: Parameters
) -> Array:
    """a_2 [Pa] as printed: the sign of eps* - eps_0 is flipped."""
    return _a2(martensite_fraction, strain, parameters, -1.0)


def a3(martensite_fraction: ArrayLike, strain: ArrayLike, parameters: Parameters) -> Array:
    """a_3 [Pa] of eq. (18), corrected: what makes (18) exact at the operating point."""
    return _a3(martensite_fraction, strain, parameters, -1.0)


def a3_as_printed(
    martensite_fraction: ArrayLike, strain: ArrayLike, parameters: Parameters
) -> Array:
    """a_3 [Pa] as printed: the sign of eps* - eps_0 is flipped."""
    return _a3(martensite_fraction, strain, parameters, 1.0)


def linear_heating(voltage: ArrayLike, operating_voltage: ArrayLike, resistance: float) -> Array:
    """V^2/R [W] to first order about V*, the heating of eq. (19) corrected."""
    volt, steady = np.asarray(voltage, float), np.asarray(operating_voltage, float)
    return steady / resistance * (2.0 * volt - steady)


def linear_heating_as_printed(
    voltage: ArrayLike, operating_voltage: ArrayLike, resistance: float
) -> Array:
    """The last term of eq. (19) as printed: it cools, and adds a number to a voltage."""
    volt, steady = np.asarray(voltage, float), np.asarray(operating_voltage, float)
    return -steady / resistance * (1.0 + 2.0 * volt)


def b1(temperature: ArrayLike, sigma: ArrayLike, parameters: Parameters) -> Array:
    """-dxi/dT [1/K] of eq. (10), corrected: eq. (20) lacks the factor pi/(A_f - A_s)."""
    return np.pi / _width("austenite", parameters) * b1_as_printed(temperature, sigma, parameters)


def b1_as_printed(temperature: ArrayLike, sigma: ArrayLike, parameters: Parameters) -> Array:
    """b_1 as printed, a number times kelvin and pascal."""
    return _half_sine(material.austenite_ramp(temperature, sigma, parameters))


def b1_of_stress(temperature: ArrayLike, sigma: ArrayLike, parameters: Parameters) -> Array:
    """dxi/dsigma [1/Pa] of eq. (10): b_1/C_A; eq. (20) multiplies the stress by b_1."""
    return b1(temperature, sigma, parameters) / parameters["wire.stress_influence_austenite"]


def b2(temperature: ArrayLike, sigma: ArrayLike, parameters: Parameters) -> Array:
    """xi at the operating point, eq. (10); printed right."""
    return material.heated_fraction(temperature, sigma, parameters)


def b3(temperature: ArrayLike, sigma: ArrayLike, parameters: Parameters) -> Array:
    """-dxi/dT [1/K] of eq. (11), corrected: eq. (21) lacks the factor pi/(M_s - M_f)."""
    return np.pi / _width("martensite", parameters) * b3_as_printed(temperature, sigma, parameters)


def b3_as_printed(temperature: ArrayLike, sigma: ArrayLike, parameters: Parameters) -> Array:
    """b_3 as printed, a number times kelvin and pascal."""
    return _half_sine(material.martensite_ramp(temperature, sigma, parameters))


def b3_of_stress(temperature: ArrayLike, sigma: ArrayLike, parameters: Parameters) -> Array:
    """dxi/dsigma [1/Pa] of eq. (11): b_3/C_M; eq. (21) multiplies the stress by b_3."""
    return b3(temperature, sigma, parameters) / parameters["wire.stress_influence_martensite"]


def b4(temperature: ArrayLike, sigma: ArrayLike, parameters: Parameters) -> Array:
    """xi at the operating point, eq. (11); printed right."""
    return material.cooled_fraction(temperature, sigma, parameters)


def alpha(parameters: Parameters) -> float:
    """Deflection per contraction [m], eq. (22) corrected; eps - eps_0 = -delta/alpha."""
    return bending.bending_coefficients(parameters)[0]


def alpha_as_printed(parameters: Parameters) -> float:
    """alpha [m] of the geometry as printed: twice the integral of eq. (16), with one width."""
    return bending.deflection_as_printed(1.0, Beam.of(parameters))


def beta(parameters: Parameters, side: str = "front") -> float:
    """Stress, summed over the wires of a side, per deflection [Pa/m]: eq. (23), corrected EI."""
    _, front, back = bending.bending_coefficients(parameters)
    return front if side == "front" else back


def beta_as_printed(parameters: Parameters) -> float:
    """beta of the geometry with EI as it is printed below eq. (14)."""
    beam = Beam.of(parameters)
    printed = bending.bending_stiffness_as_printed(beam)
    return 2.0 * printed / (beam.offset * beam.wire_section * beam.length**2)


def _a2(xi: ArrayLike, strain: ArrayLike, parameters: Parameters, sign: float) -> Array:
    fraction = np.asarray(xi, float)
    recovered = parameters["wire.maximum_recoverable_strain"] * (FRACTION_AT_REST - 2.0 * fraction)
    return np.asarray(_change(parameters) * (recovered + sign * np.asarray(strain, float)))


def _a3(xi: ArrayLike, strain: ArrayLike, parameters: Parameters, sign: float) -> Array:
    fraction = np.asarray(xi, float)
    recovered = parameters["wire.maximum_recoverable_strain"] * fraction
    bracket = recovered + sign * np.asarray(strain, float)
    return np.asarray(_change(parameters) * fraction * bracket)


def _change(parameters: Parameters) -> float:
    return float(parameters["wire.martensite_modulus"] - parameters["wire.austenite_modulus"])


def _width(phase_name: str, parameters: Parameters) -> float:
    start = parameters[f"wire.{phase_name}_start_temperature"]
    return abs(float(parameters[f"wire.{phase_name}_finish_temperature"] - start))


def _half_sine(ramp: Array) -> Array:
    """sin(x)/2 where the ramp is (1 +- cos x)/2; 0 outside the range."""
    return np.sqrt(ramp * (1.0 - ramp))
