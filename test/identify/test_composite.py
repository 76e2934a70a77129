"""Identification of the composite rig from its own records (E10, E12)."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

pytest.importorskip("numba", reason="fits of the whole model take minutes uncompiled")

from sma_bench.errors import InputError
from sma_bench.estimation.unknowns import BENDING, HEAT, MATERIAL, SHAPES
from sma_bench.identify import identify
from sma_bench.identify.whole_model import identify_moving_bench
from sma_bench.parameters import Parameters, read_parameters
from sma_bench.physics import simulate
from sma_bench.records import Record, Signal, read_record

FRONT = "composite.stress_per_deflection_front"
BACK = "composite.stress_per_deflection_back"
ALPHA = "composite.deflection_per_strain"
CHANNELS = ("front_1", "back_1")


def only(record, *endings):
    """The record without all signals but these."""
    kept = {n: s for n, s in record.signals.items() if n.endswith(endings)}
    return replace(record, signals=kept)


@pytest.fixture(scope="module")
def foreign(shared_data):
    """Records written by another program, the lab's nominal parameters, and the truth."""
    folder = shared_data / "foreign" / "composite"
    records = [read_record(folder / name) for name in ("triangle", "step")]
    truth = json.loads((folder / "truth.json").read_text())
    return records, read_parameters(folder / "nominal.yaml"), truth


@pytest.fixture(scope="module")
def identified(foreign):
    """What `identify` finds in them."""
    records, nominal, _ = foreign
    return identify(records, nominal)


def test_deflection_alone_gives_the_truth_within_its_errors_and_says_what_it_cannot_tell(foreign):
    records, nominal, truth = foreign
    found = identify_moving_bench([only(records[0], "voltage", "deflection")], nominal)
    numbers = {n: e for n, e in found.estimates.items() if n not in SHAPES}
    assert len(numbers) == 19
    z = {name: (e.value - truth[name]) / e.std for name, e in numbers.items()}
    assert max(map(abs, z.values())) < 3.0, z
    for name, estimate in found.estimates.items():
        assert estimate.std <= nominal.std(name) and 0.0 <= estimate.informed <= 1.0
    untold = next(f for f in found.findings if f.subject == "priors").text
    assert "wire.resistance" in untold
    assert "composite.stress_per_deflection_front" not in untold
    assert "the prior" in found.estimates["wire.resistance"].method
    assert found.estimates["wire.resistance"].informed < 0.2
    assert found.estimates["wire.resistance"].std > 0.8 * nominal.std("wire.resistance")
    assert found.estimates[FRONT].std < 0.7 * nominal.std(FRONT)
    assert len([f.text for f in found.findings if "product" in f.text]) == 2


def test_all_signals_give_the_truth_and_products_better_than_their_factors(foreign, identified):
    _, nominal, truth = foreign
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


def record_of(truth, noise=2e-5, rho=0.0, seed=0, drift=0.0):
    """40 s of front, 40 s of back; deflection with coloured noise, temperatures and currents."""
    random = np.random.default_rng(seed)
    time = np.arange(0.0, 80.0, 0.02)
    pulse = np.interp(time % 40.0, [2.0, 14.0, 26.0], [0.0, 2.6, 0.0])
    voltage = np.column_stack([pulse * (time < 40.0), pulse * (time >= 40.0)])
    course = simulate(truth, time, voltage)
    white = random.standard_normal(len(time)) * noise * np.sqrt(1.0 - rho**2)
    coloured = lfilter([1.0], [1.0, -rho], white)
    shift = drift * np.sin(2.0 * np.pi * time / 25.0)
    signals = [Signal("deflection", "m", time, course.deflection + coloured + shift)]
    for i, channel in enumerate(CHANNELS):
        kelvin = course.temperature[:, i] + 0.1 * random.standard_normal(len(time))
        ampere = course.current[:, i] + 0.01 * random.standard_normal(len(time))
        signals.append(Signal(f"{channel}.voltage", "V", time, voltage[:, i]))
        signals.append(Signal(f"{channel}.temperature", "K", time, kelvin))
        signals.append(Signal(f"{channel}.current", "A", time, ampere))
    return Record("made here", 0, {signal.name: signal for signal in signals})


def test_bending_coefficients_that_nobody_gave_start_from_the_geometry_and_may_differ():
    truth = bench(**{ALPHA: 0.9, FRONT: 2.4e9, BACK: 3.4e9})
    known = bench(**{ALPHA: 0.0, FRONT: 0.0, BACK: 0.0})
    found = identify_moving_bench([record_of(truth)], known)
    for name in BENDING:
        estimate = found.estimates[name]
        assert abs(estimate.value - truth[name]) < 3.0 * estimate.std
    front, back = found.estimates[FRONT], found.estimates[BACK]
    assert back.value - front.value > 5.0 * front.std


def test_range_sensors_stand_in_for_the_tip():
    record = record_of(bench())
    tip = record["deflection"]
    signals = {n: s for n, s in record.signals.items() if n != "deflection"}
    for side, sign in (("front", -1.0), ("back", 1.0)):
        name = f"{side}.range"
        signals[name] = Signal(name, "m", tip.time, 0.1 + sign * tip.values)
    first = identify_moving_bench([record], bench()).estimates[FRONT]
    second = identify_moving_bench([replace(record, signals=signals)], bench()).estimates[FRONT]
    assert second.value == pytest.approx(first.value, abs=0.2 * first.std)


@pytest.mark.slow
def test_errors_stay_true_under_coloured_noise():
    """Taken as white, noise with rho = 0.95 would make the errors six times too small."""
    truth = bench()
    # All else is known, or its uncertainty would hide what the noise does.
    exact = dict.fromkeys((*HEAT, *MATERIAL), 0.0)
    known = truth.replace({}, {**exact, ALPHA: 0.1, FRONT: 5e8, BACK: 5e8})
    deviations = []
    for seed in range(4):
        record = record_of(truth, noise=1e-4, rho=0.95, seed=seed)
        estimates = identify_moving_bench([record], known).estimates
        deviations += [(estimates[n].value - truth[n]) / estimates[n].std for n in BENDING]
    assert np.sqrt(np.mean(np.square(deviations))) < 1.5


def test_an_effect_that_the_model_lacks_is_seen_in_the_residual():
    clean = identify_moving_bench([record_of(bench())], bench())
    assert not any("times the noise" in f.text for f in clean.findings)
    drifting = identify_moving_bench([record_of(bench(), drift=3e-4)], bench())
    warning = next(f for f in drifting.findings if "times the noise" in f.text)
    assert warning.subject == "deflection"
    assert warning.numbers["ratio"] > 2.0


@pytest.mark.parametrize(("drop", "message"), [("back_1.voltage", "no voltage of channel back_1"),
                                               ("deflection", "no motion")])  # fmt: skip
def test_what_is_absent_is_named(drop, message):
    record = record_of(bench())
    signals = {n: s for n, s in record.signals.items() if n != drop}
    with pytest.raises(InputError, match=message):
        identify_moving_bench([replace(record, signals=signals)], bench())
