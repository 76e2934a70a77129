"""Every noise model, and instruments with their resolution, lag, spot, clock and losses."""

from dataclasses import replace

import numpy as np
import pytest

from examination.blind.cases import Card, draw_case
from examination.blind.reality import Outcome, World
from examination.blind.rigs import CHANNELS
from examination.blind.sensors import (
    NOISE_MODELS,
    RADIANCE_EXPONENT,
    RESOLUTION,
    Noise,
    measure,
    readings,
)

PERIOD = 0.02
CASE = draw_case(7, 0, Card("none", (), (), "all", "white"), "0001")
SENSORS = replace(CASE.sensors, camera_clock=0.0)


def step_outcome(n=3000):
    """Wires that jump from 300 to 360 K at 10 s, a tip that follows, 2 V all along after 5 s."""
    time = np.arange(n) * PERIOD
    wires = np.ones(len(CHANNELS))
    voltage = np.outer(np.where(time >= 5.0, 2.0, 0.0), wires)
    temperature = np.outer(np.where(time >= 10.0, 360.0, 300.0), wires)
    deflection = np.where(time >= 10.0, 0.02, 0.0)
    sides = np.zeros((n, 2))
    return Outcome(
        time, voltage, voltage / 3.0, temperature, np.full_like(temperature, 310.0),
        np.ones_like(temperature), np.zeros_like(temperature), deflection, sides,
        np.full(n, 295.0),
    )  # fmt: skip


def world(**features):
    return World(CASE.truth, features)


@pytest.mark.parametrize("noise_model", NOISE_MODELS)
def test_noise_has_its_standard_deviation_and_correlation(noise_model):
    rng = np.random.default_rng(1)
    noise = Noise.of_model(noise_model, 0.25, rng)
    records = np.array([noise.draw(6000, PERIOD, rng) for _ in range(60)])
    assert np.sqrt(np.mean(records**2)) == pytest.approx(0.25, rel=0.08)
    neighbours = np.mean(records[:, 1:] * records[:, :-1]) / 0.25**2
    expected = noise.share * np.exp(-PERIOD / noise.correlation_time)
    assert neighbours == pytest.approx(expected, abs=0.06)


@pytest.mark.parametrize("share, time", [(0.0, 1.0), (0.8, 0.3), (0.25, 20.0), (0.95, 1.5)])
def test_whitened_means_of_noise_are_white_and_of_unit_size(share, time):
    noise = Noise(3.0, share, time)
    drawn = noise.draw(100_000, PERIOD, np.random.default_rng(2))
    white = noise.whiten_means(drawn.reshape(-1, 10).mean(axis=1), 0.2, 10.0)[50:]
    assert white.std() == pytest.approx(1.0, abs=0.03)
    for lag in (1, 2, 5):
        assert np.mean(white[lag:] * white[:-lag]) == pytest.approx(0.0, abs=0.04)


def test_readings_have_the_resolution_of_the_converters_and_the_camera():
    signals = {s.name: s for s in measure(
        step_outcome(), world(), SENSORS, CHANNELS, np.random.default_rng(3)
    )}  # fmt: skip
    for name, zero in (("front_1.current", 0.0), ("back_2.temperature", 273.15)):
        quantity = name.rpartition(".")[2]
        counts = (signals[name].values - zero) / RESOLUTION[quantity]
        np.testing.assert_allclose(counts, np.rint(counts), atol=1e-6)
    volts = signals["front_1.voltage"]
    assert np.all(volts.values[volts.time < 4.99] == 0.0)
    assert volts.values[volts.time > 5.01].std() == pytest.approx(
        SENSORS.std("voltage"), rel=0.1
    )


def test_stamps_jitter_messages_are_lost_and_the_camera_clock_is_off():
    sensors = replace(SENSORS, dropout=0.02, jitter=0.001, camera_clock=0.01)
    signals = {s.name: s for s in measure(
        step_outcome(), world(), sensors, CHANNELS, np.random.default_rng(4)
    )}  # fmt: skip
    power, camera = signals["front_1.voltage"], signals["front_1.temperature"]
    assert len(power) == pytest.approx(0.98 * 2999, abs=20)
    assert len(camera) == pytest.approx(0.98 * 1499, abs=15)
    steps = np.diff(power.time)
    assert steps.min() > 0.0
    assert steps[steps < 0.03].std() == pytest.approx(0.001 * np.sqrt(2.0), rel=0.1)
    # Images are stamped late, so they seem to arrive early, and show the step late.
    assert np.median(camera.received - camera.time) == pytest.approx(0.006 - 0.01, abs=5e-4)
    assert np.median(power.received - power.time) == pytest.approx(0.002, abs=5e-4)
    # ROS stamps of power messages are the same for voltage and current.
    np.testing.assert_array_equal(power.time, signals["front_1.current"].time)


def test_half_filled_spot_reads_the_mean_radiance():
    read = readings(step_outcome(), world(spot_fill=0.5), SENSORS)["temperature"][-1, 0]
    mixed = 0.5 * (360.0**RADIANCE_EXPONENT + 310.0**RADIANCE_EXPONENT)
    assert read == pytest.approx(mixed ** (1.0 / RADIANCE_EXPONENT))
    assert 337.0 < read < 339.0  # above the mean temperature: hot shines more


def test_lagging_camera_reaches_63_percent_after_its_time_constant():
    read = readings(step_outcome(), world(camera_lag=0.5), SENSORS)["temperature"][:, 0]
    at = int(round(10.5 / PERIOD))
    assert read[at] == pytest.approx(300.0 + 60.0 * (1.0 - np.exp(-1.0)), abs=1.0)
    assert read[0] == pytest.approx(300.0)


def test_late_camera_clock_shifts_the_temperature():
    late = replace(SENSORS, camera_clock=0.1)
    read = readings(step_outcome(), world(), late)["temperature"][:, 0]
    assert read[int(round(10.04 / PERIOD))] == pytest.approx(300.0)
    assert read[int(round(10.14 / PERIOD))] == pytest.approx(360.0)


@pytest.mark.parametrize(
    "features, difference",
    [
        ({"pickup": 1e-3}, 1e-3 * 4 * 2.0 / 3.0),
        ({"sensor_nonlinearity": -2.0}, -2.0 * 0.02**2),
    ],
)
def test_deflection_sensor_errs_by_its_feature(features, difference):
    with_error, without = (
        readings(step_outcome(), world(**f), SENSORS)["deflection"] for f in (features, {})
    )
    assert with_error[-1] - without[-1] == pytest.approx(difference)
    assert with_error[0] == without[0] == 0.0


def test_drift_starts_at_zero_is_smooth_and_reaches_its_size():
    drifting = readings(step_outcome(), world(deflection_drift=1e-3), SENSORS)["deflection"]
    drift = drifting - step_outcome().deflection
    assert drift[0] == pytest.approx(0.0, abs=1e-12)
    assert np.abs(drift).max() == pytest.approx(1e-3)
    assert np.abs(np.diff(drift)).max() < 1e-5


def test_shutter_steps_are_steps_and_the_same_on_all_wires():
    outcome = step_outcome()
    stepped = readings(outcome, world(shutter_steps=1.0), SENSORS)["temperature"]
    offset = stepped - outcome.temperature
    assert np.ptp(offset, axis=1).max() < 1e-9
    changes = np.flatnonzero(np.abs(np.diff(offset[:, 0])) > 1e-9)
    assert 1 <= len(changes) <= 6
    assert np.all(offset[: changes[0], 0] == 0.0)
