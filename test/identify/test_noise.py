"""Raw readings: plateaus, ramps and heat of a voltage; noise of a sensor, its mean, whitening and
estimation."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lfilter

from sma_bench.estimation.estimate import Estimate
from sma_bench.estimation.noise_model import Noise, estimate_noise
from sma_bench.estimation.voltage import applied_voltage, find_segments
from sma_bench.identify.fits import combine

STEP = 10.0 / 1023.0


def read(rng, exact, noise=0.003, step=STEP):
    """Add noise and round to steps of a converter, 0 for none."""
    noisy = exact + noise * rng.standard_normal(len(exact))
    return np.round(noisy / step) * step if step else noisy


def held(time, values, grid):
    """The reconstructed voltage, and its values on a grid."""
    applied = applied_voltage([(time, values)])
    return applied, applied.on_grid(grid, np.zeros(len(applied.early)))[:, 0]


def test_a_quiet_supply_shows_all_plateaus_and_one_outlier_adds_none():
    time = np.arange(0.0, 30.0 * 26, 0.05)
    level = 26 * STEP * np.minimum((time / 30.0 + 1e-9).astype(int), 25)
    volts = read(np.random.default_rng(3), level, 0.0)
    volts[700] = 9.0
    found = find_segments(time, volts)
    assert (len(found.plateaus), len(found.ramps)) == (26, 0)


@settings(max_examples=20, deadline=None)
@given(levels=st.lists(st.integers(0, 24), min_size=2, max_size=12), dwell=st.floats(3.0, 40.0),
       rate=st.sampled_from([10.0, 20.0, 100.0]), seed=st.integers(0, 1000))  # fmt: skip
def test_any_steps_are_found_as_plateaus_at_their_levels(levels, dwell, rate, seed):
    levels = [a for a, b in zip(levels, [*levels[1:], -1], strict=True) if a != b]
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, dwell * len(levels), 1.0 / rate)
    time = time[rng.random(len(time)) > 0.05]
    truth = np.array(levels)[np.minimum((time / dwell).astype(int), len(levels) - 1)] * 0.25
    found = find_segments(time, read(rng, truth))
    assert [s.kind for s in found.items] == ["plateau"] * len(levels)
    steps = [p.level for p in found.plateaus]
    assert steps == pytest.approx([0.25 * level for level in levels], abs=STEP)


def test_a_step_too_small_for_one_noisy_sample_is_not_taken_for_a_ramp():
    """22 mV at 1.8 V, where samples may be off by 8 times 5 mV: taken for a ramp it displaced 1 %
    of the heat, which no candidate explains."""
    rng = np.random.default_rng(5)
    time = np.arange(0.0, 24.0, 0.02)
    exact = np.interp(time, [0.0, 20.0, 24.0], [1.0, 1.8, 1.8])  # a ramp stays one
    steps = np.where(time < 4.42, 1.777, np.where(time < 8.03, 1.799, 1.895))
    grid = np.arange(0.0, 12.0, 0.1)
    for volts in (steps, exact):
        _, found = held(time, read(rng, volts, 0.0054, 0.0049), grid)
        true = np.interp(grid[:-1] + 0.05, time, volts)
        far = np.min(np.abs(grid[:-1, None] + 0.05 - [4.42, 8.03]), axis=1) > 0.1
        assert found[:-1][far] == pytest.approx(true[far], abs=2.5e-3)


@pytest.mark.parametrize("noise", [0.0, 0.005])
@pytest.mark.parametrize("period", [0.04, 0.48, 1.0])
def test_triangles_of_a_slow_logger_keep_their_heat_between_readings(period, noise):
    """Heat spread evenly from one reading to the next came up to half a period early or late, which
    passed for a sensor's lag; corners between two readings passed for jumps."""

    def volts(time):
        turn = (time - 2.0) % 20.0
        return 0.55 * np.minimum(turn, 20.0 - turn) * (time > 2.0)

    time, grid = np.arange(0.0, 60.0, period), np.arange(0.0, 58.0, 0.02)
    exact = read(np.random.default_rng(0), volts(time), noise, 0.0)
    applied, found = held(time, exact, grid)
    assert found[:-1] ** 2 == pytest.approx(volts(grid[:-1] + 0.01) ** 2, abs=0.25)
    assert len(applied.early) <= 1  # where it begins, at most


