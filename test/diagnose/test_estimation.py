"""The engine of a diagnosis: records in bins and phases, unknowns of a fit, errors that cover a
misfit, and shrinkage on a held-out record."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from planted import CHANNELS, DURATION, NOISE, RATE, believed, drive, planted_record, true_bench

from sma_bench.diagnose.sizes import shrinkage
from sma_bench.errors import InputError
from sma_bench.estimation import unknowns as of_fits
from sma_bench.estimation.noise_model import Noise
from sma_bench.estimation.nuisances import STATE, linearised
from sma_bench.estimation.observation import STATES, observe, shared_bin
from sma_bench.estimation.residual import Problem
from sma_bench.estimation.solver import Fit
from sma_bench.estimation.unknowns import BACK, FRONT, TEMPERATURES, unknowns_of_records
from sma_bench.parameters import Parameters
from sma_bench.parameters.parameter import BY_NAME, LOAD_KINDS
from sma_bench.physics import simulate
from sma_bench.physics.effects import EFFECTS
from sma_bench.physics.kernel import at_rest
from sma_bench.physics.laws import normal
from sma_bench.records import Record, Signal

QUANTITIES = ("current", "temperature", "deflection")
PULSES, INTERVAL = 12, 1.645
HEIGHT = np.tile(np.where(np.arange(100) < 50, 1.0, 0.0), PULSES)


def record_of(time, voltage, *others):
    volts = (Signal(f"{n}.voltage", "V", time, v) for n, v in zip(CHANNELS, voltage, strict=True))
    return Record("made_up", 0, {s.name: s for s in (*volts, *others)})


def test_every_signal_has_its_wire_and_bins_are_means_with_their_time_noise_and_phase(tmp_path):
    view = observe(planted_record(tmp_path / "bag"), believed())
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


@pytest.mark.parametrize("drop", [{"battery": 0.6, "battery_time": 8.0},
                                  {"overload": 0.8, "knee": 0.8}, {"threshold": 0.7}])
def test_currents_are_predicted_with_what_the_supply_drops(drop, tmp_path):
    bench = true_bench().replace({f"effect.supply_drop.{n}": value for n, value in drop.items()})
    obs = observe(planted_record(tmp_path / "bag", bench=bench), bench, 0.2, ("current",))
    readings = obs.by_signal(obs.readings(obs.simulate(bench)))
    for signal, predicted in zip(obs.signals, readings, strict=True):
        assert np.ptp(predicted) > 100.0 * signal.noise
        assert np.sqrt(np.mean((signal.value - predicted) ** 2)) < 3.0 * signal.noise


def test_the_state_of_a_run_is_fitted_along_the_slopes_of_the_readings(tmp_path):
    """Whole deviations are not: where runs differed, fits of two stopped far from the optimum."""
    lab = believed()
    seen = observe(planted_record(tmp_path / "bag"), lab, quantities=("deflection",))
    half, whole = (linearised(seen, lab, states=size) for size in (0.5, 1.0))
    states = [k for k, item in enumerate(whole.items) if item.kind == STATE]
    slopes = whole.columns[:, states]
    assert len(states) == len(STATES) and np.all(np.ptp(slopes, axis=0) > NOISE["deflection"])
    assert half.columns[:, states] == pytest.approx(0.5 * slopes, abs=1e-3 * np.ptp(slopes))


def test_a_record_that_cannot_be_compared_is_refused():
    time, voltage = drive()
    record = record_of(time, voltage.T, Signal("force", "N", time, np.ones_like(time)))
    with pytest.raises(InputError, match="made_up"):
        observe(record, believed())
    tip = Signal("deflection", "m", time, 0.0 * time)
    with pytest.raises(InputError, match="voltage"):
        observe(Record("made_up", 0, {tip.name: tip}), believed())


@pytest.mark.parametrize(("rate", "noise", "of_bin", "of_sample"), [
    (50.0, 1e-6, 2e-5 / 10.0**0.5, 2e-5), (2000.0, 1e-6, 2e-5 / 10.0**0.5, 2e-5),
    (2000.0, 4e-4, 4e-4 / 400.0**0.5, 4e-4)])
def test_a_fast_logger_averages_its_noise_but_not_the_error_of_the_model(rate, noise, of_bin,
                                                                         of_sample):
    time, voltage = drive(rate=rate)
    moved = 0.02 * np.sin(np.pi * time / DURATION)  # m
    tip = moved + noise * np.random.default_rng(1).standard_normal(len(time))
    view = observe(record_of(time, voltage.T, Signal("deflection", "m", time, tip)), believed())
    assert view.signals[0].noise == pytest.approx(of_bin, rel=0.15)
    assert view.signals[0].scatter == pytest.approx(of_sample, rel=0.1)


def test_grid_cells_begin_at_jumps_and_are_short_after_them():
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
    # The response to a step is within a tenth of the noise of a fine simulation.
    fine = np.arange(0.0, 30.0, 1e-3)
    run = view.simulate(true_bench())
    held = np.interp(fine, view.grid, np.arange(len(view.grid)))
    volts = view.voltage[held.astype(int)]
    exact = simulate(true_bench(), fine, volts).temperature[:, 0]
    assert np.max(np.abs(np.interp(view.grid, fine, exact) - run.temperature[:, 0])) < 0.05


def test_the_true_model_removes_the_gap_and_another_has_a_wide_interval(tmp_path):
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


# --- Unknowns of a fit.


def test_unknowns_start_at_stated_values_and_convert_to_deviations_and_back():
    for number in (number for effect in EFFECTS.values() for number in effect.parameters):
        unknown = of_fits.number_of_effect(number)
        assert unknown.value(0.0) == number.default
        inward = -1.0 if unknown.high == number.default else 1.0
        for x in (0.2 * inward, 0.7 * inward):
            assert unknown.x_of(unknown.value(x)) == pytest.approx(x)
    given = {"wire.transition_spread": 2.0, "wire.transition_tail": 0.15}
    unknowns = unknowns_of_records(believed().replace(given), QUANTITIES)
    found = unknowns.parameters(np.zeros(unknowns.baseline))
    assert {name: found[name] for name in given} == given


@pytest.mark.parametrize(("effect", "own"), [
    ("partial_transformation", {}),
    ("temperature_dependent_convection", {"wire.convection": "free"})])  # fmt: skip
def test_an_effect_adds_to_the_nuisance_of_the_same_number(effect, own):
    """Every loop is a little different from the model's, and every correlation of still air."""
    unknowns = unknowns_of_records(rig("spring", own), QUANTITIES, other_laws=True)
    number, there = EFFECTS[effect].size.name, unknowns.with_effects([effect])
    places = [k for k, name in enumerate(there.names) if name == number]
    assert len(places) == 2 and places[0] < unknowns.baseline <= places[1]
    x = np.zeros(len(there.items))
    x[places] = 0.5, 0.7
    bench, (nuisance, _) = there.parameters(x), [there.items[k] for k in places]
    assert bench[number] == pytest.approx(sum(there.items[k].value(x[k]) for k in places))
    moved = there.nudged(bench, x, places[0], 0.1)[number] - bench[number]
    assert moved == pytest.approx(0.1 * nuisance.std)
    still = unknowns_of_records(rig("spring"), QUANTITIES, other_laws=True)
    assert (number in still.names) == (not own)


