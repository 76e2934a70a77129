"""Silicone that relaxes: a standard linear solid, or one with a spread of times.

    sum sigma_i = K e + nu K (e - q),    dq/dt = (e - q)/tau

K is the stiffness that stays (the paper's beta alpha), nu K the part that relaxes. Spread: two such
parts, half of it each, with tau/8 and 8 tau, between which a power law's relaxation lies.
Source: Zener's three-parameter solid and Prony's series, solved for an e that goes straight over a
step.
"""

import math

from sma_bench.compiled import borrowing
from sma_bench.parameters.parameter import Effect, Parameter
from sma_bench.physics import columns as at

APART = 8.0  # of the times of a spread, from its middle

EFFECT = Effect(
    "mechanical",
    (Parameter("relaxation", "1", 0.0,
               "Stiffness that relaxes over the stiffness that stays; 0 is off.",
               "assumed: 5 to 20 % of silicones", 0.0, 3.0, uncertainty=0.2),
     Parameter("time_constant", "s", 20.0, "Time constant of the relaxation.",
               "assumed: 1 to 300 s", 0.2, 2000.0, uncertainty=15.0),
     Parameter("spread_relaxation", "1", 0.0,
               "The same of stiffness that relaxes over a spread of times; 0 is off.",
               "assumed: 5 to 20 % of silicones", 0.0, 3.0, uncertainty=0.2)),
    shows="deflection creeps on under constant temperature and comes back slowly at rest, to zero",
    acts_on=("deflection",), loads=("beam",), marks=("PULLS_OTHERWISE",), row="side",
    forms={"one": ("relaxation", "time_constant"),
           "spread": ("spread_relaxation", "time_constant")},
    columns={"relaxation": "RELAXATION", "time_constant": "RELAXATION_TIME",
             "spread_relaxation": "SPREAD_RELAXATION"},
    state=("RELAXED", "RELAXED", "RELAXED"),
    scratch=("RELAXING_FROM", "RELAXING_STIFFNESS", "RELAXING_LOAD"),
)


@borrowing
def term(sides, side, k, step):
    """Of the relaxing parts the one, the fast one or the slow one: stiffness S [Pa], and share and
    rest of e - q at the step's end: e - q = share (e - e_before) + rest."""
    stiffness, times = sides[side, at.RELAXATION], 1.0
    if k > 0:
        stiffness, times = 0.5 * sides[side, at.SPREAD_RELAXATION], APART if k > 1 else 1.0 / APART
    exponent = -step / (times * sides[side, at.RELAXATION_TIME])
    rest = math.exp(exponent) * (sides[side, at.RELAXING_FROM] - sides[side, at.RELAXED + k])
    return stiffness * sides[side, at.OWN_STIFFNESS], math.expm1(exponent) / exponent, rest


@borrowing
def relaxing(sides, side, step):
    """Note stiffness and load of the relaxing parts at the end of a step."""
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
