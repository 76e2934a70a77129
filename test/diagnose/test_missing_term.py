"""Where a gap lies that nothing explains: not where a worthless response happens to be."""

from types import SimpleNamespace

import numpy as np
import pytest

from sma_bench.diagnose.decision import FLEXIBLE
from sma_bench.diagnose.stages import missing_term
from sma_bench.estimation.noise_model import Noise, estimate_noise

PERIOD, BINS = 0.2, 600
STEPS = np.where(np.arange(BINS) // 150 % 2, 1.0, 0.0)  # of a camera's shutter, in K
NAMES = ("front_1.current", "front_1.temperature")


def scatter(seed):
    return 0.05 * np.random.default_rng(seed).standard_normal(BINS)


def searched(gain, course=STEPS):
    left = [scatter(1), scatter(2) + course]
    noise = {
        name: estimate_noise([part], 0.05, PERIOD) for name, part in zip(NAMES, left, strict=True)
    }
    blocks = [
        SimpleNamespace(signal=SimpleNamespace(name=name), rows=slice(k * BINS, (k + 1) * BINS))
        for k, name in enumerate(NAMES)
    ]
    problem = SimpleNamespace(blocks=blocks, noise=noise)
    in_the_current = np.concatenate([np.full(BINS, 1e-4), np.zeros(BINS)])
    return SimpleNamespace(
        recalibrated=SimpleNamespace(problem=problem, left=np.concatenate(left)),
        flexible=SimpleNamespace(gain=gain, response=in_the_current),
    )


def powers(found):
    current, temperature = np.split(missing_term(found), 2)
    return float(np.mean(current**2)), float(np.mean(temperature**2))


@pytest.mark.parametrize("gain", [0.0, 0.5, FLEXIBLE])
def test_a_response_that_gains_little_is_not_what_is_missing(gain):
    current, temperature = powers(searched(gain))
    assert temperature == pytest.approx(np.mean(STEPS**2), rel=0.1)
    assert current < 0.1 * temperature


def test_a_sure_response_is_what_is_missing():
    current, temperature = powers(searched(FLEXIBLE + 1.0))
    assert (current, temperature) == (pytest.approx(1e-8), 0.0)


def test_what_scatters_is_taken_where_nothing_is_slow():
    found = searched(0.0, np.zeros(BINS))
    problem = found.recalibrated.problem
    problem.noise = {name: Noise(0.05, 0.0, 1.0, PERIOD) for name in NAMES}
    assert missing_term(found) is found.recalibrated.left
