"""What a fit of the whole model means: estimates, what the record cannot tell, residual checks."""

import math
from collections.abc import Sequence

import numpy as np
from scipy.special import chdtrc

from sma_bench.findings import Finding
from sma_bench.identify.estimate import Array, Estimate
from sma_bench.identify.thermal.resistance import PARAMETER as RESISTANCE
from sma_bench.identify.thermal.resistance import SCALE_STD
from sma_bench.identify.whole_model.output_error import BenchFit, SignalFit
from sma_bench.parameters.table import BY_NAME

_UNTOLD = 0.9
_TIED = 0.95
_LAGS = 20
_FLOOR = 1.15
_HOPELESS = 10.0
_RARE = 1e-6
_CLOCKS = 4.0
_PRODUCTS = (
    ("heat_loss", "wire.heat_transfer_coefficient", "wire.surface_area", "W/K", "h A_c"),
    ("heat_capacity", "wire.mass", "wire.specific_heat", "J/K", "m c_p"),
)


def estimates(fit: BenchFit, method: str) -> dict[str, Estimate]:
    """Every fitted parameter with its standard error; the method says where the prior speaks."""
    told = _told(fit)
    factor = misfit(fit)
    found = {}
    for index, name in enumerate(fit.prior.names):
        words = method if told[index] else f"{method}: the prior, which the record does not improve"
        value, std = float(fit.values[index]), factor * float(fit.std[index])
        if name == RESISTANCE:
            std = math.hypot(std, SCALE_STD * value)
        found[name] = Estimate(value, std, BY_NAME[name].unit, words, fit.n)
    return found


def misfit(fit: BenchFit) -> float:
    """Factor of all standard errors: above 1 where the model leaves far more than noise.

    A few times the noise can be the colour of the noise, which the fit knows; ten times cannot.
    """
    worst = max((float(np.std(s.residual)) / s.floor for s in fit.signals), default=1.0)
    return worst if worst > _HOPELESS else 1.0


def products(fit: BenchFit) -> dict[str, Estimate]:
    """Products that the data know better than their factors."""
    names = fit.prior.names
    found = {}
    for name, first, second, unit, symbol in _PRODUCTS:
        if first not in names or second not in names:
            continue
        pick = [names.index(first), names.index(second)]
        value = float(np.prod(fit.values[pick]))
        covariance = fit.covariance[np.ix_(pick, pick)]
        relative = fit.prior.slopes(fit.x)[pick] / fit.values[pick]
        std = misfit(fit) * abs(value) * math.sqrt(float(relative @ covariance @ relative))
        found[name] = Estimate(value, std, unit, f"{symbol}, the only form in the model", fit.n)
    return found


def findings(fit: BenchFit) -> tuple[Finding, ...]:
    """What cannot be told, contradicted priors, bounds, and the checks of the residuals."""
    return (
        *_untold(fit), *_tied(fit), *_released(fit), *_at_bounds(fit), *_clocks(fit),
        *_residuals(fit.signals),
    )


def curves(fit: BenchFit) -> dict[str, Array]:
    """Time, measured and model of every signal, and the correlation matrix."""
    found: dict[str, Array] = {"correlation": fit.correlation}
    paths = list(dict.fromkeys(s.path for s in fit.signals))
    for s in fit.signals:
        head = f"{paths.index(s.path)}.{s.measured.name}" if len(paths) > 1 else s.measured.name
        found[f"{head}.time"] = s.measured.time
        found[f"{head}.measured"] = s.measured.values
        found[f"{head}.model"] = s.model
    return found


def _told(fit: BenchFit) -> Array:
    return np.asarray(fit.std < _UNTOLD * fit.stated.std)


def _untold(fit: BenchFit) -> list[Finding]:
    remarks = []
    told = _told(fit)
    names = fit.prior.names
    if not told.all():
        which = [name for name, known in zip(names, told, strict=True) if not known]
        text = (
            "the records do not improve what was known of "
            f"{', '.join(which)}: value and error are the prior's"
        )
        remarks.append(Finding("info", "priors", text, {"parameters": float(len(which))}))
    for _, first, second, _, symbol in _PRODUCTS:
        if first in names and second in names:
            text = f"only the product {symbol} enters the model; the priors of the two split it"
            remarks.append(Finding("info", first, text))
    return remarks


