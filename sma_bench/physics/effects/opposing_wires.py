"""Bending stretches the passive side's wires, which resist and detwin; or they rub in channels.

A wire feels its own side's bending u and the share k of the other's: e = u - k u_o. The passive
side o does not contract itself; it is pulled along until its wires' force F balances its beam:

    F = K_o u_o = S (k u - p - u_o) = S' (k e - p),    S' = K_o S/(K_o + (1 - k^2) S)
    |F - n H p| <= n sigma_d,    S = sum of E_j(xi_j) over its n wires
    sum sigma_i = K u = K e + k (K/K_o) F,    bending towards this side: u - u_o

Beyond sigma_d the martensite detwins along a plateau of slope H: its stretch p grows, and remains
until that side is heated, when p falls with xi_j.
Wires that are buckled at rest resist only after a bending g has straightened them: e - g replaces
e, and F = 0 while k (e - g) < p.
Friction of wires in their channels changes the sum of stresses by +- sigma_f, as on a slider.
Source: balance of both sides; Coulomb's friction; plasticity with linear kinematic hardening, H of
NiTi from Brinson (1993), whose martensite detwins from 100 to 170 MPa over a strain of 0.067."""

from sma_bench.compiled import borrowing
from sma_bench.physics import columns as at

HARDENING = (170e6 - 100e6) / 0.067  # Pa
LOOSE = 2.0  # value of YIELDING if buckled; 0: elastic, -1 or 1: yields that way


@borrowing
def set_passive(wires, sides, side):
    """Set S', n sigma_d and n H of the wires opposite; reduce p if these recover."""
    modulus, fraction, count = 0.0, 0.0, 0
    for j in range(wires.shape[0]):
        if int(wires[j, at.SIDE]) != side:
            xi = wires[j, at.FRACTION]
            stiff = wires[j, at.AUSTENITE_STIFF]  # not the moduli that a law sets for one step
            modulus += stiff + xi * (wires[j, at.MARTENSITE_STIFF] - stiff)
            fraction += xi
            count += 1
    if count > 0:
        fraction /= count
        before = sides[side, at.PASSIVE_FRACTION]
        if fraction < before:
            sides[side, at.DETWINNED] *= fraction / before
        sides[side, at.PASSIVE_FRACTION] = fraction
    beam, give = passive_beam(sides, side), 1.0 - sides[side, at.ENGAGEMENT] ** 2
    sides[side, at.PASSIVE_MODULUS] = beam * modulus / (beam + give * modulus)
    sides[side, at.PASSIVE_LIMIT] = count * sides[side, at.DETWINNING_STRESS]
    sides[side, at.PASSIVE_HARDENING] = count * HARDENING


@borrowing
def passive_beam(sides, side):
    """K_o [Pa]."""
    return sides[sides.shape[0] - 1 - side, at.OWN_STIFFNESS]


@borrowing
def felt_of(sides, side, contraction):
    """Stretch of the passive wires: k e, or k (e - g)."""
    return sides[side, at.ENGAGEMENT] * (contraction - sides[side, at.GAP])


@borrowing
def passive_force(sides, side, felt):
    """F [Pa] of the passive wires at the stretch `felt`, in the present regime."""
    if sides[side, at.YIELDING] == LOOSE:
        return 0.0
    modulus, hardening = sides[side, at.PASSIVE_MODULUS], sides[side, at.PASSIVE_HARDENING]
    if sides[side, at.YIELDING] == 0.0:
        return modulus * (felt - sides[side, at.DETWINNED])
    limit = sides[side, at.YIELDING] * sides[side, at.PASSIVE_LIMIT]
    return modulus / (modulus + hardening) * (hardening * felt + limit)


@borrowing
def resist(sides, side):
    """Stiffness and load [Pa] of their resistance: k (K/K_o) F = stiffness e - load."""
    share = sides[side, at.MATRIX_STIFFNESS] / passive_beam(sides, side)
    share *= sides[side, at.ENGAGEMENT]
    at_rest = passive_force(sides, side, felt_of(sides, side, 0.0))
    strained = passive_force(sides, side, felt_of(sides, side, 1.0))
    return share * (strained - at_rest), -share * at_rest


@borrowing
def stretch(sides, side, felt):
    """p of the passive wires at the stretch `felt`."""
    if sides[side, at.YIELDING] == 0.0 or sides[side, at.YIELDING] == LOOSE:
        return sides[side, at.DETWINNED]
    return felt - passive_force(sides, side, felt) / sides[side, at.PASSIVE_MODULUS]


@borrowing
def yield_sign(sides, side, contraction):
    """YIELDING that is consistent with e: 0 elastic, LOOSE buckled, else a sign."""
    if sides[side, at.PASSIVE_MODULUS] <= 0.0:
        return 0.0
    felt = felt_of(sides, side, contraction)
    yielding, left = sides[side, at.YIELDING], sides[side, at.DETWINNED]
    if sides[side, at.GAP] > 0.0 and felt < left:
        return LOOSE
    if yielding == LOOSE:
        return 0.0
    if yielding != 0.0:
        return yielding if (stretch(sides, side, felt) - left) * yielding >= 0.0 else 0.0
    beyond = passive_force(sides, side, felt) - sides[side, at.PASSIVE_HARDENING] * left
    if abs(beyond) <= sides[side, at.PASSIVE_LIMIT]:
        return 0.0
    return 1.0 if beyond > 0.0 else -1.0


@borrowing
def give_way(sides, side, contraction):
    """After a step with e = `contraction`: update p; returns the passive side's bending u_o."""
    if sides[side, at.PASSIVE_MODULUS] <= 0.0:
        return 0.0
    felt = felt_of(sides, side, contraction)
    force = passive_force(sides, side, felt)
    sides[side, at.DETWINNED] = stretch(sides, side, felt)
    return force / passive_beam(sides, side)
