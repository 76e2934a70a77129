"""Transformation in the reality: grains with temperatures of their own, and loops."""

import math
from collections import namedtuple

import numpy as np

from examination.blind.reality import forms
from examination.blind.reality.forms import Array
from examination.blind.reality.world import World
from sma_bench.compiled import inlined

# --- What a wire's grains are: classes with transition temperatures of their own, their ramps.
GRAIN_CLASSES = 7
# A ramp's table reaches so many of its widths beyond either end; the nodes hit 0 and 1.
BEYOND, PER_WIDTH = 1.0, 512
# Standard deviation of the cosine ramp, taken as a distribution over its width: 1/4 - 2/pi^2.
COSINE_DEVIATION = math.sqrt(0.25 - 2.0 / math.pi**2)
# The R-phase: narrow, little hysteresis, little strain per stress (so large C), between the
# martensite's start and the austenite's (S. Miyazaki and K. Otsuka, Metall. Trans. A 17, 1986).
R_WIDTH, R_HYSTERESIS = 8.0, 3.0  # K
R_STRESS = 0.4  # of the martensite's shift with stress
# Grain classes of every wire, each an array (c,): share of the transformation strain, K at the ends
# of the ranges, one over their widths [1/K], shifts with stress [K/Pa], and those with bent stress;
# its knee and square [Pa].
Classes = namedtuple("Classes", "weight austenite_finish austenite_rate austenite_shift "
                     "martensite_finish martensite_rate martensite_shift austenite_bend "
                     "martensite_bend knee square")


def grain_classes(world: World) -> Classes:
    p = world.parameters
    starts = p["wire.austenite_start_temperature"], p["wire.martensite_start_temperature"]
    finishes = p["wire.austenite_finish_temperature"], p["wire.martensite_finish_temperature"]
    factors = np.array([world.feature(f"stress_influence_factor_{phase}")
                        for phase in ("austenite", "martensite")])
    plain = np.array([p["wire.stress_influence_austenite"], p["wire.stress_influence_martensite"]])
    # Of a bent line only the difference from the stated slope is bent.
    knee, square = world.feature("stress_knee"), world.feature("stress_square")
    is_bent = knee > 0.0 or square > 0.0
    shifts = (1.0 / plain if is_bent else factors / plain).tolist()
    bends = ((factors - 1.0) / plain if is_bent else np.zeros(2)).tolist()
    spread, r_share = world.feature("grain_spread"), world.feature("r_phase")
    # Gauss-Hermite nodes and weights of a normal distribution; one node if it has no width.
    offsets, weights = np.zeros(1), np.ones(1)
    if spread != 0.0:
        nodes, weights = np.polynomial.hermite_e.hermegauss(GRAIN_CLASSES)
        offsets, weights = spread * nodes, weights / np.sum(weights)
    rates = 1.0 / (finishes[0] - starts[0]), 1.0 / (starts[1] - finishes[1])
    relays = world.feature("relays")
    rows = [((1.0 - relays) * (1.0 - r_share) * weight, finishes[0] + offset, rates[0], shifts[0],
             finishes[1] + offset, rates[1], shifts[1])
            for offset, weight in zip(offsets, weights, strict=True)]
    if r_share > 0.0:
        middle = 0.5 * (starts[0] + starts[1])
        hot, cold = middle + 0.5 * (R_WIDTH + R_HYSTERESIS), middle - 0.5 * R_HYSTERESIS
        rows.append((r_share, hot, 1.0 / R_WIDTH, R_STRESS * shifts[0],
                     cold - 0.5 * R_WIDTH, 1.0 / R_WIDTH, R_STRESS * shifts[1]))
    if relays > 0.0:
        rows += forms.relay_rows(starts, finishes, shifts, (1.0 - r_share) * relays)
    columns = [np.ascontiguousarray(column) for column in np.array(rows).T]
    return Classes(*columns, *(np.full(len(rows), bend) for bend in bends), knee, square)


def ramp_table(smoothness: float, law: float = 0.0) -> Array:
    """(m, 2) ramp from 0 to 1 over positions 0 to 1, and its slope per table step. From (1 - cos(pi
    x))/2 of the contract, smoothness 0, to the normal distribution function of the same mean and
    deviation, 1, or to that of another law."""
    position = np.arange(round((1.0 + 2.0 * BEYOND) * PER_WIDTH) + 1) / PER_WIDTH - BEYOND
    angle = 0.5 * np.pi * np.clip(position, 0.0, 1.0)
    cosine, cosine_slope = np.sin(angle) ** 2, np.pi * np.sin(angle) * np.cos(angle)
    scaled = (position - 0.5) / COSINE_DEVIATION
    normal = np.array([0.5 * math.erfc(-x / math.sqrt(2.0)) for x in scaled])
    density = np.exp(-0.5 * scaled**2) / (math.sqrt(2.0 * math.pi) * COSINE_DEVIATION)
    if law > 0.0:
        normal, density = forms.smooth_ramp(law, position, COSINE_DEVIATION)
    # Hermite interpolation meets the plateaus without a step.
    normal[0], normal[-1], density[0], density[-1] = 0.0, 1.0, 0.0, 0.0
    value = (1.0 - smoothness) * cosine + smoothness * normal
    slope = (1.0 - smoothness) * cosine_slope + smoothness * density
    return np.ascontiguousarray(np.column_stack([value, slope / PER_WIDTH]))


