# mypy: disallow-untyped-defs=False, disallow-incomplete-defs=False
"""Transition temperatures that shift from cycle to cycle, and plastic strain with them.

    dT(n) = c [1 - exp(-n/n_0)],    eps_p(n) = p [1 - exp(-n/n_0)],    dn = |dxi|/2

The temperatures of a branch are those of the cycles done when it began: a transformation does not
move the range that it is in.
Source: functional fatigue of NiTi wires, saturating with the number of transformations.
"""

import math

from sma_bench.compiled import borrowing
from sma_bench.physics import columns as at
from sma_bench.physics.effects.effect import Effect

EFFECT = Effect(
    "transition_drift",
    "transformation",
    {
        "shift": at.FINAL_SHIFT,
        "cycles": at.SHIFT_CYCLES,
        "plastic_strain": at.FINAL_PLASTIC,
    },
    "the first cycle fits and later ones do not, or the other way round; repeated drives differ",
    ("deflection",),
)


@borrowing
def _done(wires, i, cycles):
    return 1.0 - math.exp(-cycles / wires[i, at.SHIFT_CYCLES])


@borrowing
def shift_transition(wires, i):
    """Shift the transformation of wire i by the cycles that it had made when it last turned."""
    shift = _done(wires, i, wires[i, at.TURNED_CYCLES]) * wires[i, at.FINAL_SHIFT]
    wires[i, at.AUSTENITE_FINISH] = wires[i, at.AUSTENITE_FINISH_FRESH] + shift
    wires[i, at.MARTENSITE_FINISH] = wires[i, at.MARTENSITE_FINISH_FRESH] + shift


@borrowing
def plastic_strain(wires, i):
    """Elongation of wire i by the cycles that it has made."""
    if wires[i, at.FINAL_PLASTIC] == 0.0:
        return 0.0
    return _done(wires, i, wires[i, at.CYCLES]) * wires[i, at.FINAL_PLASTIC]
