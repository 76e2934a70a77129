"""Gauss-Newton steps within bounds and a trust region, on normal equations."""

from collections.abc import Callable

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from sma_bench.identify.estimate import Array

_MOST_ITERATIONS = 60
_FIRST_RADIUS = 2.0
_SMALLEST_RADIUS = 1e-7
_GOOD, _POOR = 0.7, 0.1
_GROWTH, _SHRINKAGE = 3.0, 0.25
_FIRST_DAMPING = 1e-3


def minimise(
    residuals: Callable[[Array], Array],
    jacobian: Callable[[Array], Array],
    x: Array,
    bounds: tuple[Array, Array],
    tolerance: float,
) -> Array:
    """Minimise |residuals(x)|^2 (Levenberg and Marquardt).

    scipy.optimize.least_squares decomposes the whole Jacobian at every step; for many rows and few
    unknowns, scaled and kept well conditioned by their priors, the normal matrix is enough.

    Args:
        residuals: (k,) -> (n,), among them the priors'; jacobian: (k,) -> (n, k).
        x: (k,) start, in units of prior standard deviations.
        bounds: lowest and highest (k,).
        tolerance: stop when a step gains less than this in chi-square.
    """
    low, high = bounds
    x = np.clip(x, low, high)
    residual = residuals(x)
    cost = float(residual @ residual)
    radius = _FIRST_RADIUS
    for _ in range(_MOST_ITERATIONS):
        slope = jacobian(x)
        normal, gradient = slope.T @ slope, slope.T @ residual
        gain, expected = -1.0, 0.0
        while gain <= 0.0 and radius > _SMALLEST_RADIUS:
            step = _step_within(normal, gradient, radius, low - x, high - x)
            expected = -float(step @ (2.0 * gradient + normal @ step))
            if expected < 0.1 * tolerance:
                return x
            trial = residuals(x + step)
            gain = cost - float(trial @ trial)
            if gain > _GOOD * expected:
                radius = max(radius, _GROWTH * float(np.max(np.abs(step))))
            elif gain < _POOR * expected:
                radius = _SHRINKAGE * float(np.max(np.abs(step)))
        if gain <= 0.0:
            return x
        x, residual, cost = x + step, trial, cost - gain
        if gain < tolerance and expected < tolerance:
            return x
    return x


def _step_within(normal: Array, gradient: Array, radius: float, low: Array, high: Array) -> Array:
    """Step no longer than `radius` in any unknown: damped as much as that takes."""
    step = _step(normal, gradient, 0.0, low, high)
    damping = _FIRST_DAMPING
    while np.max(np.abs(step)) > radius:
        step = _step(normal, gradient, damping, low, high)
        damping *= 4.0
    return step


def _step(normal: Array, gradient: Array, damping: float, low: Array, high: Array) -> Array:
    """Minimum of the damped quadratic; unknowns that would leave their bounds end on them."""
    damped = normal + damping * np.eye(len(gradient))
    step = np.zeros(len(gradient))
    free = np.ones(len(gradient), dtype=bool)
    while free.any():
        force = gradient[free] + damped[np.ix_(free, ~free)] @ step[~free]
        step[free] = -cho_solve(cho_factor(damped[np.ix_(free, free)]), force)
        beyond = free & ((step < low) | (step > high))
        if not beyond.any():
            break
        step = np.clip(step, low, high)
        free &= ~beyond
    return step
