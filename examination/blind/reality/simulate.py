"""Simulates a world, step by step: voltages in, true values out.

Electricity, heat, phase, equilibrium, tip. Within a step each block uses the previous values of the
others, except phase and stress, which are solved together. Latent heat is an apparent heat capacity
from the transformation in the step before; the error of that is carried as a debt and paid back
over the next steps, so that no heat is lost."""

import math
from collections import namedtuple
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from examination.blind.reality import forms, heat, transformation
from examination.blind.reality.beam import ROWS, balance, beam, pull_at_rest
from examination.blind.reality.forms import Array
from examination.blind.reality.transformation import SMALLEST_MOVE
from examination.blind.reality.world import World
from sma_bench.compiled import borrowing, inlined, warn_if_plain

PAID_BACK = 0.1  # of the owed latent heat, each step
STEEPEST = 0.5  # 1/K, largest transformation per kelvin in an apparent capacity
CURRENT, TEMPERATURE, SURFACE, MARTENSITE, STRESS = 0, 1, 2, 3, 4
QUANTITIES = 5
# Inputs: (n,) s, (n, w) V, (n,) K, (n,) factor, (n - 1,) steps between.
Inputs = namedtuple("Inputs", "time voltage ambient gust steps")
# State of the wires, each (w,): K before and after a step, martensite before it, s driven, full
# loops so far, K drift of the transition, J of latent heat owed, the transformation per kelvin in
# the last step [1/K], V by which the supply sags; K of the reservoirs beside it (w, 3).
Wires = namedtuple("Wires", "before after martensite driven loops shift owed apparent sag beside")
# Scratch arrays: source (2, w) W and J/K; pair (2, 2); strip (5, NODES); beam (ROWS, w).
Scratch = namedtuple("Scratch", "source pair strip beam")
# Constants of a world: ohm and J of latent heat of a wire, K at which another phase may absorb
# some of that; `pairs` (s, 2) are the wires in front and behind of each strip.
Rig = namedtuple("Rig", "features resistance latent aside strip pairs classes ramps beam")


@borrowing
def run(rig, inputs, field, grains, pull, wires, scratch, values, tip):
    """Simulate a record from the given state, which is advanced in place; field (s, NODES) K;
    values (n, QUANTITIES, w) and tip (n,) m are written."""
    reading = 0.0
    for k in range(len(inputs.time)):
        if k > 0:
            parts = inputs.steps[k - 1]
            step = (inputs.time[k] - inputs.time[k - 1]) / parts
            for part in range(parts):
                share = (part + 0.5) / parts
                # Heat [W] into every wire: Joule's, and the latent heat that is still owed.
                for i in range(len(wires.after)):
                    voltage, xi = inputs.voltage[k - 1, i], pull.martensite[i]
                    amperes, joule = heat.current(rig, voltage, wires.after[i], xi,
                                                  wires.driven[i], wires.sag[i])
                    wires.sag[i] = forms.sagged(rig.features, wires.sag[i], amperes, step)
                    if voltage != 0.0:
                        wires.driven[i] += step
                    paid = PAID_BACK * wires.owed[i]
                    wires.owed[i] -= paid
                    scratch.source[0, i] = joule + paid / step
                    if rig.features.reservoir > 0.0:
                        scratch.source[0, i] += forms.from_reservoir(rig.features, wires.beside, i,
                                                                     wires.after[i], step)
                    worth = forms.latent_worth(rig.features, xi)
                    aside = forms.latent_aside(rig.features, wires.after[i], rig.aside)
                    scratch.source[1, i] = rig.latent * (worth * wires.apparent[i] + aside)
                warm(rig, inputs, k - 1, share, field, wires, step, scratch)
                phase(rig, grains, pull, wires, step)
                balance(rig.beam, pull, wires.after, step, scratch.beam)
                aftermath(rig, grains, pull, wires)
                wanted = pull.deflection[0] - pull.deflection[1]
                reading = min(reading, wanted + rig.features.friction)
                reading = max(reading, wanted - rig.features.friction)
        slipped = inputs.time[k] - inputs.time[0] >= rig.features.clamp_slip_time
        tip[k] = reading + (rig.features.clamp_slip if slipped else 0.0)
        report(rig, inputs, k, field, wires, pull, values)


