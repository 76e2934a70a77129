"""Arithmetic of numbers with errors: means of repeats, and line fits to points of equal weight
(`straight_line`), with a known covariance (`fit_linear`), or with errors in x (`fit_slope`)."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.special import stdtrit

from sma_bench.arrays import Array, Mask
from sma_bench.errors import InputError
from sma_bench.estimation.estimate import Estimate
from sma_bench.parameters import Parameters
from sma_bench.parameters.parameter import TRANSITIONS

GAUGE = "sensor.deflection.gain"
MODULI = ("wire.martensite_modulus", "wire.austenite_modulus")
SYMBOLS = {**TRANSITIONS, "C_A": "wire.stress_influence_austenite",
           "C_M": "wire.stress_influence_martensite", "E_M": MODULI[0], "E_A": MODULI[1],
           "eps_L": "wire.maximum_recoverable_strain", "Theta_T": "wire.thermal_expansion_factor"}


def combine(estimates: Sequence[Estimate]) -> Estimate:
    """Weighted mean of one or more independent estimates of one number; where they scatter by more
    than their errors explain, the error grows with the scatter (Birge ratio)."""
    if len(estimates) == 1:
        return estimates[0]
    values = np.array([e.value for e in estimates])
    weights = np.array([1.0 / max(e.statistical, 1e-12 * e.std) ** 2 for e in estimates])
    mean = float(np.sum(weights * values) / np.sum(weights))
    birge = math.sqrt(float(np.sum(weights * (values - mean) ** 2)) / (len(estimates) - 1))
    statistical = max(1.0, birge) / math.sqrt(float(np.sum(weights)))
    # Systematic errors, the same in every record, do not average out.
    last = max(estimates, key=lambda e: e.systematic)
    method = f"{estimates[0].method}; weighted mean of {len(estimates)} records"
    return Estimate(mean, math.hypot(statistical, last.systematic), last.unit, method,
                    sum(e.n for e in estimates), last.systematic, shares=last.shares)


def mean_of_repeats(readings: Sequence[tuple[float, float]], scatter: float | None = None,
                    freedom: int = 0) -> tuple[float, float, float]:
    """Mean of readings (value, own standard error) of one number, its error due to theirs, and that
    due to scatter beyond theirs, enlarged like Student's t. `scatter`: variance between repeats, if
    known from a larger set with `freedom` degrees of freedom."""
    values, n = [value for value, _ in readings], len(readings)
    own = float(np.mean([std**2 for _, std in readings]))
    if scatter is None:
        scatter, freedom = (float(np.var(values, ddof=1)), n - 1) if n > 1 else (0.0, 0)
    excess = max(scatter - own, 0.0)
    grown = stdtrit(freedom, 0.95) / stdtrit(math.inf, 0.95) if freedom else 1.0
    return float(np.mean(values)), math.sqrt(own / n), math.sqrt(excess / n) * float(grown)


def mean_and_deviation(readings: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """Mean and deviation of repeats (value, own standard error); at least the mean's own error."""
    value, own = np.array(readings).T
    reading = math.sqrt(float(np.mean(own**2)) / len(value))
    deviation = float(np.std(value, ddof=1)) if len(value) > 1 else 0.0
    return float(value.mean()), max(deviation, reading)


def diameter_error(parameters: Parameters) -> float:
    """Relative error of the diameter that stress is computed from: stated, else the table's."""
    diameter = parameters["wire.diameter"]
    return parameters.replace({"wire.diameter": diameter}).std("wire.diameter") / float(diameter)


@dataclass(frozen=True)
class Line:
    """Straight line y = value + slope (x - at); errors of value and slope are independent."""

    at: float
    value: float
    slope: float
    value_variance: float = 0.0
    slope_variance: float = 0.0

    def __call__(self, x: Array) -> Array:
        return np.asarray(self.value + self.slope * (x - self.at))

    def crossing(self, other: "Line") -> float:
        """x where two lines meet, NaN if they are parallel."""
        at_zero = other.value - self.value + self.slope * self.at - other.slope * other.at
        steeper = self.slope - other.slope
        return at_zero / steeper if steeper else math.nan

    def variance(self, x: float) -> float:
        return self.value_variance + self.slope_variance * (x - self.at) ** 2


def straight_line(x: Array, y: Array) -> Line:
    """Least-squares line through points (n,) of equal weight; their scatter gives its errors."""
    centred = x - x.mean()
    power = float(centred @ centred)
    slope = float(centred @ y) / power
    residual = y - y.mean() - slope * centred
    variance = float(residual @ residual) / max(len(x) - 2, 1)
    return Line(float(x.mean()), float(y.mean()), slope, variance / len(x), variance / power)


class LinearFit(NamedTuple):
    """Solution of y = A beta."""

    beta: Array  # (k,)
    covariance: Array  # (k, k) from the stated errors
    misfit: float  # chi2 per degree of freedom
    residuals: Array  # (n,)

    @property
    def std(self) -> Array:
        """(k,) standard errors; larger than stated where the points scatter more than stated."""
        return np.sqrt(np.diag(self.covariance) * max(1.0, self.misfit))


def fit_linear(design: Array, values: Array, covariance: Array) -> LinearFit:
    """Generalised least squares of values (n,) with a covariance (n, n) by a design (n, k), n > k.
    Raises InputError for numbers too large or too small to compute with."""
    try:
        factor = cholesky(covariance, lower=True, check_finite=False)
        whitened = solve_triangular(factor, design, lower=True, check_finite=False)
        target = solve_triangular(factor, values, lower=True, check_finite=False)
        if not np.isfinite(whitened).all() or not np.isfinite(target).all():
            raise np.linalg.LinAlgError  # else LAPACK writes to the terminal
        beta, *_ = np.linalg.lstsq(whitened, target, rcond=None)
    except np.linalg.LinAlgError:
        raise InputError("no straight line fits: readings too large or small") from None
    residual = target - whitened @ beta
    freedom = max(len(values) - design.shape[1], 1)
    return LinearFit(np.asarray(beta), np.linalg.pinv(whitened.T @ whitened),
                     float(residual @ residual) / freedom, values - design @ beta)


def fit_slope(columns: Sequence[Array | Mask], values: Array, covariance: Callable[[float], Array],
              slope: int = 1) -> LinearFit:
    """`fit_linear` of values (n,) by k columns (n,) where the abscissa has errors, too. They
    enter times the slope: `covariance` gives the (n, n) covariance for beta[slope]."""
    design = np.column_stack(columns).astype(np.float64)
    at = float(np.linalg.lstsq(design, values, rcond=None)[0][slope])
    for _ in range(3):
        fit = fit_linear(design, values, covariance(at))
        at = float(fit.beta[slope])
    return fit
