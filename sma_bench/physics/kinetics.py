"""The martensite fraction of a wire by its law, compiled: eqs. (10), (11), and the contract's rule
for incomplete loops. The two ramps of the contract's law are

    f = cos^2[pi/2 (T - A_s - sigma/C_A)/(A_f - A_s)],   1 below and 0 above its range,
    g = sin^2[pi/2 (T - M_f - sigma/C_M)/(M_s - M_f)],   0 below and 1 above its range,

and xi_r, f_r, g_r are xi, f, g at the last temperature reversal, with the stress at that time:

    T rising:   xi     = max[xi_r f/f_r,       min(1 - g/g_r, f)]
    T falling:  1 - xi = max[(1 - xi_r) g/g_r, min(1 - f/f_r, g)]

The first terms are the contract's. The second ones matter only when stress moves a range
against the direction of the temperature (a rising wire whose g falls below g_r), so in any
history at constant stress they are inactive, whatever the order of the ranges. They let
the fraction go continuously to 1 below both ranges and to 0 above both. The second line is the
first with the phases and the ramps exchanged.

Three details keep it continuous in every case. xi stays within [0, 1]. Above A_f, where f_r = 0,
some martensite can be left if M_s lies higher still: then f/f_r is replaced by (1 - g)/(1 - g_r),
the cooling curve traced back; mirrored below M_f. Where M_s (with stress) lies above A_f,
eqs. (10) and (11) contradict "xi = 0 above A_f", and the equations win on cooling."""

import math

from sma_bench.compiled import borrowing, inlined
from sma_bench.parameters.parameter import LAWS
from sma_bench.physics import columns as at
from sma_bench.physics.effects import partial_transformation as partial
from sma_bench.physics.effects.stress_dependent_transition import bent
from sma_bench.physics.effects.transformation_law import mixed
from sma_bench.physics.effects.transition_drift import drifts, shift_transition
from sma_bench.physics.laws import brinson, cosine, exponential, extended, logistic, normal

_, EXPONENTIAL, LOGISTIC, NORMAL, BRINSON, EXTENDED = range(len(LAWS))
SQRT_2, SQRT_2_PI = math.sqrt(2.0), math.sqrt(2.0 * math.pi)
# `wire.transition_spread`: normally distributed grains as three groups (Gauss-Hermite quadrature):
# distance of the outer groups in deviations, and the share of each of them.
GRAIN, OUTER = math.sqrt(3.0), 1.0 / 6.0
# `wire.transition_tail`: deviation of the cosine's distribution over a range of 1, and where the
# normal distribution of the same deviation is cut off, in deviations.
NORMAL_DEVIATION, NORMAL_REACH = math.sqrt(0.25 - 2.0 / math.pi**2), 5.0
NORMAL_REST = 0.5 * math.erfc(NORMAL_REACH / SQRT_2)  # share of the grains beyond each cut


@inlined
def cosine_ramp(wires, i, position, spread):
    """Ramp of the cosine law with its spread, tail and mixture, and its slope."""
    share, slope = cosine.ramp(position)
    if spread > 0.0:
        early, early_slope = cosine.ramp(position + GRAIN * spread)
        late, late_slope = cosine.ramp(position - GRAIN * spread)
        share += OUTER * (early + late - 2.0 * share)
        slope += OUTER * (early_slope + late_slope - 2.0 * slope)
    tail = wires[i, at.TAIL]
    if tail != 0.0:
        of_normal, normal_slope = normal_ramp(position, spread)
        share += tail * (of_normal - share)
        slope += tail * (normal_slope - slope)
    if wires[i, at.LOGISTIC_SHARE] + wires[i, at.EXPONENTIAL_SHARE] > 0.0:
        return mixed(wires, i, position, share, slope)
    return share, slope


@borrowing
def normal_ramp(position, spread):
    """Ramp of normally distributed grains, cut off at NORMAL_REACH deviations, and its slope."""
    deviation = math.sqrt(NORMAL_DEVIATION * NORMAL_DEVIATION + spread * spread)
    away = (position - 0.5) / deviation
    if away <= -NORMAL_REACH:
        return 0.0, 0.0
    if away >= NORMAL_REACH:
        return 1.0, 0.0
    scale = 1.0 / (1.0 - 2.0 * NORMAL_REST)
    share = (0.5 * math.erfc(-away / SQRT_2) - NORMAL_REST) * scale
    return share, math.exp(-0.5 * away * away) / (SQRT_2_PI * deviation) * scale


