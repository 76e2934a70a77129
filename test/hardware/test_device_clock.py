"""Device stamps on the host's clock."""

import math

import numpy as np
import pytest

from sma_bench.hardware.serial_messages import DeviceClock

WRAP, STEP = 1 << 32, 1e-4


def synchronised(drift, seconds, latency=1e-3, start_us=0):
    """A clock after pings at 12 Hz: each way takes at least 0.2 ms, the device 1 to 3 ms."""
    random, clock = np.random.default_rng(1), DeviceClock()

    def stamp(host):
        return (start_us + round(host * (1.0 - drift) * 1e6)) % WRAP

    for sent in np.arange(0.0, seconds, 0.0837):
        arrived = sent + 2e-4 + random.exponential(latency)
        left = arrived + random.uniform(1e-3, 3e-3)
        heard = left + 2e-4 + random.exponential(latency)
        clock.add(sent, stamp(arrived), stamp(left), heard)
    return clock


def test_drift_is_estimated_and_neither_a_wrap_nor_slow_answers_move_the_clock():
    for drift in (-4e-3, 5e-5, 2e-3):
        clock = synchronised(drift, 30.0)
        assert clock.drift == pytest.approx(drift, abs=2e-5)
        stamp = round(30.0 * (1.0 - drift) * 1e6)
        assert clock.host_time(stamp) == pytest.approx(30.0, abs=5e-4)
    start = WRAP - 2_500_000
    clock = synchronised(0.0, 5.0, start_us=start)
    before, after = (clock.host_time((start + us) % WRAP) for us in (1_000_000, 5_000_000))
    assert (after - before, after) == (pytest.approx(4.0, abs=1e-3), pytest.approx(5.0, abs=5e-4))
    clock = synchronised(0.0, 10.0, latency=1e-4)
    good = clock.host_time(10_000_000)
    clock.add(10.0, 10_000_000, 10_000_000, 10.2)
    assert clock.host_time(10_000_000) == pytest.approx(good, abs=5e-5)


def test_unsynchronised_clock_has_no_time():
    clock = DeviceClock()
    assert math.isnan(clock.host_time(0)) and clock.uncertainty == math.inf
    for answer in ((2.0, 0, 0, 1.0), (2.0, 10, 0, 3.0)):  # heard before it was sent, or left
        clock.add(*answer)
    assert math.isnan(clock.host_time(0))
    for k in range(20):
        late = 0.0 if k % 3 else 0.05
        clock.add(k + 0.998, 1_000_000 * k, 1_000_000 * k + 1_000, k + 1.005 + late)
    assert clock.uncertainty == pytest.approx(3e-3, rel=0.01)
    assert clock.host_time(19_000_000) == pytest.approx(20.001, abs=1e-5)


def test_a_host_that_slept_for_two_seconds_finds_its_stamps_right():
    clock, device = synchronised(1e-3, 10.0), 10.0 * (1.0 - 1e-3)
    for k in range(200):
        clock.heard(round((device + 0.01 * k) * 1e6), 12.0 + 1e-3 * k)
    clock.add(10.0, round(device * 1e6), round((device + 1e-3) * 1e6), 12.2)
    later = clock.host_time(round((device + 1.0) * 1e6))
    assert later == pytest.approx(10.0 + 1.0 / (1.0 - 1e-3), abs=1e-3)


def stalled(random, host, a_second):
    """Mask of `host` times that lie in stalls: heavy-tailed, 1 ms to 0.3 s, half above 2 ms."""
    still = np.zeros(len(host), dtype=bool)
    for begin in random.uniform(0.0, host[-1], round(a_second * host[-1])):
        length = min(1e-3 * (1.0 - random.uniform()) ** (-1.0 / 0.9), 0.3)
        still[(host >= begin) & (host < begin + length)] = True
    return still


def listened(seed, stumbling, drift, rate, seconds=10.0):
    """Errors (s) of the stamps of all frames after 5 s. The host neither writes nor reads while it
    stalls; a `stumbling` device stalls, too, and catches up at three times the speed, like an
    emulator."""
    random = np.random.default_rng(seed)
    host = np.arange(0.0, seconds + 3.0, STEP)
    awake = host[~stalled(random, host, 20.0)]
    lag, stumbles = np.zeros(len(host)), stalled(random, host, 10.0 * stumbling)
    for k in range(1, len(host)):
        lag[k] = max(0.0, lag[k - 1] + (STEP if stumbles[k] else -2.0 * STEP))

    def when_awake(time):
        time = time + random.exponential(3e-4, len(time))
        return np.maximum(time, awake[np.searchsorted(awake, time - STEP)])

    def stamps(time):
        return np.rint(time * (1.0 - drift) * 1e6).astype(int).tolist()

    # When each ping and each frame is sent, arrives, and is read.
    frames, sent = np.arange(1.0 / rate, seconds, 1.0 / rate), np.arange(0.3, seconds, 0.0837)
    arrived = np.interp(when_awake(sent) + 3e-4, host, host - lag)
    left = arrived + random.uniform(1e-3, 3e-3, len(sent))
    heard = np.maximum.accumulate(when_awake(np.interp(frames, host - lag, host) + 3e-3))
    answered = when_awake(np.interp(left, host - lag, host) + 3e-4)
    pings = zip(answered, sent, stamps(arrived), stamps(left), strict=True)
    readings = zip(heard, frames, stamps(frames), strict=True)
    clock, errors = DeviceClock(), []
    for now, begin, stamp, *end in sorted([*pings, *readings]):
        if end:
            clock.add(float(begin), stamp, *end, float(now))
            continue
        clock.heard(stamp, float(now))
        if begin > 5.0:
            errors.append(clock.host_time(stamp) - begin)
    return np.array(errors)


@pytest.mark.parametrize(("stumbling", "drift", "rate"),
                         [(False, -4e-3, 500), (False, 4e-3, 100), (True, 0.0, 100)])
def test_neither_a_busy_host_nor_a_stumbling_emulator_moves_the_stamps(stumbling, drift, rate):
    for seed in range(2 if stumbling else 1):
        errors = listened(seed, stumbling, drift, rate)
        assert len(errors) > 0.9 * 5.0 * rate
        assert np.abs(errors).max() < 1e-3
