"""Generalised least squares for models that are linear in their parameters."""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cholesky, solve_triangular

from sma_bench.errors import InputError
from sma_bench.identify.estimate import Array


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
        beta=np.asarray(beta),
        covariance=np.linalg.pinv(whitened.T @ whitened),
        misfit=float(left @ left) / freedom,
        residuals=values - design @ beta,
    )
