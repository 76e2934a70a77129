"""Martensite whose strain depends on the load (the laws brinson and extended).

Of the fraction xi the oriented part xi_S has the strain eps_L, the rest none:

    d xi_S = D(sigma) d xi            martensite forms; Brinson: only while xi_S/xi <= D
    d xi_S = xi_S/xi d xi             martensite vanishes
    xi_S/xi >= D(sigma)               Brinson: existing martensite detwins as the stress grows

Within a step xi_S is linear in xi, and in sigma where it detwins, about the start of the step: the
core solves the same equations as for other wires, with other moduli and strains. At rest, a wire
under a weight, a spring or an antagonist is oriented by that stress; one that is clamped or bends a
beam was stretched before it was mounted: xi_S = xi = 1, as in the contract."""

import numpy as np

from sma_bench.arrays import Array
from sma_bench.compiled import borrowing
from sma_bench.parameters import Parameters
from sma_bench.parameters.parameter import BY_NAME, LAWS
from sma_bench.parameters.parameters import ORIENTING, load_kind
from sma_bench.physics import columns as at
from sma_bench.physics.laws import brinson, extended
from sma_bench.physics.laws.cosine import ramp

FIRST = min(map(LAWS.index, ORIENTING))  # index in LAWS from which laws are of this kind
BRINSON = LAWS.index("brinson")
_ROUNDING = 1e-6  # tolerance of a share
_EQUAL = 0.01  # detwinning goes on where D is at most this far below xi_S/xi


def at_rest(p: Parameters, prestretch: Array) -> Array:
    """xi_S/xi of wires at rest, mounted with these elastic strains (w,)."""
    if p["wire.law"] not in ORIENTING or load_kind(p) not in ("force", "spring", "antagonist"):
        return np.ones_like(prestretch)
    row, numbers = np.zeros((1, at.WIRE_COLUMNS)), [p[name] for name in ORIENTING[p["wire.law"]]]
    row[0, [at.LAW, at.ORIENTS_FROM, at.ORIENTS_WITHIN]] = LAWS.index(p["wire.law"]), *numbers
    stresses = prestretch * p["wire.martensite_modulus"]
    return np.array([orients(row, 0, stress)[0] for stress in stresses])


def as_oriented(p: Parameters, prestretch: float) -> Parameters:
    """Parameters whose largest recoverable strain is that of a wire oriented as at rest."""
    if p["wire.law"] not in ORIENTING:
        return p
    strain = BY_NAME["wire.maximum_recoverable_strain"]
    oriented = p[strain.name] * float(at_rest(p, np.array([prestretch]))[0])
    return p.replace({strain.name: max(oriented, strain.low)})


@borrowing
def orients(wires, i, stress):
    """D of wire i by its law, and its slope [1/Pa]."""
    if wires[i, at.LAW] == BRINSON:
        return brinson.orients(wires, i, stress)
    return extended.orients(wires, i, stress)


@borrowing
def orient(wires, i):
    """Before a step: set strains and moduli of wire i for it; returns the strain to add."""
    stress, xi, full = wires[i, at.STRESS], wires[i, at.FRACTION], wires[i, at.FULL_STRAIN]
    is_brinson, there = wires[i, at.LAW] == BRINSON, 0.0
    new, slope = orients(wires, i, stress)
    old = min(wires[i, at.ORIENTED] / xi, 1.0) if xi > 0.0 else new
    if is_brinson:  # existing martensite detwins as at M_s, less if warmer
        warm = wires[i, at.TEMPERATURE] - wires[i, at.MARTENSITE_FINISH]
        warm = max(warm - 1.0 / wires[i, at.MARTENSITE_SLOPE], 0.0) / wires[i, at.MARTENSITE_SHIFT]
        there, slope = orients(wires, i, stress - warm)
        new = new if old < new + _ROUNDING else 0.0
    follows = old if wires[i, at.TREND] > 0.0 else new
    grows = is_brinson and stress > wires[i, at.STRESS_BEFORE] and there > old - _EQUAL
    jump, compliance = (xi * (there - old), full * xi * slope) if grows else (0.0, 0.0)
    wires[i, at.STRESS_BEFORE] = stress
    wires[i, at.ORIENTED_SLOPE], wires[i, at.ORIENTED_START] = follows, xi * (old - follows) + jump
    wires[i, at.ORIENTED_BY_STRESS] = xi * slope if grows else 0.0
    # sigma = E [... - q (sigma - sigma_0)] + ..., solved for sigma.
    change = wires[i, at.MARTENSITE_STIFF] - wires[i, at.AUSTENITE_STIFF]
    modulus = wires[i, at.AUSTENITE_STIFF] + xi * change
    softer = 1.0 / (1.0 + modulus * compliance)
    wires[i, at.MODULUS_CHANGE] = change * softer * softer
    wires[i, at.AUSTENITE_MODULUS] = modulus * softer - xi * wires[i, at.MODULUS_CHANGE]
    wires[i, at.EXPANSION] = wires[i, at.EXPANDS] * softer
    wires[i, at.RECOVERABLE_STRAIN] = full * follows
    return full * (1.0 - follows - wires[i, at.ORIENTED_START]) + compliance * stress


@borrowing
def after_step(wires, i):
    """Update the oriented fraction of wire i."""
    xi, moved = wires[i, at.FRACTION], wires[i, at.STRESS] - wires[i, at.STRESS_BEFORE]
    now = wires[i, at.ORIENTED_START] + wires[i, at.ORIENTED_SLOPE] * xi
    now += wires[i, at.ORIENTED_BY_STRESS] * moved
    wires[i, at.ORIENTED] = min(max(now, 0.0), xi)


# --- The R-phase, between austenite and martensite: an option of every law, off by default. Part of
# what is not martensite is R-phase, which is longer than austenite by eps_R:
#
#     xi_R = (1 - xi) sin^2[pi/2 (T_R + w/2 - T + sigma/C_R)/w]
#
# It shows on cooling, before martensite forms, and where A_s lies below T_R on heating too. C_R is
# steep, and the hysteresis of 1 to 5 K so narrow that it is left out: xi_R has no memory. Its heat
# (5 J/g) and resistance are not modelled. Source: Otsuka and Ren 2005. Parameters: eps_R
# (`wire.r_phase_strain`; 0: none), T_R (`wire.r_phase_temperature`), w (`wire.r_phase_range`).

STRESS_INFLUENCE = 16e6  # C_R, Pa/K: 13 to 20 MPa/K


@borrowing
def r_phase_strain(wires, i):
    """Strain by which R-phase lengthens wire i, at its temperature at the end of the step."""
    temperature = wires[i, at.START] + wires[i, at.LAG] * wires[i, at.FRACTION]
    colder = wires[i, at.R_END] - temperature + wires[i, at.STRESS] / STRESS_INFLUENCE
    share = ramp(colder / wires[i, at.R_RANGE])[0]
    return wires[i, at.R_STRAIN] * share * (1.0 - wires[i, at.FRACTION])
