"""Device stamps on the host's clock."""

import math

import numpy as np
import pytest

from sma_bench.hardware.device import DeviceClock

WRAP = 1 << 32


def synchronised(drift, seconds, latency=1e-3, start_us=0, seed=1):
    """A clock after pings at 12 Hz: each way takes 0.2 ms and an exponential time, the device 1 to
    3 ms in between."""
    random = np.random.default_rng(seed)
    clock = DeviceClock()

    def stamp(host):
        return (start_us + round(host * (1.0 - drift) * 1e6)) % WRAP

    for sent in np.arange(0.0, seconds, 0.0837):
        arrived = sent + 2e-4 + random.exponential(latency)
        left = arrived + random.uniform(1e-3, 3e-3)
        heard = left + 2e-4 + random.exponential(latency)
        clock.add(sent, stamp(arrived), stamp(left), heard)
    return clock, seconds


@pytest.mark.parametrize("drift", [-4e-3, 5e-5])
def test_stamps_are_right_within_half_a_millisecond_after_five_seconds(drift):
    for seed in range(20):
        clock, now = synchronised(drift, 5.0, seed=seed)
        stamp = round(now * (1.0 - drift) * 1e6)
        assert clock.host_time(stamp) == pytest.approx(now, abs=5e-4)


def test_drift_is_estimated_and_neither_a_wrap_nor_slow_answers_move_the_clock():
    clock, _ = synchronised(2e-3, 30.0)
    assert clock.drift == pytest.approx(2e-3, abs=2e-5)
    start = WRAP - 2_500_000
    clock, now = synchronised(0.0, 5.0, start_us=start)
    before = clock.host_time((start + 1_000_000) % WRAP)
    after = clock.host_time((start + 5_000_000) % WRAP)
    assert after - before == pytest.approx(4.0, abs=1e-3)
    assert after == pytest.approx(now, abs=5e-4)
    clock, now = synchronised(0.0, 10.0, latency=1e-4)
    good = clock.host_time(round(now * 1e6))
    stamp = round(now * 1e6)
    clock.add(now, stamp, stamp, now + 0.2)
    assert clock.host_time(round(now * 1e6)) == pytest.approx(good, abs=5e-5)


def test_unsynchronised_clock_has_no_time():
    clock = DeviceClock()
    assert math.isnan(clock.host_time(0)) and clock.uncertainty == math.inf
    for answer in ((2.0, 0, 0, 1.0), (2.0, 10, 0, 3.0)):  # heard before it was sent, or left
        clock.add(*answer)
    assert not clock.synchronised
    for k in range(20):
        late = 0.0 if k % 3 else 0.05
        clock.add(k + 0.998, 1_000_000 * k, 1_000_000 * k + 1_000, k + 1.005 + late)
    assert clock.uncertainty == pytest.approx(3e-3, rel=0.01)
    assert clock.host_time(19_000_000) == pytest.approx(20.001, abs=1e-5)


# --- busy computers -------------------------------------------------------------------------------

STEP = 1e-4


def stalled(random, host, a_second):
    """When nothing runs: stalls of heavy-tailed length, 1 ms to 0.3 s, half of them above 2 ms."""
    still = np.zeros(len(host), dtype=bool)
    for begin in random.uniform(0.0, host[-1], round(a_second * host[-1])):
        length = min(1e-3 * (1.0 - random.uniform()) ** (-1.0 / 0.9), 0.3)
        still[(host >= begin) & (host < begin + length)] = True
    return still


def listened(seed, *, busy, stumbling, drift=0.0, rate=100, seconds=10.0):
    """Errors in s of the stamps of all frames after 5 s.

    A `busy` host neither writes nor reads during its stalls. A `stumbling` device stands still
    during its own, and catches up at three times the speed, as an emulator does.
    """
    random = np.random.default_rng(seed)
    host = np.arange(0.0, seconds + 3.0, STEP)
    still = stalled(random, host, 20.0 if busy else 0.0)
    awake = host[~still]
    lag = np.zeros(len(host))
    for k in np.flatnonzero(stalled(random, host, 10.0 if stumbling else 0.0)):
        lag[k] = STEP
    for k in range(1, len(host)):
        lag[k] = lag[k - 1] + STEP if lag[k] else max(0.0, lag[k - 1] - 2.0 * STEP)

    def when_awake(time):
        """A moment later than a time: nobody is quick even when awake."""
        time = time + random.exponential(3e-4, len(time))
        return np.maximum(time, awake[np.searchsorted(awake, time - STEP)])

    def stamps(time):
        return np.rint(time * (1.0 - drift) * 1e6).astype(int)

    frames = np.arange(1.0 / rate, seconds, 1.0 / rate)
    sent = np.arange(0.3, seconds, 0.0837)
    arrived = np.interp(when_awake(sent) + 3e-4, host, host - lag)
    left = arrived + random.uniform(1e-3, 3e-3, len(sent))
    heard = np.maximum.accumulate(when_awake(np.interp(frames, host - lag, host) + 3e-3))
    answered = when_awake(np.interp(left, host - lag, host) + 3e-4)
    came = [(time, -1, k) for k, time in enumerate(heard)]
    came += [(time, k, 0) for k, time in enumerate(answered)]
    clock, errors = DeviceClock(), []
    for now, ping, frame in sorted(came):
        if ping >= 0:
            asked, answer = stamps(arrived[ping : ping + 1])[0], stamps(left[ping : ping + 1])[0]
            clock.add(float(sent[ping]), int(asked), int(answer), float(now))
            continue
        stamp = int(stamps(frames[frame : frame + 1])[0])
        clock.heard(stamp, float(now))
        if frames[frame] > 5.0:
            errors.append(clock.host_time(stamp) - frames[frame])
    return np.array(errors)


@pytest.mark.parametrize(
    ("busy", "stumbling", "drift", "rate"),
    [(True, False, -4e-3, 500), (True, False, 4e-3, 100), (True, True, 0.0, 100)],
)
def test_neither_a_busy_host_nor_a_stumbling_emulator_moves_the_stamps(
    busy, stumbling, drift, rate
):
    for seed in range(3 if stumbling else 2):
        errors = listened(seed, busy=busy, stumbling=stumbling, drift=drift, rate=rate)
        assert len(errors) > 0.9 * 5.0 * rate
        assert np.abs(errors).max() < 1e-3


def test_a_host_that_slept_for_two_seconds_finds_its_stamps_right():
    clock, now = synchronised(1e-3, 10.0)
    device = now * (1.0 - 1e-3)
    for k in range(200):
        stamp = round((device + 0.01 * k) * 1e6)
        clock.heard(stamp, now + 2.0 + 1e-3 * k)
    clock.add(now, round(device * 1e6), round((device + 1e-3) * 1e6), now + 2.2)
    later = round((device + 1.0) * 1e6)
    assert clock.host_time(later) == pytest.approx(now + 1.0 / (1.0 - 1e-3), abs=1e-3)
