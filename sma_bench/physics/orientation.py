"""Martensite whose strain the load decides, with the laws that say so (brinson, extended).

Of the fraction xi the part xi_S has the strain eps_L, the rest none:

    d xi_S = D(sigma) d xi            what forms; Brinson's only while xi_S/xi is not above D
    d xi_S = xi_S/xi d xi             what vanishes
    xi_S/xi >= D(sigma)               Brinson's: what is there detwins as the stress grows

Within a step xi_S is straight in xi, and in sigma where it detwins, about where the step began: the
core solves what it solves of every wire, with other moduli and strains. At rest a wire that bears a
weight, a spring or an antagonist is as that stress has oriented it; one that is clamped or bends a
beam was stretched before it was mounted: xi_S = xi = 1, as the contract has it."""

import numpy as np

from sma_bench.arrays import Array
from sma_bench.compiled import borrowing
from sma_bench.parameters import Parameters
from sma_bench.parameters.parameter import BY_NAME, LAWS
from sma_bench.parameters.parameters import ORIENTING, load_kind
from sma_bench.physics import columns as at
from sma_bench.physics.laws import brinson, extended, law_of
from sma_bench.physics.laws.cosine import ramp

FIRST = min(map(LAWS.index, ORIENTING))  # number from which laws are of this kind
BRINSON = LAWS.index("brinson")
_ROUNDING = 1e-6  # of a share
_EQUAL = 0.01  # share by which less than D is no detwinning that has ended


def at_rest(p: Parameters, prestretch: Array) -> Array:
    """xi_S/xi of wires at rest, mounted with these elastic strains (w,)."""
    if p["wire.law"] not in ORIENTING or load_kind(p) not in ("force", "spring", "antagonist"):
        return np.ones_like(prestretch)
    return np.asarray(law_of(p).oriented(prestretch * p["wire.martensite_modulus"], p))


def as_oriented(p: Parameters, prestretch: float) -> Parameters:
    """The same with the strain that a wire has at rest for its largest one."""
    if p["wire.law"] not in ORIENTING:
        return p
    strain = BY_NAME["wire.maximum_recoverable_strain"]
    oriented = p[strain.name] * float(at_rest(p, np.array([prestretch]))[0])
    return p.replace({strain.name: max(oriented, strain.low)})


@borrowing
def orient(wires, i):
    """Before a step of wire i: its strains and moduli within it; the strain that it adds."""
    stress, xi, full = wires[i, at.STRESS], wires[i, at.FRACTION], wires[i, at.FULL_STRAIN]
    is_brinson, there = wires[i, at.LAW] == BRINSON, 0.0
    law = brinson.orients(wires, i, stress) if is_brinson else extended.orients(wires, i, stress)
    new, slope = law
    old = min(wires[i, at.ORIENTED] / xi, 1.0) if xi > 0.0 else new
    if is_brinson:  # what is there detwins as at M_s, the warmer the less
        warm = wires[i, at.TEMPERATURE] - wires[i, at.MARTENSITE_FINISH]
        warm = max(warm - 1.0 / wires[i, at.MARTENSITE_SLOPE], 0.0) / wires[i, at.MARTENSITE_SHIFT]
        there, slope = brinson.orients(wires, i, stress - warm)
        new = new if old < new + _ROUNDING else 0.0
    follows = old if wires[i, at.TREND] > 0.0 else new
    grows = is_brinson and stress > wires[i, at.STRESS_BEFORE] and there > old - _EQUAL
    jump, compliance = (xi * (there - old), full * xi * slope) if grows else (0.0, 0.0)
    wires[i, at.STRESS_BEFORE] = stress
    wires[i, at.FOLLOWS], wires[i, at.BEGUN] = follows, xi * (old - follows) + jump
    wires[i, at.DETWINS] = xi * slope if grows else 0.0
    # sigma = E [... - q (sigma - sigma_0)] + ..., solved for sigma.
    change = wires[i, at.MARTENSITE_STIFF] - wires[i, at.AUSTENITE_STIFF]
    modulus = wires[i, at.AUSTENITE_STIFF] + xi * change
    softer = 1.0 / (1.0 + modulus * compliance)
    wires[i, at.MODULUS_CHANGE] = change * softer * softer
    wires[i, at.AUSTENITE_MODULUS] = modulus * softer - xi * wires[i, at.MODULUS_CHANGE]
    wires[i, at.EXPANSION] = wires[i, at.EXPANDS] * softer
    wires[i, at.RECOVERABLE_STRAIN] = full * follows
    return full * (1.0 - follows - wires[i, at.BEGUN]) + compliance * stress


@borrowing
def after_step(wires, i):
    """What of wire i is oriented now."""
    xi, moved = wires[i, at.FRACTION], wires[i, at.STRESS] - wires[i, at.STRESS_BEFORE]
    now = wires[i, at.BEGUN] + wires[i, at.FOLLOWS] * xi + wires[i, at.DETWINS] * moved
    wires[i, at.ORIENTED] = min(max(now, 0.0), xi)


# --- The R-phase, between austenite and martensite: an option of every law, off by default. Of what
# is not martensite a part is R-phase, which is longer than austenite by eps_R:
#
#     xi_R = (1 - xi) sin^2[pi/2 (T_R + w/2 - T + sigma/C_R)/w]
#
# It shows on cooling, before martensite forms, and where A_s lies below T_R on heating too. C_R is
# so steep, and its hysteresis of 1 to 5 K so narrow (left out here), that it moves with T alone.
# Its heat (5 J/g) and resistance are not modelled. Source: Otsuka and Ren 2005. Parameters: eps_R
# (`wire.r_phase_strain`; 0: none), T_R (`wire.r_phase_temperature`), w (`wire.r_phase_range`).

STRESS_INFLUENCE = 16e6  # C_R, Pa/K: 13 to 20 MPa/K


@borrowing
def r_phase_strain(wires, i):
    """Strain by which R-phase lengthens wire i, at the temperature that its step leads to."""
    temperature = wires[i, at.START] + wires[i, at.LAG] * wires[i, at.FRACTION]
    colder = wires[i, at.R_END] - temperature + wires[i, at.STRESS] / STRESS_INFLUENCE
    share = ramp(colder / wires[i, at.R_RANGE])[0]
    return wires[i, at.R_STRAIN] * share * (1.0 - wires[i, at.FRACTION])
