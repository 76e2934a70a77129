"""A record as the diagnosis sees it: bins, phases, and what cannot be compared."""

from dataclasses import replace

import numpy as np
import pytest
from planted import CHANNELS, DURATION, NOISE, RATE, believed, drive, planted_record, true_bench

from sma_bench.errors import InputError
from sma_bench.estimation import nuisances
from sma_bench.estimation.observation import Observation, observe
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


def test_every_signal_is_there_with_its_wire_and_side(view):
    wires = {f"{channel}.{q}" for channel in CHANNELS for q in ("current", "temperature")}
    assert {s.name for s in view.signals} == wires | {"deflection"}
    back = next(s for s in view.signals if s.name == "back_1.temperature")
    assert view.sides[back.wire] == "back"


def test_bins_are_means_of_samples_with_their_mean_time_and_noise(view):
    temperature = next(s for s in view.signals if s.name == "front_1.temperature")
    assert temperature.period == pytest.approx(0.2)
    assert np.median(temperature.count) == 10
    assert RATE * DURATION - 5 <= temperature.count.sum() <= RATE * DURATION
    assert temperature.count.min() >= 5
    assert temperature.noise == pytest.approx(NOISE["temperature"] / np.sqrt(10.0), rel=0.15)
    assert np.all(np.diff(temperature.time) > 0.0)


def test_time_before_during_and_after_driving_has_its_phase(view):
    at = np.array([0.5, 4.0, 6.5, 10.0, 19.0])
    assert view.phase_of(at).tolist() == ["initial", "drive", "rest", "drive", "rest"]


def test_readings_of_the_truth_are_within_the_noise(view):
    readings = view.readings(view.simulate(true_bench()))
    for signal, reading in zip(view.signals, readings, strict=True):
        misfit = np.sqrt(np.mean((signal.value - reading) ** 2)) / signal.noise
        assert 0.7 < misfit < 1.4, signal.name


def test_readings_are_the_bins_of_the_courses_with_their_stamps_late(view):
    late = view.moved(np.zeros(len(view.drive.early)), {"temperature": 0.07, "deflection": -0.03})
    run = late.simulate(true_bench())
    for signal, reading in zip(late.signals, late.readings(run), strict=True):
        np.testing.assert_allclose(reading, signal.average @ late.course(signal, run), rtol=1e-12)
    assert not np.allclose(late.readings(run)[1], view.readings(run)[1], rtol=1e-6)


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


def test_leads_and_the_wires_resistance_take_the_same_heat_away(view):
    """Both are differences of V^2 R/(R + R_s)^2: where they cancel nothing may be left that a fit
    would take for information."""
    unknowns = unknowns_of_records(believed(), view.quantities).with_effects(["supply_drop"])
    problem, x = Problem.of([view]), unknowns.start()
    predicted = problem.predict(unknowns.parameters(x))
    which = [unknowns.names.index("wire.resistance"), len(x) - 1]
    columns = problem.derivatives(unknowns, x, predicted, which) / unknowns.slopes(x)[which]
    for block in problem.blocks:
        if block.signal.quantity != "current":
            own, leads = columns[block.rows].T
            assert np.linalg.norm(leads - 2.0 * own) < 1e-3 * np.linalg.norm(leads)


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


@pytest.mark.parametrize("wait, runs", [(60.0, 1 + 2), (1.0, 1 + 1 + 6)], ids=["far", "near"])
def test_jumps_moved_together_show_what_each_shows_alone(monkeypatch, wait, runs):
    """Those far apart in one simulation; those not forgotten by the next one alone after all."""
    time = np.arange(0.0, 200.0, 0.02)
    on = [(time > start) & (time < start + 5.0) for start in (5.0, 80.0, 155.0)]
    signals = [
        Signal(f"{name}.voltage", "V", time, 2.0 * np.any(on, axis=0) * (name == CHANNELS[0]))
        for name in CHANNELS
    ]
    view = observe(record_of(*signals, Signal("deflection", "m", time, 0.0 * time)), believed())
    simulated = []
    follow = Observation.simulate
    monkeypatch.setattr(
        Observation, "simulate", lambda *args: simulated.append(args) or follow(*args)
    )
    monkeypatch.setattr(nuisances, "_FEWER", 0.0)
    alone = nuisances.nuisances_about(view, believed())
    assert len(simulated) == 1 + 6
    simulated.clear()
    monkeypatch.setattr(nuisances, "_FEWER", 1.0)
    monkeypatch.setattr(nuisances, "_FORGOTTEN", wait)
    together = nuisances.nuisances_about(view, believed())
    assert len(simulated) == runs
    assert together.items == alone.items
    assert np.ptp(alone.columns[:, -6:], axis=0).min() > 1e-6
    assert together.columns == pytest.approx(alone.columns, abs=1e-12)


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
