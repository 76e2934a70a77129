"""Sensor chains: their noise and their steps."""

import numpy as np
import pytest

from sma_bench.hardware.bench_sensors import Instrument


def readings(noise, resolution, seed=1, n=20_000, value=2.5):
    instrument = Instrument(noise, resolution, np.random.SeedSequence(seed))
    return np.array([instrument.read(value) for _ in range(n)])


def test_a_perfect_instrument_reads_the_truth():
    assert set(readings(0.0, 0.0)) == {2.5}


def test_noise_has_its_standard_deviation_and_no_offset():
    read = readings(0.08, 0.0)
    assert np.std(read) == pytest.approx(0.08, rel=0.03)
    assert np.mean(read) == pytest.approx(2.5, abs=0.003)


def test_readings_are_whole_steps():
    read = readings(0.08, 0.1)
    assert np.allclose(read, np.round(read / 0.1) * 0.1)
    assert len(set(np.round(read, 6))) > 4


def test_the_seed_makes_the_noise():
    assert np.array_equal(readings(0.1, 0.0, seed=3), readings(0.1, 0.0, seed=3))
    assert not np.array_equal(readings(0.1, 0.0, seed=3), readings(0.1, 0.0, seed=4))


def test_many_at_once_are_what_one_after_the_other_reads():
    true = np.linspace(-0.3, 2.0, 9000)
    apart, together = (Instrument(0.08, 0.1, np.random.SeedSequence(5)) for _ in range(2))
    one_by_one = np.array([apart.read(value) for value in true.tolist()])
    parts = [together.read_all(true[:10]), [together.read(true[10])], together.read_all(true[11:])]
    assert np.concatenate(parts).tobytes() == one_by_one.tobytes()
