"""Equilibrium of the bench: wires of both sides, silicone or load, and their memory.

For the wires i of side s, whose deflection towards itself is d_s, against the other side o:

    contraction of the side     e_s = (d_s - opposing d_o)/alpha
    stress, eq. (6)             sigma_i = E(xi_i)[eps_L a_i - p_i - t_i - e_s] + Theta_T (T_i - T_0)
    balance, eqs. (12), (13)    sum sigma_i = load_s + beta_s [(1 - m) d_s + m/2 (q_1 + q_2)]
                                              (+ stiffening)
    relaxation (Prony)          dq_j/dt = dd_s/dt - q_j/tau_j

Wires with a load are stretched by it at rest, which is in sigma_i. Antagonists are two sides that
oppose each other fully, so that d_front - d_back is the slider's way.

With a the transformed share (1 - xi, or what of it has stayed), p plastic strain and t detwinned
strain. With all features off, a = 1 - xi, p = t = 0, and this is the contract's bending. All
unknowns are solved together by Newton's method, xi as a linear function of stress in the step
(transformation.py); the relaxation is exact for a deflection that is linear within the step."""

import math
from collections import namedtuple

import numpy as np

from examination.blind.reality import forms
from examination.blind.reality.world import World
from sma_bench.compiled import inlined
from sma_bench.parameters.parameters import wire_length

ITERATIONS = 25
CONVERGED = 1e-9  # of a strain; the error left is of the order of its square
HARDENING = 0.05  # of the modulus, while martensite detwins
LEAST_MARTENSITE, LEAST_DAMPING = 0.05, 0.1
IDLE = 1e12  # Pa/m, of the wires behind a weight or a spring, which are never heated
CLAMPS = 1e20  # Pa/m
# Rows of the scratch array: of the sides, then of the wires.
STIFF, LOAD, IMBALANCE, SLOPE, GIVE, ERROR, ALONG, BEFORE = 0, 1, 2, 3, 4, 5, 6, 7
ROWS = 8
# Constants: SI units; arrays by wire (w,), side (2,) or Prony term (k,).
Beam = namedtuple("Beam", "side stiffness load prestretch lever bow opposing relaxation_time "
                  "relaxation_share austenite_modulus modulus_change recoverable expansion "
                  "rest_temperature features")
# State: of the wires (w,) the fraction at the predicted stress and along stress, stresses [Pa] and
# their change in the last step, largest austenite fraction so far, plastic and detwinned strain; of
# the sides (2,) the deflection [m] towards itself, its change in the last step, and what the Prony
# terms still hold of it (2, k); of the wires how far each is loose in its slack, and what part of
# the residual strain stays by now.
Pull = namedtuple("Pull", "martensite martensite_slope predicted stress stress_change transformed "
                  "elongation detwinned deflection change held loose settled")


def beam(world: World) -> Beam:
    p = world.parameters
    sides = np.array([0 if side == "front" else 1 for side in world.sides], dtype=np.int64)
    bow = np.zeros(2)
    # Lever [m], stiffness [Pa/m] and load [Pa] of each side, and how they oppose each other.
    if world.load == "beam":
        asymmetry, opposing = world.feature("stiffness_asymmetry"), world.feature("opposing")
        front, back = (p[f"composite.stress_per_deflection_{side}"] for side in ("front", "back"))
        stiffness, load = (front * (1.0 + asymmetry), back * (1.0 - asymmetry)), (0.0, 0.0)
        unequal = world.feature("progressive_asymmetry"), world.feature("lever_asymmetry")
        lever, nearer, bow = forms.unequal_sides(p["composite.deflection_per_strain"], *unequal)
    else:
        section = p["wire.count"] * math.pi * p["wire.diameter"] ** 2 / 4.0
        spring, preload = p["load.stiffness"] / section, p["load.preload"] / section
        held, lever, nearer = p["load.force"] / section, np.full(2, wire_length(p)), 1.0
        stiffness, load, opposing = {"antagonist": ((spring, spring), (preload, preload), 1.0),
                                     "clamped": ((CLAMPS, IDLE), (0.0, 0.0), 0.0),
                                     "spring": ((spring, IDLE), (preload + held, 0.0), 0.0),
                                     "force": ((0.0, IDLE), (held, 0.0), 0.0)}[world.load]
    stiffness, load = np.array(stiffness) * nearer, np.array(load)
    relaxing = world.feature("relaxation_law"), world.feature("relaxation_time")
    return Beam(sides, stiffness, load, load / (np.bincount(sides) * p["wire.martensite_modulus"]),
                lever, bow, opposing, *forms.prony(*relaxing), p["wire.austenite_modulus"],
                p["wire.martensite_modulus"] - p["wire.austenite_modulus"],
                p["wire.maximum_recoverable_strain"], p["wire.thermal_expansion_factor"],
                p["environment.ambient_temperature"], world.numbers)


