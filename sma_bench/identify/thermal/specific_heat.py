"""E3, specific heat: ramps below A_s (eq. 5, Figs. 4 and 5)."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import median_filter

from sma_bench.errors import InputError
from sma_bench.findings import Finding
from sma_bench.identify.estimate import Array, Estimate, Experiment
from sma_bench.identify.signals import Drive
from sma_bench.identify.thermal.differentiator import slope_of_rates
from sma_bench.identify.thermal.heat_checks import check_delay, check_gain, check_misfit
from sma_bench.identify.thermal.heat_fit import (
    HEAT_TRANSFER,
    SPECIFIC_HEAT,
    HeatFit,
    Knowledge,
    Window,
    fit_heat,
    rough_time_constant,
)
from sma_bench.identify.thermal.ramps import FEWEST_SAMPLES, choose_windows, cut_windows
from sma_bench.parameters import Parameters
from sma_bench.records import Record

PARAMETER = "wire.specific_heat"
COEFFICIENT = "wire.heat_transfer_coefficient"
AUSTENITE_START = "wire.austenite_start_temperature"
_SMALLEST_RISE = 10.0
_AMBIENT_STD = 2.0
_UNKNOWN = 1.0


@dataclass(frozen=True)
class HeatLoss:
    """What E1 and E2, or the parameters, know of R (as it heats: with the leads in it) and h.

    `gain` 1/(R h A_c) in K/V^2 comes from E2 and is independent of R; without it h stands alone.
    `known` is False where h is nobody's measurement, then the ramps themselves must tell it.
    """

    resistance: Estimate
    coefficient: Estimate
    gain: Estimate | None = None
    known: bool = True

    def statements(self) -> tuple[Array, Array]:
        """Rows (2, 3) and values (2,) on the logarithms of (c_p, h, R), in standard deviations."""
        of_r = self.resistance.relative_std
        # The gain is R's and h's product; E2 measured it as one number, R apart from it.
        row = np.array([0.0, 1.0, 1.0] if self.gain else [0.0, 1.0, 0.0])
        std = self.gain.relative_std if self.gain else self.coefficient.relative_std
        log_h, log_r = math.log(self.coefficient.value), math.log(self.resistance.value)
        centre = np.array([0.0, log_h, log_r])
        rows = np.array([np.array([0.0, 0.0, 1.0]) / of_r, row / (std if self.known else _UNKNOWN)])
        return rows, rows @ centre

    def blind(self) -> "HeatLoss":
        """The same without any knowledge of h."""
        return HeatLoss(self.resistance, self.coefficient, None, known=False)


def identify_specific_heat(
    drives: Sequence[tuple[Record, Drive]], parameters: Parameters, heat_loss: HeatLoss
) -> Experiment:
    """Specific heat from voltage ramps, with the rest before and the cooling after each.

    The estimate is the most likely c_p of eq. (2) under noise on the temperature: differentiated
    noise, on which the paper's slope of dT/dt over f(T, V) rests, biases c_p. That slope is in
    `details` as "differentiator". c_p is conditional on wire.mass: only m c_p enters the equation.
    The standard error includes those of R and h, coloured noise, and an unknown offset of a sample
    period between the stamps of voltage and temperature, which a jump of the voltage resolves.

    Args:
        drives: records with channels that hold ramps.
        parameters: wire.mass, wire.surface_area, environment.ambient_temperature and A_s.
        heat_loss: R and h.

    Raises:
        InputError: no ramp, no temperature, or no rise of it below A_s.
    """
    limit = float(parameters[AUSTENITE_START])
    cuts = [cut_windows(record, drive, limit) for record, drive in drives]
    windows, findings = choose_windows(cuts, limit, PARAMETER)
    sources = [
        f"{record.path}: {drive.channel}, {len(cut)} ramps"
        for (record, drive), cut in zip(drives, cuts, strict=True)
    ]
    _require_rise(windows, sources, limit)
    knowledge = _knowledge(parameters, heat_loss, windows)
    fit = fit_heat(windows, knowledge, _start(windows, parameters, heat_loss))
    estimate, remarks = _estimate(windows, fit, parameters, heat_loss)
    paper, rates = slope_of_rates(
        windows, fit.ambient, heat_loss.resistance.value,
        heat_loss.coefficient.value * parameters["wire.surface_area"], parameters["wire.mass"],
    )
    n = sum(len(w.temperature) for w in windows)
    details = {
        "differentiator": paper,
        "time_constant": _time_constant(fit, parameters, n),
        "delay": Estimate(fit.delay, fit.delay_std, "s", "stamps of temperature - voltage", n),
    }
    estimates = {PARAMETER: estimate}
    if not heat_loss.known:
        # c_p and h belong together: a file with this c_p and another h has the wrong tau.
        h = fit.value(HEAT_TRANSFER)
        estimates[COEFFICIENT] = Estimate(
            h, h * fit.relative_std(HEAT_TRANSFER), "W/(m2 K)",
            "output-error fit of eq. (2) to the ramps", n,
        )
    return Experiment(
        "E3", "Specific heat", estimates, (*findings, *remarks),
        _curves(windows, fit) | rates, "; ".join(sources), details,
    )


def _require_rise(windows: Sequence[Window], sources: Sequence[str], limit: float) -> None:
    where = "; ".join(sources)
    if not windows:
        raise InputError(
            f"{where}: fewer than {FEWEST_SAMPLES} temperatures around any ramp below A_s = "
            f"{limit:.1f} K, expected a ramp that stays below it"
        )
    rise = max(float(np.ptp(median_filter(w.temperature, 5, mode="nearest"))) for w in windows)
    noise = float(np.median([np.std(np.diff(w.temperature)) for w in windows])) / math.sqrt(2.0)
    if rise < _SMALLEST_RISE * noise:
        raise InputError(
            f"{where}: the temperature rises by {rise:.2g} K at a noise of {noise:.2g} K, "
            f"expected {_SMALLEST_RISE:g} times as much or more"
        )


def _knowledge(
    parameters: Parameters, heat_loss: HeatLoss, windows: Sequence[Window]
) -> Knowledge:
    rows, values = heat_loss.statements()
    periods = [
        float(np.median(np.diff(t))) for w in windows for t in (w.voltage_time, w.temperature_time)
    ]
    return Knowledge(
        rows=rows,
        values=values,
        delay_std=max(periods),
        ambient=float(np.median([np.percentile(w.temperature, 5) for w in windows])),
        ambient_std=_AMBIENT_STD,
        mass=parameters["wire.mass"],
        area=parameters["wire.surface_area"],
    )


def _start(windows: Sequence[Window], parameters: Parameters, heat_loss: HeatLoss) -> Array:
    gain, tau = rough_time_constant(windows)
    area, resistance = parameters["wire.surface_area"], heat_loss.resistance.value
    h = heat_loss.coefficient.value if heat_loss.known else 1.0 / (gain * resistance * area)
    return np.log([tau * h * area / parameters["wire.mass"], h, resistance])


def _estimate(
    windows: Sequence[Window], fit: HeatFit, parameters: Parameters, heat_loss: HeatLoss
) -> tuple[Estimate, list[Finding]]:
    tau = _time_constant(fit, parameters, 0).value
    checks = [
        check_delay(fit, tau, _knowledge(parameters, heat_loss, windows).delay_std),
        check_misfit(windows, fit, tau),
    ]
    if heat_loss.known:
        blind = fit_heat(
            windows, _knowledge(parameters, heat_loss.blind(), windows), fit.shared[:3]
        )
        stated = -math.log(heat_loss.coefficient.value * heat_loss.resistance.value)
        known = (heat_loss.gain or heat_loss.coefficient).relative_std
        checks.append(check_gain(fit, blind, stated, known))
    # Random errors grow with the misfit; what the checks doubt besides comes on top.
    relative = fit.relative_std(SPECIFIC_HEAT) * max(check.factor for check in checks)
    relative = math.hypot(relative, *(check.doubt for check in checks))
    findings = [check.finding for check in checks if check.finding is not None]
    value = fit.value(SPECIFIC_HEAT)
    method = (
        "output-error fit of eq. (2), exact response to the measured voltage, "
        f"m = {parameters['wire.mass'] * 1e3:.4g} g taken as exact"
    )
    n = sum(len(w.temperature) for w in windows)
    return Estimate(value, value * relative, "J/(kg K)", method, n), findings


def _time_constant(fit: HeatFit, parameters: Parameters, n: int) -> Estimate:
    weights = np.array([1.0, -1.0, 0.0, 0.0])
    tau = parameters["wire.mass"] / parameters["wire.surface_area"]
    tau *= math.exp(float(weights @ fit.shared))
    std = tau * math.sqrt(float(weights @ fit.covariance @ weights))
    return Estimate(tau, std, "s", "m c_p/(h A_c)", n)


def _curves(windows: Sequence[Window], fit: HeatFit) -> dict[str, Array]:
    """Measured and fitted temperature, one window after the other, NaN in between."""
    gap = np.array([np.nan])

    def joined(parts: Sequence[Array]) -> Array:
        return np.concatenate([piece for part in parts for piece in (part, gap)])

    return {
        "time": joined([w.temperature_time for w in windows]),
        "temperature": joined([w.temperature for w in windows]),
        "model": joined(list(fit.model)),
        "voltage": joined(
            [np.interp(w.temperature_time, w.voltage_time, w.voltage) for w in windows]
        ),
    }