@pytest.mark.parametrize(
    ("drive", "noise", "step", "off"), [
        ("triangles", 0.06, 0.02, 0.005), ("triangles", 0.01, 0.05, 0.003),
        ("ramps", 0.06, 0.02, 0.009), ("sines", 0.02, 0.0, 0.003), ("sines", 0.005, 0.01, 0.0018),
        ("sines", 0.01, 0.05, 0.004), ("cycles", 0.02, 0.0, 0.005),
    ],
)  # fmt: skip
def test_ramps_and_curves_of_a_noisy_voltmeter_keep_their_heat(drive, noise, step, off):
    """Corners hidden by noise and chords of a sine passed for a lag of the thermometer (86 %)."""
    random = np.random.default_rng(5)
    time = np.arange(0.0, 200.0, 0.01)
    phase = np.maximum(time - 3.0, 0.0)
    levels = np.r_[0.0, 0.0, random.uniform(0.5, 4.0, 51)]
    exact = {
        "triangles": np.interp(time % 60.0, [0.0, 2.0, 22.0, 42.0], [0.0, 0.0, 4.0, 0.0]),
        "ramps": np.interp(time, np.arange(53) * 4.0, levels),
        "sines": 2.0 - 2.0 * np.cos(phase * np.pi / 20.0),
        "cycles": 4.0 * (1.0 - np.exp(-(phase % 50.0) / 8.0)) * (phase > 0.0),
    }[drive]
    voltage, found = held(time, read(random, exact, noise, step), np.arange(0.0, 199.0, 0.5))
    whole = slice(50 * len(found[:-1]))
    true = np.sqrt(np.mean(exact[whole].reshape(-1, 50) ** 2, axis=1))
    steady = (true > 0.5) & ~voltage.is_jumping(time[whole]).reshape(-1, 50).any(axis=1)
    assert np.sqrt(np.mean((found[:-1] - true)[steady] ** 2)) < off


@settings(max_examples=60, deadline=None)
@given(kind=st.sampled_from(["corners", "steps", "waves", "wander"]), n=st.integers(25, 1500),
       noise=st.sampled_from([0.0, 0.001, 0.02, 0.1]), step=st.sampled_from([0.0, 0.005, 0.05]),
       rate=st.sampled_from([2.0, 10.0, 100.0]), seed=st.integers(0, 9999))  # fmt: skip
def test_the_pieces_of_any_voltage_stay_in_order_and_near_it(
    kind, n, noise, step, rate, seed
):
    random = np.random.default_rng(seed)
    time = np.cumsum(random.uniform(0.5, 1.5, n)) / rate
    at, levels = np.sort(random.uniform(0.0, time[-1], 12)), random.uniform(0.0, 5.0, 12)
    exact = np.interp(time, at, levels)
    if kind == "steps":
        exact = levels[np.maximum(np.searchsorted(at, time) - 1, 0)]
    elif kind == "waves":
        exact = 2.5 - 2.5 * np.cos(time * random.uniform(0.05, 3.0))
    elif kind == "wander":
        exact = exact + 0.02 * np.cumsum(random.standard_normal(n))
    volts = read(random, exact, noise, step)
    voltage, found = held(time, volts, np.linspace(time[0], time[-1], 50))
    (polygon,) = voltage.channels
    assert all(first < last for first, last, _ in polygon.lines)
    assert np.all(np.diff(polygon.time) >= 0.0)
    assert all(np.isfinite(knots).all() for error in voltage.line_errors() for knots in error)
    assert np.isfinite(found).all() and found.max() <= 1.5 * np.abs(volts).max() + 0.5


# --- Noise of a sensor.
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


def log_likelihood(noise, residual):
    """As in the fits: the whitened residual, and the log determinant of the whitening."""
    white = noise.whiten(residual)
    return -0.5 * white @ white - noise.log_scale(len(residual))


def test_disagreeing_records_widen_the_error():
    agreeing = combine([Estimate(v, 0.1, "K", "m", 5) for v in (1.0, 1.05, 0.95)])
    disagreeing = combine([Estimate(v, 0.1, "K", "m", 5) for v in (1.0, 2.0, 0.0)])
    assert agreeing.std == pytest.approx(0.1 / np.sqrt(3.0))
    assert disagreeing.std == pytest.approx(1.0 / np.sqrt(3.0), rel=0.01)
    assert agreeing.n == 15


@pytest.mark.parametrize("noise", NOISES, ids=str)
def test_whitened_noise_is_white_and_its_likelihood_equals_that_of_the_full_covariance(noise):
    white = noise.whiten(drawn(noise, 20_000, seed=3))
    assert np.var(white) == pytest.approx(1.0, abs=0.04)
    for lag in (1, 2, 5, 25):
        assert abs(np.mean(white[lag:] * white[:-lag])) < 4.0 / np.sqrt(len(white))
    lags = noise.period * np.abs(np.subtract.outer(np.arange(150), np.arange(150)))
    matrix = noise.white**2 * np.eye(150) + noise.drift**2 * np.exp(-lags / noise.time)
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


def test_an_implausible_drift_costs_probability_unless_the_sensors_zero_wanders():
    residual = drawn(Noise(0.1, 6.0, 60.0, PERIOD), 1500, 4)
    free = estimate_noise([residual], 0.1, PERIOD)
    held = estimate_noise([residual], 0.1, PERIOD, usual=0.3)
    wandering = estimate_noise([residual], 0.1, PERIOD, usual=0.3, wanders=True)
    assert free.log_prior == wandering.log_prior == 0.0
    assert held.log_prior < -3.0
    assert held.drift < free.drift
    whole = log_likelihood(held, residual) + held.log_prior
    assert whole < log_likelihood(free, residual)