def pull_at_rest(beam: Beam) -> Pull:
    """At rest, all martensite, carrying the load."""
    wires = len(beam.side)
    stress = (beam.load / np.bincount(beam.side))[beam.side]
    settled = np.full(wires, 0.0 if beam.features.residual_ratchet > 0.0 else 1.0)
    return Pull(np.ones(wires), *np.zeros((2, wires)), stress, *np.zeros((4, wires)),
                *np.zeros((2, 2)), np.zeros((2, len(beam.relaxation_time))), np.zeros(wires),
                settled)


@inlined
def wire_stress(beam, pull, i, xi, temperature, contraction):
    """Stress of wire i, slopes along xi and contraction, detwinned strain, how loose it lies."""
    austenite, straight = 1.0 - xi, 1.0
    share, share_slope = austenite, -1.0
    if austenite < pull.transformed[i]:
        stays = beam.features.unrecovered_strain * pull.settled[i]
        share += stays * (pull.transformed[i] - austenite)
        share_slope += stays
    modulus = beam.austenite_modulus + xi * beam.modulus_change
    thermal = beam.expansion * (temperature - beam.rest_temperature)
    stretch = beam.recoverable * share - pull.elongation[i] - pull.detwinned[i] - contraction
    stretch += beam.prestretch[beam.side[i]]
    strain = stretch + thermal / modulus
    if beam.opposing > 0.0 and beam.features.opposing_gap > 0.0 and contraction < 0.0 < strain:
        # Passive wires are buckled: they are straightened before they resist.
        taken = min(beam.features.opposing_gap, -contraction, strain)
        straight = 1.0 if taken == beam.features.opposing_gap else 0.0
        stretch, strain, contraction = stretch - taken, strain - taken, contraction + taken
    elastic, grip, loose = forms.taken_up(beam.features, strain, modulus, pull.loose[i])
    stress = modulus * elastic
    along_xi = modulus * beam.recoverable * share_slope
    if grip == 1.0:
        along_xi = beam.modulus_change * (stretch - loose) + along_xi
    else:
        slope = along_xi - beam.modulus_change * thermal / modulus
        along_xi = beam.modulus_change * elastic + grip * slope
    along, detwinned = -modulus * grip, pull.detwinned[i]
    if beam.opposing > 0.0 and grip == 1.0:
        yielding = beam.features.detwinning_stress / max(xi, LEAST_MARTENSITE)
        if beam.features.opposing_friction > 0.0:
            yielding = beam.features.opposing_friction
        flow, soft, along = detwinning(yielding, modulus, stress, detwinned, contraction)
        stress -= modulus * flow
        along_xi *= soft
        detwinned += flow
    return stress, along_xi, along * straight, detwinned, loose


@inlined
def detwinning(yielding, modulus, stress, detwinned, contraction):
    """Strain by which martensite beyond its length at rest yields, with kinematic hardening, the
    factor on the slope of stress along xi, the slope along contraction. Up to the length at rest
    its stretching back is already in the transformation strain."""
    flow, soft, along = 0.0, 1.0, -modulus
    beyond = max(-contraction, 0.0)
    back = HARDENING * modulus * detwinned
    stretched = stress - back > yielding and beyond > detwinned
    pushed = stress - back < -yielding and detwinned > 0.0
    if stretched or pushed:
        soft = HARDENING / (1.0 + HARDENING)
        along = -modulus * soft
        excess = stress - back - yielding if stretched else stress - back + yielding
        flow = excess / (modulus * (1.0 + HARDENING))
        if stretched and flow > beyond - detwinned:
            flow, soft, along = beyond - detwinned, 1.0, 0.0
        elif pushed and flow < -detwinned:
            flow, soft, along = -detwinned, 1.0, -modulus
    return flow, soft, along


@inlined
def side_contraction(beam, i, front, back):
    """Contraction of the side of wire i when the sides deflect so [m]."""
    own, against = (front, back) if beam.side[i] == 0 else (back, front)
    return (own - beam.opposing * against) / beam.lever[beam.side[i]]


@inlined
def fraction(pull, i):
    """xi of wire i at its present stress, and its slope; it stays within 0 and 1."""
    xi = pull.martensite[i] + pull.martensite_slope[i] * (pull.stress[i] - pull.predicted[i])
    inside = 0.0 <= xi <= 1.0
    return min(max(xi, 0.0), 1.0), pull.martensite_slope[i] if inside else 0.0


