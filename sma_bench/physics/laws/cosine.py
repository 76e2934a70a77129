"""The contract's law: two cosines.

    share = sin^2(pi/2 position)

Source: eqs. (10), (11); Liang and Rogers 1990. No parameters but the four temperatures."""

import math

from sma_bench.compiled import inlined

ENDS = (0.0, 1.0)  # positions


@inlined
def ramp(position):
    """sin^2 ramp from 0 to 1 over positions 0 to 1, and its slope."""
    if position <= 0.0:
        return 0.0, 0.0
    if position >= 1.0:
        return 1.0, 0.0
    root = math.sin(0.5 * math.pi * position)
    return root * root, math.pi * root * math.sqrt(1.0 - root * root)
