"""One wire: its heat (eqs. 1 to 5), its phase (eqs. 10, 11 and the contract's kinetics of
incomplete loops), its stress by the constitutive law of Liang and Rogers (eqs. 6 to 9).

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
eqs. (10) and (11) contradict "xi = 0 above A_f", and the equations win on cooling."""

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import ndtr

from sma_bench.arrays import Array
from sma_bench.compiled import borrowing
from sma_bench.parameters import Parameters
from sma_bench.parameters.parameter import EFFECTS, SOURCES
from sma_bench.parameters.parameters import OXIDISED, REFERENCE_EXCESS, free_exponent, radiation
from sma_bench.physics import columns as at
from sma_bench.physics.effects.phase_dependent_resistance import LEAST
from sma_bench.physics.effects.transformation_law import mixture
from sma_bench.physics.laws import law_of, shifting_stress

# Of `wire.transition_tail`: deviation of the cosine's distribution over a range of 1, and where the
# normal distribution of the same deviation is cut off, in deviations.
NORMAL_DEVIATION = float(np.sqrt(0.25 - 2.0 / np.pi**2))
NORMAL_REACH = 5.0
# Of `wire.transition_spread`: where the outer groups of grains lie, in deviations; share of each.
GRAIN, OUTER = float(np.sqrt(3.0)), 1.0 / 6.0


def austenite_ramp(temperature: ArrayLike, stress: ArrayLike, parameters: Parameters) -> Array:
    """f(T [K], sigma [Pa]) of the full loop: 1 below A_s + sigma/C_A, 0 above A_f + sigma/C_A, eq.
    (10) between; of another `wire.law` as its file has it."""
    finish = parameters["wire.austenite_finish_temperature"]
    shift = shifting_stress(stress, parameters)[0] / parameters["wire.stress_influence_austenite"]
    below = finish - np.asarray(temperature, float) + shift
    return _smooth_ramp(below, finish - parameters["wire.austenite_start_temperature"], parameters)


def martensite_ramp(temperature: ArrayLike, stress: ArrayLike, parameters: Parameters) -> Array:
    """g(T [K], sigma [Pa]): 0 below M_f + sigma/C_M, 1 above M_s + sigma/C_M, 1 less eq. (11)."""
    finish = parameters["wire.martensite_finish_temperature"]
    shift = shifting_stress(stress, parameters)[1] / parameters["wire.stress_influence_martensite"]
    above = np.asarray(temperature, float) - shift - finish
    return _smooth_ramp(above, parameters["wire.martensite_start_temperature"] - finish, parameters)


heated_fraction = austenite_ramp  # from martensite, eq. (10)


def cooled_fraction(temperature: ArrayLike, stress: ArrayLike, parameters: Parameters) -> Array:
    """Martensite fraction on cooling from austenite, eq. (11)."""
    return 1.0 - martensite_ramp(temperature, stress, parameters)


def _smooth_ramp(distance: Array, width: float, parameters: Parameters) -> Array:
    """Ramp of grains that do not transform alike: their temperatures are normally distributed with
    the deviation `wire.transition_spread`, as three groups (Gauss and Hermite's); a share
    `wire.transition_tail` has a normal distribution for a ramp, which the cosine's is nearly."""
    spread, tail = parameters["wire.transition_spread"] / width, parameters["wire.transition_tail"]
    position, ramp = distance / width, law_of(parameters).share
    share = ramp(position)
    if spread > 0.0:
        outer = ramp(position + GRAIN * spread) + ramp(position - GRAIN * spread)
        share = share + OUTER * (outer - 2.0 * share)
    if tail > 0.0:
        deviations = (position - 0.5) / np.hypot(NORMAL_DEVIATION, spread)
        least = ndtr(-NORMAL_REACH)
        shares = ndtr(np.clip(deviations, -NORMAL_REACH, NORMAL_REACH))
        share = share + tail * (np.asarray((shares - least) / (1.0 - 2.0 * least)) - share)
    if EFFECTS["transformation_law"].is_on(parameters):
        share = mixture(position, share, parameters)
    return share


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


