"""Silicone that relaxes: a standard linear solid, or one with a spread of times.

    sum sigma_i = K e + nu K (e - q),    dq/dt = (e - q)/tau

K is the permanent stiffness (the paper's beta alpha), nu K the part that relaxes. With a spread of
times there are two such parts, half of nu K each, with tau/8 and 8 tau, as in a power law.
Source: Zener's three-parameter solid and Prony's series, solved for an e that is linear over a
step."""

import math

from sma_bench.compiled import borrowing
from sma_bench.physics import columns as at

APART = 8.0  # ratio of the times of a spread to tau


@borrowing
def term(sides, side, k, step):
    """Of relaxing part k (0: the single one, 1: fast, 2: slow) the stiffness S [Pa], and share and
    rest in e - q = share (e - e_before) + rest at the end of the step."""
    stiffness, times = sides[side, at.RELAXATION], 1.0
    if k > 0:
        stiffness, times = 0.5 * sides[side, at.SPREAD_RELAXATION], APART if k > 1 else 1.0 / APART
    exponent = -step / (times * sides[side, at.RELAXATION_TIME])
    rest = math.exp(exponent) * (sides[side, at.RELAXING_FROM] - sides[side, at.RELAXED + k])
    return stiffness * sides[side, at.OWN_STIFFNESS], math.expm1(exponent) / exponent, rest


@borrowing
def relaxing(sides, side, step):
    """Set the stiffness and load of the relaxing parts for the end of a step."""
    before = sides[side, at.BENDING] + sides[side, at.PASSIVE_BENDING]
    sides[side, at.RELAXING_FROM] = before
    sides[side, at.RELAXING_STIFFNESS], sides[side, at.RELAXING_LOAD] = 0.0, 0.0
    for k in range(3):
        stiffness, share, rest = term(sides, side, k, step)
        sides[side, at.RELAXING_STIFFNESS] += stiffness * share
        sides[side, at.RELAXING_LOAD] += stiffness * (rest - share * before)


@borrowing
def relax(sides, side, bent, step):
    """Advance q of all parts to the end of a step, where the side bends by `bent`."""
    for k in range(3):
        _, share, rest = term(sides, side, k, step)
        sides[side, at.RELAXED + k] = bent - rest - share * (bent - sides[side, at.RELAXING_FROM])
