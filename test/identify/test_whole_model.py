"""The whole model fitted: to records of the composite rig (E10), to a wire in a load frame (E9),
and to a drive made for another purpose (E0)."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

pytest.importorskip("numba", reason="fits of the whole model take minutes uncompiled")

from planted import few_effects
from wire_records import Sensors, Wire, only, record_of

import sma_bench
from examination.check.identification import draw_bench, measured
from examination.check.rigs import FINE, WORK, draw_record, draw_rig, try_rig
from sma_bench.errors import InputError
from sma_bench.estimation.rig import Hold, find_holds
from sma_bench.estimation.unknowns import BENDING, HEAT, MATERIAL, SHAPES
from sma_bench.identify import identify
from sma_bench.identify.isobaric import isobaric_tests
from sma_bench.identify.signals import holds_frame
from sma_bench.identify.whole_model import identify_load_frame, identify_moving_bench
from sma_bench.parameters import Parameters, read_parameters
from sma_bench.parameters.parameter import TRANSITIONS
from sma_bench.physics import simulate
from sma_bench.records import Record, Signal, read_record

FRONT, BACK, ALPHA = BENDING[1], BENDING[2], BENDING[0]
CHANNELS = ("front_1", "back_1")


# --- E10: the composite.
@pytest.fixture(scope="module")
def foreign(shared_data):
    """Records written by another program, the lab's nominal parameters, and the truth."""
    folder = shared_data / "foreign" / "composite"
    records = [read_record(folder / name) for name in ("triangle", "step")]
    truth = json.loads((folder / "truth.json").read_text())
    return records, read_parameters(folder / "nominal.yaml"), truth


def test_deflection_alone_gives_true_numbers_within_errors_and_names_those_it_cannot_give(foreign):
    records, nominal, truth = foreign
    found = identify_moving_bench([only(records[0], "voltage", "deflection")], nominal)
    numbers = {n: e for n, e in found.estimates.items() if n not in SHAPES}
    assert len(numbers) == 19
    z = {name: (e.value - truth[name]) / e.std for name, e in numbers.items()}
    assert max(map(abs, z.values())) < 3.0, z
    for name, estimate in found.estimates.items():
        assert estimate.std <= nominal.std(name) and 0.0 <= estimate.informed <= 1.0
    unknown = next(f for f in found.findings if f.subject == "priors").text
    ohms = found.estimates["wire.resistance"]
    assert "wire.resistance" in unknown and FRONT not in unknown and "the prior" in ohms.method
    assert ohms.informed < 0.2 and ohms.std > 0.8 * nominal.std("wire.resistance")
    assert found.estimates[FRONT].std < 0.7 * nominal.std(FRONT)
    assert len([f.text for f in found.findings if "product" in f.text]) == 2


def test_all_signals_give_true_numbers_and_products_better_than_their_factors(foreign):
    records, nominal, truth = foreign
    identified = identify(records, nominal)
    (found,) = identified.experiments
    assert found.name == "E10"
    capacity, loss = found.details["heat_capacity"], found.details["heat_loss"]
    true = truth["wire.mass"] * truth["wire.specific_heat"]
    assert abs(capacity.value - true) < 3.0 * capacity.std
    assert abs(loss.value / (truth["wire.heat_transfer_coefficient"] * 1.885e-4) - 1.0) < 1e-3
    assert loss.relative_std < 0.2 * found.estimates["wire.surface_area"].relative_std
    document = identified.to_json()
    names = document["correlation"]["names"]
    assert names == list(document["parameters"])
    matrix = np.array(document["correlation"]["matrix"])
    np.testing.assert_allclose(np.diag(matrix), 1.0)
    np.testing.assert_allclose(matrix, matrix.T)
    assert abs(matrix[names.index(FRONT), names.index(BACK)]) > 0.9
    for name, number in document["parameters"].items():
        assert name in SHAPES or abs(number["value"] - truth[name]) < 3.0 * number["std"], name
        whole = np.hypot(number["statistical"], number["systematic"])
        assert whole == pytest.approx(number["std"])
        assert number["std"] <= nominal.std(name) * (1.0 + 1e-12)
    assert document["parameters"]["wire.resistance"]["informed"] > 0.99


