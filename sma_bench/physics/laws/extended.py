"""The law of Lagoudas and others: a strain that grows with stress, smooth kinetics and different
moduli of the phases.

With H(sigma) the strain of martensite that forms at sigma, eps_L the largest,

    H/eps_L = r + (1 - r) [1 - exp(-sigma/sigma_o)]
    share   = [1 + y sqrt(2 - y^2)]/2,   y = 2 position - 1

and both ranges shift by s/C_A, s/C_M, where by Clausius and Clapeyron

    s = sigma H/eps_L + sigma^2 (1/E_M - 1/E_A)/(2 eps_L)

Martensite keeps the strain with which it formed, until heating transforms it (orientation.py).

Source: Lagoudas, Hartl et al. 2012, whose hardening with the exponents n = 1/2 gives the share; E9
fits the same H (identify/constitutive.py). Parameters: r (`wire.least_strain_share`: 0 untrained, 1
fully trained), sigma_o (`wire.orientation_stress`)."""

import math
from collections.abc import Mapping
from typing import Any

from sma_bench.compiled import inlined
from sma_bench.physics import columns as at

ENDS = (0.0, 1.0)  # positions


@inlined
def ramp(position):
    """Share and slope."""
    y = 2.0 * position - 1.0
    if abs(y) >= 1.0:
        return (1.0 if y > 0.0 else 0.0), 0.0
    root = math.sqrt(2.0 - y * y)
    return 0.5 * (1.0 + y * root), 2.0 * (1.0 - y * y) / root


@inlined
def orients(wires, i, stress):
    """H/eps_L of a wire, and its slope [1/Pa]; r at zero or compressive stress."""
    least = wires[i, at.ORIENTS_FROM]
    if stress <= 0.0:
        return least, 0.0
    left = (1.0 - least) * math.exp(-stress / wires[i, at.ORIENTS_WITHIN])
    return 1.0 - left, left / wires[i, at.ORIENTS_WITHIN]


@inlined
def shifting(wires, i, stress):
    """Stress s [Pa] that shifts the range of heating, its slope; the same for cooling."""
    strain, slope = orients(wires, i, stress)
    bend = wires[i, at.MISMATCH] * max(stress, 0.0)
    s, by_stress = (strain + 0.5 * bend) * stress, strain + slope * stress + bend
    return s, by_stress, s, by_stress


def mismatch(p: Mapping[str, Any]) -> float:
    """(1/E_M - 1/E_A)/eps_L of s [1/Pa], at least 0."""
    softer = 1.0 / p["wire.martensite_modulus"] - 1.0 / p["wire.austenite_modulus"]
    return float(max(softer, 0.0) / p["wire.maximum_recoverable_strain"])
