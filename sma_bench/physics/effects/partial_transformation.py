# mypy: disallow-untyped-defs=False, disallow-incomplete-defs=False
"""Kinetics of incomplete loops.

    heating from (T_r, xi_r):  xi = (1 - p) xi_r f(T)/f(T_r) + p xi_r min(1, f(T)/min(f(T_r), xi_r))

and likewise for 1 - xi and g while cooling. p = 0 is the contract's rule, in which a turned loop
starts at once. With p = 1 it stays flat until it meets the full loop: the regions that transformed
last are the first to go back (thermoelastic order; Ortin and Delaey 2002).
"""

from sma_bench.compiled import compiled
from sma_bench.physics import columns as at
from sma_bench.physics.effects.effect import Effect

EFFECT = Effect(
    "partial_transformation",
    "transformation",
    {"memory": at.MEMORY},
    "full loops fit, partial ones do not: deflection lingers or runs ahead after a turn inside "
    "the loop",
    ("deflection",),
)


@compiled
def flat_then_outer(phase, share, share_slope, reversed_share):
    """Phase left by the rule of p = 1, and its slope; all of the arguments are above 0."""
    threshold = min(phase, reversed_share)
    if share >= threshold:
        return phase, 0.0
    return phase * share / threshold, phase * share_slope / threshold