def stress(temperature: ArrayLike, martensite_fraction: ArrayLike, contraction: ArrayLike,
           parameters: Parameters) -> Array:
    """sigma [Pa], eq. (6) from sigma = 0, xi = 1 and ambient temperature at rest; T [K], xi and the
    contraction -(eps - eps_0) broadcast against each other."""
    xi = np.asarray(martensite_fraction, float)
    elastic = -modulus(xi, parameters) * np.asarray(contraction, float)
    transformed = transformation_coefficient(xi, parameters) * (xi - 1.0)
    return np.asarray(elastic + clamped_stress(temperature, parameters) + transformed)


# --- Heat, and what drives it.

def current(parameters: Parameters, voltage: ArrayLike, temperature: ArrayLike, fraction: ArrayLike,
            sag: ArrayLike = 0.0) -> Array:
    """I = n (V - u)/(R(xi, T) + n R_s) through the n wires of a channel whose battery sags by u
    [V]; eq. (3) with all effects off. `voltage`: as read or commanded, any shape; a source of
    current holds it whatever the resistance, one of power sqrt(P/R); of a duty it is the mean."""
    volts, kelvin, xi = (np.asarray(a, dtype=np.float64) for a in (voltage, temperature, fraction))
    names = ("austenite_change", "hump", "temperature_coefficient", "martensite_coefficient")
    change, hump, growth, of_martensite = (parameters[f"effect.phase_dependent_resistance.{name}"]
                                           for name in names)
    count, shape = parameters["wire.count"], np.broadcast_shapes(kelvin.shape, xi.shape)
    resistance = np.full(shape, parameters["wire.resistance"])
    if parameters["bench.drive"] == "current":
        return np.asarray(count * volts / resistance)
    if change or growth or hump or of_martensite:
        rise = kelvin - parameters["environment.ambient_temperature"]
        of_phase = 1.0 + change * (1.0 - xi)
        if hump != 0.0:
            of_phase = np.maximum(of_phase + 4.0 * hump * xi * (1.0 - xi), LEAST)
        of_heat = np.maximum(1.0 + (growth + of_martensite * xi) * rise, LEAST)
        resistance = resistance * of_phase * of_heat
    if parameters["bench.drive"] == "power":
        return np.asarray(count * volts / np.sqrt(parameters["wire.resistance"] * resistance))
    leads = parameters["bench.lead_resistance"] + parameters["effect.supply_drop.resistance"]
    resists = resistance + count * leads
    if parameters["effect.supply_drop.battery"]:
        volts = np.maximum(volts - np.asarray(sag, dtype=np.float64), 0.0)
    found = count * volts / resists
    if overload := count * parameters["effect.supply_drop.overload"]:
        knee = parameters["effect.supply_drop.knee"]
        beyond = (count * volts + overload * knee) / (resists + overload)
        found = np.where(found > knee, beyond, found)
    return np.asarray(found)


def heating_voltage(voltage: ArrayLike, parameters: Parameters) -> Array:
    """Volts whose square heats as the drive does, of commanded V, any shape: of a duty the mean,
    duty times `bench.supply_voltage`; of a source of current that times `wire.resistance /
    wire.count`, of one of power the root of that product."""
    volts = np.asarray(voltage, dtype=np.float64)
    if parameters["bench.drive"] == "duty":
        return np.sqrt(np.maximum(volts, 0.0) * parameters["bench.supply_voltage"])
    return volts


def commanded_voltage(volts: ArrayLike, parameters: Parameters) -> Array:
    """Inverse of `heating_voltage`: the command that heats as direct `volts` do."""
    direct = np.asarray(volts, dtype=np.float64)
    if parameters["bench.drive"] == "duty":
        return np.square(direct) / parameters["bench.supply_voltage"]
    return direct


def power_per_volt(voltage: ArrayLike, parameters: Parameters) -> Array:
    """Change of a wire's heat [W] per volt of the command, at a command [V]."""
    volts = np.asarray(voltage, dtype=np.float64)
    if parameters["bench.drive"] == "duty":
        volts = np.full_like(volts, 0.5 * parameters["bench.supply_voltage"])
    return 2.0 * volts / heated_resistance(parameters)