@pytest.mark.parametrize("back", [None, 5.2e9])
def test_sides_stated_alike_are_recalibrated_together_and_others_apart(back):
    lab = believed().replace({BACK: back} if back else {})
    unknowns = unknowns_of_records(lab, QUANTITIES)
    assert (BACK in unknowns.bench_names) == bool(back)
    x = np.zeros(unknowns.baseline)
    x[unknowns.bench_names.index(FRONT)] = 2.0
    moved = unknowns.parameters(x)
    assert moved[FRONT] > 1.05 * lab[FRONT]
    assert moved[BACK] == pytest.approx(back or moved[FRONT])
    # One of two factors of a product carries the uncertainty of both.
    heat = next(item for item in unknowns.items if item.name == "wire.specific_heat")
    mass, own = lab.std("wire.mass") / lab["wire.mass"], lab.std("wire.specific_heat")
    assert heat.partner == "wire.mass" and heat.own_std == own
    assert heat.std == pytest.approx(np.hypot(own, mass * heat.mean))
    assert "wire.mass" not in unknowns.names


SIDES = {"antagonist": ("front", "back"), "beam": ("front", "back")}
STATED = ("load.stiffness", "load.preload", "load.force", "wire.diameter", *TEMPERATURES,
          "wire.specific_heat", "wire.thermal_expansion_factor", FRONT)


