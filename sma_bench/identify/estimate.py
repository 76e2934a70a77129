"""What an experiment yields: numbers with their errors, remarks and curves to draw; and generalised
least squares for models that are linear in their parameters.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.linalg import cholesky, solve_triangular

from sma_bench.errors import InputError
from sma_bench.estimation.estimate import Estimate

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]
Mask = npt.NDArray[np.bool_]

_CONTRADICTS = 3.0  # standard errors
# A file states errors by two digits: one that is as large may be this measurement's own.
_ROUNDED = 1.06


def combine(estimates: Sequence[Estimate]) -> Estimate:
    """Weighted mean of independent estimates of one number.

    Where they scatter by more than their errors explain, the error grows with the scatter
    (Birge ratio), so that disagreeing records never yield a smaller error than agreeing ones.

    Raises:
        InputError: nothing to combine.
    """
    if not estimates:
        raise InputError("no estimates to combine")
    if len(estimates) == 1:
        return estimates[0]
    values = np.array([e.value for e in estimates])
    weights = np.array([1.0 / max(e.statistical, 1e-12 * e.std) ** 2 for e in estimates])
    mean = float(np.sum(weights * values) / np.sum(weights))
    birge = math.sqrt(float(np.sum(weights * (values - mean) ** 2)) / (len(estimates) - 1))
    statistical = max(1.0, birge) / math.sqrt(float(np.sum(weights)))
    # What is the same in every record does not average out.
    last = max(estimates, key=lambda e: e.systematic)
    return Estimate(
        value=mean, std=math.hypot(statistical, last.systematic), unit=last.unit,
        method=f"{estimates[0].method}; weighted mean of {len(estimates)} records",
        n=sum(e.n for e in estimates), systematic=last.systematic, shares=last.shares,
    )


def mean_of_repeats(
    readings: Sequence[tuple[float, float]], scatter: float | None = None, freedom: int = 0
) -> tuple[float, float, float]:
    """Mean of repeated readings of one number, the standard error that its own errors leave, and
    that of what the repeats differ by beyond them.

    What n repeats differ by is known by n - 1 of them: the error grows as Student's t does, so that
    1.645 of it hold the truth in 90 %.

    Args:
        readings: (value, own standard error) of each.
        scatter: variance between repeats where more of them, with `freedom`, tell it.
    """
    from scipy.special import stdtrit  # half a second to load

    values, n = [value for value, _ in readings], len(readings)
    own = float(np.mean([std**2 for _, std in readings]))
    if scatter is None:
        scatter, freedom = (float(np.var(values, ddof=1)), n - 1) if n > 1 else (0.0, 0)
    excess = max(scatter - own, 0.0)
    grown = stdtrit(freedom, 0.95) / stdtrit(math.inf, 0.95) if freedom else 1.0
    return float(np.mean(values)), math.sqrt(own / n), math.sqrt(excess / n) * float(grown)


def with_prior(measured: Estimate, prior: Estimate) -> tuple[Estimate, str]:
    """A measurement beside what was stated, and a remark if they contradict each other.

    A measurement that is surer counts alone: it was made to replace what was stated. One that is
    less sure is joined with it.
    """
    if prior.std <= 0.0:
        return measured, ""
    ratio = measured.std / prior.std
    if ratio <= _ROUNDED:
        narrowed = measured.capped(prior.std)
        return replace(narrowed, informed=1.0 - min(ratio, 1.0) ** 2), ""
    apart = (measured.value - prior.value) / math.hypot(measured.std, prior.std)
    remark = "" if abs(apart) < _CONTRADICTS else (
        f"measured {measured.value:.6g} +- {measured.std:.2g} {measured.unit} is {apart:+.1f} "
        f"standard errors from {prior.value:.6g} +- {prior.std:.2g}, which was stated to be surer"
    )
    weight = 1.0 / (1.0 + ratio * ratio)
    std = prior.std * math.sqrt(1.0 - weight)
    return replace(
        measured, value=prior.value + weight * (measured.value - prior.value), std=std,
        method=f"{measured.method}, joined with what was known",
        systematic=min(weight * measured.systematic, std), informed=weight,
        shares={name: weight * share for name, share in measured.shares.items()},
    ), remark


@dataclass(frozen=True)
class LinearFit:
    """Solution of y = A beta with a known covariance of y.

    `beta` (k,), `covariance` (k, k) from the stated errors, `misfit` chi2 per degree of freedom,
    `residuals` (n,).
    """

    beta: Array
    covariance: Array
    misfit: float
    residuals: Array

    @property
    def std(self) -> Array:
        """(k,) standard errors; larger than stated where the points scatter more than stated."""
        return np.sqrt(np.diag(self.covariance) * max(1.0, self.misfit))

    def contrast(self, weights: Array) -> tuple[float, float]:
        """A linear combination of the parameters and its standard error, scaled as `std`."""
        variance = float(weights @ self.covariance @ weights) * max(1.0, self.misfit)
        return float(weights @ self.beta), float(np.sqrt(variance))


def fit_linear(design: Array, values: Array, covariance: Array) -> LinearFit:
    """Generalised least squares.

    Args:
        design: (n, k) matrix A, n > k.
        values: (n,) measured y.
        covariance: (n, n) of y, positive definite.

    Raises:
        InputError: numbers so large or small that nothing can be solved with them.
    """
    try:
        factor = cholesky(covariance, lower=True, check_finite=False)
        whitened = solve_triangular(factor, design, lower=True, check_finite=False)
        target = solve_triangular(factor, values, lower=True, check_finite=False)
        if not np.isfinite(whitened).all() or not np.isfinite(target).all():
            raise np.linalg.LinAlgError  # LAPACK would write on the terminal
        beta, *_ = np.linalg.lstsq(whitened, target, rcond=None)
    except np.linalg.LinAlgError:
        raise InputError("readings that no bench has: no straight line fits them") from None
    left = target - whitened @ beta
    freedom = max(len(values) - design.shape[1], 1)
    return LinearFit(
        beta=np.asarray(beta), covariance=np.linalg.pinv(whitened.T @ whitened),
        misfit=float(left @ left) / freedom, residuals=values - design @ beta,
    )
