"""Plateaus and ramps from the voltage alone."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sma_bench.estimation.voltage import applied_voltage, find_segments

STEP = 10.0 / 1023.0


def measured(rng, time, voltage, noise=0.003):
    return np.round((voltage + rng.normal(0.0, noise, len(time))) / STEP) * STEP


def test_quiet_supply_shows_the_same_plateaus_and_one_wild_sample_none():
    time = np.arange(0.0, 30.0 * 26, 0.05)
    level = 26 * STEP * np.minimum((time / 30.0 + 1e-9).astype(int), 25)
    read = measured(np.random.default_rng(3), time, level, 0.0)
    read[700] = 9.0
    found = find_segments(time, read)
    assert (len(found.plateaus), len(found.ramps)) == (26, 0)


@settings(max_examples=20, deadline=None)
@given(levels=st.lists(st.integers(0, 24), min_size=2, max_size=12), dwell=st.floats(3.0, 40.0),
       rate=st.sampled_from([10.0, 20.0, 100.0]), seed=st.integers(0, 1000))  # fmt: skip
def test_any_steps_come_back_as_plateaus_at_their_levels(levels, dwell, rate, seed):
    levels = [a for a, b in zip(levels, [*levels[1:], -1], strict=True) if a != b]
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, dwell * len(levels), 1.0 / rate)
    time = time[rng.random(len(time)) > 0.05]
    truth = np.array(levels)[np.minimum((time / dwell).astype(int), len(levels) - 1)] * 0.25
    found = find_segments(time, measured(rng, time, truth))
    assert [s.kind for s in found.items] == ["plateau"] * len(levels)
    assert [p.level for p in found.plateaus] == pytest.approx(
        [0.25 * level for level in levels], abs=STEP
    )


def test_a_ramp_of_a_duty_read_by_a_coarse_converter_heats_as_it_did():
    """Its volts are a root of time; taken for a few straight lines they made c_p 19 % too large."""
    time = np.arange(0.0, 41.0, 0.01)
    exact = np.sqrt(72.0 * np.interp(time, [0.0, 20.0, 40.0], [0.0, 1.0, 0.0]))
    read = np.round(exact / STEP) * STEP
    grid = np.arange(0.0, 41.0, 0.1)
    held = applied_voltage([(time, read)]).on_grid(grid, np.zeros(0))[:, 0]
    true = np.sqrt(72.0 * np.interp(grid + 0.05, [0.0, 20.0, 40.0], [0.0, 1.0, 0.0]))
    driven = true > 0.3 * true.max()
    assert held[driven] == pytest.approx(true[driven], rel=1.5e-3)


def test_a_step_that_one_noisy_sample_does_not_show_is_no_ramp():
    """22 mV at 1.8 V, where a sample may be off by 8 times 5 mV: taken for a ramp it put 1 % of the
    heat elsewhere, which no candidate explains."""
    rng = np.random.default_rng(5)
    time = np.arange(0.0, 24.0, 0.02)
    exact = np.interp(time, [0.0, 20.0, 24.0], [1.0, 1.8, 1.8])  # a ramp stays one
    steps = np.where(time < 4.42, 1.777, np.where(time < 8.03, 1.799, 1.895))
    grid = np.arange(0.0, 12.0, 0.1)
    for volts in (steps, exact):
        read = np.round((volts + rng.normal(0.0, 0.0054, len(time))) / 0.0049) * 0.0049
        applied = applied_voltage([(time, read)])
        held = applied.on_grid(grid, np.zeros(len(applied.early)))[:-1, 0]
        true = np.interp(grid[:-1] + 0.05, time, volts)
        far = np.min(np.abs(grid[:-1, None] + 0.05 - [4.42, 8.03]), axis=1) > 0.1
        assert held[far] == pytest.approx(true[far], abs=2.5e-3)


@pytest.mark.parametrize("noise", [0.0, 0.005])
@pytest.mark.parametrize("period", [0.04, 0.48, 1.0])
def test_triangles_of_a_slow_logger_heat_as_they_did_between_its_readings(period, noise):
    """Heat spread evenly from one reading to the next came up to half a period early or late, which
    passed for a sensor's lag; corners between two readings passed for jumps."""

    def volts(time):
        turn = (time - 2.0) % 20.0
        return 0.55 * np.minimum(turn, 20.0 - turn) * (time > 2.0)

    time, grid = np.arange(0.0, 60.0, period), np.arange(0.0, 58.0, 0.02)
    read = volts(time) + noise * np.random.default_rng(0).standard_normal(len(time))
    found = applied_voltage([(time, read)])
    held = found.on_grid(grid, np.zeros(len(found.early)))[:-1, 0]
    assert held**2 == pytest.approx(volts(grid[:-1] + 0.01) ** 2, abs=0.25)
    assert len(found.early) <= 1  # where it begins, at most


@pytest.mark.parametrize(
    ("drive", "noise", "step", "off"), [
        ("triangles", 0.06, 0.02, 0.005), ("triangles", 0.01, 0.05, 0.003),
        ("ramps", 0.06, 0.02, 0.009), ("sines", 0.02, 0.0, 0.003), ("sines", 0.005, 0.01, 0.0018),
        ("sines", 0.01, 0.05, 0.004), ("cycles", 0.02, 0.0, 0.005),
    ],
)  # fmt: skip
def test_a_noisy_voltmeters_ramps_and_curves_heat_as_they_did(drive, noise, step, off):
    """Corners that noise hid and chords of a sine were a lag of the thermometer, with 86 %."""
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
    read = exact + noise * random.standard_normal(len(time))
    read = np.round(read / step) * step if step else read
    voltage = applied_voltage([(time, read)])
    grid = np.arange(0.0, 199.0, 0.5)
    held = voltage.on_grid(grid, np.zeros(len(voltage.early)))[:-1, 0]
    true = np.sqrt(np.mean(exact[: 50 * len(held)].reshape(-1, 50) ** 2, axis=1))
    jumping = voltage.is_jumping(time[: 50 * len(held)]).reshape(-1, 50).any(axis=1)
    steady = (true > 0.5) & ~jumping
    assert np.sqrt(np.mean((held - true)[steady] ** 2)) < off


@settings(max_examples=60, deadline=None)
@given(kind=st.sampled_from(["corners", "steps", "waves", "wander"]), n=st.integers(25, 1500),
       noise=st.sampled_from([0.0, 0.001, 0.02, 0.1]), step=st.sampled_from([0.0, 0.005, 0.05]),
       rate=st.sampled_from([2.0, 10.0, 100.0]), seed=st.integers(0, 9999))  # fmt: skip
def test_whatever_a_voltage_does_its_pieces_stay_in_order_and_near_it(
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
    read = exact + noise * random.standard_normal(n)
    read = np.round(read / step) * step if step else read
    voltage = applied_voltage([(time, read)])
    (polygon,) = voltage.channels
    assert all(first < last for first, last, _ in polygon.lines)
    assert np.all(np.diff(polygon.time) >= 0.0)
    assert all(np.isfinite(knots).all() for error in voltage.line_errors() for knots in error)
    grid = np.linspace(time[0], time[-1], 50)
    held = voltage.on_grid(grid, np.zeros(len(voltage.early)))
    assert np.isfinite(held).all() and held.max() <= 1.5 * np.abs(read).max() + 0.5
