# mypy: disallow-untyped-defs=False, disallow-incomplete-defs=False
"""A step of the core where effects are on: what they do before and after the common solution.

Called for wires and sides that are marked so; all others take the core's shorter way. A side's
regime (wires taut, hanging or pushing; passive wires elastic or yielding) and a wire's (at its most
austenite so far or not) are tried as they were last, and changed where the solution contradicts.
"""

import math
from importlib import import_module

from sma_bench.compiled import borrowing
from sma_bench.parameters.parameter import EFFECTS
from sma_bench.physics import columns as at
from sma_bench.physics.effects.ambient_drift import air_temperature
from sma_bench.physics.effects.matrix_thermal_mass import warm_together
from sma_bench.physics.effects.opposing_wires import (
    give_way,
    look_at_passive,
    resist,
    yield_sign,
)
from sma_bench.physics.effects.phase_dependent_resistance import resistance
from sma_bench.physics.effects.residual_strain import passes_most
from sma_bench.physics.effects.slack import contact
from sma_bench.physics.effects.supply_drop import power
from sma_bench.physics.effects.temperature_dependent_convection import loss
from sma_bench.physics.effects.temperature_lag import follow
from sma_bench.physics.effects.temperature_underfill import spot_temperature
from sma_bench.physics.effects.viscoelastic_matrix import relax, relaxing
from sma_bench.physics.kinetics import close_loops

PLACES = 6  # a compiled function cannot go through a list of others: it names so many


def of_effects(place, nothing):
    """PLACES functions: those called `place` of all effects, then `nothing`."""
    modules = [import_module(f"{EFFECTS_PACKAGE}.{name}") for name in sorted(EFFECTS)]
    found = [getattr(module, place) for module in modules if hasattr(module, place)]
    if len(found) > PLACES:
        raise ImportError(f"{len(found)} effects with {place}, expected at most {PLACES}")
    return (*found, *[nothing] * (PLACES - len(found)))


@borrowing
def no_strain(wires, i):
    """No effect."""
    return 0.0


@borrowing
def no_change(wires, i, fraction_before, step):
    """No effect."""


EFFECTS_PACKAGE = "sma_bench.physics.effects"
strain_1, strain_2, strain_3, strain_4, strain_5, strain_6 = of_effects("added_strain", no_strain)
change_1, change_2, change_3, change_4, change_5, change_6 = of_effects("after_step", no_change)


@borrowing
def added_strain(wires, i):
    """Strain of wire i that all effects add to the contract's."""
    first = strain_1(wires, i) + strain_2(wires, i) + strain_3(wires, i)
    return first + strain_4(wires, i) + strain_5(wires, i) + strain_6(wires, i)


@borrowing
def after_step(wires, i, fraction_before, step):
    """What all effects hand to the next step."""
    change_1(wires, i, fraction_before, step)
    change_2(wires, i, fraction_before, step)
    change_3(wires, i, fraction_before, step)
    change_4(wires, i, fraction_before, step)
    change_5(wires, i, fraction_before, step)
    change_6(wires, i, fraction_before, step)


@borrowing
def heat_balance(wires, i, voltage, step):
    """Steady temperature [K] of wire i with its surroundings held; sets its decay and lag."""
    air = air_temperature(wires, i)
    heating = power(wires, i, voltage, resistance(wires, i))
    if wires[i, at.MATRIX_CAPACITY] > 0.0:
        surface = wires[i, at.MATRIX_RISE] + wires[i, at.AMBIENT]
        return warm_together(wires, i, heating, loss(wires, i, surface - air), air, step)
    conductance = loss(wires, i, wires[i, at.TEMPERATURE] - air)
    total = conductance + wires[i, at.ACROSS]
    exponent = -step * total / wires[i, at.CAPACITY]
    wires[i, at.DECAY] = math.exp(exponent)
    wires[i, at.LAG] = wires[i, at.LATENT_RISE] * math.expm1(exponent) / exponent
    return (heating + conductance * air + wires[i, at.ACROSS] * wires[i, at.OPPOSITE]) / total


@borrowing
def set_strain(wires, i):
    """Strain of wire i beyond the contract's, for the step to come."""
    wires[i, at.OFFSET] = wires[i, at.PRESTRETCH] + added_strain(wires, i)


