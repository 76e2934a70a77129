"""Wires that pull a weight, a spring or each other, identified from motion and voltage alone: their
parameters, their law, and predictions with limits."""

import json
from dataclasses import replace

import numpy as np
import pytest
from planted import machine_drive, moving_lab, moving_record, strokes

pytest.importorskip("numba", reason="fits of the whole model take minutes uncompiled")

import sma_bench
from sma_bench.cli import main
from sma_bench.errors import InputError
from sma_bench.estimation.laws import band_of
from sma_bench.estimation.observation import observe
from sma_bench.identify import identify
from sma_bench.identify.result import identification_from
from sma_bench.parameters import Parameters, write_parameters
from sma_bench.parameters.parameter import TRANSITIONS
from sma_bench.records.record import Signal, first_order_lag
from sma_bench.report.experiment_figures import bench_fit_pictures
from sma_bench.synthetic.bench_records import signals_of, simulate_finely

MOVED = (
    *("wire.resistance", "wire.heat_transfer_coefficient", "wire.specific_heat"),
    *("wire.austenite_start_temperature", "wire.austenite_finish_temperature"),
    *("wire.maximum_recoverable_strain", "load.force", "load.stiffness", "load.preload"),
)
COSINE = {"wire.law": "cosine"}  # stated, so that no others are fitted
RISES = {"effect.phase_dependent_resistance.austenite_change": -0.1}


def recorded(truth, shape, seed, *keep, period=35.0, top=5.5, duration=75.0):
    drive = strokes(truth, shape, period, duration, top)
    return moving_record(truth, drive, seed, keep or ("voltage", "elongation", "deflection"))


def pair(truth, **length):
    shapes = enumerate(("triangle", "step"))
    return [recorded(truth, shape, seed, **length) for seed, shape in shapes]


def drawn(believed, seed=4):
    """A bench drawn from the prior."""
    random = np.random.default_rng(seed)
    names = [n for n in MOVED if believed[n] or not n.startswith("load")]
    off = {n: believed[n] + believed.std(n) * random.standard_normal() for n in names}
    return believed.replace(off)


def missed(bench, exact_bench):
    """Rms difference of the motion of two benches on a sine, over the stroke."""
    made = [simulate_finely(b, *strokes(b, "sine", 35.0, 110.0)) for b in (bench, exact_bench)]
    moved, exact = (next(s.values for s in signals_of(one)
                         if s.name.endswith(("elongation", "deflection"))) for one in made)
    return np.sqrt(np.mean((moved - exact) ** 2)) / np.ptp(exact)


def within(found, truth, deviations=4.0):
    for name, estimate in found.estimates.items():
        assert abs(estimate.value - truth[name]) < deviations * estimate.std, name


@pytest.mark.slow
def test_motion_and_voltage_of_two_runs_predict_a_third():  # test_whole_model.py: beams
    believed = moving_lab("antagonist", COSINE, {"load.stiffness": 40.0})
    truth = drawn(believed)
    found = identify(pair(truth), believed)
    assert [e.name for e in found.experiments] == ["E10"]
    assert missed(found.parameters, truth) < min(0.01, 0.5 * missed(believed, truth))
    within(found, truth)
    assert all(e.std <= believed.std(n) * 1.0001 for n, e in found.estimates.items())
    assert max(estimate.informed for estimate in found.estimates.values()) > 0.9


@pytest.mark.slow
def test_friction_of_a_nonlinear_spring_is_separated_from_the_wires_own_hysteresis():
    known = {"load.friction": 0.3, "load.stiffening": 40.0, "load.stiffness": 40.0}
    believed = moving_lab("spring", COSINE, known)
    truth = drawn(believed).replace({"load.friction": 0.4, "load.stiffening": 50.0})
    found = identify(pair(truth), believed)
    for name, far in (("load.friction", 0.2), ("load.stiffening", 100.0)):
        estimate = found.estimates[name]
        assert abs(estimate.value - truth[name]) < 3.0 * estimate.std < far
    assert found.estimates["load.friction"].informed > 0.9
    assert missed(found.parameters, truth) < 0.003


