"""Silicone that relaxes: a standard linear solid.

    sum sigma_i = K e + nu K (e - q),    dq/dt = (e - q)/tau

K is the stiffness that stays (the paper's beta alpha), nu K the part that relaxes.
Source: Zener's three-parameter solid, solved for an e that goes straight over a step.
"""

import math

from sma_bench.compiled import borrowing
from sma_bench.parameters.parameter import Effect, Parameter
from sma_bench.physics import columns as at

EFFECT = Effect(
    "mechanical",
    (Parameter("relaxation", "1", 0.0,
               "Stiffness that relaxes over the stiffness that stays; 0 is off.",
               "assumed: 5 to 20 % of silicones", 0.0, 3.0, uncertainty=0.2),
     Parameter("time_constant", "s", 20.0, "Time constant of the relaxation.",
               "assumed: 1 to 300 s", 0.2, 2000.0, uncertainty=15.0)),
    shows="deflection creeps on under constant temperature and comes back slowly at rest, to zero",
    acts_on=("deflection",), loads=("beam",), marks=("PULLS_OTHERWISE",), row="side",
    columns={"relaxation": "RELAXATION", "time_constant": "RELAXATION_TIME"}, state=("RELAXED",),
    scratch=("RELAXING_STIFFNESS", "RELAXING_LOAD"),
)


@borrowing
def relaxing(sides, side, step):
    """Note stiffness and load of the relaxing part at the end of a step."""
    exponent = -step / sides[side, at.RELAXATION_TIME]
    stiffness = sides[side, at.RELAXATION] * sides[side, at.OWN_STIFFNESS]
    share = math.expm1(exponent) / exponent
    before = sides[side, at.BENDING] + sides[side, at.PASSIVE_BENDING]
    left = math.exp(exponent) * (before - sides[side, at.RELAXED])
    sides[side, at.RELAXING_STIFFNESS] = stiffness * share
    sides[side, at.RELAXING_LOAD] = stiffness * (left - share * before)


@borrowing
def relax(sides, side, bent):
    """Advance q to the end of a step, where the side bends by `bent`."""
    force = sides[side, at.RELAXING_STIFFNESS] * bent + sides[side, at.RELAXING_LOAD]
    stiffness = sides[side, at.RELAXATION] * sides[side, at.OWN_STIFFNESS]
    sides[side, at.RELAXED] = bent - force / stiffness
