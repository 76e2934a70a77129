"""Tanaka's law: transformations that start sharply and fade out.

    share = exp[a (position - 1)],   a = ln 40,   1 from position 1 on

in temperatures, on heating and on cooling,

    xi     = exp[-a (T - A_s - sigma/C_A)/(A_f - A_s)]
    1 - xi = exp[-a (M_s - T + sigma/C_M)/(M_s - M_f)]

A_s and M_s are where they start, A_f and M_f where 97.5 % is done. The rate of Tanaka's rule is in
proportion to what is left, so that an inner loop follows the contract's rule. Source: Tanaka 1986,
whose ends are at 99 %. No parameters but the four temperatures."""

import math

from sma_bench.compiled import inlined

UNDONE = 0.025  # share where the transformation is said to end
RATE = math.log(40.0)
_LEAST = 1e-6  # of a share whose position is asked for


@inlined
def ramp(position):
    """Share and slope."""
    if position >= 1.0:
        return 1.0, 0.0
    share = math.exp(RATE * (position - 1.0))
    return share, RATE * share


def position(share: float) -> float:
    """Inverse of `ramp`; of nearly nothing that of a millionth."""
    return 1.0 + math.log(max(share, _LEAST)) / RATE
