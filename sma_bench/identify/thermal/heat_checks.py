"""What may be wrong with a fit of the heat equation, and by how much c_p is then in doubt."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sma_bench.estimation.noise_model import autocorrelation, inflation
from sma_bench.findings import Finding
from sma_bench.identify.estimate import Array
from sma_bench.identify.thermal.heat_fit import HEAT_TRANSFER, SPECIFIC_HEAT, HeatFit, Window

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
