"""One wire: its heat (eqs. 1 to 5) and its stress by the constitutive law of Liang and Rogers (eqs.
6 to 9); its phase is in kinetics.py."""

import numpy as np
from numpy.typing import ArrayLike

from sma_bench.arrays import Array
from sma_bench.compiled import borrowing
from sma_bench.parameters import Parameters
from sma_bench.parameters.parameter import SOURCES
from sma_bench.parameters.parameters import OXIDISED, REFERENCE_EXCESS, free_exponent, radiation
from sma_bench.physics import columns as at


def modulus(martensite_fraction: ArrayLike, parameters: Parameters) -> Array:
    """E(xi) [Pa], eq. (7)."""
    austenite = parameters["wire.austenite_modulus"]
    change = parameters["wire.martensite_modulus"] - austenite
    return np.asarray(austenite + np.asarray(martensite_fraction, float) * change)


def stress(temperature: ArrayLike, martensite_fraction: ArrayLike, contraction: ArrayLike,
           parameters: Parameters) -> Array:
    """sigma [Pa], eq. (6) from sigma = 0, xi = 1 and ambient temperature at rest; T [K], xi and the
    contraction -(eps - eps_0) broadcast against each other."""
    xi, e_of_xi = np.asarray(martensite_fraction, float), modulus(martensite_fraction, parameters)
    elastic = -e_of_xi * np.asarray(contraction, float)
    rise = np.asarray(temperature, float) - parameters["environment.ambient_temperature"]
    thermal = parameters["wire.thermal_expansion_factor"] * rise  # eq. (8)
    omega = -parameters["wire.maximum_recoverable_strain"] * e_of_xi  # eq. (9)
    return np.asarray(elastic + thermal + omega * (xi - 1.0))


# --- Heat, and what drives it.

def heating_voltage(voltage: ArrayLike, parameters: Parameters) -> Array:
    """Direct voltage with the same heat as a command [V], any shape. Commands: with duty the mean,
    duty times `bench.supply_voltage`; with a source of current, the current times R/n (R, n:
    `wire.resistance`, `wire.count`); with a source of power, sqrt(power R/n)."""
    volts = np.asarray(voltage, dtype=np.float64)
    if parameters["bench.drive"] == "duty":
        return np.sqrt(np.maximum(volts, 0.0) * parameters["bench.supply_voltage"])
    return volts


def commanded_voltage(volts: ArrayLike, parameters: Parameters) -> Array:
    """Inverse of `heating_voltage`: the command with the same heat as direct `volts`."""
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
    """Voltage and current of a record, from those of the drive (any shape; means of a duty):
    direct ones with the same heat, whose quotient is the resistance."""
    mean, amperes = (np.asarray(a, dtype=np.float64) for a in (voltage, current))
    if parameters["bench.drive"] == "power":
        watts = np.square(mean) * parameters["wire.count"] / parameters["wire.resistance"]
        return np.divide(watts, amperes, out=np.zeros_like(mean), where=amperes > 0.0), amperes
    volts = heating_voltage(mean, parameters)
    return volts, amperes * np.divide(volts, mean, out=np.ones_like(mean), where=mean > 0.0)


def heated_resistance(parameters: Parameters) -> float:
    """V^2 over the heat of one wire [ohm], where the voltage is measured before the leads."""
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
# x = T - T_inf in K, smoothed within 2 K of 0; n by the wire's diameter (parameters/parameters.py);
# e = 0.4; s: Stefan-Boltzmann constant. `wire.heat_transfer_coefficient` is h 60 K above ambient, C
# what radiation leaves of it. Source: Churchill and Chu 1975; Morgan 1975 (n = 0.15 if as thin).

_ROUNDED = 2.0  # K, smoothing of the excess near 0
_MOST = 0.9  # largest share of h that is radiation, if h is stated small


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
