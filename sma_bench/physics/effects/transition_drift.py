"""Transition temperatures that shift from cycle to cycle, and plastic strain with them.

    dT(n) = c [1 - exp(-n/n_0)],    eps_p(n) = p [1 - exp(-n/n_0)],    dn = |dxi|/2

Martensite's two temperatures move by c + c_M.

The temperatures of a branch are those of the cycles done when it began: a transformation does not
move the range that it is in.
Source: functional fatigue of NiTi wires, saturating with the number of transformations.
"""

import math

from sma_bench.compiled import borrowing
from sma_bench.parameters.parameter import Effect, Parameter
from sma_bench.physics import columns as at

EFFECT = Effect(
    "transformation",
    (Parameter("shift", "K", 0.0,
               "Shift of all transition temperatures after many cycles; 0 is off.",
               "assumed: fatigue, up to 10 K", -30.0, 30.0, uncertainty=5.0),
     Parameter("cycles", "1", 3.0,
               "n_0, transformations there and back after which 63 % of the shift is done.",
               "assumed: the first cycles shift most", 0.2, 1000.0, uncertainty=2.0),
     Parameter("plastic_strain", "1", 0.0, "Elongation that grows with the shift.",
               "assumed: up to 0.5 %", -0.02, 0.02, uncertainty=5e-4),
     Parameter("martensite_shift", "K", 0.0,
               "Shift of martensite's temperatures beyond that of all; 0 is off.",
               "assumed: the hysteresis of NiTi narrows as it is trained", -30.0, 30.0,
               uncertainty=5.0)),
    shows="the first cycle fits and later ones do not, or the other way round; repeated drives "
    "differ",
    acts_on=("deflection",), marks=("EVOLVES",),
    forms={"all": ("shift", "cycles", "plastic_strain"),
           "martensite": ("martensite_shift", "cycles", "plastic_strain")},
    columns={"shift": "FINAL_SHIFT", "cycles": "SHIFT_CYCLES", "plastic_strain": "FINAL_PLASTIC",
             "martensite_shift": "MARTENSITE_FINAL_SHIFT"},
    constants=("AUSTENITE_FINISH_FRESH", "MARTENSITE_FINISH_FRESH"),
    state=("CYCLES", "TURNED_CYCLES"),
)


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