@borrowing
def any_ramp(wires, i, position, spread):
    """Ramp of wire i's law, and its slope."""
    law = wires[i, at.LAW]
    if law == EXPONENTIAL:
        return exponential.ramp(position)
    if law == LOGISTIC:
        return logistic.ramp(position)
    if law == NORMAL:
        return normal.ramp(position)
    return extended.ramp(position) if law == EXTENDED else cosine_ramp(wires, i, position, spread)


@inlined
def baseline_shifting(wires, i, stress):
    """Stress that shifts the heating range, its slope; the same for cooling: all of the stress."""
    shifts, slope = bent(wires, i, stress)
    return shifts, slope, shifts, slope


@borrowing
def any_shifting(wires, i, stress):
    """As `baseline_shifting`, for the law of wire i."""
    shifts, slope = bent(wires, i, stress)
    on_f, f_slope, on_g, g_slope = shifts, 1.0, shifts, 1.0
    if wires[i, at.LAW] == BRINSON:
        on_f, f_slope, on_g, g_slope = brinson.shifting(wires, i, shifts)
    elif wires[i, at.LAW] == EXTENDED:
        on_f, f_slope, on_g, g_slope = extended.shifting(wires, i, shifts)
    return on_f, f_slope * slope, on_g, g_slope * slope


@inlined
def positions(wires, i, temperature, on_f, on_g):
    """Positions of T on the ramps f and g, which the stresses on_f and on_g shift."""
    of_f = wires[i, at.AUSTENITE_FINISH] - temperature + on_f * wires[i, at.AUSTENITE_SHIFT]
    of_g = temperature - on_g * wires[i, at.MARTENSITE_SHIFT] - wires[i, at.MARTENSITE_FINISH]
    return of_f * wires[i, at.AUSTENITE_SLOPE], of_g * wires[i, at.MARTENSITE_SLOPE]


def rule_of(ramp, shifting):
    """The rule in the docstring above, for a law's ramp and the stresses that shift its ranges."""

    @inlined
    def phase_left(wires, i, own, other, own_spread, other_spread):
        """Fraction left of the vanishing phase, and its slopes along both positions."""
        phase, own_reversed = wires[i, at.PHASE_REVERSED], wires[i, at.OWN_REVERSED]
        other_reversed = wires[i, at.OTHER_REVERSED]
        share, share_slope = ramp(wires, i, own, own_spread)
        left, by_own, by_other = 0.0, 0.0, 0.0
        if own_reversed > 0.0:
            scale = phase / own_reversed
            left, by_own = share * scale, share_slope * scale
            if wires[i, at.RETURN_POINT] != 0.0:
                left, by_own = partial.towards_turn(wires, i, share, share_slope)
            if wires[i, at.MEMORY] != 0.0:
                memory = wires[i, at.MEMORY]
                of_grains, by_share = partial.left_of_grains(phase, share, own_reversed, memory)
                left += of_grains - share * scale
                by_own += (by_share - scale) * share_slope
                if left > phase and share < own_reversed:  # if a return point is on too
                    left, by_own = phase, 0.0
        elif phase > 0.0 and other_reversed < 1.0:
            scale = phase / (1.0 - other_reversed)
            rest, rest_slope = ramp(wires, i, other, other_spread)
            left, by_other = (1.0 - rest) * scale, -rest_slope * scale
        # The other ramp is computed only if stress has moved it back.
        if other < wires[i, at.OTHER_POSITION_REVERSED] and other_reversed > 0.0 and share > left:
            rest, rest_slope = ramp(wires, i, other, other_spread)
            bound = 1.0 - rest / other_reversed
            if bound >= share:
                left, by_own, by_other = share, share_slope, 0.0
            elif bound > left:
                left, by_own, by_other = bound, 0.0, -rest_slope / other_reversed
        return (1.0, 0.0, 0.0) if left > 1.0 else (left, by_own, by_other)

    @inlined
    def by_rule(wires, i, temperature, stress):
        """xi of wire i, d xi/dT and d xi/d sigma."""
        on_f, f_slope, on_g, g_slope = shifting(wires, i, stress)
        of_f, of_g = positions(wires, i, temperature, on_f, on_g)
        f_spread, g_spread = wires[i, at.AUSTENITE_SPREAD], wires[i, at.MARTENSITE_SPREAD]
        # A single call, because it is inlined into every loop that solves for xi.
        rising = wires[i, at.TREND] > 0.0
        own, other, own_spread, other_spread = of_f, of_g, f_spread, g_spread
        if not rising:
            own, other, own_spread, other_spread = of_g, of_f, g_spread, f_spread
        xi, by_f, by_g = phase_left(wires, i, own, other, own_spread, other_spread)
        if not rising:
            xi, by_f, by_g = 1.0 - xi, -by_g, -by_f
        by_f *= wires[i, at.AUSTENITE_SLOPE]
        by_g *= wires[i, at.MARTENSITE_SLOPE]
        by_stress = by_f * wires[i, at.AUSTENITE_SHIFT] * f_slope
        by_stress -= by_g * wires[i, at.MARTENSITE_SHIFT] * g_slope
        return xi, by_g - by_f, by_stress

    return by_rule


