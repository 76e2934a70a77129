"""A record as the diagnosis sees it: bins, phases, and what cannot be compared."""

import numpy as np
import pytest
from planted import CHANNELS, DURATION, NOISE, RATE, believed, drive, planted_record, true_bench

from sma_bench.diagnose.view import view_record
from sma_bench.errors import InputError
from sma_bench.records import Record, Signal


@pytest.fixture(scope="module")
def view(tmp_path_factory):
    return view_record(planted_record(tmp_path_factory.mktemp("view") / "bag"), believed())


def record_of(*signals):
    return Record("made_up", 0, {s.name: s for s in signals})


def volts():
    time, voltage = drive()
    return [
        Signal(f"{name}.voltage", "V", time, voltage[:, k]) for k, name in enumerate(CHANNELS)
    ]


def test_every_signal_is_there_with_its_wire_and_side(view):
    wires = {f"{channel}.{q}" for channel in CHANNELS for q in ("current", "temperature")}
    assert {s.name for s in view.signals} == wires | {"deflection"}
    back = next(s for s in view.signals if s.name == "back_1.temperature")
    assert view.sides[back.wire] == "back"


def test_bins_are_means_of_samples_with_their_mean_time_and_noise(view):
    temperature = next(s for s in view.signals if s.name == "front_1.temperature")
    assert temperature.period == pytest.approx(0.2)
    assert np.median(temperature.count) == 10
    assert temperature.count.sum() == pytest.approx(RATE * DURATION, abs=1)
    assert temperature.noise == pytest.approx(NOISE["temperature"] / np.sqrt(10.0), rel=0.15)
    assert np.all(np.diff(temperature.time) > 0.0)


def test_a_straight_course_is_averaged_to_its_value_at_the_mean_time(view):
    for signal in view.signals:
        if signal.quantity != "current":
            mean = signal.average @ (3.0 + 2.0 * view.grid)
            np.testing.assert_allclose(mean, 3.0 + 2.0 * signal.time, atol=1e-9)


def test_a_current_is_the_mean_of_voltage_times_conductance(view):
    current = next(s for s in view.signals if s.quantity == "current")
    reading = current.average @ np.full(len(view.grid), 0.4)
    time, voltage = drive()
    whole = np.sum(reading * current.count) / RATE
    assert whole == pytest.approx(0.4 * np.sum(voltage[:, 0]) / RATE, rel=1e-3)
    held = (current.time > 2.8) & (current.time < 4.2)
    np.testing.assert_allclose(reading[held], 0.4 * 2.6, rtol=1e-4)


def test_time_before_during_and_after_driving_has_its_phase(view):
    at = np.array([0.5, 4.0, 6.5, 10.0, 19.0])
    assert view.phase_of(at).tolist() == ["initial", "drive", "rest", "drive", "rest"]


def test_readings_of_the_truth_are_within_the_noise(view):
    readings = view.readings(view.simulate(true_bench()))
    for signal, reading in zip(view.signals, readings, strict=True):
        misfit = np.sqrt(np.mean((signal.value - reading) ** 2)) / signal.noise
        assert 0.7 < misfit < 1.4, signal.name


def test_what_cannot_be_compared_is_named():
    time, _ = drive()
    force = Signal("force", "N", time, np.ones_like(time))
    with pytest.raises(InputError, match="made_up"):
        view_record(record_of(*volts(), force), believed())
    with pytest.raises(InputError, match="voltage"):
        view_record(record_of(Signal("deflection", "m", time, 0.0 * time)), believed())