def rig(load, values=None, stds=None):
    sides = SIDES.get(load, ("front",))
    own = {"load.kind": load, "bench.channel_sides": sides, "bench.channels": [*"ab"[: len(sides)]],
           "load.stiffness": 65.0, "load.preload": 1.0, "wire.length": 0.2}
    return Parameters(own | (values or {}), stds)


@st.composite
def statements(draw):
    """Values and uncertainties that a file can state, exact to absurd, some at a bound."""
    values, stds = {}, {}
    for name in draw(st.sets(st.sampled_from(STATED), max_size=6)):
        low, high = BY_NAME[name].low, BY_NAME[name].high
        values[name] = draw(st.sampled_from([low, high, None]))
        stds[name] = draw(st.sampled_from([0.0, 1e-6, 1.0, 1e3, 1e12, 1e300]))
    return {name: value for name, value in values.items() if value is not None}, stds


@settings(max_examples=80)
@given(load=st.sampled_from(LOAD_KINDS), stated=statements(),
       reach=st.sampled_from([1.0, 5.0, np.inf]), seed=st.integers(0, 2**32 - 1))
def test_wherever_a_fit_goes_there_is_a_bench_that_can_be_simulated(load, stated, reach, seed):
    try:
        bench = rig(load, *stated)
    except InputError:  # as the file would be refused
        return
    unknowns = unknowns_of_records(bench, QUANTITIES, load_frame=True, unmodelled=True)
    low, high = unknowns.bounds()
    assert np.all((low <= 0.0) & (high >= 0.0))
    ends = np.random.default_rng(seed).choice([-1.0, 1.0], len(low)) * reach
    x = np.clip(ends, low, high)
    there = unknowns.parameters(x)
    a_s, a_f, m_s, m_f = (there[name] for name in TEMPERATURES)
    assert a_s < a_f and m_f < m_s
    drive = np.full((40, len(there["bench.channels"])), 2.0)
    run = simulate(there, np.arange(40) * 0.25, drive, initial=at_rest(there))
    assert np.all(np.isfinite([run.temperature, run.stress, run.martensite_fraction]))
    assert np.all(np.isfinite(unknowns.turn(x))) and np.all(np.isfinite(unknowns.slopes(x)))


def test_temperatures_have_their_stated_uncertainties():
    """Each one alone, whatever coordinates a fit uses; the rest of the prior is that of wires in
    the field, given these."""
    stds = dict(zip(TEMPERATURES, (1.1, 0.4, 2.0, 1.5), strict=True))
    unknowns = unknowns_of_records(rig("beam", {}, stds), QUANTITIES)
    items = {item.name: item.std for item in unknowns.items}
    assert {name: items[name] for name in TEMPERATURES} == pytest.approx(stds)
    wide = unknowns_of_records(rig("beam", {}, {TEMPERATURES[0]: 1.1}), QUANTITIES)
    found = {item.name: item.std for item in wide.items}
    assert found[TEMPERATURES[0]] == pytest.approx(1.1)
    assert all(3.0 < found[name] < 20.0 for name in TEMPERATURES[1:])
    # If nobody states them, every draw has a hysteresis.
    unknowns = unknowns_of_records(rig("spring"), QUANTITIES)
    at = [unknowns.names.index(name) for name in TEMPERATURES]
    drawn = np.random.default_rng(3).standard_normal((2000, len(unknowns.items)))
    values = [unknowns.values(np.clip(x, *unknowns.bounds()))[at] for x in drawn]
    a_s, a_f, m_s, m_f = np.transpose(values)
    assert np.all(a_s + a_f > m_s + m_f) and np.all(a_s < a_f) and np.all(m_f < m_s)
    assert np.std(np.mean(values, axis=1)) == pytest.approx(25.0, rel=0.1)


def test_an_uncertainty_of_0_is_exact():
    for name in (*of_fits.SHAPES, "wire.resistance", FRONT, "load.stiffness", *TEMPERATURES[1:3]):
        unknowns = unknowns_of_records(rig("spring", {}, {name: 0.0}), QUANTITIES, unmodelled=True)
        assert name not in unknowns.names
        drawn = np.random.default_rng(1).standard_normal(len(unknowns.start(1.0)))
        there = unknowns.parameters(np.clip(drawn, *unknowns.bounds()))
        assert there[name] == pytest.approx(unknowns.base[name])


