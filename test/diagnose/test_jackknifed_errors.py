"""Errors of a fit hold a misfit: two records of six pulses each, one number is their height."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np

from sma_bench.estimation.residual import Problem
from sma_bench.estimation.solver import Fit

PULSES, INTERVAL = 12, 1.645
HEIGHT = np.tile(np.where(np.arange(100) < 50, 1.0, 0.0), PULSES)


def fitted_height(random, uneven):
    """The least squares height of pulses that truly are 1 high in the mean, each off by `uneven`
    of a standard deviation, in white noise of 1."""
    true = np.repeat(1.0 + uneven * random.standard_normal(PULSES), 100) * HEIGHT
    measured = true + random.standard_normal(len(true))
    information = HEIGHT @ HEIGHT + 1.0
    x = np.array([HEIGHT @ measured / information])
    signal = SimpleNamespace(time=np.arange(600.0))
    records = [SimpleNamespace(grid=signal.time) for _ in range(2)]
    blocks = [
        SimpleNamespace(observation=record, signal=signal, rows=slice(600 * k, 600 * (k + 1)))
        for k, record in enumerate(records)
    ]
    stub = SimpleNamespace(observations=records, blocks=blocks, whiten=lambda rows: rows,
                           white_nuisances=np.zeros((len(true), 0)))
    stub.stretches = lambda parts: Problem.stretches(stub, parts)
    unknowns = SimpleNamespace(slopes=lambda x: np.ones(len(x)), turn=lambda x: np.eye(len(x)))
    covariance, fitted = np.array([[1.0 / information]]), HEIGHT * x[0]
    left = measured - fitted
    return Fit(stub, unknowns, x, np.zeros(0), covariance, 0.0, fitted, HEIGHT[:, None], left)


def held(uneven):
    """Shares of 90 % intervals that hold the height: by the noise alone, and as stated."""
    random = np.random.default_rng(3)
    fits = [fitted_height(random, uneven) for _ in range(250)]
    off = np.array([abs(f.x[0] - 1.0) for f in fits])
    return [
        float(np.mean(off < INTERVAL * np.array([getattr(f, name)[0] for f in fits])))
        for name in ("std", "jackknifed")
    ]


def test_errors_hold_a_misfit_that_differs_from_pulse_to_pulse_and_else_the_noise():
    noise_alone, stated = held(uneven=1.0)
    assert noise_alone < 0.5
    assert 0.8 < stated < 0.95
    noise_alone, stated = held(uneven=0.0)
    assert noise_alone > 0.86 and stated < 0.96
    # And are never above what was known, nor where one reading beyond all measure tells everything.
    fitted = fitted_height(np.random.default_rng(4), uneven=50.0)
    derivatives = np.vstack([[1e20], fitted.derivatives[1:]])
    assert fitted.jackknifed[0] == replace(fitted, derivatives=derivatives).jackknifed[0] == 1.0