def bench(**changes):
    values = {"bench.channels": CHANNELS, "bench.channel_sides": ("front", "back"),
              "wire.heat_transfer_coefficient": 110.0, "wire.surface_area": 188.5e-6,
              "wire.martensite_start_temperature": 330.0,
              "wire.martensite_finish_temperature": 314.0, ALPHA: 1.0, FRONT: 4e9,
              BACK: 4e9}  # fmt: skip
    exact = dict.fromkeys(("wire.mass", "wire.surface_area"), 0.0)
    return Parameters.of_paper().replace({**values, **changes}, exact)


def bent(truth, noise=2e-5, rho=0.0, seed=0, drift=0.0):
    """40 s of front, 40 s of back; deflection with coloured noise, temperatures and currents."""
    random = np.random.default_rng(seed)
    time = np.arange(0.0, 80.0, 0.02)
    pulse = np.interp(time % 40.0, [2.0, 14.0, 26.0], [0.0, 2.6, 0.0])
    voltage = np.column_stack([pulse * (time < 40.0), pulse * (time >= 40.0)])
    run = simulate(truth, time, voltage)
    white = random.standard_normal(len(time)) * noise * np.sqrt(1.0 - rho**2)
    coloured = lfilter([1.0], [1.0, -rho], white)
    shift = drift * np.sin(2.0 * np.pi * time / 25.0)
    signals = [Signal("deflection", "m", time, run.deflection + coloured + shift)]
    for i, channel in enumerate(CHANNELS):
        kelvin = run.temperature[:, i] + 0.1 * random.standard_normal(len(time))
        ampere = run.current[:, i] + 0.01 * random.standard_normal(len(time))
        signals += [Signal(f"{channel}.voltage", "V", time, voltage[:, i]),
                    Signal(f"{channel}.temperature", "K", time, kelvin),
                    Signal(f"{channel}.current", "A", time, ampere)]
    return Record("made here", 0, {signal.name: signal for signal in signals})


def without(record, name):
    return replace(record, signals={n: s for n, s in record.signals.items() if n != name})


def test_bending_coefficients_that_were_not_given_start_from_the_geometry_and_may_differ():
    truth = bench(**{ALPHA: 0.9, FRONT: 2.4e9, BACK: 3.4e9})
    known = bench(**{ALPHA: 0.0, FRONT: 0.0, BACK: 0.0})
    found = identify_moving_bench([bent(truth)], known)
    for name in BENDING:
        estimate = found.estimates[name]
        assert abs(estimate.value - truth[name]) < 3.0 * estimate.std
    front, back = found.estimates[FRONT], found.estimates[BACK]
    assert back.value - front.value > 5.0 * front.std


def test_range_sensors_replace_the_tip_and_a_drift_outside_the_model_is_reported():
    record = bent(bench())
    tip, ranges = record["deflection"], without(record, "deflection")
    for side, sign in (("front", -1.0), ("back", 1.0)):
        name = f"{side}.range"
        ranges.signals[name] = Signal(name, "m", tip.time, 0.1 + sign * tip.values)
    clean, seen, drifting = (identify_moving_bench([one], bench())
                             for one in (record, ranges, bent(bench(), drift=3e-4)))
    first, second = (found.estimates[FRONT] for found in (clean, seen))
    assert second.value == pytest.approx(first.value, abs=0.2 * first.std)
    assert not any("times the noise" in f.text for f in clean.findings)
    warning = next(f for f in drifting.findings if "times the noise" in f.text)
    assert warning.subject == "deflection" and warning.numbers["ratio"] > 2.0


