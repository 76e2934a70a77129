# mypy: disallow-untyped-defs=False, disallow-incomplete-defs=False
"""Derivatives of a simulation by any number of parameters, carried along its course.

The equations of core.py differentiated: with x' the derivative of x by every parameter, a step is

    T'|     = START' + LAG' xi                                      (| at fixed xi and e)
    sigma'| = E' (stretch) + E (stretch)' + Theta_T' (T - T_inf) + Theta_T (T'| - T_inf')
    xi'     = [rule'(T'|, sigma'|) - coupling e'] / slope
    e'      = sum (sigma'| + stress slope xi'|) - load' - e K'  over  K + sum (...)

a system of the Newton step's own matrix, and, for every parameter, some multiplications and
additions. What a bench is enters by the derivatives of its rows (columns.py), which are laid out as
the rows themselves, with the parameters along a last axis; so an effect that is no more than a
number in these rows brings its derivative with it. `carries` says of which benches that holds.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from sma_bench.compiled import borrowing, inlined
from sma_bench.parameters import Parameters
from sma_bench.parameters.parameter import EFFECTS
from sma_bench.parameters.table import BY_NAME
from sma_bench.physics import columns as at
from sma_bench.physics.core import residual, set_step
from sma_bench.physics.kernel import Kernel
from sma_bench.physics.kinetics import left_gradient, positions, ramp_gradient, reverse
from sma_bench.physics.simulate import Simulation

Array = NDArray[np.float64]

# Effects that take a way of their own through the core; a sensor's behind it disturbs nothing.
_OTHERWISE = [
    name for effect in EFFECTS.values() if effect.marks or effect.stage != "sensor"
    for name in effect.not_carried if BY_NAME[name].default == 0.0
]
# Work: T', sigma', xi' of a wire at a fixed contraction.
WARM, PULL, TURN, WORK = range(4)


@dataclass(frozen=True, eq=False)
class Sensitivities:
    """Derivatives of a simulation, p parameters along the last axis.

    Attributes:
        temperature: (w, n, p), stress: (w, n, p), contraction: (s, n, p); per unit of the steps.
    """

    temperature: Array
    stress: Array
    contraction: Array

    @classmethod
    def of(
        cls, simulation: Simulation, moved: Sequence[Parameters], steps: Array
    ) -> Self:
        """Those of a simulation that began at rest, of a bench of which `carries` is true.

        Args:
            moved: the bench with one parameter moved by a very small step (p,), p times.
        """
        kernel = Kernel.of(simulation.parameters, None)
        rows = kernel.memory(None)
        others = [Kernel(bench, None).memory(None) for bench in moved]
        by_wires, by_sides = (
            np.stack([other[k] - rows[k] for other in others], axis=-1) / steps
            for k in range(2)
        )
        wires, samples, count = len(rows[0]), len(simulation.time), len(moved)
        of_wires = np.empty((2, wires, samples, count))
        of_sides = np.empty((len(rows[1]), samples, count))
        run_derivatives(
            simulation.time, simulation.voltage, *rows, simulation.temperature,
            simulation.martensite_fraction, simulation.stress, simulation.contraction,
            by_wires, by_sides, np.empty((wires, WORK, count)), of_wires, of_sides,
        )
        return cls(of_wires[0], of_wires[1], of_sides)


def carries(parameters: Parameters) -> bool:
    """Whether derivatives of this bench can be carried along."""
    if parameters["bench.drive"] != "voltage":
        return False
    return not any(parameters[name] for name in _OTHERWISE)


@inlined
def own_ramps(wires, i, by_wires, p):
    """Where the ranges lie, by parameter p, at a fixed temperature and stress."""
    stress = wires[i, at.STRESS]
    of_f, of_g = positions(wires, i, wires[i, at.TEMPERATURE], stress)
    by_f = by_wires[i, at.AUSTENITE_FINISH, p] + stress * by_wires[i, at.AUSTENITE_SHIFT, p]
    by_g = -by_wires[i, at.MARTENSITE_FINISH, p] - stress * by_wires[i, at.MARTENSITE_SHIFT, p]
    by_f = by_f * wires[i, at.AUSTENITE_SLOPE]
    by_g = by_g * wires[i, at.MARTENSITE_SLOPE]
    by_f += of_f / wires[i, at.AUSTENITE_SLOPE] * by_wires[i, at.AUSTENITE_SLOPE, p]
    by_g += of_g / wires[i, at.MARTENSITE_SLOPE] * by_wires[i, at.MARTENSITE_SLOPE, p]
    return by_f, by_g


@borrowing
def turn(wires, i, by_wires, trend):
    """A reversal, as kinetics.reverse, and its derivatives."""
    of_f, of_g = positions(wires, i, wires[i, at.TEMPERATURE], wires[i, at.STRESS])
    tail = wires[i, at.TAIL]
    _, f_slope, f_spread, f_tail = ramp_gradient(of_f, wires[i, at.AUSTENITE_SPREAD], tail)
    _, g_slope, g_spread, g_tail = ramp_gradient(of_g, wires[i, at.MARTENSITE_SPREAD], tail)
    reverse(wires, i, trend)
    rising = trend > 0.0
    for p in range(by_wires.shape[2]):
        by_f, by_g = own_ramps(wires, i, by_wires, p)
        warmer, tighter = by_wires[i, at.TEMPERATURE, p], by_wires[i, at.STRESS, p]
        by_f += wires[i, at.AUSTENITE_SLOPE] * (wires[i, at.AUSTENITE_SHIFT] * tighter - warmer)
        by_g += wires[i, at.MARTENSITE_SLOPE] * (warmer - wires[i, at.MARTENSITE_SHIFT] * tighter)
        by_f = f_slope * by_f + f_spread * by_wires[i, at.AUSTENITE_SPREAD, p]
        by_g = g_slope * by_g + g_spread * by_wires[i, at.MARTENSITE_SPREAD, p]
        by_f += f_tail * by_wires[i, at.TAIL, p]
        by_g += g_tail * by_wires[i, at.TAIL, p]
        by_xi = by_wires[i, at.FRACTION, p]
        by_wires[i, at.PHASE_REVERSED, p] = by_xi if rising else -by_xi
        by_wires[i, at.OWN_REVERSED, p] = by_f if rising else by_g
        by_wires[i, at.OTHER_REVERSED, p] = by_g if rising else by_f


@borrowing
def by_step(wires, by_wires, step):
    """Constants of a step of this length [s], and their derivatives."""
    set_step(wires, step)
    for i in range(wires.shape[0]):
        exponent = -step / wires[i, at.TIME_CONSTANT]
        decay, share = wires[i, at.DECAY], math.expm1(exponent) / exponent
        slower = step / (wires[i, at.TIME_CONSTANT] * wires[i, at.TIME_CONSTANT])
        lag_slope = wires[i, at.LATENT_RISE] * (decay - share) / exponent * slower
        for p in range(by_wires.shape[2]):
            by_time = by_wires[i, at.TIME_CONSTANT, p]
            by_wires[i, at.DECAY, p] = decay * slower * by_time
            by_wires[i, at.LAG, p] = share * by_wires[i, at.LATENT_RISE, p] + lag_slope * by_time


@borrowing
def warm(wires, i, by_wires, voltage):
    """Temperature at the end of a step as far as it does not depend on xi, by every parameter."""
    square = voltage * voltage
    excess = wires[i, at.TEMPERATURE] - wires[i, at.AMBIENT] - wires[i, at.HEATING] * square
    if excess * wires[i, at.TREND] > 0.0:
        turn(wires, i, by_wires, -wires[i, at.TREND])
    decay, lag, xi = wires[i, at.DECAY], wires[i, at.LAG], wires[i, at.FRACTION]
    for p in range(by_wires.shape[2]):
        steady = by_wires[i, at.AMBIENT, p] + square * by_wires[i, at.HEATING, p]
        by_wires[i, at.START, p] = (
            steady + (by_wires[i, at.TEMPERATURE, p] - steady) * decay
            + excess * by_wires[i, at.DECAY, p]
            - xi * by_wires[i, at.LAG, p] - lag * by_wires[i, at.FRACTION, p]
        )


@borrowing
def pull(wires, i, by_wires, work, contraction):
    """T', sigma' and xi' of a solved wire at a fixed contraction; the solution's slopes."""
    xi, expansion = wires[i, at.FRACTION], wires[i, at.EXPANSION]
    _, slope, coupling, _, stress_slope, modulus = residual(wires, i, contraction, xi)
    stretch = wires[i, at.RECOVERABLE_STRAIN] * (1.0 - xi) + wires[i, at.OFFSET] - contraction
    rise = wires[i, at.TEMPERATURE] - wires[i, at.AMBIENT]
    for p in range(by_wires.shape[2]):
        warmer = by_wires[i, at.START, p] + xi * by_wires[i, at.LAG, p]
        stiffer = by_wires[i, at.AUSTENITE_MODULUS, p] + xi * by_wires[i, at.MODULUS_CHANGE, p]
        longer = (1.0 - xi) * by_wires[i, at.RECOVERABLE_STRAIN, p]
        longer += by_wires[i, at.PRESTRETCH, p]
        work[i, WARM, p] = warmer
        work[i, PULL, p] = (
            stiffer * stretch + modulus * longer + rise * by_wires[i, at.EXPANSION, p]
            + expansion * (warmer - by_wires[i, at.AMBIENT, p])
        )
    solved = 1.0 / slope if slope > 0.0 else 0.0  # at a snap there is no derivative
    transform(wires, i, by_wires, work, solved)
    return coupling * solved, stress_slope, modulus


@borrowing
def transform(wires, i, by_wires, work, solved):
    """xi' at a fixed contraction."""
    of_f, of_g = positions(wires, i, wires[i, at.TEMPERATURE], wires[i, at.STRESS])
    f_spread, g_spread = wires[i, at.AUSTENITE_SPREAD], wires[i, at.MARTENSITE_SPREAD]
    if wires[i, at.TREND] > 0.0:
        f, g, of_f_spread, of_g_spread, tail, phase, own, other, memory = left_gradient(
            wires, i, of_f, of_g, f_spread, g_spread
        )
    else:
        g, f, of_g_spread, of_f_spread, tail, phase, own, other, memory = left_gradient(
            wires, i, of_g, of_f, g_spread, f_spread
        )
        solved = -solved
    ramps = abs(f) + abs(g) + abs(tail) + abs(of_f_spread) + abs(of_g_spread)
    if ramps + abs(phase) + abs(own) + abs(other) + abs(memory) == 0.0:
        for p in range(by_wires.shape[2]):
            work[i, TURN, p] = 0.0
        return
    f_per_kelvin, g_per_kelvin = wires[i, at.AUSTENITE_SLOPE], wires[i, at.MARTENSITE_SLOPE]
    by_warm = g * g_per_kelvin - f * f_per_kelvin
    by_pull = f * f_per_kelvin * wires[i, at.AUSTENITE_SHIFT]
    by_pull -= g * g_per_kelvin * wires[i, at.MARTENSITE_SHIFT]
    for p in range(by_wires.shape[2]):
        by_f, by_g = own_ramps(wires, i, by_wires, p)
        work[i, TURN, p] = solved * (
            by_warm * work[i, WARM, p] + by_pull * work[i, PULL, p] + f * by_f + g * by_g
            + of_f_spread * by_wires[i, at.AUSTENITE_SPREAD, p]
            + of_g_spread * by_wires[i, at.MARTENSITE_SPREAD, p]
            + tail * by_wires[i, at.TAIL, p] + phase * by_wires[i, at.PHASE_REVERSED, p]
            + own * by_wires[i, at.OWN_REVERSED, p] + other * by_wires[i, at.OTHER_REVERSED, p]
            + memory * by_wires[i, at.MEMORY, p]
        )