def test_a_force_of_opposing_wires_is_named_as_not_compared():
    lab = moving_lab("antagonist", COSINE)
    record = recorded(lab, "triangle", 1)
    time = record["deflection"].time
    record.signals["force"] = Signal("force", "N", time, np.ones_like(time))
    assert observe(record, lab).left_out == ("force",)


def test_force_under_an_imposed_motion_identifies_the_wire_and_predicts_another_motion():
    believed = moving_lab("displacement")
    truth, keep = drawn(believed), ("voltage", "elongation", "force")
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
    within(found, truth)
    bare = replace(seen, signals={n: s for n, s in seen.signals.items() if n != "elongation"})
    with pytest.raises(InputError, match="no elongation, expected the imposed one"):
        identify([bare], believed, ["E9"])


@pytest.mark.parametrize(("drive", "keep"), [
    ("current", ("current", "elongation")), ("power", ("voltage", "current", "elongation")),
])  # fmt: skip
def test_a_current_source_needs_no_voltmeter_and_a_power_source_shows_no_resistance(drive, keep):
    believed = moving_lab("spring", {"bench.drive": drive})
    truth = drawn(believed, seed=6).replace(RISES)
    seen, unseen = (recorded(truth, s, 1, *keep) for s in ("triangle", "sine"))
    assert ("wire.voltage" in seen.signals) == (drive == "power")
    exact = sma_bench.simulate(unseen, truth).elongation[:, 0]
    assert exact == pytest.approx(unseen["elongation"].values, abs=1.2e-4)
    found = identify([seen], believed)
    assert [e.name for e in found.experiments] == ["E10"]
    assert drive == "current" or found.estimates["wire.resistance"].informed < 0.05
    before, after = (
        np.std(sma_bench.simulate(unseen, p).elongation[:, 0] - exact)
        for p in (believed, found.parameters)
    )
    assert after < min(0.01 * np.ptp(exact), 0.2 * before)


@pytest.mark.slow
def test_a_wire_with_hardly_any_stated_parameters_is_identified_and_predicts_another_run():
    """Its heat loss is far from the default: most starts show no motion at all. Its runs repeat, so
    the identified parameters alone predict as well as the fit. Its area is that of a cylinder: the
    paper's is twice that of its wire."""
    truth = moving_lab("spring").replace({
        "wire.specific_heat": 420.0, "wire.surface_area": np.pi * 0.3e-3 * 0.2,
        "wire.heat_transfer_coefficient": 150.0})  # fmt: skip
    names = ("wire.length", "wire.diameter", "wire.resistance", "environment.ambient_temperature")
    names += ("load.kind", "load.stiffness", "load.preload")
    short = pair(truth, period=25.0, duration=55.0)
    found = identify(short, Parameters({name: truth[name] for name in names}, {}))
    assert found.law.name == "cosine"
    assert missed(found.parameters, truth) < 0.01


def lagging(record, seconds, seed):
    """The record as a thermometer with this lag, and a noise of 0.1 K, reads it."""
    hot, random = record["wire.temperature"], np.random.default_rng(seed)
    read = first_order_lag(hot.values, np.exp(-0.04 / seconds), hot.values[0])
    hot = replace(hot, values=read + 0.1 * random.standard_normal(len(read)))
    return replace(record, signals={**record.signals, hot.name: hot})


def test_a_lag_of_the_thermometer_does_not_change_the_wires_parameters():
    believed = moving_lab("beam")
    truth, seen = drawn(believed), ("voltage", "deflection", "temperature")
    found = identify([lagging(recorded(truth, shape, 3, *seen), 1.2, seed)
                      for seed, shape in enumerate(("triangle", "step"))], believed)
    assert abs(found.estimates["sensor.temperature.lag"].value - 1.2) < 0.02
    for name in ("wire.specific_heat", "wire.austenite_finish_temperature"):
        assert abs(found.estimates[name].value - truth[name]) < 3.0 * found.estimates[name].std
    assert {one.verdict for one in found.fit.values()} == {"ok"}