@inlined
def report(rig, inputs, k, field, wires, pull, values):
    for i in range(len(wires.after)):
        values[k, CURRENT, i] = heat.current(rig, inputs.voltage[k, i], wires.after[i],
                                             pull.martensite[i], wires.driven[i], wires.sag[i])[0]
        values[k, TEMPERATURE, i] = wires.after[i]
        values[k, MARTENSITE, i] = pull.martensite[i]
        values[k, STRESS, i] = pull.stress[i]
    for strip in range(len(rig.pairs)):
        for end in range(2):
            cell = field[strip, 0 if end == 0 else heat.NODES - 1]
            values[k, SURFACE, rig.pairs[strip, end]] = heat.surface_temperature(
                rig.strip, cell, inputs.ambient[k], inputs.gust[k])[0]


@inlined
def warm(rig, inputs, k, share, field, wires, step, scratch):
    """Advance every strip, in the air at this share of the way from sample k to the next."""
    air = inputs.ambient[k] * (1.0 - share) + inputs.ambient[k + 1] * share
    gust = inputs.gust[k] * (1.0 - share) + inputs.gust[k + 1] * share
    for strip in range(len(rig.pairs)):
        for end in range(2):
            i = rig.pairs[strip, end]
            scratch.pair[0, end], scratch.pair[1, end] = scratch.source[0, i], scratch.source[1, i]
            wires.before[i] = wires.after[i]
        # Warm air that rises past the wire behind.
        plume = rig.features.side_conductance * rig.features.coupling_plume
        scratch.pair[0, 1] += plume * (wires.after[rig.pairs[strip, 0]] - air)
        heat.warm(rig.strip, field, strip, scratch.pair, air, gust, step, scratch.strip)
        wires.after[rig.pairs[strip, 0]] = field[strip, heat.FRONT_WIRE]
        wires.after[rig.pairs[strip, 1]] = field[strip, heat.BACK_WIRE]


@inlined
def phase(rig, grains, pull, wires, step):
    """Transform every wire at its new temperature and the stress that its trend predicts."""
    memory, bow = rig.features.return_point_memory, rig.features.loop_bow
    for i in range(len(wires.after)):
        moved, shift = wires.after[i] - wires.before[i], wires.shift[i]
        if moved > 0.0:  # if only the transformation to martensite drifts
            shift *= 1.0 - rig.features.drift_of_martensite
        if abs(moved) > SMALLEST_MOVE and (moved > 0.0) != grains.rising[i]:
            transformation.turn(rig.classes, rig.ramps, memory, grains, i, wires.before[i] - shift,
                                pull.stress[i])
        pull.predicted[i] = pull.stress[i] + pull.stress_change[i]
        xi, slope = transformation.transform(rig.classes, rig.ramps, memory, bow, grains, i,
                                             wires.after[i] - shift, pull.predicted[i])
        if rig.features.transformation_lag > 0.0:
            share = -math.expm1(-step / rig.features.transformation_lag)
            xi = wires.martensite[i] + share * (xi - wires.martensite[i])
            slope *= share
        pull.martensite[i], pull.martensite_slope[i] = xi, slope


@inlined
def aftermath(rig, grains, pull, wires):
    """Update what depends on the step's transformation: grains, fatigue, latent heat."""
    has = rig.features
    for i in range(len(wires.after)):
        # Correct for the stress at equilibrium, which `transform` had only predicted.
        loaded = pull.stress[i] - pull.predicted[i]
        for c in range(grains.martensite.shape[1]):
            martensite = grains.martensite[i, c] + grains.martensite_slope[i, c] * loaded
            grains.martensite[i, c] = min(max(martensite, 0.0), 1.0)
        change = pull.martensite[i] - wires.martensite[i]
        worth = forms.latent_worth(has, wires.martensite[i])
        if rig.beam.opposing > 0.0 and change < 0.0 and has.opposing_friction == 0.0:
            # What transforms to austenite loses its detwinned strain.
            pull.detwinned[i] *= pull.martensite[i] / wires.martensite[i]
        wires.martensite[i] = pull.martensite[i]
        wires.loops[i] += 0.5 * abs(change)
        worn = forms.worn(has, wires.loops[i], wires.driven[i])
        wires.shift[i], pull.elongation[i] = has.transition_drift * worn, has.plastic_strain * worn
        pull.settled[i] = forms.ratcheted(has, wires.loops[i])
        if rig.latent > 0.0:
            moved = wires.after[i] - wires.before[i]
            wires.owed[i] += rig.latent * (worth * (change + wires.apparent[i] * moved))
            if abs(moved) > SMALLEST_MOVE:
                wires.apparent[i] = min(max(-change / moved, 0.0), STEEPEST)


