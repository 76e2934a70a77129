"""Silicone around the wire (temperature E) and a clamp (K), which warm with it.

    m c_p dT/dt = ... - G (T - E),    C_e dE/dt = G (T - E) - G_a (E - T_inf) [- G_c (E - E_other)]

A clamp takes heat from the wire or, if there is silicone, from that:

    ... - G_k (T - K),    t_k dK/dt = T - K

G and G_a in series equal the paper's h A_c, so that steady temperatures do not change. 1/G is the
share `inner_share` of 1/(h A_c). Heat coupling between the sides passes through the silicone; an h
that depends on temperature acts on G_a. Source: two-node model of a wire in an elastomer, solved
exactly for constant heat, air and opposite silicone during a step."""

import math

from sma_bench.compiled import borrowing
from sma_bench.physics import columns as at
from sma_bench.physics.effects.latent_heat import latent_rise

_LEAST = 1e-9  # J/K; less has no effect, but rates out of range


@borrowing
def warmed(wires, i, step):
    """Share of the difference to a constant temperature that the clamp covers in a step."""
    return -math.expm1(-step / wires[i, at.CLAMP_TIME])


@borrowing
def combine_sinks(wires, i, opposite, step):
    """Combine the heat sinks of wire i other than air, the side `opposite` [K] and the clamp, into
    one conductance and temperature for a step; the clamp's is its mean over the step."""
    across, clamp = wires[i, at.ACROSS], wires[i, at.CLAMP_CONDUCTANCE]
    wires[i, at.BESIDE], wires[i, at.BESIDE_TEMPERATURE] = across, opposite
    if clamp > 0.0:
        clamp *= warmed(wires, i, step) * wires[i, at.CLAMP_TIME] / step
        wires[i, at.BESIDE] = across + clamp
        warm = across * opposite + clamp * (wires[i, at.AMBIENT] + wires[i, at.CLAMP_RISE])
        wires[i, at.BESIDE_TEMPERATURE] = warm / (across + clamp)


@borrowing
def heat_with_silicone(wires, i, heating, loss, air, step):
    """Solve wire and silicone at the end of the step, the part that is independent of xi; returns
    the wire's temperature [K] and sets its decay to 0. `loss`: h A_c at the surface."""
    share, across = wires[i, at.MATRIX_INNER_SHARE], wires[i, at.BESIDE]
    inner, outer = wires[i, at.LOSS] / share, loss / (1.0 - share)
    opposite = wires[i, at.BESIDE_TEMPERATURE]
    steady_matrix = (heating + outer * air + across * opposite) / (outer + across)
    steady_wire = steady_matrix + heating / inner
    wire = wires[i, at.TEMPERATURE] - steady_wire
    matrix = wires[i, at.MATRIX_RISE] + wires[i, at.AMBIENT] - steady_matrix
    # d(wire)/dt = -a (wire - matrix),  d(matrix)/dt = b wire - c matrix
    a = inner / wires[i, at.CAPACITY]
    capacity = max(wires[i, at.MATRIX_CAPACITY], _LEAST)
    b, outward = inner / capacity, (outer + across) / capacity
    c = b + outward
    fast = -0.5 * (a + c) - math.sqrt(0.25 * (a - c) ** 2 + a * b)
    slow = a * outward / fast
    apart = slow - fast
    slow_change, fast_change = math.expm1(slow * step), math.expm1(fast * step)
    slow_decay, fast_decay = 1.0 + slow_change, 1.0 + fast_change
    slow_mean, fast_mean = slow_change / (slow * step), fast_change / (fast * step)
    wires[i, at.DECAY] = 0.0
    wires[i, at.LAG] = -(a + fast) * slow_mean + (a + slow) * fast_mean
    wires[i, at.LAG] *= latent_rise(wires, i) / apart
    wires[i, at.MATRIX_LAG] = latent_rise(wires, i) * b * (slow_mean - fast_mean) / apart
    # exp(A t) = [exp(slow t) (A - fast) - exp(fast t) (A - slow)] / (slow - fast)
    of_wire = slow_decay * (a * matrix - (a + fast) * wire)
    of_wire -= fast_decay * (a * matrix - (a + slow) * wire)
    of_matrix = slow_decay * (b * wire - (c + fast) * matrix)
    of_matrix -= fast_decay * (b * wire - (c + slow) * matrix)
    wires[i, at.MATRIX_START] = steady_matrix - wires[i, at.AMBIENT] + of_matrix / apart
    return steady_wire + of_wire / apart


@borrowing
def after_step(wires, i, fraction_before, step):
    """After a step: update the silicone and the clamp of wire i."""
    if wires[i, at.MATRIX_CAPACITY] > 0.0:
        lag = wires[i, at.MATRIX_LAG] * (wires[i, at.FRACTION] - fraction_before)
        wires[i, at.MATRIX_RISE] = wires[i, at.MATRIX_START] + lag
    if wires[i, at.CLAMP_CONDUCTANCE] > 0.0:
        inside = wires[i, at.TEMPERATURE] - wires[i, at.AMBIENT]
        inside = wires[i, at.MATRIX_RISE] if wires[i, at.MATRIX_CAPACITY] > 0.0 else inside
        wires[i, at.CLAMP_RISE] += warmed(wires, i, step) * (inside - wires[i, at.CLAMP_RISE])
