"""Wires that pull a weight, a spring or each other: identified from motion and voltage alone."""

from dataclasses import replace

import numpy as np
import pytest
from planted import machine_drive, moving_lab, moving_record, strokes

pytest.importorskip("numba", reason="fits of the whole model take minutes uncompiled")

import sma_bench
from examination.check import loads
from sma_bench.errors import InputError
from sma_bench.identify import identify, whole_model
from sma_bench.parameters import Parameters
from sma_bench.records.record import first_order_lag
from sma_bench.synthetic.bench_records import signals_of, simulate_finely

MOVED = (
    *("wire.resistance", "wire.heat_transfer_coefficient", "wire.specific_heat"),
    *("wire.austenite_start_temperature", "wire.austenite_finish_temperature"),
    *("wire.maximum_recoverable_strain", "load.force", "load.stiffness", "load.preload"),
)


def drive(bench, shape):
    return strokes(bench, shape, 35.0, 110.0)


def recorded(truth, shape, seed, *keep):
    keep = keep or ("voltage", "elongation", "deflection")
    return moving_record(truth, drive(truth, shape), seed, keep)


def drawn(believed, seed):
    """A bench as probable as any other under what is believed."""
    random = np.random.default_rng(seed)
    names = [n for n in MOVED if believed[n] or not n.startswith("load")]
    off = {n: believed[n] + believed.std(n) * random.standard_normal() for n in names}
    return believed.replace(off)


def motion(bench, shape):
    """m of a drive, exact."""
    signals = signals_of(simulate_finely(bench, *drive(bench, shape)))
    return next(s.values for s in signals if s.name.endswith(("elongation", "deflection")))


@pytest.mark.parametrize("kind", ["spring", "antagonist"])  # test_composite.py: beams
def test_motion_and_voltage_of_two_runs_predict_a_third(kind):
    believed = moving_lab(kind, stds={"load.stiffness": 40.0})
    truth = drawn(believed, seed=4)
    found = identify([recorded(truth, s, k) for k, s in enumerate(("triangle", "step"))], believed)
    assert [e.name for e in found.experiments] == ["E10"]
    exact = motion(truth, "sine")
    before, after = (
        np.sqrt(np.mean((motion(p, "sine") - exact) ** 2)) / np.ptp(exact)
        for p in (believed, found.parameters)
    )
    assert after < min(0.01, 0.5 * before)
    for name, estimate in found.estimates.items():
        assert abs(estimate.value - truth[name]) < 4.0 * estimate.std, name
        assert estimate.std <= believed.std(name) * 1.0001
    assert max(estimate.informed for estimate in found.estimates.values()) > 0.9


def test_friction_that_is_unknown_is_told_from_the_wires_own_hysteresis():
    believed = moving_lab("spring", stds={"load.friction": 0.3, "load.stiffness": 40.0})
    truth = drawn(believed, seed=4).replace({"load.friction": 0.4})
    found = identify([recorded(truth, s, k) for k, s in enumerate(("triangle", "step"))], believed)
    friction, exact = found.estimates["load.friction"], motion(truth, "sine")
    assert abs(friction.value - 0.4) < 3.0 * friction.std < 0.2 and friction.informed > 0.9
    assert np.std(motion(found.parameters, "sine") - exact) < 0.003 * np.ptp(exact)


def test_force_under_an_imposed_motion_tells_the_wire_and_predicts_another_motion():
    believed = moving_lab("displacement")
    truth, keep = drawn(believed, seed=4), ("voltage", "elongation", "force")
    seen, other, unseen = (
        moving_record(truth, machine_drive(truth, shape, period, 80.0), seed, keep)
        for shape, period, seed in (("triangle", 35.0, 1), ("sine", 27.0, 2), ("sine", 21.0, 3))
    )
    found = identify([seen, other], believed)
    assert [e.name for e in found.experiments] == ["E9"]
    assert {name: one.verdict for name, one in found.fit.items()} == {"force": "ok"}
    assert not any("elongation" in str(warning) for warning in found.warnings)
    exact = unseen["force"].values
    before, after = (
        np.std(sma_bench.simulate(unseen, p).force[:, 0] - exact) / np.ptp(exact)
        for p in (believed, found.parameters)
    )
    assert after < min(0.01, 0.5 * before)
    for name, estimate in found.estimates.items():
        assert abs(estimate.value - truth[name]) < 4.0 * estimate.std, name
    bare = replace(seen, signals={n: s for n, s in seen.signals.items() if n != "elongation"})
    with pytest.raises(InputError, match="no elongation, expected the imposed one"):
        identify([bare], believed, ["E9"])