@inlined
def balance(beam, pull, temperature, step, scratch):
    """Find the stresses and deflections at the end of a step; `pull` is advanced in place."""
    wires = len(beam.side)
    for s in range(2):
        scratch[STIFF, s], scratch[LOAD, s] = beam.stiffness[s], beam.load[s]
        relaxing = beam.features.matrix_relaxation
        if relaxing > 0.0:
            # Effective stiffness of the relaxing part in this step, and its load [m].
            worth, shift = 0.0, 0.0
            for j in range(len(beam.relaxation_time)):
                time, part = beam.relaxation_time[j], beam.relaxation_share[j]
                ratio = step / forms.relaxing_in(beam.features, time, pull.held[s, j])
                gain = -math.expm1(-ratio) / ratio
                worth += part * gain
                shift += part * (math.exp(-ratio) * pull.held[s, j] - gain * pull.deflection[s])
            scratch[STIFF, s] *= 1.0 - relaxing + relaxing * worth
            scratch[LOAD, s] += beam.stiffness[s] * relaxing * shift
    front, back = pull.deflection[0] + pull.change[0], pull.deflection[1] + pull.change[1]
    for i in range(wires):
        scratch[BEFORE, i] = pull.stress[i]
        pull.stress[i] = pull.predicted[i]
    largest, iteration = 1.0, 0
    while largest > CONVERGED and iteration < ITERATIONS:
        iteration += 1
        # Errors of stresses and balance at these deflections, and their slopes.
        for s in range(2):
            d = front if s == 0 else back
            cubic = beam.stiffness[s] * (beam.features.stiffening + beam.bow[s]) * d * d
            scratch[IMBALANCE, s] = -(scratch[STIFF, s] + cubic) * d - scratch[LOAD, s]
            scratch[SLOPE, s], scratch[GIVE, s] = scratch[STIFF, s] + 3.0 * cubic, 0.0
        for i in range(wires):
            s = beam.side[i]
            contraction = side_contraction(beam, i, front, back)
            xi, slope = fraction(pull, i)
            found = wire_stress(beam, pull, i, xi, temperature[i], contraction)
            stress, along_xi, along = found[0], found[1], found[2]
            damping = max(1.0 - along_xi * slope, LEAST_DAMPING)
            scratch[ERROR, i] = (pull.stress[i] - stress) / damping
            scratch[ALONG, i] = along / damping
            scratch[IMBALANCE, s] += pull.stress[i] - scratch[ERROR, i]
            scratch[GIVE, s] -= scratch[ALONG, i] / beam.lever[s]
        a, d = scratch[SLOPE, 0] + scratch[GIVE, 0], scratch[SLOPE, 1] + scratch[GIVE, 1]
        b, c = beam.opposing * scratch[GIVE, 0], beam.opposing * scratch[GIVE, 1]
        determinant = a * d - b * c
        move_front = (d * scratch[IMBALANCE, 0] + b * scratch[IMBALANCE, 1]) / determinant
        move_back = (c * scratch[IMBALANCE, 0] + a * scratch[IMBALANCE, 1]) / determinant
        front += move_front
        back += move_back
        largest = (abs(move_front) + abs(move_back)) / min(beam.lever[0], beam.lever[1])
        for i in range(wires):
            contraction = side_contraction(beam, i, move_front, move_back)
            change = scratch[ALONG, i] * contraction - scratch[ERROR, i]
            pull.stress[i] += change
            largest = max(largest, abs(change) / beam.austenite_modulus)
    # Store the solved state, and update the memory of wires and silicone.
    for i in range(wires):
        pull.stress_change[i] = pull.stress[i] - scratch[BEFORE, i]
        contraction = side_contraction(beam, i, front, back)
        xi = fraction(pull, i)[0]
        found = wire_stress(beam, pull, i, xi, temperature[i], contraction)
        pull.detwinned[i], pull.loose[i] = found[3], found[4]
        most = forms.crept_back(beam.features, pull.transformed[i], 1.0 - xi, step)
        pull.transformed[i] = max(most, 1.0 - xi)
        pull.martensite[i], pull.martensite_slope[i] = xi, 0.0
    for s in range(2):
        moved = (front if s == 0 else back) - pull.deflection[s]
        for j in range(len(beam.relaxation_time)):
            time = beam.relaxation_time[j]
            ratio = step / forms.relaxing_in(beam.features, time, pull.held[s, j])
            gain = -math.expm1(-ratio) / ratio
            pull.held[s, j] = math.exp(-ratio) * pull.held[s, j] + gain * moved
        pull.deflection[s] += moved
        pull.change[s] = moved
