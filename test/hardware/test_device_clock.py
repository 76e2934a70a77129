"""Device stamps on the host's clock."""

import math

import numpy as np
import pytest

from sma_bench.hardware.device_clock import DeviceClock

WRAP = 1 << 32


def synchronised(
    drift: float, seconds: float, latency: float = 1e-3, start_us: int = 0, seed: int = 1
) -> tuple[DeviceClock, float]:
    """A clock after pings at 12 Hz: each way takes 0.2 ms and an exponential time, the device 1 to
    3 ms in between."""
    random = np.random.default_rng(seed)
    clock = DeviceClock()

    def stamp(host: float) -> int:
        return (start_us + round(host * (1.0 - drift) * 1e6)) % WRAP

    for sent in np.arange(0.0, seconds, 0.0837):
        arrived = sent + 2e-4 + random.exponential(latency)
        left = arrived + random.uniform(1e-3, 3e-3)
        heard = left + 2e-4 + random.exponential(latency)
        clock.add(sent, stamp(arrived), stamp(left), heard)
    return clock, seconds


@pytest.mark.parametrize("drift", [-4e-3, 0.0, 5e-5, 4e-3])
def test_stamps_are_right_within_half_a_millisecond_after_five_seconds(drift: float) -> None:
    for seed in range(20):
        clock, now = synchronised(drift, 5.0, seed=seed)
        stamp = round(now * (1.0 - drift) * 1e6)
        assert clock.host_time(stamp) == pytest.approx(now, abs=5e-4)


def test_drift_is_estimated() -> None:
    clock, _ = synchronised(2e-3, 30.0)
    assert clock.drift == pytest.approx(2e-3, abs=2e-5)


def test_uncertainty_is_half_of_what_the_quickest_ways_took() -> None:
    clock = DeviceClock()
    assert clock.uncertainty == math.inf
    clock.add(1.0, 0, 1_000, 1.005)
    clock.add(2.0, 1_000_000, 1_005_000, 2.007)
    clock.add(3.0, 2_000_000, 2_000_000, 3.010)
    assert clock.uncertainty == pytest.approx(1e-3)


def test_wrap_of_the_microsecond_counter_is_not_a_jump() -> None:
    start = WRAP - 2_500_000
    clock, now = synchronised(0.0, 5.0, start_us=start)
    before = clock.host_time((start + 1_000_000) % WRAP)
    after = clock.host_time((start + 5_000_000) % WRAP)
    assert after - before == pytest.approx(4.0, abs=1e-3)
    assert after == pytest.approx(now, abs=5e-4)


def test_unsynchronised_clock_has_no_time() -> None:
    clock = DeviceClock()
    assert not clock.synchronised
    assert math.isnan(clock.host_time(0))


def test_answer_before_its_question_is_ignored() -> None:
    clock = DeviceClock()
    clock.add(2.0, 0, 0, 1.0)
    clock.add(2.0, 10, 0, 3.0)
    assert not clock.synchronised


def test_slow_answers_hardly_move_it() -> None:
    clock, now = synchronised(0.0, 10.0, latency=1e-4)
    good = clock.host_time(round(now * 1e6))
    stamp = round(now * 1e6)
    clock.add(now, stamp, stamp, now + 0.2)
    assert clock.host_time(round(now * 1e6)) == pytest.approx(good, abs=5e-5)
