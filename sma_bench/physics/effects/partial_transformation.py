# mypy: disallow-untyped-defs=False, disallow-incomplete-defs=False
"""Kinetics of incomplete loops.

    heating from (T_r, xi_r):  xi = (1 - p) xi_r f(T)/f(T_r) + p xi_r min(1, f(T)/min(f(T_r), xi_r))

and likewise for 1 - xi and g while cooling. p = 0 is the contract's rule, in which a turned loop
starts at once. With p = 1 it stays flat until it meets the full loop: the regions that transformed
last are the first to go back (thermoelastic order; Ortin and Delaey 2002).

With `return_point` m the straight line of xi over f aims at m times the last but one reversal
(xi_b, f_b) instead of the origin, so that for m = 1 an inner loop closes where it was opened, is
then forgotten, and the outer one goes on (return-point memory; Mayergoyz 1986):

    xi = m xi_b + (xi_r - m xi_b) (f(T) - m f_b)/(f_r - m f_b)       down to f_b
"""

from sma_bench.compiled import borrowing
from sma_bench.parameters.effect_table import Effect
from sma_bench.parameters.parameter import Parameter
from sma_bench.physics import columns as at

TINY = 1e-12
TURN_DEPTH = 6  # reversals that are remembered, each as xi, f, g

EFFECT = Effect(
    "partial_transformation",
    "transformation",
    (
        Parameter(
            "effect.partial_transformation.memory", "1", 0.0,
            "0: loops start at once where they are turned (contract); 1: they stay flat until they "
            "meet the full loop.",
            "assumed: between the two", -0.5, 1.0, uncertainty=0.4,
        ),
        Parameter(
            "effect.partial_transformation.return_point", "1", 0.0,
            "0: inner loops run on to the origin (contract); 1: they close where they were opened.",
            "assumed: between the two", 0.0, 1.0, uncertainty=0.4,
        ),
    ),
    shows=(
        "full loops fit, partial ones do not: deflection lingers or runs ahead after a turn inside "
        "the loop"
    ),
    acts_on=("deflection",),
    marks=("EVOLVES",),
    columns={"memory": "MEMORY", "return_point": "RETURN_POINT"},
    state=(
        "TURNS",
        "TURN_STATES", "TURN_STATES", "TURN_STATES", "TURN_STATES", "TURN_STATES", "TURN_STATES",
        "TURN_STATES", "TURN_STATES", "TURN_STATES", "TURN_STATES", "TURN_STATES", "TURN_STATES",
        "TURN_STATES", "TURN_STATES", "TURN_STATES", "TURN_STATES", "TURN_STATES", "TURN_STATES",
    ),  # fmt: skip
    carried=("memory",),
)


@borrowing
def flat_then_outer(phase, share, share_slope, reversed_share):
    """Phase left by the rule of p = 1, and its slope; all of the arguments are above 0."""
    threshold = min(phase, reversed_share)
    if share >= threshold:
        return phase, 0.0
    return phase * share / threshold, phase * share_slope / threshold


@borrowing
def remember_turn(wires, i, f, g):
    """Note a reversal; when too many loops lie within each other the innermost is forgotten."""
    count = int(wires[i, at.TURNS])
    if count == TURN_DEPTH:
        count -= 2
    first = at.TURN_STATES + 3 * count
    wires[i, first], wires[i, first + 1], wires[i, first + 2] = wires[i, at.FRACTION], f, g
    wires[i, at.TURNS] = count + 1


@borrowing
def loop_of(wires, i, share):
    """The loop in which `share` of the own ramp lies: reversals that remain, and the line's start
    (phase, share)."""
    rising = wires[i, at.TREND] > 0.0
    count = int(wires[i, at.TURNS])
    phase, begin = wires[i, at.PHASE_REVERSED], wires[i, at.OWN_REVERSED]
    while count >= 2:
        end = wires[i, at.TURN_STATES + 3 * (count - 2) + (1 if rising else 2)]
        if share >= end:
            break
        aim, aim_share = aim_of(wires, i, count)
        if begin - aim_share > TINY:
            phase = aim + (phase - aim) * (end - aim_share) / (begin - aim_share)
        begin = end
        count -= 2
    return count, phase, begin


@borrowing
def aim_of(wires, i, count):
    """Phase and share of the own ramp that a line aims at while `count` reversals are known."""
    if count < 2:
        return 0.0, 0.0
    state = at.TURN_STATES + 3 * (count - 2)
    rising = wires[i, at.TREND] > 0.0
    phase = wires[i, state] if rising else 1.0 - wires[i, state]
    share = wires[i, state + 1] if rising else wires[i, state + 2]
    return wires[i, at.RETURN_POINT] * phase, wires[i, at.RETURN_POINT] * share


@borrowing
def towards_turn(wires, i, share, share_slope):
    """Phase left on the line to where the loop was opened, and its slope."""
    count, phase, begin = loop_of(wires, i, share)
    aim, aim_share = aim_of(wires, i, count)
    if begin - aim_share <= TINY:
        return phase, 0.0
    slope = (phase - aim) / (begin - aim_share)
    left = aim + slope * (share - aim_share)
    if left < 0.0:
        return 0.0, 0.0
    return left, slope * share_slope


@borrowing
def forget_closed(wires, i, share):
    """After a step: loops that the wire has run out of are forgotten."""
    count, phase, begin = loop_of(wires, i, share)
    wires[i, at.TURNS] = count
    wires[i, at.PHASE_REVERSED], wires[i, at.OWN_REVERSED] = phase, begin