def test_centres_and_hysteresis_widths_of_unstated_grains_move_independently():
    wire = of_fits.as_in_the_field(rig("spring", {"wire.law": "normal"}))
    unknowns = unknowns_of_records(wire, ("deflection",), unmodelled=True)
    spread, first = (unknowns.names.index(name) for name in (of_fits.SPREAD, TEMPERATURES[0]))
    x = np.zeros(len(unknowns.items))
    assert [unknowns.parameters(x)[n] for n in TEMPERATURES] == [wire[n] for n in TEMPERATURES]
    centres, halves, within = normal.groups(wire)
    for x[spread] in (-2.0, 2.0):
        moved = unknowns.parameters(x)
        there = normal.groups(moved)
        assert there[2] == pytest.approx(within) and np.mean(there[0]) == pytest.approx(centres[2])
        more = np.diff(there[1])[-1] / np.diff(halves)[-1]
        assert more == pytest.approx(moved[of_fits.SPREAD] / wire[of_fits.SPREAD])
        assert abs(more - 1.0) > 0.3
    x[first : first + 4] = 0.3, -0.2, 0.4, 0.1
    steps = 1e-5 * np.eye(len(x))
    changes = [unknowns.values(x + step) - unknowns.values(x - step) for step in steps]
    slopes = unknowns.slopes(x)[:, np.newaxis] * unknowns.turn(x)
    np.testing.assert_allclose(slopes, np.transpose(changes) / 2e-5, rtol=1e-3, atol=1e-3)
    # Wherever it goes there is a wire of that law.
    for reach in (1.0, 5.0, np.inf):
        for ends in np.random.default_rng(5).choice([-1.0, 1.0], (40, len(x))):
            unknowns.parameters(np.clip(reach * ends, *unknowns.bounds()))


# --- Errors of a fit.


def fitted_height(random, uneven):
    """Least squares fit of the height of pulses, whose true heights have mean 1 and standard
    deviation `uneven`, in white noise of 1; two records of six pulses each."""
    true = np.repeat(1.0 + uneven * random.standard_normal(PULSES), 100) * HEIGHT
    measured = true + random.standard_normal(len(true))
    information = HEIGHT @ HEIGHT + 1.0
    x = np.array([HEIGHT @ measured / information])
    signal = SimpleNamespace(time=np.arange(600.0))
    records = [SimpleNamespace(grid=signal.time) for _ in range(2)]
    blocks = [
        SimpleNamespace(observation=record, signal=signal, rows=slice(600 * k, 600 * (k + 1)))
        for k, record in enumerate(records)
    ]
    stub = SimpleNamespace(observations=records, blocks=blocks, whiten=lambda rows: rows,
                           white_nuisances=np.zeros((len(true), 0)))
    stub.stretches = lambda parts: Problem.stretches(stub, parts)
    unknowns = SimpleNamespace(slopes=lambda x: np.ones(len(x)), turn=lambda x: np.eye(len(x)))
    covariance, fitted = np.array([[1.0 / information]]), HEIGHT * x[0]
    left = measured - fitted
    return Fit(stub, unknowns, x, np.zeros(0), covariance, 0.0, fitted, HEIGHT[:, None], left)


def held(uneven):
    """Shares of 90 % intervals that contain the height: from the noise alone, and jackknifed."""
    random = np.random.default_rng(3)
    fits = [fitted_height(random, uneven) for _ in range(250)]
    off = np.array([abs(f.x[0] - 1.0) for f in fits])
    return [
        float(np.mean(off < INTERVAL * np.array([getattr(f, name)[0] for f in fits])))
        for name in ("std", "jackknifed")
    ]


def test_errors_cover_a_misfit_that_differs_between_pulses_and_else_the_noise():
    noise_alone, stated = held(uneven=1.0)
    assert noise_alone < 0.5
    assert 0.8 < stated < 0.95
    noise_alone, stated = held(uneven=0.0)
    assert noise_alone > 0.86 and stated < 0.96
    # They never exceed the prior's, even if one reading carries all the information.
    fitted = fitted_height(np.random.default_rng(4), uneven=50.0)
    derivatives = np.vstack([[1e20], fitted.derivatives[1:]])
    assert fitted.jackknifed[0] == replace(fitted, derivatives=derivatives).jackknifed[0] == 1.0
