"""Grains whose transformation temperatures and widths of hysteresis are normally distributed.

A grain of centre c and half width b becomes austenite at c + b and martensite at c - b (both
shifted by stress). Five groups of shares w_j have half widths b_j about their mean; within each
the centres are normally distributed with the deviation s about c_j. The memory of a group is one
number, a generalised play (Krasnosel'skii and Pokrovskii 1989):

    p_j = max[T - sigma/C_A - b_j, min(p_j, T - sigma/C_M + b_j)]
    xi  = 1 - sum w_j Phi[(p_j - c_j)/s]

Inner loops and return-point memory follow from that (Mayergoyz 1991). The full branches are normal
distributions with A_s, A_f, M_s, M_f at 2.5 and 97.5 %: deviations D_A = (A_f - A_s)/3.92 and D_M =
(M_s - M_f)/3.92, mean half width b = (A_s + A_f - M_s - M_f)/4. With the deviation r b of the half
widths (r: `wire.hysteresis_spread`) the centres must have

    k = (D_A^2 - D_M^2)/4                         covariance with the half widths
    v = (D_A^2 + D_M^2)/2 - (r b)^2               variance
    b_j = b (1 + r z_j),   c_j = c + k/(r b)^2 (b_j - b),   s^2 = v - k^2/(r b)^2

which is possible for r b between |D_A - D_M|/2 and (D_A + D_M)/2. z_j = 1.1 (-2 ... 2); the w_j
give z the moments of the normal distribution up to the fifth; no half width is below 0.
`effect.partial_transformation` is refused with this law, which has its own inner loops.

With `wire.transition_skew` a the centres of a group follow two half normal distributions, with
deviations (1 - a) s' below and (1 + a) s' above the peak (Fechner 1897). Instead of Phi:

    (1 - a) Phi[z/(1 - a)] below,   (1 + a) Phi[z/(1 + a)] - a above,   z = (p_j - c_j)/s'

The variance stays s^2, and the four temperatures stay within half a kelvin of the 2.5 and 97.5 %
points (Cornish and Fisher 1938). `ramp` ignores a.

The clamps keep the ends of a wire cold (`wire.end_length` L, about sqrt(k d/4h)): at the distance x
from a clamp its rise above ambient is 1 - exp(-x/L) of that in the middle. Each end is modelled as
three pieces of length L, each one play of mean half width at 0.25, 0.6 or 0.9 of the rise."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.special import ndtr

from sma_bench.arrays import Array
from sma_bench.compiled import borrowing, inlined
from sma_bench.parameters.parameter import TRANSITIONS
from sma_bench.parameters.parameters import BRANCH, hysteresis, wire_length
from sma_bench.physics import columns as at
from sma_bench.physics.effects.stress_dependent_transition import bent

ENDS = (0.5 - 4.75 / BRANCH, 0.5 + 4.75 / BRANCH)  # positions; a millionth is left beyond
_AWAY = 1.1 * np.arange(-2.0, 3.0)  # z_j
# w_j: 1, 1 and 3 are a normal distribution's moments of order 0, 2 and 4.
_OUTER, _INNER = np.linalg.solve([_AWAY[:2] ** 2, _AWAY[:2] ** 4], [0.5, 1.5]).tolist()
SHARES = (_OUTER, _INNER, 1.0 - 2.0 * (_OUTER + _INNER), _INNER, _OUTER)
_WARM = (0.25, 0.6, 0.9)  # rise of the pieces of an end, relative to the middle
_MOST_COLD = 0.5  # largest share of a wire's length in its ends
_SQRT_2, _SQRT_2_PI = math.sqrt(2.0), math.sqrt(2.0 * math.pi)
_FAR = 7.0  # deviations, beyond which nothing (1e-12) is left to transform
_NARROWEST = 0.01  # K, smallest s
_OFF = 2.0 * math.sqrt(2.0 / math.pi)  # mean of the two halves minus their peak, over s' a
_WIDER = 3.0 - 8.0 / math.pi  # (s/s')^2 - 1 over a^2
_POINTS = ((0.5 * BRANCH) ** 2 - 1.0) / 6.0  # shift of both points per skewness, deviations
_HALVINGS = 60  # of the bisection in `begin`
OF_PLAYS = (at.CENTRES, at.HALF_WIDTHS, at.SHARES, at.WARMTH)


@inlined
def ramp(position):
    """Share of a full branch and its slope."""
    away = BRANCH * (position - 0.5)
    return 0.5 * math.erfc(-away / _SQRT_2), BRANCH * math.exp(-0.5 * away * away) / _SQRT_2_PI


def groups(parameters: Mapping[str, Any]) -> tuple[Array, Array, float]:
    """(PLAYS,) centres c_j (their peaks) and half widths b_j, and the deviation s', all in K."""
    heating, cooling, mean = hysteresis(parameters)
    centre = sum(parameters[name] for name in TRANSITIONS.values()) / 4.0
    deviation = parameters["wire.hysteresis_spread"] * mean
    together = (heating**2 - cooling**2) / 4.0
    slope = together / deviation**2 if deviation > 0.0 else 0.0
    variance = (heating**2 + cooling**2) / 2.0 - deviation**2 - slope * together
    away, within = deviation * _AWAY, math.sqrt(max(variance, _NARROWEST**2))
    skew, halves = parameters["wire.transition_skew"], np.maximum(mean + away, 0.0)
    if skew == 0.0:
        return centre + slope * away, halves, within
    scale = within / math.sqrt(1.0 + _WIDER * skew**2)
    third = _OFF * skew * scale**3 * (1.0 + (16.0 / math.pi - 5.0) * skew**2)  # central moment
    centre -= _OFF * skew * scale + _POINTS * third / (0.5 * (heating**2 + cooling**2))
    return centre + slope * away, halves, scale


