"""One wire: its phase (eqs. 10, 11 and the contract's kinetics of incomplete loops), its stress by
the constitutive law of Liang and Rogers (eqs. 6 to 9), and the current through it (eq. 3).

The rule of the phase, between reversals of the temperature. The two ramps of the contract are

    f = cos^2[pi/2 (T - A_s - sigma/C_A)/(A_f - A_s)],   1 below and 0 above its range,
    g = sin^2[pi/2 (T - M_f - sigma/C_M)/(M_s - M_f)],   0 below and 1 above its range,

and xi_r, f_r, g_r are xi, f, g at the last reversal, at the stress of that moment:

    T rising:   xi     = max[xi_r f/f_r,       min(1 - g/g_r, f)]
    T falling:  1 - xi = max[(1 - xi_r) g/g_r, min(1 - f/f_r, g)]

The first terms are the contract's. The second ones matter only when stress moves a range
against the direction of the temperature (a rising wire whose g falls below g_r), so in any
history at constant stress they are inactive, whatever the order of the ranges. They keep
the fraction going continuously to 1 below both ranges and to 0 above both. The second line is
the first with the phases and the ramps exchanged.

Three details keep it continuous in every case. xi stays within [0, 1]. Above A_f, where f_r = 0,
some martensite can be left if M_s lies higher still: then f/f_r is replaced by (1 - g)/(1 - g_r),
the cooling curve traced back; mirrored below M_f. Where M_s (with stress) lies above A_f,
eqs. (10) and (11) contradict "xi = 0 above A_f", and the equations win on cooling.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtr

from sma_bench.parameters import Parameters
from sma_bench.physics.effects.phase_dependent_resistance import LEAST

Array = NDArray[np.float64]

# Of `wire.transition_tail`: deviation of the cosine's distribution over a range of 1, and where the
# normal distribution of the same deviation is cut off, in deviations.
NORMAL_DEVIATION = float(np.sqrt(0.25 - 2.0 / np.pi**2))
NORMAL_REACH = 5.0
# Of `wire.transition_spread`: where the outer groups of grains lie, in deviations; share of each.
GRAIN, OUTER = float(np.sqrt(3.0)), 1.0 / 6.0


def austenite_ramp(temperature: ArrayLike, stress: ArrayLike, parameters: Parameters) -> Array:
    """f(T, sigma): 1 below A_s + sigma/C_A, 0 above A_f + sigma/C_A, eq. (10) between.

    Args:
        temperature: T [K]; stress: sigma [Pa]; broadcast against each other.
    """
    start = parameters["wire.austenite_start_temperature"]
    finish = parameters["wire.austenite_finish_temperature"]
    shift = np.asarray(stress, float) / parameters["wire.stress_influence_austenite"]
    below = finish - np.asarray(temperature, float) + shift
    return _smooth_ramp(below, finish - start, parameters)


def martensite_ramp(temperature: ArrayLike, stress: ArrayLike, parameters: Parameters) -> Array:
    """g(T, sigma): 0 below M_f + sigma/C_M, 1 above M_s + sigma/C_M, 1 - eq. (11) between.

    Args:
        temperature: T [K]; stress: sigma [Pa]; broadcast against each other.
    """
    start = parameters["wire.martensite_start_temperature"]
    finish = parameters["wire.martensite_finish_temperature"]
    shift = np.asarray(stress, float) / parameters["wire.stress_influence_martensite"]
    above = np.asarray(temperature, float) - shift - finish
    return _smooth_ramp(above, start - finish, parameters)


def heated_fraction(temperature: ArrayLike, stress: ArrayLike, parameters: Parameters) -> Array:
    """Martensite fraction on heating from martensite, eq. (10)."""
    return austenite_ramp(temperature, stress, parameters)


def cooled_fraction(temperature: ArrayLike, stress: ArrayLike, parameters: Parameters) -> Array:
    """Martensite fraction on cooling from austenite, eq. (11)."""
    return 1.0 - martensite_ramp(temperature, stress, parameters)


def fraction_since_reversal(
    rising: bool, fraction_reversed: float, ramps_reversed: tuple[float, float],
    ramps: tuple[float, float],
) -> float:
    """Martensite fraction from the state at the last reversal: the rule of this module.

    Args:
        rising: the temperature rises since the reversal.
        fraction_reversed: xi_r.
        ramps_reversed, ramps: (f, g) at the reversal and now.
    """
    f, g = ramps
    f_reversed, g_reversed = ramps_reversed
    if rising:
        return _left(fraction_reversed, f, f_reversed, g, g_reversed)
    return 1.0 - _left(1.0 - fraction_reversed, g, g_reversed, f, f_reversed)


def _left(
    phase: float, own: float, own_reversed: float, other: float, other_reversed: float
) -> float:
    """What is left of the phase that vanishes, given its own ramp and the other's."""
    if own_reversed > 0.0:
        left = phase * own / own_reversed
    elif phase > 0.0 and other_reversed < 1.0:
        left = phase * (1.0 - other) / (1.0 - other_reversed)
    else:
        left = 0.0
    if other < other_reversed:
        left = max(left, min(1.0 - other / other_reversed, own))
    return min(left, 1.0)