def _tied(fit: BenchFit) -> list[Finding]:
    correlation = fit.correlation
    told = _told(fit)
    remarks = []
    for i, first in enumerate(fit.prior.names):
        for j, second in enumerate(fit.prior.names[:i]):
            rho = float(correlation[i, j])
            if abs(rho) > _TIED and told[i] and told[j]:
                text = f"hardly told apart from {second}: correlation {rho:+.3f}"
                remarks.append(Finding("info", first, text, {"correlation": rho}))
    return remarks


def _released(fit: BenchFit) -> list[Finding]:
    remarks = []
    for name in fit.released:
        i = fit.prior.names.index(name)
        away = (float(fit.values[i]) - float(fit.stated.mean[i])) / float(fit.stated.std[i])
        text = (
            f"the records say {fit.values[i]:.6g} +- {fit.std[i]:.2g} {BY_NAME[name].unit}, "
            f"{away:+.1f} standard deviations from the stated {fit.stated.mean[i]:.6g} +- "
            f"{fit.stated.std[i]:.2g}; the statement was given less weight"
        )
        remarks.append(Finding("warning", name, text, {"deviations": away}))
    return remarks


def _at_bounds(fit: BenchFit) -> list[Finding]:
    low, high = fit.prior.bounds()
    stuck = (fit.x - low < 1e-3) | (high - fit.x < 1e-3)
    return [
        Finding("warning", name, f"fit stopped at the end of its range, {value:.6g}")
        for name, value, bad in zip(fit.prior.names, fit.values.tolist(), stuck, strict=True)
        if bad
    ]


def _clocks(fit: BenchFit) -> list[Finding]:
    remarks = []
    for path, quantity, delay, std in fit.delays:
        if abs(delay) > _CLOCKS * std:
            text = (
                f"{path}: stamps lie {delay * 1e3:+.1f} +- {std * 1e3:.1f} ms behind those of "
                "the voltage"
            )
            remarks.append(Finding("info", quantity, text, {"delay": delay, "delay_std": std}))
    return remarks


def _residuals(signals: Sequence[SignalFit]) -> list[Finding]:
    remarks = []
    for s in signals:
        ratio = float(np.std(s.residual)) / s.floor
        numbers = {"rms": float(np.std(s.residual)), "noise_floor": s.floor, "ratio": ratio}
        if ratio > _FLOOR:
            text = (
                f"{s.path}: the model leaves {ratio:.2f} times the noise from sample to sample "
                f"({np.std(s.residual):.3g} against {s.floor:.3g}): coloured noise or an effect "
                "that the model lacks; "
                + ("all standard errors are enlarged as much" if ratio > _HOPELESS else
                   "errors count it as coloured noise")
            )
            remarks.append(Finding("warning", s.measured.name, text, numbers))
        chance = _chance_of_white(s.white)
        if chance < _RARE:
            text = (
                f"{s.path}: the whitened residual is still correlated (probability {chance:.1g} "
                "if it were white): standard errors may be too small"
            )
            remarks.append(Finding("warning", s.measured.name, text, {"probability": chance}))
    if signals and not remarks:
        text = "every residual is at its noise floor and, whitened, uncorrelated"
        remarks.append(Finding("info", "residuals", text))
    return remarks


def _chance_of_white(white: Array) -> float:
    """Probability that white noise is as correlated over 20 lags (Ljung and Box, 1978)."""
    n = len(white)
    centred = white - white.mean()
    power = float(centred @ centred)
    if n < 5 * _LAGS or power == 0.0:
        return 1.0
    rho = np.array([float(centred[:-k] @ centred[k:]) / power for k in range(1, _LAGS + 1)])
    q = n * (n + 2) * float(np.sum(rho**2 / (n - np.arange(1, _LAGS + 1))))
    return float(chdtrc(_LAGS, q))
