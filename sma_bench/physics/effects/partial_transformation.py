"""Kinetics of incomplete loops.

Grains that transform early on heating do so late on cooling: the last to transform is the first to
transform back (thermoelastic order; Ortin and Delaey 2002). On heating from (T_r, xi_r), with f the
ramp of the full loop and f_r = f(T_r) > xi_r,

    xi = f_r C(xi_r/f_r, f(T)/f_r),    C(u, v) = 2 q u v/(s + sqrt[s^2 - 4 q (q - 1) u v])
    s = 1 + (q - 1) (u + v),           q = (1 + p)/(1 - p)

and likewise for 1 - xi and g on cooling. C is the share of grains below u in one order and below v
in the other, with the odds ratio q between the orders (Plackett 1965). p = 0 is the contract's rule
xi = xi_r f/f_r, where xi changes at once after a reversal. With p = 1 (`memory`) it stays constant
until it meets the full loop.

With `return_point` m the straight line of xi over f aims at m times the last but one reversal
(xi_b, f_b) instead of the origin: for m = 1 an inner loop closes where it was opened, is then
forgotten, and the outer loop continues (return-point memory; Mayergoyz 1986):

    xi = m xi_b + (xi_r - m xi_b) (f(T) - m f_b)/(f_r - m f_b)       down to f_b

It is refused with `wire.law` normal, which has its own inner loops."""

import math

from sma_bench.compiled import borrowing, inlined
from sma_bench.physics import columns as at

TINY = 1e-12  # of a share: shorter lines count as points
ROUNDED = 1e-3  # least 1 - p: q is infinite at p = 1
TURN_DEPTH = 6  # reversals that are remembered, each as xi, f, g


@inlined
def left_of_grains(phase, share, reversed_share, memory):
    """Phase left by the rule with p, and its slope in `share`. `reversed_share` is above 0."""
    if phase >= reversed_share:
        slope = phase / reversed_share
        return share * slope, slope
    u, v = phase / reversed_share, share / reversed_share
    rest = max(1.0 - memory, ROUNDED)
    excess = 2.0 * (1.0 - rest) / rest  # q - 1
    if v > 1.0:  # stress has moved the ramp back: extend it linearly
        by_v = u / (1.0 + excess * (1.0 - u))
        return reversed_share * (u + (v - 1.0) * by_v), by_v
    odds, s = 1.0 + excess, 1.0 + excess * (u + v)
    root = math.sqrt(1.0 + 2.0 * excess * (u + v - 2.0 * u * v) + (excess * (u - v)) ** 2)
    by_v = 0.5 * (1.0 - (s - 2.0 * odds * u) / root)
    return reversed_share * (2.0 * odds * u * v / (s + root)), by_v


@borrowing
def remember_turn(wires, i, f, g):
    """Store a reversal; if there are too many nested loops, forget the innermost."""
    count = int(wires[i, at.TURNS])
    if count == TURN_DEPTH:
        count -= 2
    first = at.TURN_STATES + 3 * count
    wires[i, first], wires[i, first + 1], wires[i, first + 2] = wires[i, at.FRACTION], f, g
    wires[i, at.TURNS] = count + 1


@borrowing
def loop_of(wires, i, share):
    """Number of reversals still open at `share` of its ramp; start of the line (phase, share)."""
    rising, count = wires[i, at.TREND] > 0.0, int(wires[i, at.TURNS])
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
    """Phase and share of the ramp that a line aims at when `count` reversals are open."""
    if count < 2:
        return 0.0, 0.0
    state = at.TURN_STATES + 3 * (count - 2)
    phase, share = wires[i, state], wires[i, state + 1]
    if wires[i, at.TREND] <= 0.0:
        phase, share = 1.0 - phase, wires[i, state + 2]
    return wires[i, at.RETURN_POINT] * phase, wires[i, at.RETURN_POINT] * share


@borrowing
def towards_turn(wires, i, share, share_slope):
    """Phase left on the line to the point where the loop was opened, and its slope."""
    count, phase, begin = loop_of(wires, i, share)
    aim, aim_share = aim_of(wires, i, count)
    if begin - aim_share <= TINY:
        return phase, 0.0
    slope = (phase - aim) / (begin - aim_share)
    left = aim + slope * (share - aim_share)
    return (0.0, 0.0) if left < 0.0 else (left, slope * share_slope)


@borrowing
def forget_closed(wires, i, share):
    """After a step: forget the loops that the wire has left."""
    count, phase, begin = loop_of(wires, i, share)
    wires[i, at.TURNS] = count
    wires[i, at.PHASE_REVERSED], wires[i, at.OWN_REVERSED] = phase, begin