def test_a_lag_that_nobody_stated_does_not_decide_for_another_law():
    # A slow wire: its temperature shows the lag and the transformation.
    slow = {"wire.heat_transfer_coefficient": 90.0, "wire.specific_heat": 450.0}
    believed = moving_lab("force", more=slow)
    record = recorded(drawn(believed), "triangle", 3, "voltage", "current", "temperature",
                      "elongation", top=2.6)
    found = identify([lagging(record, 1.5, 8)], believed)
    assert found.law.name == "cosine"
    assert abs(found.estimates["sensor.temperature.lag"].value - 1.5) < 0.05


def test_a_resistance_stated_far_off_is_named_if_the_currents_do_not_fit_it():
    truth = moving_lab("force", COSINE)
    record = recorded(truth, "triangle", 3, "voltage", "current", "temperature", "elongation")
    for off, named in ((1.0, False), (1.15, True)):
        stated = truth.replace({"wire.resistance": off * truth["wire.resistance"]},
                               {"wire.resistance": 0.01})  # fmt: skip
        found = identify([record], stated)
        findings = [f for e in found.experiments for f in e.findings]
        said = [one.text for one in findings if "readings of wire.current are" in one.text]
        assert bool(said) == named, said


# --- Laws of the wire, and limits of predicted readings.
GRADE = dict(zip(TRANSITIONS.values(), (338.0, 362.0, 336.0, 314.0), strict=True))
ROOM, STROKE = "environment.ambient_temperature", "wire.maximum_recoverable_strain"


def bench(law="cosine", more=()):
    return moving_lab("spring", {**GRADE, "wire.law": law, **dict(more)})


def run(truth, shape, seed, top=5.5, period=35.0):
    record = recorded(truth, shape, seed, "voltage", "elongation", period=period, top=top)
    return replace(record, path=f"{shape}_{seed}")


def predicted(found, unseen, share=0.9):
    """The predicted band, and the measured motion at its times."""
    band, moved = found.predict(unseen, share)["deflection"], unseen["elongation"]
    return band, np.interp(band.time, moved.time, moved.values)


@pytest.fixture(scope="module")
def weighed():
    truth = bench("normal", {"wire.resistance": 2.75, "effect.latent_heat.heat": 8e3})
    records = [run(truth, shape, seed) for seed, shape in enumerate(("triangle", "step"))]
    known = bench()
    stated = {n: known[n] for n in known.given - {"wire.law"}}
    return truth, identify(records, Parameters(stated, known.given_uncertainty))


def test_the_law_is_identified_and_its_band_contains_a_hold_out(weighed):
    truth, found = weighed
    assert found.law.name == found.parameters["wire.law"] == truth["wire.law"]
    assert found.law.probability > 0.9
    assert found.law.probability + sum(found.law.others.values()) == pytest.approx(1.0)
    assert identification_from(found.to_json(), "result").law == found.law
    unseen = run(truth, "sine", 9, period=22.0)
    (band, moved), (narrow, _) = (predicted(found, unseen, share) for share in (0.9, 0.5))
    assert np.std(band.mean - moved) < 0.015 * np.ptp(moved)
    assert np.mean((moved > band.low) & (moved < band.high)) > 0.9
    assert np.mean(band.high - band.low) < 0.3 * np.ptp(moved)
    assert np.all(narrow.high - narrow.low < band.high - band.low)
    # All drawn benches agree with the fitted records.
    every = (own for one in found.experiments[0].laws for own in one.drawn)
    fit, places = max(every, key=lambda own: own[0])[1:]
    readings = fit.problem.predict_many([fit.unknowns.parameters(x) for x in places])
    off = np.sqrt(np.mean((readings - fit.predicted[:, np.newaxis]) ** 2, axis=0))
    assert np.max(off) < 0.05 * np.ptp(fit.predicted)
    assert np.min(np.max(np.abs(places - fit.x), axis=1)) > 0.01
    # The report draws the limits of another run.
    for picture in bench_fit_pictures(found.experiments[0]):
        for axes in picture.figure.axes:
            fitted, low, high = (line.get_ydata() for line in axes.lines[1:])
            assert np.mean((fitted > low) & (fitted < high)) > 0.9


