"""The paper's own way to the specific heat: slope of dT/dt over f(T, V) (eq. 5, Fig. 5)."""

import math
from collections.abc import Sequence

import numpy as np

from sma_bench.errors import InputError
from sma_bench.identify.estimate import Array, Estimate
from sma_bench.identify.thermal.heat_fit import Window

FILTER_TIME = 0.1
_MOST_CELLS = 1_000_000


def slope_of_rates(
    windows: Sequence[Window],
    ambient: Sequence[float],
    resistance: float,
    heat_loss: float,
    mass: float,
) -> tuple[Estimate, dict[str, Array]]:
    """c_p in J/(kg K) from 1/slope of dT/dt over f(T, V) = (V^2/R - h A_c (T - T_inf))/m.

    A differentiator of time constant FILTER_TIME gives dT/dt; f passes the same filter, so that
    both lag alike. The camera's noise is in both f and dT/dt and biases the slope.

    Args:
        windows: measured ramps; ambient: K, one a window.
        resistance: ohm; heat_loss: h A_c in W/K; mass: kg.

    Returns:
        The estimate, and the driven samples: "force" f in W/kg and "rate" dT/dt in K/s.
    """
    rates, forces = [], []
    from scipy.signal import lfilter  # half a second to load

    for w, surrounding in zip(windows, ambient, strict=True):
        period = float(np.median(np.diff(w.temperature_time)))
        period = max(period, float(np.ptp(w.temperature_time)) / _MOST_CELLS)
        grid = np.arange(w.temperature_time[0], w.temperature_time[-1], period)
        temperature = np.interp(grid, w.temperature_time, w.temperature)
        voltage = np.interp(grid, w.voltage_time, w.voltage)
        force = (voltage**2 / resistance - heat_loss * (temperature - surrounding)) / mass
        kept = np.exp(-period / FILTER_TIME)
        low, passed = np.array([1.0 - kept]), np.array([1.0, -kept])
        smooth = lfilter(low, passed, temperature, zi=[kept * temperature[0]])[0]
        driven = (voltage > 0.05 * voltage.max()) & (grid > grid[0] + 5.0 * FILTER_TIME)
        rates.append(((temperature - smooth) / FILTER_TIME)[driven])
        forces.append(lfilter(low, passed, force, zi=[kept * force[0]])[0][driven])
    rate, force = np.concatenate(rates), np.concatenate(forces)
    slope = float(force @ rate) / float(force @ force) if len(rate) else 0.0
    if slope == 0.0:
        raise InputError("the ramps do not heat the wire for longer than the filter's time")
    left = rate - slope * force
    # Filtered samples repeat each other over the filter's time.
    effective = max(len(rate) * period / (2.0 * FILTER_TIME), 2.0)
    std = float(np.std(left)) / math.sqrt(effective) / float(np.sqrt(np.mean(force**2)))
    estimate = Estimate(
        1.0 / slope, std / slope**2, "J/(kg K)",
        "slope of filtered dT/dt over f(T, V) as in the paper; biased by noise", len(rate),
    )
    return estimate, {"force": force, "rate": rate}
