"""Noise of a sensor: what a mean of it is worth, what whitens it, and that it is found again."""

import numpy as np
import pytest
from scipy.signal import lfilter

from sma_bench.estimation.estimate import Estimate
from sma_bench.estimation.noise_model import Noise, estimate_noise
from sma_bench.identify.estimate import combine

PERIOD = 0.2
NOISES = [Noise(1.0, *drift, PERIOD) for drift in ((0.0, 1.0), (2.0, 5.0), (0.5, 60.0))]


def drawn(noise: Noise, count: int, seed: int) -> np.ndarray:
    """White noise and a first-order drift that is stationary from the start."""
    random = np.random.default_rng(seed)
    phi = np.exp(-noise.period / noise.time)
    driving = noise.drift * np.sqrt(1.0 - phi**2) * random.standard_normal(count)
    driving[0] = noise.drift * random.standard_normal()
    drift = lfilter([1.0], [1.0, -phi], driving)
    return drift + noise.white * random.standard_normal(count)


def covariance(noise: Noise, count: int) -> np.ndarray:
    lag = noise.period * np.abs(np.subtract.outer(np.arange(count), np.arange(count)))
    return noise.white**2 * np.eye(count) + noise.drift**2 * np.exp(-lag / noise.time)


def log_likelihood(noise, residual):
    """As the fits add it up: the whitened residual and the log of the whitening's determinant."""
    white = noise.whiten(residual)
    return -0.5 * white @ white - noise.log_scale(len(residual))


def test_disagreeing_records_widen_the_error():
    agreeing = combine([Estimate(v, 0.1, "K", "m", 5) for v in (1.0, 1.05, 0.95)])
    clashing = combine([Estimate(v, 0.1, "K", "m", 5) for v in (1.0, 2.0, 0.0)])
    assert agreeing.std == pytest.approx(0.1 / np.sqrt(3.0))
    assert clashing.std == pytest.approx(1.0 / np.sqrt(3.0), rel=0.01)
    assert agreeing.n == 15


@pytest.mark.parametrize("noise", NOISES, ids=str)
def test_whitened_noise_is_white_and_its_likelihood_that_of_the_full_covariance(noise):
    white = noise.whiten(drawn(noise, 20_000, seed=3))
    assert np.var(white) == pytest.approx(1.0, abs=0.04)
    for lag in (1, 2, 5, 25):
        assert abs(np.mean(white[lag:] * white[:-lag])) < 4.0 / np.sqrt(len(white))
    matrix = covariance(noise, 150)
    for seed in range(3):
        residual = drawn(noise, 150, seed)
        exact = -0.5 * residual @ np.linalg.solve(matrix, residual)
        exact -= 0.5 * np.linalg.slogdet(matrix)[1]
        # The recursion is in its steady state from the second bin on.
        assert log_likelihood(noise, residual) == pytest.approx(exact, abs=2.5)


def test_white_level_drift_and_memory_are_recovered():
    true = Noise(0.3, 0.9, 6.0, PERIOD)
    found = estimate_noise([drawn(true, 3000, 1), drawn(true, 3000, 2)], 0.3, PERIOD)
    assert found.white == pytest.approx(true.white, rel=0.15)
    assert found.drift == pytest.approx(true.drift, rel=0.35)
    assert 2.5 < found.time < 15.0
    found = estimate_noise([drawn(Noise(0.3, 0.0, 1.0, PERIOD), 2000, 5)], 0.3, PERIOD)
    assert found.white == pytest.approx(0.3, rel=0.06)
    assert found.drift < 0.3 * found.white
    # A fit cannot lower the noise below what neighbouring samples show.
    assert estimate_noise([np.zeros(500)], 0.3, PERIOD).white == pytest.approx(0.27)


def test_a_drift_that_no_sensor_has_costs_probability_unless_its_zero_wanders():
    residual = drawn(Noise(0.1, 6.0, 60.0, PERIOD), 1500, 4)
    free = estimate_noise([residual], 0.1, PERIOD)
    held = estimate_noise([residual], 0.1, PERIOD, usual=0.3)
    wandering = estimate_noise([residual], 0.1, PERIOD, usual=0.3, wanders=True)
    assert free.log_prior == wandering.log_prior == 0.0
    assert held.log_prior < -3.0
    assert held.drift < free.drift
    whole = log_likelihood(held, residual) + held.log_prior
    assert whole < log_likelihood(free, residual)