# --- How the grains of a wire transform: straight lines in the plane of ramp and phase.
#
# While the temperature rises, the phase that vanishes is martensite, y = xi, and its own ramp is
# o = f; while it falls, austenite, y = 1 - xi, with o = g. Between two reversals y is a straight
# line over o, from the state at the reversal to a target:
#
#     y = y_t + slope (o - o_t)
#
# With the target y_t = o_t = 0 this is the contract's proportional rule. With the target at the
# reversal before the last, a loop closes where it was opened and is then forgotten (return-point
# memory and wiping-out: F. Preisach, Z. Phys. 94, 1935; I. Mayergoyz, Phys. Rev. Lett. 56, 1986).
# `memory` moves the target from the one to the other.
#
# Two more lines keep a class continuous whatever the stress does, as the product reads the
# contract: where stress has moved the other ramp u back beyond its value u_r at the reversal, y
# is at least min(1 - u/u_r, o); and where the reversal lies beyond the own ramp's end (M_s above
# A_f), y is a line over 1 - u, the curve of the other direction traced back.
#
# Wires of one side that are driven very unequally can pull each other, one into martensite and
# one into austenite; the contract's rule has several solutions then, and which one is found
# depends on the step.
LOOPS = 16  # reversals that a class remembers
SMALLEST_MOVE = 1e-9  # K, below which the temperature counts as held
NOTHING = 1e-14
# What a class remembers of its last reversal, columns of `line`: the line, the other ramp, its own.
SLOPE, AIM_PHASE, AIM_RAMP, TRACED, OTHER_RAMP, OTHER_PLACE, TURNED = 0, 1, 2, 3, 4, 5, 6
LINE = 7
# State of the classes (c) of every wire (w): whether its temperature rose last (w,); martensite
# (w, c) and its slope along stress [1/Pa] in the present step; the present branch (w, c, LINE); how
# many reversals are remembered, and their (w, c, LOOPS, 3) martensite, f, g.
Grains = namedtuple("Grains", "rising martensite martensite_slope line reversals reversal")


def grains_at_rest(wires: int, classes: int) -> Grains:
    """All martensite, cold; its first move is up."""
    shape = (wires, classes)
    line = np.zeros((*shape, LINE))
    line[..., SLOPE] = line[..., TURNED] = 1.0
    return Grains(np.ones(wires, dtype=np.bool_), np.ones(shape), np.zeros(shape), line,
                  np.zeros(shape, dtype=np.int64), np.zeros((*shape, LOOPS, 3)))


@inlined
def ramp(table, position):
    """Value and slope of the ramp at a position: cubic Hermite interpolation of its table."""
    place = min(max((position + BEYOND) * PER_WIDTH, 0.0), table.shape[0] - 1.0)
    k = min(int(place), table.shape[0] - 2)
    u = place - k
    start, start_slope, end_slope = table[k, 0], table[k, 1], table[k + 1, 1]
    rise = table[k + 1, 0] - start
    square = 3.0 * rise - 2.0 * start_slope - end_slope
    cube = start_slope + end_slope - 2.0 * rise
    value = start + u * (start_slope + u * (square + u * cube))
    return value, (start_slope + u * (2.0 * square + u * 3.0 * cube)) * PER_WIDTH


@inlined
def ramp_of(classes, table, c, rising, temperature, stress):
    """f (rising) or g of class c, and its slope along stress."""
    bent, along = forms.bent_stress(classes.knee, classes.square, stress)
    if rising:
        rate, shift = classes.austenite_rate[c], classes.austenite_shift[c]
        bend = classes.austenite_bend[c]
        warmer = classes.austenite_finish[c] + shift * stress + bend * bent
        value, slope = ramp(table, (warmer - temperature) * rate)
        return value, slope * (shift + bend * along) * rate
    rate, shift = classes.martensite_rate[c], classes.martensite_shift[c]
    bend = classes.martensite_bend[c]
    colder = temperature - shift * stress - bend * bent
    value, slope = ramp(table, (colder - classes.martensite_finish[c]) * rate)
    return value, -slope * (shift + bend * along) * rate


@inlined
def other_place(classes, c, rising, temperature, stress):
    """Where class c lies along the other ramp [K]; the ramp vanishes downwards."""
    bent = forms.bent_stress(classes.knee, classes.square, stress)[0]
    if rising:
        shift = classes.martensite_shift[c] * stress + classes.martensite_bend[c] * bent
        return temperature - shift
    return classes.austenite_shift[c] * stress + classes.austenite_bend[c] * bent - temperature