def _smooth_ramp(distance: Array, width: float, parameters: Parameters) -> Array:
    """Ramp of grains that do not transform alike: their temperatures are normally distributed with
    the deviation `wire.transition_spread`, as three groups (Gauss and Hermite's); a share
    `wire.transition_tail` has a normal distribution for a ramp, which the cosine's is nearly."""
    spread, tail = parameters["wire.transition_spread"] / width, parameters["wire.transition_tail"]
    position = distance / width
    share = _ramp(position)
    if spread > 0.0:
        outer = _ramp(position + GRAIN * spread) + _ramp(position - GRAIN * spread)
        share = share + OUTER * (outer - 2.0 * share)
    if tail > 0.0:
        deviations = (position - 0.5) / np.hypot(NORMAL_DEVIATION, spread)
        least = ndtr(-NORMAL_REACH)
        shares = ndtr(np.clip(deviations, -NORMAL_REACH, NORMAL_REACH))
        share = share + tail * (np.asarray((shares - least) / (1.0 - 2.0 * least)) - share)
    return share


def _ramp(position: Array) -> Array:
    # sin^2 keeps relative precision near 0, which (1 - cos)/2 loses: ratios of ramps are taken.
    return np.square(np.sin(0.5 * np.pi * np.clip(position, 0.0, 1.0)))


# --- stress


def modulus(martensite_fraction: ArrayLike, parameters: Parameters) -> Array:
    """E(xi) [Pa], eq. (7)."""
    austenite = parameters["wire.austenite_modulus"]
    change = parameters["wire.martensite_modulus"] - austenite
    return np.asarray(austenite + np.asarray(martensite_fraction, float) * change)


def transformation_coefficient(martensite_fraction: ArrayLike, parameters: Parameters) -> Array:
    """Omega [Pa], eq. (9)."""
    return -parameters["wire.maximum_recoverable_strain"] * modulus(martensite_fraction, parameters)


def clamped_stress(temperature: ArrayLike, parameters: Parameters) -> Array:
    """Stress [Pa] of a clamped wire at T [K] before it transforms, eq. (8)."""
    rise = np.asarray(temperature, float) - parameters["environment.ambient_temperature"]
    return np.asarray(parameters["wire.thermal_expansion_factor"] * rise)


def stress(
    temperature: ArrayLike, martensite_fraction: ArrayLike, contraction: ArrayLike,
    parameters: Parameters,
) -> Array:
    """sigma [Pa], eq. (6) from sigma = 0, xi = 1 and ambient temperature at rest.

    Args:
        temperature: T [K]; martensite_fraction: xi; broadcast against each other.
        contraction: -(eps - eps_0), positive when the wire is shorter than at rest.
    """
    xi = np.asarray(martensite_fraction, float)
    elastic = -modulus(xi, parameters) * np.asarray(contraction, float)
    transformed = transformation_coefficient(xi, parameters) * (xi - 1.0)
    return np.asarray(elastic + clamped_stress(temperature, parameters) + transformed)


# --- current

_CHANGE = "effect.phase_dependent_resistance.austenite_change"
_SLOPE = "effect.phase_dependent_resistance.temperature_coefficient"


def current(
    parameters: Parameters, voltage: ArrayLike, temperature: ArrayLike, fraction: ArrayLike
) -> NDArray[np.float64]:
    """I = n V/(R(xi, T) + n R_s) through the n wires of a channel; with all effects off eq. (3).

    A current source holds it whatever the resistance; of a duty it is the mean.

    Args:
        voltage: V, as the driver reads it or is commanded (`heat.heating_voltage`); temperature: K;
            fraction: of martensite; any shape.
    """
    volts, kelvin, xi = (np.asarray(a, dtype=np.float64) for a in (voltage, temperature, fraction))
    count = parameters["wire.count"]
    resistance = parameters["wire.resistance"]
    if parameters[_CHANGE] or parameters[_SLOPE]:
        of_phase = 1.0 + parameters[_CHANGE] * (1.0 - xi)
        rise = kelvin - parameters["environment.ambient_temperature"]
        resistance = resistance * of_phase * np.maximum(1.0 + parameters[_SLOPE] * rise, LEAST)
    else:
        volts = np.broadcast_to(volts, np.broadcast_shapes(volts.shape, kelvin.shape, xi.shape))
    if parameters["bench.drive"] == "current":
        return np.asarray(count * volts / parameters["wire.resistance"])
    leads = parameters["bench.lead_resistance"] + parameters["effect.supply_drop.resistance"]
    return np.asarray(count * volts / (resistance + count * leads))