def direct_reading(parameters: Parameters, voltage: ArrayLike,
                   current: ArrayLike) -> tuple[Array, Array]:
    """What a record holds of a drive of V and A (of a duty the means; any shape): the direct
    voltage and current of the same heat, whose quotient is the resistance."""
    mean, amperes = (np.asarray(a, dtype=np.float64) for a in (voltage, current))
    if parameters["bench.drive"] == "power":
        watts = np.square(mean) * parameters["wire.count"] / parameters["wire.resistance"]
        return np.divide(watts, amperes, out=np.zeros_like(mean), where=amperes > 0.0), amperes
    volts = heating_voltage(mean, parameters)
    return volts, amperes * np.divide(volts, mean, out=np.ones_like(mean), where=mean > 0.0)


def heated_resistance(parameters: Parameters) -> float:
    """V^2 over the heat of one wire [ohm], where the voltage is that before the leads."""
    wire = float(parameters["wire.resistance"])
    leads = float(parameters["wire.count"] * parameters["bench.lead_resistance"])
    if leads == 0.0 or parameters["bench.drive"] in SOURCES:
        return wire
    return (wire + leads) ** 2 / wire


def heat_loss(parameters: Parameters) -> float:
    """h A_c [W/K]."""
    return float(parameters["wire.heat_transfer_coefficient"] * parameters["wire.surface_area"])


def time_constant(parameters: Parameters) -> float:
    """m c_p/(h A_c) [s]."""
    return float(parameters["wire.mass"] * parameters["wire.specific_heat"] / heat_loss(parameters))


def steady_temperature(voltage: ArrayLike, parameters: Parameters) -> Array:
    """T [K] that a held direct voltage [V] leads to, eq. (4) solved for T."""
    rise = np.square(voltage) / (heated_resistance(parameters) * heat_loss(parameters))
    return np.asarray(parameters["environment.ambient_temperature"] + rise)


# --- Free convection and radiation of a wire in still air, `wire.convection: free`:
#
#     h A_c = C [(x^2 + 2^2)/(60^2 + 2^2)]^(n/2) + e s A_c (T + T_inf)(T^2 + T_inf^2)
#
# x = T - T_inf in K, rounded within 2 K; n by the wire's diameter (parameters/parameters.py); e =
# 0.4, s Stefan and Boltzmann's constant. C is what is left of `wire.heat_transfer_coefficient` A_c,
# which holds 60 K above ambient. Source: Churchill and Chu 1975; Morgan 1975: n 0.15 if as thin.

_ROUNDED = 2.0  # K
_MOST = 0.9  # of a small coefficient, that radiation can be


def note_free(row: Array, p: Parameters) -> None:
    """Write the loss of free convection into the row of a wire."""
    ambient, total = p["environment.ambient_temperature"], heat_loss(p)
    area, hot = p["wire.surface_area"], ambient + REFERENCE_EXCESS
    radiated = min(radiation(OXIDISED, hot, ambient) * area, _MOST * total)
    row[at.RADIATION] = radiated / ((hot + ambient) * (hot**2 + ambient**2))
    exponent = 0.5 * free_exponent(p["wire.diameter"], ambient)
    reference = REFERENCE_EXCESS**2 + _ROUNDED**2
    row[at.CONVECTION_EXPONENT], row[at.HEATED_OTHERWISE] = exponent, 1.0
    row[at.CONVECTION] = (total - radiated) / reference**exponent


@borrowing
def free_loss(wires: Array, i: int, excess: float) -> float:
    """Heat loss of wire i [W/K] at a surface `excess` K above the air."""
    power = (excess * excess + _ROUNDED * _ROUNDED) ** wires[i, at.CONVECTION_EXPONENT]
    air, surface = wires[i, at.AMBIENT], wires[i, at.AMBIENT] + excess
    radiated = wires[i, at.RADIATION] * (surface + air) * (surface * surface + air * air)
    return wires[i, at.CONVECTION] * power + radiated
