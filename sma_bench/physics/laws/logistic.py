"""Logistic branches, smooth at both ends, with Duhem's rule for turning.

    share = 1/(1 + exp[-2 a (position - 1/2)]),   a = ln 39

A_s, A_f, M_s, M_f are the points at which 2.5 and 97.5 % are done. Inner loops follow Duhem's
rule: the rate along a branch is proportional to the fraction left of the vanishing phase,

    dxi = xi d(ln f)   while T rises,      d(1 - xi) = (1 - xi) d(ln g)   while it falls

which is the contract's rule. Source: logistic branches Ikuta et al. 1991, Duhem's rule for wires
Dutta and Ghorbel 2005. No parameters but the four temperatures."""

import math

from sma_bench.compiled import inlined

STEEPNESS = 2.0 * math.log(39.0)
ENDS = (0.5 + math.log(1e-6) / STEEPNESS, 0.5 - math.log(1e-6) / STEEPNESS)  # but for a millionth


@inlined
def ramp(position):
    """Share and slope."""
    share = 1.0 / (1.0 + math.exp(-STEEPNESS * (position - 0.5)))
    return share, STEEPNESS * share * (1.0 - share)
