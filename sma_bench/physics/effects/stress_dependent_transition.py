"""Stress shifts the transformation by more or less than the parameters say.

    shifts of f, g: sigma (1/C_A + a), sigma (1/C_M + b),    each bracket at least 0
    or u/C_A, u/C_M,    u = sigma + r [(sigma^2 + sigma_k^2)^(1/2) - sigma_k],  sigma > 0

The first are straight lines of another slope; the second are bent, with slope 1/C near zero stress
and (1 + r)/C far above sigma_k. With a slope below 0 a clamped wire would transform in one jump.
Source: Clausius and Clapeyron, eqs. (10), (11) with C_A, C_M that are wrong or missing; lines that
start at a critical stress: Brinson 1993."""

import math

from sma_bench.compiled import inlined
from sma_bench.physics import columns as at


@inlined
def bent(wires, i, stress):
    """u of wire i [Pa], and its slope."""
    if wires[i, at.BEND] == 0.0 or stress <= 0.0:
        return stress, 1.0
    knee = wires[i, at.BEND_STRESS]
    root = math.sqrt(stress * stress + knee * knee)
    return stress + wires[i, at.BEND] * (root - knee), 1.0 + wires[i, at.BEND] * stress / root
