# mypy: disallow-untyped-defs=False, disallow-incomplete-defs=False
"""Silicone that relaxes: a standard linear solid.

    sum sigma_i = K e + nu K (e - q),    dq/dt = (e - q)/tau

K is the stiffness that stays (the paper's beta alpha), nu K the part that relaxes.
Source: Zener's three-parameter solid, solved for an e that goes straight over a step.
"""

import math

from sma_bench.compiled import borrowing
from sma_bench.physics import columns as at
from sma_bench.physics.effects.effect import Effect

EFFECT = Effect(
    "viscoelastic_matrix",
    "mechanical",
    {"relaxation": at.RELAXATION, "time_constant": at.RELAXATION_TIME},
    "deflection creeps on under constant temperature and comes back slowly at rest, to zero",
    ("deflection",),
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
