"""Transition temperatures that shift from cycle to cycle, and plastic strain with them.

    dT(n) = c [1 - exp(-n/n_0)],    eps_p(n) = p [1 - exp(-n/n_0)],    dn = |dxi|/2

Martensite's two temperatures shift by c + c_M.

A branch keeps the temperatures of the cycles done when it began: a transformation does not move its
own range.
Source: functional fatigue of NiTi wires, saturating with the number of transformations."""

import math

from sma_bench.compiled import borrowing
from sma_bench.physics import columns as at


@borrowing
def _done(wires, i, cycles):
    return 1.0 - math.exp(-cycles / wires[i, at.SHIFT_CYCLES])


@borrowing
def drifts(wires, i):
    """True if the transformation temperatures of wire i shift."""
    return wires[i, at.FINAL_SHIFT] != 0.0 or wires[i, at.MARTENSITE_FINAL_SHIFT] != 0.0


@borrowing
def shift_transition(wires, i):
    """Shift the temperatures of wire i by its cycles up to the last reversal."""
    done = _done(wires, i, wires[i, at.TURNED_CYCLES])
    shift = done * wires[i, at.FINAL_SHIFT]
    wires[i, at.AUSTENITE_FINISH] = wires[i, at.AUSTENITE_FINISH_FRESH] + shift
    shift += done * wires[i, at.MARTENSITE_FINAL_SHIFT]
    wires[i, at.MARTENSITE_FINISH] = wires[i, at.MARTENSITE_FINISH_FRESH] + shift


@borrowing
def added_strain(wires, i):
    """Strain added to wire i: minus its plastic elongation over its cycles so far."""
    if wires[i, at.FINAL_PLASTIC] == 0.0:
        return 0.0
    return -_done(wires, i, wires[i, at.CYCLES]) * wires[i, at.FINAL_PLASTIC]


@borrowing
def after_step(wires, i, fraction_before, step):
    """After a step: add its transformation to the cycles of wire i."""
    wires[i, at.CYCLES] += 0.5 * abs(wires[i, at.FRACTION] - fraction_before)