@borrowing
def balance(wires, sides, side, by_wires, by_sides, work):
    """A side's contraction, and with it its wires, by every parameter."""
    contraction, stiffness = sides[side, at.CONTRACTION], sides[side, at.STIFFNESS]
    parameters = by_wires.shape[2]
    if sides[side, at.PRESCRIBED] == 0.0:
        for p in range(parameters):
            of_load = by_sides[side, at.LOAD, p] + contraction * by_sides[side, at.STIFFNESS, p]
            by_sides[side, at.CONTRACTION, p] = -of_load
    for i in range(wires.shape[0]):
        sign = 1.0 if wires[i, at.SIDE] == side else -sides[side, at.COUPLED]
        if sign == 0.0:
            continue
        coupling, stress_slope, modulus = pull(wires, i, by_wires, work, sign * contraction)
        wires[i, at.COUPLING], wires[i, at.STEP] = coupling, stress_slope
        wires[i, at.GUESS] = modulus
        stiffness += modulus + stress_slope * coupling
        if sides[side, at.PRESCRIBED] == 0.0:
            for p in range(parameters):
                tighter = work[i, PULL, p] + stress_slope * work[i, TURN, p]
                by_sides[side, at.CONTRACTION, p] += sign * tighter
    if sides[side, at.PRESCRIBED] == 0.0:
        softness = 1.0 / stiffness if stiffness > 0.0 else 0.0
        for p in range(parameters):
            by_sides[side, at.CONTRACTION, p] *= softness
    for i in range(wires.shape[0]):
        sign = 1.0 if wires[i, at.SIDE] == side else -sides[side, at.COUPLED]
        if sign == 0.0:
            continue
        coupling, stress_slope = wires[i, at.COUPLING], wires[i, at.STEP]
        modulus, lag = wires[i, at.GUESS], wires[i, at.LAG]
        for p in range(parameters):
            shorter = sign * by_sides[side, at.CONTRACTION, p]
            by_xi = work[i, TURN, p] - coupling * shorter
            by_wires[i, at.FRACTION, p] = by_xi
            by_wires[i, at.TEMPERATURE, p] = work[i, WARM, p] + lag * by_xi
            by_wires[i, at.STRESS, p] = (
                work[i, PULL, p] + stress_slope * by_xi - modulus * shorter
            )