def plays(parameters: Mapping[str, Any]) -> tuple[Array, float]:
    """(4, p) centres, half widths [K], shares of the wire and warmth (1: of its middle) of all
    plays, those of cold ends last; and the deviation s [K]."""
    centres, halves, deviation = groups(parameters)
    middle = np.array([centres, halves, SHARES, np.ones(len(SHARES))])
    if parameters["wire.end_length"] == 0.0:
        return middle, deviation
    end = min(2.0 * parameters["wire.end_length"] / wire_length(parameters), _MOST_COLD / 3.0)
    middle[2] *= 1.0 - 3.0 * end
    ends = [[np.mean(centres), np.mean(halves), end, warmth] for warmth in _WARM]
    return np.hstack([middle, np.transpose(ends)]), deviation


@inlined
def cumulative(x):
    """Phi(x) and exp(-x^2/2), within 7 deviations: Hart 1968 after West 2005, to 1e-15. They share
    one exponential, which takes half the time of an additional erfc."""
    z, density = abs(x), math.exp(-0.5 * x * x)
    above = 3.52624965998911e-2 * z + 0.700383064443688
    above = ((above * z + 6.37396220353165) * z + 33.912866078383) * z + 112.079291497871
    above = (above * z + 221.213596169931) * z + 220.206867912376
    below = (8.83883476483184e-2 * z + 1.75566716318264) * z + 16.064177579207
    below = ((below * z + 86.7807322029461) * z + 296.564248779674) * z + 637.333633378831
    below = (below * z + 793.826512519948) * z + 440.413735824752
    tail = density * above / below
    return (1.0 - tail if x > 0.0 else tail), density


@borrowing
def skewed(wires, i, away):
    """Share of a group's grains at `away` deviations from the centres' peak; exp(-x^2/2) there."""
    skew = wires[i, at.SKEW]
    wide, less = (1.0 + skew, skew) if away > 0.0 else (1.0 - skew, 0.0)
    share, density = cumulative(away / wide)
    return wide * share - less, density


@inlined
def pushed(wires, i, j, hot, cold, rise):
    """Play j of wire i at T - sigma/C_A = `hot`, T - sigma/C_M = `cold` [K], `rise` above ambient;
    1 if heating has moved it, -1 if cooling has, 0 if it stays."""
    colder = (1.0 - wires[i, at.WARMTH + j]) * rise
    hot -= colder
    cold -= colder
    half, play = wires[i, at.HALF_WIDTHS + j], wires[i, at.PLAY + j]
    if hot - half >= play:
        return hot - half, 1.0
    return (max(cold + half, hot - half), -1.0) if cold + half < play else (play, 0.0)