def test_a_current_source_needs_no_voltmeter():
    rises = {"effect.phase_dependent_resistance.austenite_change": -0.1}
    believed = moving_lab("spring", {"bench.drive": "current"})
    truth = drawn(believed, seed=6).replace(rises)
    seen, unseen = (recorded(truth, s, 1, "current", "elongation") for s in ("triangle", "sine"))
    assert "wire.voltage" not in seen.signals
    exact = sma_bench.simulate(unseen, truth).elongation[:, 0]
    assert exact == pytest.approx(unseen["elongation"].values, abs=1.2e-4)
    found = identify([seen], believed).parameters
    before, after = (
        np.std(sma_bench.simulate(unseen, p).elongation[:, 0] - exact) for p in (believed, found)
    )
    assert after < min(0.01 * np.ptp(exact), 0.2 * before)


def test_a_source_of_power_says_nothing_of_the_resistance_and_predicts_all_the_same():
    rises = {"effect.phase_dependent_resistance.austenite_change": -0.1}
    believed = moving_lab("spring", {"bench.drive": "power"})
    truth = drawn(believed, seed=6).replace(rises)
    seen, unseen = (
        recorded(truth, s, 1, "voltage", "current", "elongation") for s in ("triangle", "sine")
    )
    exact = sma_bench.simulate(unseen, truth).elongation[:, 0]
    assert exact == pytest.approx(unseen["elongation"].values, abs=1.2e-4)
    found = identify([seen], believed)
    assert [e.name for e in found.experiments] == ["E10"]
    assert found.estimates["wire.resistance"].informed < 0.05
    before, after = (
        np.std(sma_bench.simulate(unseen, p).elongation[:, 0] - exact)
        for p in (believed, found.parameters)
    )
    assert after < min(0.01 * np.ptp(exact), 0.2 * before)


def test_a_wire_of_which_next_to_nothing_is_stated_is_found_and_predicts_another_run():
    """Its loss of heat is far from the usual: most starts show no motion at all. Its runs repeat:
    what they share is in its own numbers, so that a file of these predicts as the fit does."""
    truth = moving_lab("spring").replace({"wire.specific_heat": 420.0})
    said = ("wire.length", "wire.diameter", "wire.resistance", "environment.ambient_temperature")
    said += ("load.kind", "load.stiffness", "load.preload")
    stated = Parameters({name: truth[name] for name in said}, {})
    found = identify([recorded(truth, s, k) for k, s in enumerate(("triangle", "step"))], stated)
    assert found.law.name == "cosine"
    exact = motion(truth, "sine")
    assert np.std(motion(found.parameters, "sine") - exact) < 0.01 * np.ptp(exact)


def test_a_spring_that_is_not_linear_is_found_where_that_is_not_known():
    believed = moving_lab("spring", stds={"load.stiffening": 40.0})
    truth = drawn(believed, seed=4).replace({"load.stiffening": 50.0})
    found = identify([recorded(truth, s, k) for k, s in enumerate(("triangle", "step"))], believed)
    curve, exact = found.estimates["load.stiffening"], motion(truth, "sine")
    assert abs(curve.value - 50.0) < 3.0 * curve.std < 100.0
    assert np.std(motion(found.parameters, "sine") - exact) < 0.005 * np.ptp(exact)


@pytest.mark.slow
def test_two_runs_of_another_reality_predict_five_of_other_shapes(monkeypatch):
    """Of which the wire has latent heat, free convection and a resistance that changes.

    `./bench check loads` plays the other loads.
    """
    monkeypatch.setattr(whole_model, "starts", lambda unknowns: [unknowns.start()])
    found = loads.try_bench("spring", 7, "rich")
    assert np.median(found["believed"]) > 5.0 * np.median(found["unseen"])
    assert np.median(found["unseen"]) < loads.MEDIAN and max(found["unseen"]) < loads.TAIL


def test_a_thermometer_that_lags_does_not_make_another_wire():
    believed = moving_lab("beam")
    truth = drawn(believed, seed=4)
    random, seen = np.random.default_rng(8), []
    for shape in ("triangle", "step"):
        record = recorded(truth, shape, 3, "voltage", "deflection", "temperature")
        hot = record["wire.temperature"]
        kept = np.exp(-0.04 / 1.2)  # a thermocouple of 1.2 s
        read = first_order_lag(hot.values, kept, hot.values[0])
        lagging = replace(hot, values=read + 0.1 * random.standard_normal(len(read)))
        seen.append(replace(record, signals={**record.signals, hot.name: lagging}))
    found = identify(seen, believed)
    assert abs(found.estimates["sensor.temperature.lag"].value - 1.2) < 0.02
    for name in ("wire.specific_heat", "wire.austenite_finish_temperature"):
        assert abs(found.estimates[name].value - truth[name]) < 3.0 * found.estimates[name].std
    assert {one.verdict for one in found.fit.values()} == {"ok"}