@inlined
def turn(classes, table, memory, grains, i, temperature, stress):
    rising, line = not grains.rising[i], grains.line
    grains.rising[i] = rising
    for c in range(len(classes.weight)):
        f = ramp_of(classes, table, c, True, temperature, stress)[0]
        g = ramp_of(classes, table, c, False, temperature, stress)[0]
        if memory > 0.0:
            known = grains.reversals[i, c]
            if known == LOOPS:
                known -= 2  # the innermost loop is forgotten early
            grains.reversal[i, c, known, 0] = grains.martensite[i, c]
            grains.reversal[i, c, known, 1] = f
            grains.reversal[i, c, known, 2] = g
            grains.reversals[i, c] = known + 1
        own, other = (f, g) if rising else (g, f)
        line[i, c, OTHER_RAMP] = other
        line[i, c, OTHER_PLACE] = other_place(classes, c, rising, temperature, stress)
        line[i, c, TURNED] = own
        phase = grains.martensite[i, c] if rising else 1.0 - grains.martensite[i, c]
        draw(memory, grains, i, c, phase, own)
        if own <= NOTHING and phase > 0.0 and other < 1.0:
            line[i, c, TRACED] = 1.0
            line[i, c, SLOPE] = phase / (1.0 - other)


@inlined
def draw(memory, grains, i, c, phase, own):
    """Draw the line of class c from this state to its target."""
    line = grains.line
    line[i, c, TRACED] = line[i, c, AIM_PHASE] = line[i, c, AIM_RAMP] = 0.0
    opened = grains.reversals[i, c] - 2
    if memory > 0.0 and opened >= 0:
        martensite = grains.reversal[i, c, opened, 0]
        line[i, c, AIM_PHASE] = memory * (martensite if grains.rising[i] else 1.0 - martensite)
        ramp_there = grains.reversal[i, c, opened, 1 if grains.rising[i] else 2]
        line[i, c, AIM_RAMP] = memory * ramp_there
    away = own - line[i, c, AIM_RAMP]
    if away > NOTHING:
        line[i, c, SLOPE] = (phase - line[i, c, AIM_PHASE]) / away
    else:
        line[i, c, SLOPE], line[i, c, AIM_PHASE] = 0.0, phase


@inlined
def transform(classes, table, memory, bow, grains, i, temperature, stress):
    """Move wire i to a state: its martensite fraction there, and the slope along stress [1/Pa]. The
    temperature is reduced by the drift of the transition in the direction of `grains.rising`."""
    rising, line = grains.rising[i], grains.line
    total, total_slope = 0.0, 0.0
    for c in range(len(classes.weight)):
        own, along = ramp_of(classes, table, c, rising, temperature, stress)
        # Forget the loops that the ramp has run out of, each line going on from where it ended.
        inside = memory <= 0.0
        while grains.reversals[i, c] >= 2 and not inside:
            opened = grains.reversals[i, c] - 2
            end = grains.reversal[i, c, opened, 1 if rising else 2]
            inside = own > end
            if not inside:
                phase = line[i, c, AIM_PHASE] + line[i, c, SLOPE] * (end - line[i, c, AIM_RAMP])
                grains.reversals[i, c] = opened
                draw(memory, grains, i, c, phase, end)
        phase = line[i, c, AIM_PHASE] + line[i, c, SLOPE] * (own - line[i, c, AIM_RAMP])
        slope = line[i, c, SLOPE] * along
        if bow > 0.0:
            turned = line[i, c, TURNED]
            factor, steep = forms.duhem(bow, own, turned, line[i, c, SLOPE] * turned)
            phase, slope = phase * factor, slope * steep
        moved_back = other_place(classes, c, rising, temperature, stress) < line[i, c, OTHER_PLACE]
        moved_back = moved_back and line[i, c, OTHER_RAMP] > 0.0
        if moved_back or line[i, c, TRACED] > 0.0:
            other, other_along = ramp_of(classes, table, c, not rising, temperature, stress)
            if line[i, c, TRACED] > 0.0:
                phase, slope = line[i, c, SLOPE] * (1.0 - other), -line[i, c, SLOPE] * other_along
            if moved_back:
                least = 1.0 - other / line[i, c, OTHER_RAMP]
                least_slope = -other_along / line[i, c, OTHER_RAMP]
                if least > own:
                    least, least_slope = own, along
                if least > phase:
                    phase, slope = least, least_slope
        phase = min(max(phase, 0.0), 1.0)
        grains.martensite[i, c] = phase if rising else 1.0 - phase
        grains.martensite_slope[i, c] = slope if rising else -slope
        total += classes.weight[c] * grains.martensite[i, c]
        total_slope += classes.weight[c] * grains.martensite_slope[i, c]
    return total, total_slope