@inlined
def _hot_and_cold(wires, i, temperature, stress):
    moved = temperature - wires[i, at.AUSTENITE_FINISH] + wires[i, at.AUSTENITE_FINISH_FRESH]
    shifts = bent(wires, i, stress)[0]
    hot = moved - shifts * wires[i, at.AUSTENITE_SHIFT]
    return hot, moved - shifts * wires[i, at.MARTENSITE_SHIFT]


@borrowing
def fraction(wires, i, temperature, stress):
    """xi of wire i, d xi/dT and d xi/d sigma."""
    hot, cold = _hot_and_cold(wires, i, temperature, stress)
    rise = temperature - wires[i, at.AMBIENT]
    austenite, by_temperature, by_hot, by_cold = 0.0, 0.0, 0.0, 0.0
    straight = wires[i, at.SKEW] == 0.0
    for j in range(int(wires[i, at.GROUPS])):  # a variable count, so that the loop is not unrolled
        play, way = pushed(wires, i, j, hot, cold, rise)
        away = (play - wires[i, at.CENTRES + j]) * wires[i, at.SHARPNESS]
        if away > _FAR:
            austenite += wires[i, at.SHARES + j]
        elif away > -_FAR:
            share, density = cumulative(away) if straight else skewed(wires, i, away)
            austenite += wires[i, at.SHARES + j] * share
            slope = wires[i, at.SHARES + j] * density
            if way > 0.0:
                by_hot += slope
            elif way < 0.0:
                by_cold += slope
            if way != 0.0:
                by_temperature += slope * wires[i, at.WARMTH + j]
    scale = wires[i, at.SHARPNESS] / _SQRT_2_PI
    by_temperature *= scale
    scale *= bent(wires, i, stress)[1]
    by_stress = by_hot * wires[i, at.AUSTENITE_SHIFT] + by_cold * wires[i, at.MARTENSITE_SHIFT]
    return 1.0 - austenite, -by_temperature, by_stress * scale


@borrowing
def push(wires, i):
    """After a step: update the plays of wire i."""
    hot, cold = _hot_and_cold(wires, i, wires[i, at.TEMPERATURE], wires[i, at.STRESS])
    rise = wires[i, at.TEMPERATURE] - wires[i, at.AMBIENT]
    for j in range(int(wires[i, at.GROUPS])):
        wires[i, at.PLAY + j] = pushed(wires, i, j, hot, cold, rise)[0]


def begin(row: Array) -> None:
    """Set the plays of a wire's row without history: all at one level, limited by temperature and
    stress, so that they give its fraction or come nearest to it."""
    count = int(row[at.GROUPS])
    centres, halves, shares, warmth = (row[first : first + count] for first in OF_PLAYS)
    moved = row[at.TEMPERATURE] - row[at.AUSTENITE_FINISH] + row[at.AUSTENITE_FINISH_FRESH]
    moved = moved - (1.0 - warmth) * (row[at.TEMPERATURE] - row[at.AMBIENT])
    shifts = bent(row[np.newaxis], 0, row[at.STRESS])[0]
    least = moved - shifts * row[at.AUSTENITE_SHIFT] - halves
    most = moved - shifts * row[at.MARTENSITE_SHIFT] + halves
    low, high = float(least.min()), float(most.max())
    for _ in range(_HALVINGS):
        level = 0.5 * (low + high)
        away = (np.maximum(least, np.minimum(level, most)) - centres) * row[at.SHARPNESS]
        skew = np.where(away > 0.0, row[at.SKEW], -row[at.SKEW])
        done = (1.0 + skew) * ndtr(away / (1.0 + skew)) - np.where(away > 0.0, skew, 0.0)
        if 1.0 - done @ shares > row[at.FRACTION]:
            low = level
        else:
            high = level
    row[at.PLAY : at.PLAY + count] = np.maximum(least, np.minimum(high, most))