@pytest.mark.slow
def test_errors_stay_right_under_correlated_noise():
    """Taken as white, noise with rho = 0.95 would make the errors six times too small."""
    truth = bench()
    # All else is exact, so that its uncertainty does not hide the effect of the noise.
    exact = dict.fromkeys((*HEAT, *MATERIAL), 0.0)
    known = truth.replace({}, {**exact, ALPHA: 0.1, FRONT: 5e8, BACK: 5e8})
    deviations = []
    for seed in range(4):
        record = bent(truth, noise=1e-4, rho=0.95, seed=seed)
        estimates = identify_moving_bench([record], known).estimates
        deviations += [(estimates[n].value - truth[n]) / estimates[n].std for n in BENDING]
    assert np.sqrt(np.mean(np.square(deviations))) < 1.5


@pytest.mark.parametrize(("drop", "message"), [("back_1.voltage", "no voltage of channel back_1"),
                                               ("deflection", "no motion")])  # fmt: skip
def test_a_missing_signal_is_named(drop, message):
    with pytest.raises(InputError, match=message):
        identify_moving_bench([without(bent(bench()), drop)], bench())


# --- E9: the load frame.
SEED = 5


@pytest.fixture(scope="module")
def lab():
    """A bench drawn at random with its isobaric and its clamped record."""
    drawn = draw_bench(np.random.default_rng(SEED))
    records = {
        name: Record(Path(name), 0, {s.name: s for s in measured(name, drawn.truth, SEED)})
        for name in ("isobaric", "clamped")
    }
    return drawn, records


def test_a_clamped_staircase_alone_gives_the_thermal_expansion_factor(lab):
    drawn, records = lab
    found = identify_load_frame([records["clamped"]], drawn.known)
    estimate = found.estimates["wire.thermal_expansion_factor"]
    true = drawn.truth["wire.thermal_expansion_factor"]
    assert abs(estimate.value - true) < 3.0 * estimate.std < 0.06 * abs(true)
    unknown = next(f for f in found.findings if f.subject == "priors").text
    assert "wire.maximum_recoverable_strain" in unknown


def test_a_load_is_followed_where_it_was_measured_and_nowhere_else():
    """A stamp minutes after the last reading of the force made a fit hundreds of times slower."""
    time = np.concatenate([np.arange(0.0, 70.0, 0.05), np.arange(100.0, 160.0, 0.05)])
    force = np.where(time < 60.0, 2.0, np.where(time < 70.0, 0.2 * time - 10.0, 6.0))
    still = {"elongation": 1e-3 * np.sin(time), "force": force}
    record = Record(Path("bag"), 0, {name: Signal(name, "m", time, values) for name,
                                     values in still.items()})  # fmt: skip
    holds = find_holds(record, 0.0, 1000.0)
    assert holds[0].start == 0.0 and holds[-1].stop == 1000.0
    assert all(a.stop == b.start for a, b in zip(holds, holds[1:], strict=False))
    followed = [hold for hold in holds if not hold.steady]
    assert 40 <= len(followed) <= 80
    assert [h.value for h in followed if h.start < 85.0 < h.stop] == pytest.approx([5.0], abs=0.1)
    for hold in followed:
        if hold.stop - hold.start < 1.0 and not 69.0 < hold.start < 101.0:
            middle = 0.5 * (hold.start + hold.stop)
            assert hold.value == pytest.approx(np.interp(middle, time, force), abs=0.1)


def test_loops_of_a_frame_are_isobaric_tests_if_asked_for_and_wires_share_its_force(lab):
    drawn, records = lab
    found = identify([records["isobaric"]], drawn.known, ["E6"])
    assert [e.name for e in found.experiments] == ["E6"]
    for name, symbol in TRANSITIONS.items():
        estimate = found.estimates[symbol]
        assert abs(estimate.value - drawn.truth[symbol]) < 3.0 * estimate.std, name
    one, two = (drawn.known.replace({"wire.count": count}) for count in (1, 2))
    hold = Hold(0.0, 1.0, clamped=False, value=25.0, std=0.0)
    assert hold.boundary(0.0, two).load == 0.5 * hold.boundary(0.0, one).load
    alone, shared = ([t.stress for t in isobaric_tests(records["isobaric"], p)] for p in (one, two))
    assert alone and shared == pytest.approx(0.5 * np.array(alone))


