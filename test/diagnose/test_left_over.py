"""Which signals a fit leaves more of in motion than at rest."""

from types import SimpleNamespace

import numpy as np

from sma_bench.diagnose.left_over import left_over
from sma_bench.estimation.noise_model import Noise

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
