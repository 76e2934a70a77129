"""Which signals a fit leaves more of in motion than at rest, and what it makes of its errors."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np

from sma_bench.diagnose.left_over import left_over
from sma_bench.estimation.noise_model import Noise
from sma_bench.estimation.residual import Problem
from sma_bench.estimation.solver import Fit

BINS, PERIOD, WHITE = 400, 0.2, 0.1
NAMES = ("front_1.current", "front_1.temperature", "deflection")
MOVING = np.arange(BINS) % 100 < 50


def fitted(**louder):
    """A fit that leaves white noise, of some signals times a factor while the bench moves."""
    random = np.random.default_rng(5)
    left, blocks = [], []
    for name in NAMES:
        factor = louder.get(name.rpartition(".")[2], 1.0)
        scatter = WHITE * random.standard_normal(BINS)
        left.append(np.where(MOVING, factor, 1.0) * scatter)
        signal = SimpleNamespace(name=name, noise=WHITE, count=np.full(BINS, 4.0))
        rows = slice(len(blocks) * BINS, (len(blocks) + 1) * BINS)
        blocks.append(SimpleNamespace(signal=signal, rows=rows))
    observation = SimpleNamespace(
        simulate=lambda parameters: None,
        rates=lambda simulation: [MOVING + 0.001 * np.arange(BINS) / BINS for _ in NAMES],
    )
    problem = SimpleNamespace(
        observations=[observation], blocks=blocks,
        noise={name: Noise(WHITE, 0.0, 1.0, PERIOD) for name in NAMES},
        log_prior=lambda: -2.0,
    )
    return SimpleNamespace(problem=problem, left=np.concatenate(left), parameters=None)


def test_noise_shows_nowhere():
    left = left_over(fitted())
    assert left.shows == () and left.size == 0.0 and left.drift == 2.0


def test_every_signal_that_scatters_in_motion_is_named_and_the_surest_first():
    left = left_over(fitted(temperature=3.0, deflection=2.0))
    assert left.shows == ("front_1.temperature", "deflection")
    assert left.signal == "front_1.temperature"
    assert left_over(fitted(deflection=2.0)).shows == ("deflection",)


# --- Errors of numbers: two records of six pulses each, of which one number is the height.

PULSES, INTERVAL = 12, 1.645
HEIGHT = np.tile(np.where(np.arange(100) < 50, 1.0, 0.0), PULSES)


def fitted_height(random, uneven):
    """The least squares height of pulses that truly are 1 high in the mean, each off by `uneven`
    of a standard deviation, in white noise of 1."""
    true = np.repeat(1.0 + uneven * random.standard_normal(PULSES), 100) * HEIGHT
    measured = true + random.standard_normal(len(true))
    information = HEIGHT @ HEIGHT + 1.0
    x = np.array([HEIGHT @ measured / information])
    time = np.arange(600.0)
    records = [SimpleNamespace(grid=time) for _ in range(2)]
    blocks = [
        SimpleNamespace(
            observation=record, signal=SimpleNamespace(time=time),
            rows=slice(600 * k, 600 * (k + 1)),
        )
        for k, record in enumerate(records)
    ]
    stub = SimpleNamespace(
        observations=records, blocks=blocks, whiten=lambda rows: rows,
        white_nuisances=np.zeros((len(true), 0)),
    )
    stub.stretches = lambda parts: Problem.stretches(stub, parts)
    unknowns = SimpleNamespace(
        slopes=lambda x: np.ones(len(x)), turn=lambda x: np.eye(len(x))
    )
    return Fit(
        stub, unknowns, x, np.zeros(0), np.array([[1.0 / information]]), 0.0,
        HEIGHT * x[0], HEIGHT[:, None], measured - HEIGHT * x[0],
    )


def held(uneven):
    """Shares of 90 % intervals that hold the height: by the noise alone, and as stated."""
    random = np.random.default_rng(3)
    fits = [fitted_height(random, uneven) for _ in range(400)]
    off = np.array([abs(f.x[0] - 1.0) for f in fits])
    return [
        float(np.mean(off < INTERVAL * np.array([getattr(f, name)[0] for f in fits])))
        for name in ("std", "jackknifed")
    ]


def test_errors_hold_a_misfit_that_differs_from_pulse_to_pulse():
    noise_alone, stated = held(uneven=1.0)
    assert noise_alone < 0.5
    assert 0.8 < stated < 0.95


def test_errors_of_a_model_that_leaves_noise_are_those_of_the_noise():
    noise_alone, stated = held(uneven=0.0)
    assert noise_alone > 0.86 and stated < 0.96


def test_errors_are_never_above_what_was_known():
    random = np.random.default_rng(4)
    assert fitted_height(random, uneven=50.0).jackknifed[0] == 1.0


def test_errors_where_one_reading_beyond_all_measure_tells_everything_are_the_priors():
    fitted_well = fitted_height(np.random.default_rng(4), uneven=0.0)
    derivatives = fitted_well.derivatives.copy()
    derivatives[0] = 1e20
    assert replace(fitted_well, derivatives=derivatives).jackknifed[0] == 1.0
