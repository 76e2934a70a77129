"""Tanaka's law: transformations that start sharply and fade out.

    share = exp[a (position - 1)],   a = ln 40,   1 from position 1 on

in temperatures, on heating and on cooling,

    xi     = exp[-a (T - A_s - sigma/C_A)/(A_f - A_s)]
    1 - xi = exp[-a (M_s - T + sigma/C_M)/(M_s - M_f)]

They start at A_s and M_s; at A_f and M_f 97.5 % is done. The rate of Tanaka's rule is proportional
to the fraction left, so that inner loops follow the contract's rule. Source: Tanaka 1986,
whose ends are at 99 %. No parameters but the four temperatures."""

import math

from sma_bench.compiled import inlined

RATE = math.log(40.0)
ENDS = (1.0 + math.log(1e-6) / RATE, 1.0)  # positions; a millionth is left at the first


@inlined
def ramp(position):
    """Share and slope."""
    if position >= 1.0:
        return 1.0, 0.0
    share = math.exp(RATE * (position - 1.0))
    return share, RATE * share