@borrowing
def prepare_side(wires, sides, side, step):
    """What a side pulls against in the step to come, in the regime that it was last in."""
    sides[side, at.MATRIX_STIFFNESS] = sides[side, at.OWN_STIFFNESS]
    sides[side, at.MATRIX_LOAD] = sides[side, at.OWN_LOAD]
    if sides[side, at.RELAXATION] > 0.0:
        relaxing(sides, side, step)
        sides[side, at.MATRIX_STIFFNESS] += sides[side, at.RELAXING_STIFFNESS]
        sides[side, at.MATRIX_LOAD] += sides[side, at.RELAXING_LOAD]
    if sides[side, at.ENGAGEMENT] > 0.0:
        look_at_passive(wires, sides, side)
    set_regime(sides, side)


@borrowing
def set_regime(sides, side):
    """Stiffness and load of the beam in this regime, and of what the wires feel of it."""
    stiffness, load = sides[side, at.MATRIX_STIFFNESS], sides[side, at.MATRIX_LOAD]
    if sides[side, at.ENGAGEMENT] > 0.0:
        passive_stiffness, passive_load = resist(sides, side)
        stiffness += passive_stiffness
        load -= passive_load
    sides[side, at.BEAM_STIFFNESS], sides[side, at.BEAM_LOAD] = stiffness, load
    if sides[side, at.SLACK] > 0.0:
        if sides[side, at.TAUT] == 0.0:
            stiffness, load = 0.0, 0.0
        elif sides[side, at.TAUT] > 0.0:
            load -= stiffness * sides[side, at.SLACK]
    sides[side, at.STIFFNESS], sides[side, at.LOAD] = stiffness, load


@borrowing
def bending(sides, side):
    """Bending of a side's beam at its present contraction and regime."""
    if sides[side, at.SLACK] > 0.0:
        if sides[side, at.TAUT] == 0.0:
            return -sides[side, at.BEAM_LOAD] / sides[side, at.BEAM_STIFFNESS]
        if sides[side, at.TAUT] > 0.0:
            return sides[side, at.CONTRACTION] - sides[side, at.SLACK]
    return sides[side, at.CONTRACTION]


@borrowing
def change_regime(wires, sides, side):
    """After a solution: take another regime where it contradicts this one; whether it did."""
    changed = False
    for i in range(wires.shape[0]):
        mine = wires[i, at.SIDE] == side or sides[side, at.COUPLED] > 0.0
        if mine and passes_most(wires, i):
            changed = True
    if changed or sides[side, at.PRESCRIBED] > 0.0:
        return changed
    if sides[side, at.ENGAGEMENT] > 0.0:
        sign = yield_sign(sides, side, bending(sides, side))
        if sign != sides[side, at.YIELDING]:
            sides[side, at.YIELDING] = sign
            set_regime(sides, side)
            return True
    if sides[side, at.SLACK] > 0.0:
        taut = contact(sides, side)
        if taut != sides[side, at.TAUT]:
            sides[side, at.TAUT] = taut
            set_regime(sides, side)
            return True
    return False


@borrowing
def finish_side(sides, side):
    """Bending of a side after a step, and what relaxes and detwins with it."""
    bent = bending(sides, side)
    if sides[side, at.ENGAGEMENT] > 0.0:
        sides[side, at.PASSIVE_BENDING] = give_way(sides, side, bent)
        bent += sides[side, at.ENGAGEMENT] * sides[side, at.PASSIVE_BENDING]
    if sides[side, at.RELAXATION] > 0.0:
        relax(sides, side, bent)
    sides[side, at.BENDING] = bent - sides[side, at.PASSIVE_BENDING]


@borrowing
def finish_wire(wires, i, fraction_before, step):
    """Silicone, cycles and reading of wire i after a step."""
    if wires[i, at.RETURN_POINT] != 0.0:
        close_loops(wires, i)
    after_step(wires, i, fraction_before, step)
    if wires[i, at.READ_OTHERWISE] > 0.0:
        seen = see(wires, i)
        wires[i, at.READING] = follow(
            wires[i, at.READING], wires[i, at.SEEN], seen, step, wires[i, at.READING_LAG]
        )
        wires[i, at.SEEN] = seen
    else:
        wires[i, at.READING] = wires[i, at.TEMPERATURE]


@borrowing
def see(wires, i):
    """Temperature [K] that a spot on wire i and its background look like."""
    background = air_temperature(wires, i)
    if wires[i, at.MATRIX_CAPACITY] > 0.0:
        background = wires[i, at.MATRIX_RISE] + wires[i, at.AMBIENT]
    return spot_temperature(wires, i, background)
