"""Heat of one wire: eqs. (1) to (5), the energy balance."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sma_bench.parameters import Parameters

Array = NDArray[np.float64]


def temperature_rate(
    temperature: ArrayLike, voltage: ArrayLike, parameters: Parameters,
    martensite_rate: ArrayLike = 0.0, latent_heat: float = 0.0,
) -> Array:
    """dT/dt [K/s], eq. (1); eq. (2) without latent heat.

    Args:
        temperature: T [K], any shape.
        voltage: V [V] before the leads, broadcast against it.
        martensite_rate: dxi/dt [1/s].
        latent_heat: heat of transformation [J/kg], positive.
    """
    heat_capacity = parameters["wire.mass"] * parameters["wire.specific_heat"]
    convected = heat_loss(parameters) * (
        np.asarray(temperature, float) - parameters["environment.ambient_temperature"]
    )
    heating = np.square(voltage) / heated_resistance(parameters)
    latent = parameters["wire.mass"] * latent_heat * np.asarray(martensite_rate, float)
    return np.asarray((heating - convected + latent) / heat_capacity)


def current(voltage: ArrayLike, resistance: float) -> Array:
    """Current [A] through a wire of `resistance` [ohm] at `voltage` [V], eq. (3)."""
    return np.asarray(voltage, float) / resistance


def heating_voltage(voltage: ArrayLike, parameters: Parameters) -> Array:
    """Volts whose square heats as the drive does: a duty's supply is on for a share of the time.

    Args:
        voltage: commanded V, any shape: of a duty the mean, duty times `bench.supply_voltage`; of a
            current source the current times `wire.resistance / wire.count`.
    """
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


def direct_reading(
    parameters: Parameters, voltage: ArrayLike, current: ArrayLike
) -> tuple[Array, Array]:
    """What a record holds of a drive: the direct voltage and current of the same heat.

    Their quotient is the resistance and their product the power, of a duty too.

    Args:
        voltage, current: V and A, means of a duty; any shape.
    """
    mean, amperes = (np.asarray(a, dtype=np.float64) for a in (voltage, current))
    volts = heating_voltage(mean, parameters)
    return volts, amperes * np.divide(volts, mean, out=np.ones_like(mean), where=mean > 0.0)


def heated_resistance(parameters: Parameters) -> float:
    """V^2 over the heat of one wire [ohm], where the voltage is that before the leads."""
    wire = float(parameters["wire.resistance"])
    leads = float(parameters["wire.count"] * parameters["bench.lead_resistance"])
    if leads == 0.0 or parameters["bench.drive"] == "current":
        return wire
    return (wire + leads) ** 2 / wire


def heat_loss(parameters: Parameters) -> float:
    """h A_c [W/K]."""
    return float(parameters["wire.heat_transfer_coefficient"] * parameters["wire.surface_area"])


def time_constant(parameters: Parameters) -> float:
    """m c_p/(h A_c) [s]."""
    capacity = parameters["wire.mass"] * parameters["wire.specific_heat"]
    return float(capacity / heat_loss(parameters))


def steady_temperature(voltage: ArrayLike, parameters: Parameters) -> Array:
    """T [K] that a held direct voltage [V] leads to, eq. (4) solved for T."""
    rise = np.square(voltage) / (heated_resistance(parameters) * heat_loss(parameters))
    return np.asarray(parameters["environment.ambient_temperature"] + rise)


@dataclass(frozen=True)
class EnergyBalance:
    """Energies of every step and wire [J], each of shape (n - 1, w).

    electrical = stored + convected + latent + imbalance.
    """

    electrical: Array
    stored: Array
    convected: Array
    latent: Array

    @property
    def imbalance(self) -> Array:
        """What the balance leaves over [J]; rounding only, if eq. (1) was solved."""
        return self.electrical - self.stored - self.convected - self.latent


def energy_balance(
    parameters: Parameters, time: Array, voltage: Array, temperature: Array,
    martensite_fraction: Array, latent_heat: float = 0.0,
) -> EnergyBalance:
    """Energy balance of eq. (1) over every step, exact for held voltage and transformation rate.

    Convection is integrated in closed form from the temperature at the start of the step, so the
    balance closes only if the temperature at its end is right.

    Args:
        time: (n,) s; voltage: (n, w) V, held from each sample to the next.
        temperature: (n, w) K; martensite_fraction: (n, w).
        latent_heat: J/kg, as it was simulated with.
    """
    mass, tau = parameters["wire.mass"], time_constant(parameters)
    loss = heat_loss(parameters)
    step = np.diff(time)[:, np.newaxis]
    volts = heating_voltage(voltage[:-1], parameters)
    electrical = np.square(volts) / heated_resistance(parameters) * step
    stored = mass * parameters["wire.specific_heat"] * np.diff(temperature, axis=0)
    latent = -mass * latent_heat * np.diff(martensite_fraction, axis=0)
    rise = temperature[:-1] - parameters["environment.ambient_temperature"]
    steady_rise = (electrical - latent) / (step * loss)
    convected = loss * (
        steady_rise * step - (rise - steady_rise) * tau * np.expm1(-step / tau)
    )
    return EnergyBalance(electrical, stored, convected, latent)
