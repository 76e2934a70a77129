"""Part of the recovered strain stays when the wire cools.

    strain of eq. (9) becomes eps_L [(1 - r)(1 - xi) + r m]
    m = largest (1 - xi) so far, which falls at the rate k (m - (1 - xi))

The first heating follows the paper; after it the share r of the strain remains at rest, or recovers
at the rate k. A record that follows another of the same bench may begin with the strain left by it
(`fresh_start`). Source: two-way memory, and martensite that a small load does not fully reorient
(detwin). The laws brinson and extended, whose strain depends on the load, include this: it is
refused with them."""

import math
from collections.abc import Mapping
from typing import Any

from sma_bench.arrays import Array
from sma_bench.compiled import borrowing
from sma_bench.physics import columns as at

CARRIED_OVER = "carried_over"  # the form that needs an earlier record
_SIZE, _RATE = "effect.residual_strain.share", "effect.residual_strain.recovery"
FRESH_START = "effect.residual_strain.fresh_start"


def carries_over(parameters: Mapping[str, Any]) -> bool:
    """True if residual strain from one record is carried over into the next."""
    return bool(parameters[_SIZE] != 0.0 and parameters[FRESH_START] < 1.0)


def carried_over(parameters: Mapping[str, Any], most: Array, pause: float) -> Array:
    """m (w,) at the start of a record, from `most` at the end of the last one, `pause` s ago."""
    kept: float = (1.0 - parameters[FRESH_START]) * math.exp(-parameters[_RATE] * pause)
    return kept * most


@borrowing
def added_strain(wires, i):
    """Residual strain of wire i; sets RECOVERABLE_STRAIN, the part of eps_L that follows xi."""
    share, most = wires[i, at.RESIDUAL_SHARE], wires[i, at.MOST_AUSTENITE]
    if wires[i, at.TREND] > 0.0 and 1.0 - wires[i, at.FRACTION] >= most:
        wires[i, at.RECOVERABLE_STRAIN] = wires[i, at.FULL_STRAIN]
        return 0.0
    wires[i, at.RECOVERABLE_STRAIN] = wires[i, at.FULL_STRAIN] * (1.0 - share)
    return wires[i, at.FULL_STRAIN] * share * most


@borrowing
def after_step(wires, i, fraction_before, step):
    """After a step: update m of wire i."""
    austenite = 1.0 - wires[i, at.FRACTION]
    beyond = max(wires[i, at.MOST_AUSTENITE] - austenite, 0.0)
    wires[i, at.MOST_AUSTENITE] = austenite + beyond * math.exp(-wires[i, at.RECOVERY] * step)


@borrowing
def exceeds_most(wires, i):
    """After a solution: let all strain follow xi if 1 - xi exceeds m; True if that changed it."""
    most = wires[i, at.MOST_AUSTENITE]
    follows = wires[i, at.RECOVERABLE_STRAIN] == wires[i, at.FULL_STRAIN]
    follows = follows or wires[i, at.RESIDUAL_SHARE] == 0.0
    if follows or wires[i, at.TREND] < 0.0 or 1.0 - wires[i, at.GUESS] <= most:
        return False
    wires[i, at.RECOVERABLE_STRAIN] = wires[i, at.FULL_STRAIN]
    wires[i, at.OFFSET] -= wires[i, at.FULL_STRAIN] * wires[i, at.RESIDUAL_SHARE] * most
    return True
