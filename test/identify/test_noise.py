"""What a mean is worth."""

import numpy as np
import pytest

from sma_bench.estimation.estimate import Estimate
from sma_bench.estimation.noise_model import (
    autocorrelation,
    inflation,
    quantisation_variance,
    resolution,
)
from sma_bench.identify.estimate import combine


def coloured(rng, n, keep):
    out = np.zeros(n)
    for k in range(1, n):
        out[k] = keep * out[k - 1] + np.sqrt(1.0 - keep**2) * rng.normal()
    return out


def test_white_noise_is_not_taken_for_coloured():
    rng = np.random.default_rng(1)
    found = [inflation(autocorrelation([rng.normal(size=300) for _ in range(50)]))
             for _ in range(20)]
    assert np.mean(found) == pytest.approx(1.0, abs=0.02)


def test_inflation_of_a_first_order_process_is_that_of_theory():
    rng = np.random.default_rng(2)
    pieces = [coloured(rng, 300, 0.8) for _ in range(50)]
    # (1 + r)/(1 - r) = 9; stretches of 300 samples with their own mean show a little less.
    assert inflation(autocorrelation(pieces)) == pytest.approx(9.0, rel=0.2)


def test_resolution_is_found_in_a_quantised_signal_only():
    rng = np.random.default_rng(3)
    signal = rng.normal(0.0, 0.05, 5000)
    assert resolution(np.round(signal / 0.026) * 0.026) == pytest.approx(0.026)
    assert resolution(signal) == 0.0
    assert resolution(np.full(100, 3.0)) == 0.0


@pytest.mark.parametrize("noise", [0.0, 0.1, 0.2, 0.3, 0.5])
def test_hidden_converter_error_is_that_of_simulated_means(noise):
    rng = np.random.default_rng(4)
    truth = rng.uniform(0.0, 10.0, 400)
    samples = np.round(truth[:, None] + rng.normal(0.0, noise, (400, 4000)))
    error = samples.mean(axis=1) - truth
    scatter = float(np.sqrt(np.mean(samples.var(axis=1))))
    expected = quantisation_variance(np.hypot(noise, 1.0 / np.sqrt(12.0)), 1.0)
    assert error.var() == pytest.approx(expected + scatter**2 / 4000, rel=0.25, abs=2e-5)


def test_disagreeing_records_widen_the_error():
    agreeing = combine([Estimate(v, 0.1, "K", "m", 5) for v in (1.0, 1.05, 0.95)])
    clashing = combine([Estimate(v, 0.1, "K", "m", 5) for v in (1.0, 2.0, 0.0)])
    assert agreeing.std == pytest.approx(0.1 / np.sqrt(3.0))
    assert clashing.std == pytest.approx(1.0 / np.sqrt(3.0), rel=0.01)
    assert agreeing.n == 15