# --- The simulation of a world: voltages in, true values out.
LONGEST_STEP, ROUNDING = 5e-3, 1e-9  # s


@dataclass(frozen=True, eq=False)
class Outcome:
    """True values on the given time grid, SI units, (n,) or (n, w) wires: voltage at
    the driver, held from each sample to the next; surface of the silicone beside each wire, which
    an infrared spot sees too; deflection of the tip or the slider, positive to the front, or
    elongation of a wire with a weight or a spring."""

    time: Array
    voltage: Array
    current: Array
    temperature: Array
    surface: Array
    martensite_fraction: Array
    stress: Array
    deflection: Array
    ambient: Array


def happen(world: World, time: ArrayLike, voltage: ArrayLike, fine: float = 1.0) -> Outcome:
    """Simulate a world under voltages (n, w) V, held from each of the increasing times (n,) s to
    the next, from rest at ambient temperature; features of its sensors have no influence here.
    Internal steps are at most 5 ms/fine long (0.25: 20 ms, for cheap sensitivities)."""
    warn_if_plain()
    time, voltage = np.array(time, dtype=float), np.array(voltage, dtype=float)
    driven, wires = len(world.parameters["bench.channels"]), len(world.sides)
    gap = np.diff(time)
    assert voltage.shape == (len(time), driven) and np.isfinite(voltage).all() and (gap > 0.0).all()
    steps = np.ceil(gap * (fine / LONGEST_STEP) - ROUNDING).astype(np.int64)
    volts = np.hstack([voltage, np.zeros((len(time), wires - driven))])
    inputs = Inputs(time, volts, heat.ambient(world, time), heat.gusts(world, time),
                    np.maximum(steps, 1))
    pairs = [[i for i, s in enumerate(world.sides) if s == side] for side in ("front", "back")]
    p, law = world.parameters, (world.feature("kinetics_smoothness"), world.feature("kinetics_law"))
    rig = Rig(world.numbers, p["wire.resistance"], p["wire.mass"] * world.feature("latent_heat"),
              p["wire.austenite_start_temperature"] - forms.ASIDE_BELOW, heat.strip_of(world),
              np.array(pairs, dtype=np.int64).T.copy(), transformation.grain_classes(world),
              transformation.ramp_table(*law), beam(world))
    # Cold, all martensite, never driven.
    still = float(p["environment.ambient_temperature"])
    before, after = np.full((2, wires), still)
    at_rest = Wires(before, after, np.ones(wires), *np.zeros((6, wires)),
                    np.full((wires, 3), still))
    scratch = Scratch(np.zeros((2, wires)), np.zeros((2, 2)), np.zeros((5, heat.NODES)),
                      np.zeros((ROWS, wires)))
    field = np.full((len(rig.pairs), heat.NODES), still)
    values = np.zeros((len(time), QUANTITIES, wires))
    tip = np.zeros(len(time))
    grains = transformation.grains_at_rest(wires, len(rig.classes.weight))
    run(rig, inputs, field, grains, pull_at_rest(rig.beam), at_rest, scratch, values, tip)
    values = values[:, :, :driven]
    return Outcome(time, volts[:, :driven], values[:, CURRENT], values[:, TEMPERATURE],
                   values[:, SURFACE], values[:, MARTENSITE], values[:, STRESS],
                   deflection=tip if world.load in ("beam", "antagonist") else -tip,
                   ambient=inputs.ambient)