@pytest.mark.parametrize(("law", "more"), [
    ("cosine", {}), ("brinson", {"wire.detwinning_start_stress": 50e6}),
])  # fmt: skip
def test_a_stated_law_is_used_and_others_are_not_tried(law, more):
    truth = bench("logistic" if law == "cosine" else law, more)
    found = identify([run(truth, "triangle", 1)], bench(law, more))
    assert (found.law.name, found.law.others) == (law, {}) and found.parameters["wire.law"] == law
    assert set(more) <= set(found.estimates)


def test_convection_that_is_not_stated_may_be_found_constant():
    h = "wire.heat_transfer_coefficient"
    truth = bench("cosine", {h: 90.0})
    stated = {n: truth[n] for n in truth.given - {h, "wire.convection"}}
    std = {n: s for n, s in truth.given_uncertainty.items() if n != h}
    records = [run(truth, shape, 1, 3.6) for shape in ("triangle", "step")]
    found = identify(records, Parameters(stated, std))
    assert found.parameters["wire.convection"] == "constant"
    band, moved = predicted(found, run(truth, "sine", 9, 3.0, 22.0))
    assert np.std(band.mean - moved) < 0.01 * np.ptp(moved)


def test_runs_that_do_not_repeat_are_reported_and_widen_the_band():
    truth = bench()

    def differing(rooms):
        """Results of runs in rooms that differ by so many K, each with another stroke."""
        benches = [truth.replace({ROOM: 296.15 + away, STROKE: 0.044 * (1.0 + 0.01 * away)})
                   for away in rooms]
        records = [run(own, "triangle", seed) for seed, own in enumerate(benches)]
        found = identify(records, truth)
        findings = [f.numbers for f in found.experiments[0].findings]
        (repeats,) = (numbers["repeats"] for numbers in findings if "repeats" in numbers)
        band = found.predict(run(truth, "step", 8))["deflection"]
        return records, repeats, np.mean(band.high - band.low)

    records, restless, wide = differing((0.0, 2.5, -2.5))
    _, quiet, narrow = differing((0.0, 0.0, 0.0))
    moved = [record["elongation"].values for record in records]
    pairs = [(a, b) for k, a in enumerate(moved) for b in moved[:k]]
    measured = np.sqrt(np.mean([np.mean((a - b) ** 2) for a, b in pairs])) / np.ptp(moved[0])
    assert measured / 1.5 < restless < 1.5 * measured
    assert quiet < 0.5 * restless and narrow < wide


def test_the_command_adds_the_band_to_its_result(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_parameters("lab.yaml", moving_lab("spring"))
    asked = ["simulate", "--protocol", "quick_ramp", "--params", "lab.yaml", "--rate", "10"]
    assert main([*asked, "--out", "made", "--band", "0.9", "--json", "made.json"]) == 0
    band = json.loads((tmp_path / "made.json").read_text())["band"]
    low, high = (np.array(band["limits"]["elongation"][end]) for end in ("low", "high"))
    assert band["share"] == 0.9 and len(band["time"]) == len(low) and np.all(low < high)
    assert main([*asked, "--out", "again", "--band", "0.9"]) == 2


def test_a_band_without_a_basis_is_refused():
    nothing = identification_from({"parameters": {}, "experiments": [], "warnings": []}, "r")
    with pytest.raises(InputError, match="E10"):
        nothing.predict(None)
    with pytest.raises(InputError, match="uncertainty"):
        band_of(Parameters.defaults(), lambda own: None, 0.9)
    with pytest.raises(InputError, match="share"):
        band_of(moving_lab("spring"), lambda own: [], 1.0)