by_cosine = rule_of(cosine_ramp, baseline_shifting)
by_any_ramp = rule_of(any_ramp, any_shifting)


@borrowing
def of_other_law(wires, i, temperature, stress):
    """As `fraction`, for a law other than the baseline's."""
    if wires[i, at.LAW] == NORMAL:
        return normal.fraction(wires, i, temperature, stress)
    return by_any_ramp(wires, i, temperature, stress)


@inlined
def fraction(wires, i, temperature, stress):
    """xi of wire i, d xi/dT, d xi/d sigma; only the baseline is inlined into innermost loops."""
    if wires[i, at.LAW] != 0.0:
        return of_other_law(wires, i, temperature, stress)
    return by_cosine(wires, i, temperature, stress)


@inlined
def ramps(wires, i, temperature, stress):
    """f and g of wire i, and its positions on them."""
    on_f, _, on_g, _ = any_shifting(wires, i, stress)
    of_f, of_g = positions(wires, i, temperature, on_f, on_g)
    f = any_ramp(wires, i, of_f, wires[i, at.AUSTENITE_SPREAD])[0]
    return f, any_ramp(wires, i, of_g, wires[i, at.MARTENSITE_SPREAD])[0], of_f, of_g


@borrowing
def full_loop(wires, temperature, stress, f, g):
    """Write the ramps f, g (n,) of the first wire at temperatures [K] and stresses [Pa] (n,)."""
    for k in range(temperature.size):
        f[k], g[k], _, _ = ramps(wires, 0, temperature[k], stress[k])


@borrowing
def reverse(wires, i, trend):
    """Make the present state of wire i the state of the last reversal."""
    if drifts(wires, i):
        wires[i, at.TURNED_CYCLES] = wires[i, at.CYCLES]
        shift_transition(wires, i)
    f, g, of_f, of_g = ramps(wires, i, wires[i, at.TEMPERATURE], wires[i, at.STRESS])
    if wires[i, at.RETURN_POINT] != 0.0:
        partial.remember_turn(wires, i, f, g)
    phase = wires[i, at.FRACTION]
    if trend <= 0.0:
        phase, f, g, of_g = 1.0 - phase, g, f, of_f
    wires[i, at.TREND], wires[i, at.CHANGE], wires[i, at.PHASE_REVERSED] = trend, 0.0, phase
    wires[i, at.OWN_REVERSED], wires[i, at.OTHER_REVERSED] = f, g
    wires[i, at.OTHER_POSITION_REVERSED] = of_g


@borrowing
def close_loops(wires, i):
    """After a step: forget the inner loops that wire i has left."""
    f, g, _, _ = ramps(wires, i, wires[i, at.TEMPERATURE], wires[i, at.STRESS])
    partial.forget_closed(wires, i, g if wires[i, at.TREND] < 0.0 else f)