def test_a_frame_needs_a_drive_and_held_loads_or_clamps(lab):
    drawn, records = lab
    record = without(records["isobaric"], "wire.voltage")
    assert holds_frame(record, drawn.known.replace({"bench.drive": "current"}))
    assert not holds_frame(record, drawn.known)
    force = records["isobaric"]["force"]
    wandering = 5.0 + 3.0 * np.sin(force.time / 7.0) + 0.02 * np.cos(90.0 * force.time)
    signals = records["isobaric"].signals | {"force": replace(force, values=wandering)}
    with pytest.raises(InputError, match="expected held loads or a clamped wire"):
        identify_load_frame([replace(record, signals=signals)], drawn.known)


def test_a_held_load_is_fitted_without_a_thermometer():
    rng = np.random.default_rng([38, 86])
    record = draw_record(draw_rig("force", rng), rng)
    assert {"elongation", "force"} <= set(record.signals)
    assert "front_wire.temperature" not in record.signals
    with few_effects(("latent_heat", "residual_strain")):
        found = try_rig(86)
    assert [found[work] for work in WORK] == [FINE] * 2, found


# --- E0: any drive.
R, H, C_P = "wire.resistance", "wire.heat_transfer_coefficient", "wire.specific_heat"
TRUTH = {R: 3.0, H: 80.0, C_P: 500.0}
ONE = {"bench.channels": ["wire"], "bench.channel_sides": ["front"]}
LAB = ONE | {"wire.mass": 0.09e-3, "wire.surface_area": 236e-6, R: 3.3, H: 60.0, C_P: 450.0,
             f"uncertainty.{R}": 0.3, f"uncertainty.{H}": 30.0, f"uncertainty.{C_P}": 150.0}


def on_wait_off(t):
    return np.where((t > 5.0) & (t < 40.0), 0.9, 0.0)


def random_binary(t):
    return 0.9 * np.random.default_rng(1).integers(0, 2, 33)[(t / 2.5).astype(int)]


def read(drive, *quantities):
    wire = Wire(*TRUTH.values(), LAB["wire.mass"], LAB["wire.surface_area"], ambient=296.0)
    record = record_of(wire, Sensors(), 1, drive, 80.0, 0.05)
    return only(record, *quantities) if quantities else record


@pytest.mark.parametrize("drive", [on_wait_off, random_binary])
def test_any_drive_that_excites_gives_resistance_loss_and_heat(drive):
    found = identify([read(drive)], sma_bench.load_parameters(LAB))
    assert "E0" in [e.name for e in found.experiments]
    for name, true in TRUTH.items():
        estimate = found.estimates[name]
        assert estimate.value == pytest.approx(true, abs=3.0 * estimate.std)
        assert estimate.std < 0.15 * true and estimate.informed > 0.8
    assert not found.is_misfit
    better = next(f.text for e in found.experiments for f in e.findings if f.subject == "E0")
    assert all(name in better for name in ("E1", "E2", "E3"))
    alone = sma_bench.identify(read(drive, "voltage", "current"), LAB).estimates
    assert set(alone) == {R}  # a current does not show the heat loss
    assert alone[R].value == pytest.approx(3.0, rel=0.03)


def test_a_current_source_without_a_voltmeter_is_fitted():
    record = read(random_binary, "current", "temperature")
    found = sma_bench.identify(record, LAB | {"bench.drive": "current"})
    loss = found.estimates[H].value
    assert loss / found.parameters[R] == pytest.approx(80.0 / 3.0, rel=0.05)
    with pytest.raises(InputError, match="no voltage of wire"):
        sma_bench.identify(record, LAB)


def test_a_run_given_twice_a_wire_at_rest_and_one_without_readings_are_refused():
    record = read(random_binary)
    with pytest.raises(InputError, match="copy: holds the samples of"):
        sma_bench.identify([record, replace(record, path=Path("copy"))], LAB)
    for nothing in (read(lambda t: 0.0 * t), read(random_binary, "voltage")):
        with pytest.raises(InputError, match="E0"):
            sma_bench.identify(nothing, LAB)
