"""Transition temperatures that shift from cycle to cycle, and plastic strain with them.

    dT(n) = c [1 - exp(-n/n_0)],    eps_p(n) = p [1 - exp(-n/n_0)],    dn = |dxi|/2

Martensite's two temperatures move by c + c_M.

The temperatures of a branch are those of the cycles done when it began: a transformation does not
move the range that it is in.
Source: functional fatigue of NiTi wires, saturating with the number of transformations."""

import math

from sma_bench.compiled import borrowing
from sma_bench.physics import columns as at


@borrowing
def _done(wires, i, cycles):
    return 1.0 - math.exp(-cycles / wires[i, at.SHIFT_CYCLES])


@borrowing
def drifts(wires, i):
    """Whether the transformation of wire i shifts."""
    return wires[i, at.FINAL_SHIFT] != 0.0 or wires[i, at.MARTENSITE_FINAL_SHIFT] != 0.0


@borrowing
def shift_transition(wires, i):
    """Shift the transformation of wire i by the cycles that it had made when it last turned."""
    done = _done(wires, i, wires[i, at.TURNED_CYCLES])
    shift = done * wires[i, at.FINAL_SHIFT]
    wires[i, at.AUSTENITE_FINISH] = wires[i, at.AUSTENITE_FINISH_FRESH] + shift
    shift += done * wires[i, at.MARTENSITE_FINAL_SHIFT]
    wires[i, at.MARTENSITE_FINISH] = wires[i, at.MARTENSITE_FINISH_FRESH] + shift


@borrowing
def added_strain(wires, i):
    """Less pull of wire i, by its elongation over the cycles that it has made."""
    if wires[i, at.FINAL_PLASTIC] == 0.0:
        return 0.0
    return -_done(wires, i, wires[i, at.CYCLES]) * wires[i, at.FINAL_PLASTIC]


@borrowing
def after_step(wires, i, fraction_before, step):
    """Count the transformation of wire i in a step."""
    wires[i, at.CYCLES] += 0.5 * abs(wires[i, at.FRACTION] - fraction_before)