@borrowing
def look(wires, sides, temperature, fraction, stress, contraction, k):
    """The state that the simulation had at sample k."""
    for i in range(wires.shape[0]):
        wires[i, at.TEMPERATURE], wires[i, at.FRACTION] = temperature[k, i], fraction[k, i]
        wires[i, at.STRESS] = stress[k, i]
    for side in range(sides.shape[0]):
        sides[side, at.CONTRACTION] = contraction[k, side]


@borrowing
def note(by_wires, by_sides, of_wires, of_sides, k):
    """Derivatives of sample k, to where they are kept."""
    for p in range(by_wires.shape[2]):
        for i in range(by_wires.shape[0]):
            of_wires[0, i, k, p] = by_wires[i, at.TEMPERATURE, p]
            of_wires[1, i, k, p] = by_wires[i, at.STRESS, p]
        for side in range(by_sides.shape[0]):
            of_sides[side, k, p] = by_sides[side, at.CONTRACTION, p]


@borrowing
def run_derivatives(
    time, voltage, wires, sides, temperature, fraction, stress, contraction, by_wires, by_sides,
    work, of_wires, of_sides,
):
    """Derivatives by p parameters along what core.run has simulated from the same rows.

    Args:
        time, voltage, wires, sides: as of core.run; the rows are advanced.
        temperature, fraction, stress: (n, w), contraction: (n, s), as simulated.
        by_wires: (w, WIRE_COLUMNS, p) derivatives of the rows, by_sides: (s, SIDE_COLUMNS, p);
            advanced in place; work: (w, WORK, p).
        of_wires: (2, w, n, p) of temperature and stress; of_sides: (s, n, p) of the contraction;
            written.
    """
    for i in range(wires.shape[0]):
        turn(wires, i, by_wires, 1.0)
    note(by_wires, by_sides, of_wires, of_sides, 0)
    last_step = 0.0
    for k in range(1, time.shape[0]):
        step = time[k] - time[k - 1]
        if step != last_step:
            last_step = step
            by_step(wires, by_wires, step)
        for i in range(wires.shape[0]):
            warm(wires, i, by_wires, voltage[k - 1, i])
            # As core.heat has it, before the state of the step's end is looked at.
            steady = wires[i, at.AMBIENT] + wires[i, at.HEATING] * voltage[k - 1, i] ** 2
            excess = wires[i, at.TEMPERATURE] - steady
            wires[i, at.START] = steady + excess * wires[i, at.DECAY]
            wires[i, at.START] -= wires[i, at.LAG] * wires[i, at.FRACTION]
        look(wires, sides, temperature, fraction, stress, contraction, k)
        for side in range(sides.shape[0]):
            if side > 0 and sides[0, at.COUPLED] > 0.0:
                for p in range(by_wires.shape[2]):
                    by_sides[side, at.CONTRACTION, p] = -by_sides[0, at.CONTRACTION, p]
                break
            balance(wires, sides, side, by_wires, by_sides, work)
        note(by_wires, by_sides, of_wires, of_sides, k)

