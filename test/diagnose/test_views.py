"""A record as the diagnosis sees it: bins, phases, what cannot be compared, and how far the gap of
one that is held out shrinks."""

import numpy as np
import pytest
from planted import CHANNELS, DURATION, NOISE, RATE, believed, drive, planted_record, true_bench

from sma_bench.diagnose.sizes import shrinkage
from sma_bench.errors import InputError
from sma_bench.estimation.noise_model import Noise
from sma_bench.estimation.observation import observe, shared_bin
from sma_bench.physics import simulate
from sma_bench.records import Record, Signal


@pytest.fixture(scope="module")
def view(tmp_path_factory):
    return observe(planted_record(tmp_path_factory.mktemp("view") / "bag"), believed())


def record_of(time, voltage, *others):
    volts = (Signal(f"{n}.voltage", "V", time, v) for n, v in zip(CHANNELS, voltage, strict=True))
    return Record("made_up", 0, {s.name: s for s in (*volts, *others)})


def test_every_signal_has_its_wire_and_bins_are_means_with_their_time_noise_and_phase(view):
    wires = {f"{channel}.{q}" for channel in CHANNELS for q in ("current", "temperature")}
    assert {s.name for s in view.signals} == wires | {"deflection"}
    back = next(s for s in view.signals if s.name == "back_1.temperature")
    assert view.sides[back.wire] == "back"
    at = np.array([0.5, 4.0, 6.5, 10.0, 19.0])
    assert view.phase_of(at).tolist() == ["initial", "drive", "rest", "drive", "rest"]
    temperature = next(s for s in view.signals if s.name == "front_1.temperature")
    assert temperature.period == pytest.approx(0.2)
    assert np.median(temperature.count) == 10
    assert RATE * DURATION - 5 <= temperature.count.sum() <= RATE * DURATION
    assert temperature.count.min() >= 5
    assert temperature.noise == pytest.approx(NOISE["temperature"] / np.sqrt(10.0), rel=0.15)


def test_what_cannot_be_compared_is_named():
    time, voltage = drive()
    record = record_of(time, voltage.T, Signal("force", "N", time, np.ones_like(time)))
    with pytest.raises(InputError, match="made_up"):
        observe(record, believed())
    tip = Signal("deflection", "m", time, 0.0 * time)
    with pytest.raises(InputError, match="voltage"):
        observe(Record("made_up", 0, {tip.name: tip}), believed())


def test_cells_begin_at_the_jumps_and_are_short_after_them():
    time = np.arange(0.0, 30.0, 0.02)
    first = 2.2 * ((time > 3.0) & (time < 8.0))
    second = 1.8 * ((time > 14.0) & (time < 20.0))
    noise = 1e-4 * np.random.default_rng(1).standard_normal((2, len(time)))
    noisy = (first + noise[0] * (first > 0), second + noise[1] * (second > 0))
    tip = Signal("deflection", "m", time, 0.0 * time)
    view = observe(record_of(time, noisy, tip), believed())
    edges = np.concatenate([view.drive.early, view.drive.late])
    assert len(edges) == 8
    assert np.isin(edges, view.grid).all()
    after = view.grid[(view.grid > view.drive.late[0]) & (view.grid < view.drive.late[0] + 0.4)]
    assert np.max(np.diff(after)) < 0.011
    assert np.max(np.diff(view.grid)) < 0.11
    # What a step does is read to a tenth of the noise of a fine simulation.
    fine = np.arange(0.0, 30.0, 1e-3)
    course = view.simulate(true_bench())
    held = np.interp(fine, view.grid, np.arange(len(view.grid)))
    volts = view.voltage[held.astype(int)]
    exact = simulate(true_bench(), fine, volts).temperature[:, 0]
    assert np.max(np.abs(np.interp(view.grid, fine, exact) - course.temperature[:, 0])) < 0.05


def test_a_true_model_takes_a_gap_away_and_what_another_leaves_may_be_more_elsewhere(tmp_path):
    wanted = {"quantities": ("deflection",)}
    records = [planted_record(tmp_path / f"{k}", turned=k > 0, **wanted) for k in range(2)]
    shortest = shared_bin(records, believed())
    views = [observe(record, believed(), shortest, ("deflection",)) for record in records]
    noise = {"deflection": Noise(white=1e-5, drift=0.0, time=5.0, period=0.5, usual=5e-5)}
    truth, believes = true_bench(), believed()
    found = shrinkage(views, believes, truth, truth, noise)["deflection"]
    assert found.fraction > 0.95
    assert found.ci90[1] - found.ci90[0] < 0.1
    moved = ("wire.heat_transfer_coefficient", "wire.austenite_start_temperature")
    half = truth.replace({name: 0.5 * (believes[name] + truth[name]) for name in moved})
    wide = shrinkage(views, believes, half, half, noise)["deflection"]
    left = 1.0 - wide.fraction
    assert wide.ci90[0] < 1.0 - 1.4 * left
    assert wide.fraction <= wide.ci90[1] <= 1.0
