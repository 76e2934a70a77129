"""A record as the diagnosis sees it: bins, phases, and what cannot be compared."""

from dataclasses import replace

import numpy as np
import pytest
from planted import CHANNELS, DURATION, NOISE, RATE, believed, drive, planted_record, true_bench

from sma_bench.errors import InputError
from sma_bench.estimation.observation import observe
from sma_bench.estimation.residual import Problem
from sma_bench.estimation.unknowns import unknowns_of_records
from sma_bench.physics import simulate
from sma_bench.records import Record, Signal


@pytest.fixture(scope="module")
def view(tmp_path_factory):
    return observe(planted_record(tmp_path_factory.mktemp("view") / "bag"), believed())


def record_of(*signals):
    return Record("made_up", 0, {s.name: s for s in signals})


def volts():
    time, voltage = drive()
    return [
        Signal(f"{name}.voltage", "V", time, voltage[:, k]) for k, name in enumerate(CHANNELS)
    ]


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
    assert np.all(np.diff(temperature.time) > 0.0)


def test_readings_of_the_truth_are_within_the_noise(view):
    readings = view.readings(view.simulate(true_bench()))
    for signal, reading in zip(view.signals, readings, strict=True):
        misfit = np.sqrt(np.mean((signal.value - reading) ** 2)) / signal.noise
        assert 0.7 < misfit < 1.4, signal.name


def test_differences_on_coarse_cells_are_those_of_the_records_own(view):
    problem = Problem.of([view])
    assert len(problem.coarse.observations[0].grid) < 0.5 * len(view.grid)
    unknowns = unknowns_of_records(believed(), view.quantities).with_effects(
        ["viscoelastic_matrix", "side_heat_coupling", "latent_heat"]
    )
    x = unknowns.start()
    x[unknowns.baseline :] = 0.05
    own = replace(problem, voltage_noise=True)
    predicted = problem.predict(unknowns.parameters(x))
    rows = {
        name: problem.whiten(of.derivatives(unknowns, x, predicted, range(len(x))))
        for name, of in (("coarse", problem), ("own", own))
    }
    off, size = (np.linalg.norm(a, axis=0) for a in (rows["coarse"] - rows["own"], rows["own"]))
    moved = size > 1.0  # what the record tells of at all
    assert moved.sum() > 15
    assert np.max(off[moved] / size[moved]) < 0.08
    tells = {k: 0.5 * np.linalg.slogdet(r.T @ r + np.eye(len(x)))[1] for k, r in rows.items()}
    assert tells["coarse"] == pytest.approx(tells["own"], abs=0.1)  # nats


def test_what_cannot_be_compared_is_named():
    time, _ = drive()
    force = Signal("force", "N", time, np.ones_like(time))
    with pytest.raises(InputError, match="made_up"):
        observe(record_of(*volts(), force), believed())
    with pytest.raises(InputError, match="voltage"):
        observe(record_of(Signal("deflection", "m", time, 0.0 * time)), believed())


def test_cells_begin_at_the_jumps_and_are_short_after_them(jumping):
    view = observe(record_of(*jumping), believed())
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


def test_a_held_level_between_two_steps_of_the_converter_is_not_known(jumping):
    scatter = np.random.default_rng(2).standard_normal(len(jumping[0].time))
    coarse = [
        Signal(s.name, s.unit, s.time, np.round((s.values + 2e-3 * scatter) / 0.01) * 0.01)
        if s.name.endswith("voltage") else s for s in jumping
    ]
    view = observe(record_of(*coarse), believed())
    place = np.zeros(len(view.drive.early))
    assert len(view.drive.level_errors()) == 2
    for errors, level in zip(view.drive.level_errors(), (1.8, 2.2), strict=True):
        change = view.drive.on_grid(view.grid, place, errors) - view.voltage
        held = np.abs(view.voltage - level) < 0.02
        assert np.all((change[held] > 1e-3) & (change[held] < 1.1 * 0.01 / np.sqrt(12.0)))
        other = np.abs(view.voltage - (4.0 - level)) < 0.02
        assert not change[other | (view.voltage < 0.02)].any()
    assert observe(record_of(*jumping), believed()).drive.level_errors() == []


@pytest.fixture(scope="module")
def jumping():
    """Two held levels of both channels, and a deflection."""
    time = np.arange(0.0, 30.0, 0.02)
    first = 2.2 * ((time > 3.0) & (time < 8.0))
    second = 1.8 * ((time > 14.0) & (time < 20.0))
    noise = 1e-4 * np.random.default_rng(1).standard_normal((2, len(time)))
    return [
        Signal(f"{CHANNELS[0]}.voltage", "V", time, first + noise[0] * (first > 0)),
        Signal(f"{CHANNELS[1]}.voltage", "V", time, second + noise[1] * (second > 0)),
        Signal("deflection", "m", time, 0.0 * time),
    ]
