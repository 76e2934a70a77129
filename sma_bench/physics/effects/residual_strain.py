"""Part of the recovered strain stays when the wire cools.

    strain of eq. (9) becomes eps_L [(1 - r)(1 - xi) + r m]
    m = max over the past of (1 - xi), less k (m - (1 - xi)) a second

The first heating is the paper's; after it, r of the strain stays at rest, or creeps back at the
rate k. A record that follows another of the same bench may begin with what stayed in that one
(`fresh_start`). Source: two-way memory and incomplete reorientation (detwinning) of the martensite
under too small a load. Laws of which that load decides the strain (brinson, extended) have it by
themselves: it is refused with them."""

import math
from collections.abc import Mapping
from typing import Any

from sma_bench.arrays import Array
from sma_bench.compiled import borrowing
from sma_bench.physics import columns as at

CARRIED_OVER = "carried_over"  # the form that needs a record before
_SIZE, _RATE = "effect.residual_strain.share", "effect.residual_strain.recovery"
FRESH_START = "effect.residual_strain.fresh_start"


def carries_over(parameters: Mapping[str, Any]) -> bool:
    """Whether what a wire did in one record matters in the next one."""
    return bool(parameters[_SIZE] != 0.0 and parameters[FRESH_START] < 1.0)


def carried_over(parameters: Mapping[str, Any], most: Array, pause: float) -> Array:
    """m (w,) at the start of a record, from that at the end of the one before, `pause` s ago."""
    kept: float = (1.0 - parameters[FRESH_START]) * math.exp(-parameters[_RATE] * pause)
    return kept * most


@borrowing
def added_strain(wires, i):
    """Strain of wire i that stays; how much of eps_L still follows xi is set on the way."""
    share, most = wires[i, at.RESIDUAL_SHARE], wires[i, at.MOST_AUSTENITE]
    if wires[i, at.TREND] > 0.0 and 1.0 - wires[i, at.FRACTION] >= most:
        wires[i, at.RECOVERABLE_STRAIN] = wires[i, at.FULL_STRAIN]
        return 0.0
    wires[i, at.RECOVERABLE_STRAIN] = wires[i, at.FULL_STRAIN] * (1.0 - share)
    return wires[i, at.FULL_STRAIN] * share * most


@borrowing
def after_step(wires, i, fraction_before, step):
    """Note how austenitic wire i has been at most, less what has crept back."""
    austenite = 1.0 - wires[i, at.FRACTION]
    beyond = max(wires[i, at.MOST_AUSTENITE] - austenite, 0.0)
    wires[i, at.MOST_AUSTENITE] = austenite + beyond * math.exp(-wires[i, at.RECOVERY] * step)


@borrowing
def passes_most(wires, i):
    """After a solution: let the strain follow xi if wire i is now at its most; whether it did."""
    most = wires[i, at.MOST_AUSTENITE]
    follows = wires[i, at.RECOVERABLE_STRAIN] == wires[i, at.FULL_STRAIN]
    follows = follows or wires[i, at.RESIDUAL_SHARE] == 0.0
    if follows or wires[i, at.TREND] < 0.0 or 1.0 - wires[i, at.GUESS] <= most:
        return False
    wires[i, at.RECOVERABLE_STRAIN] = wires[i, at.FULL_STRAIN]
    wires[i, at.OFFSET] -= wires[i, at.FULL_STRAIN] * wires[i, at.RESIDUAL_SHARE] * most
    return True
