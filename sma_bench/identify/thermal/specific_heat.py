"""E3, specific heat: ramps below A_s (eq. 5, Figs. 4 and 5)."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import median_filter

from sma_bench.errors import InputError
from sma_bench.estimation.noise_model import autocorrelation, inflation
from sma_bench.findings import Finding
from sma_bench.identify.estimate import Array, Estimate, Experiment
from sma_bench.identify.signals import Drive
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


# --- What may be wrong with a fit of the heat equation, and by how much c_p is then in doubt.

SUBJECT = "wire.specific_heat"
_SIGNIFICANT = 3.0
_SMALL_DELAY = 1e-3
# A camera that lags by L as a filter looks like a delay of 0.7 L to L and adds about L^2/tau.
_LAG_SHARE = 2.5
_BAD_MISFIT = 6.0
_LARGE_MISFIT = 0.01
_FEWEST_IN_BIN = 5


@dataclass(frozen=True)
class Check:
    """`factor` times the random error and, added in squares, the relative `doubt` of c_p."""

    finding: Finding | None = None
    factor: float = 1.0
    doubt: float = 0.0


def check_delay(fit: HeatFit, tau: float, assumed: float) -> Check:
    """Whether an offset between the stamps was resolved, and whether it is a mere offset.

    Args:
        fit: the fit with its delay; tau: s.
        assumed: standard deviation of the delay before the fit, s.
    """
    numbers = {"delay": fit.delay, "delay_std": fit.delay_std}
    if fit.delay_std > 0.5 * assumed:
        text = (
            "a time offset between voltage and temperature cannot be told from thermal inertia "
            f"here (no jump of the voltage among the samples used); +- {assumed * 1e3:.0f} ms are "
            "in the error"
        )
        return Check(Finding("warning", SUBJECT, text, numbers))
    text = (
        f"temperature stamps lie {fit.delay * 1e3:+.1f} +- {fit.delay_std * 1e3:.1f} ms behind "
        "those of the voltage"
    )
    if abs(fit.delay) < max(_SIGNIFICANT * fit.delay_std, _SMALL_DELAY):
        return Check(Finding("info", "temperature", text, numbers))
    text += "; taken at face value they would pass for thermal inertia"
    if abs(fit.delay) < assumed:
        return Check(Finding("info", "temperature", text, numbers))
    doubt = _LAG_SHARE * (fit.delay / tau) ** 2
    text += (
        f"; more than a sample period: if the camera lags rather than being late, c_p is too high "
        f"by up to {100.0 * doubt:.0f} %, which is in the error"
    )
    return Check(Finding("warning", "temperature", text, numbers), doubt=doubt)


def check_gain(fit: HeatFit, blind: HeatFit, stated: float, known: float) -> Check:
    """Whether the ramps by themselves ask for the steady rise that E2 measured.

    Args:
        fit: with what is known of h; blind: without.
        stated: logarithm of 1/(R h) as known; known: its standard error.
    """
    own, own_std = blind.log_gain
    difference, error = own - stated, math.hypot(own_std, known)
    if abs(difference) < _SIGNIFICANT * error:
        return Check()
    text = (
        f"the ramps ask for a steady rise {100.0 * difference:+.1f} +- {100.0 * error:.1f} % off "
        "that of the known R and h: latent heat, a lagging sensor or another air flow; with h "
        f"free c_p is {blind.value(SPECIFIC_HEAT):.1f} J/(kg K) and h "
        f"{blind.value(HEAT_TRANSFER):.1f} W/(m2 K); the error of c_p covers both"
    )
    numbers = {"gain_difference": difference, "gain_difference_std": error}
    shift = float(blind.shared[SPECIFIC_HEAT] - fit.shared[SPECIFIC_HEAT])
    return Check(Finding("warning", SUBJECT, text, numbers), doubt=abs(shift))


def check_misfit(windows: Sequence[Window], fit: HeatFit, tau: float) -> Check:
    """Whether residuals stay on one side over a time constant (s) anywhere."""
    mean, errors, share = _largest_misfit(windows, fit, tau)
    if errors < _BAD_MISFIT or share < _LARGE_MISFIT:
        return Check()
    text = (
        f"the heat equation misses the measured temperature by {mean:+.2f} K over a time constant "
        f"({errors:.0f} standard errors, {100.0 * share:.0f} % of the rise): the wire or its "
        "camera does not follow eq. (2) with one time constant; the error of c_p is widened in "
        "proportion"
    )
    numbers = {"misfit": mean, "standard_errors": errors}
    return Check(Finding("warning", SUBJECT, text, numbers), factor=errors / _SIGNIFICANT)


def _largest_misfit(
    windows: Sequence[Window], fit: HeatFit, tau: float
) -> tuple[float, float, float]:
    """Largest mean residual over a time constant: in K, in standard errors, and over the rise."""
    colour = math.sqrt(inflation(autocorrelation(_at_rest(windows, fit))))
    worst = (0.0, 0.0, 0.0)
    for window, left, model in zip(windows, fit.residuals, fit.model, strict=True):
        rise = float(np.ptp(model))
        width = max(tau, _FEWEST_IN_BIN * float(np.median(np.diff(window.temperature_time))))
        bins = ((window.temperature_time - window.temperature_time[0]) / width).astype(int)
        for k in np.unique(bins):
            piece = left[bins == k]
            mean = float(np.mean(piece))
            errors = abs(mean) * math.sqrt(len(piece)) / (fit.scatter * colour)
            if len(piece) >= _FEWEST_IN_BIN and errors > worst[1]:
                worst = (mean, errors, abs(mean) / rise)
    return worst


def _at_rest(windows: Sequence[Window], fit: HeatFit) -> list[Array]:
    """Residuals before each drive, where the model has nothing to get wrong."""
    resting = []
    for window, left in zip(windows, fit.residuals, strict=True):
        voltage = np.interp(window.temperature_time, window.voltage_time, window.voltage)
        driven = np.abs(voltage) > 0.05 * float(np.max(np.abs(voltage)))
        resting.append(left[np.cumsum(driven) == 0])
    return resting


# --- The paper's own way to the specific heat: slope of dT/dt over f(T, V) (eq. 5, Fig. 5).

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
