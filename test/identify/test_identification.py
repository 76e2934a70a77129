"""Which experiments a set of records allows, reasons for missing ones, how results are combined
with stated values, and the verdict on the fit, which is shown before the numbers everywhere."""

import ast
import json
import os
import string
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml
from wire_records import changed, ramp, staircase

import sma_bench
from examination.attack_lab.instruments import Alloy
from examination.check.alloys import isobaric_tests
from sma_bench.cli import main
from sma_bench.diagnose.diagnosis import about_unstated
from sma_bench.errors import InputError
from sma_bench.estimation.estimate import Estimate
from sma_bench.estimation.unknowns import unknowns_of_records
from sma_bench.identify import identify
from sma_bench.identify.result import Experiment, refusal, remark
from sma_bench.identify.run import IdentificationRun
from sma_bench.parameters import Parameters, read_parameters
from sma_bench.parameters.parameter import EXACT_SENSORS, TRANSITIONS
from sma_bench.records import Record, Signal, open_record
from sma_bench.tasks import batch
from sma_bench.tasks.batch import run_task

R, H, CP = "wire.resistance", "wire.heat_transfer_coefficient", "wire.specific_heat"
AREA, EXPANSION = "wire.surface_area", "wire.thermal_expansion_factor"
LAG = "sensor.temperature.lag"
DEFAULTS = Parameters.of_paper().replace(uncertainty=EXACT_SENSORS)
WEIGHED = Parameters({name: DEFAULTS[name] for name in ("wire.mass", AREA)}, EXACT_SENSORS)


def steady_record(voltage, n=2000):
    time = 0.05 * np.arange(n)
    values = {"voltage": voltage, "current": voltage / 2.7, "temperature": 297.0}
    signals = [Signal(f"wire.{k}", "", time, np.full(n, v)) for k, v in values.items()]
    return Record(Path("steady"), 0, {signal.name: signal for signal in signals})


@pytest.mark.compiled
def test_result_file_has_the_form_of_the_contract():
    document = identify([staircase(), ramp()], DEFAULTS).to_json()
    assert set(document) == {"parameters", "experiments", "warnings", "correlation", "fit", "card"}
    keys = "value std unit method n statistical systematic informed warnings stated"
    assert set(document["parameters"][R]) == set(keys.split())
    assert document["parameters"][R]["unit"] == "ohm"
    assert json.loads(json.dumps(document, allow_nan=False)) == document


def test_missing_current_is_reported_and_the_rest_identified_with_the_given_resistance():
    record = staircase()
    del record.signals["wire.current"]
    found = identify([record], DEFAULTS.replace({R: 2.75}, {R: 0.03}))
    assert [e.name for e in found.experiments] == ["E2"]
    assert any("E1: not identified" in w and "no signal wire.current" in w for w in found.warnings)
    # 1.1 % of the resistance is 1.1 % of the coefficient.
    assert found.estimates[H].relative_std == pytest.approx(0.03 / 2.75, rel=0.05)
    with pytest.raises(InputError, match="no E3.*0 ramps"):  # asked for and not possible
        identify([record], DEFAULTS, ["E2", "E3"])


@pytest.mark.compiled
def test_a_default_in_use_and_samples_left_out_are_warned_about():
    pulled = ramp()
    time = pulled["wire.temperature"].time
    pulled.signals["force"] = Signal("force", "N", time, 5.0 + 0.02 * np.sin(time))
    found = identify([pulled], WEIGHED)
    assert any("1 temperatures held" in note.text for note in found.notes if note.subject == "E8")
    assert any(R in w and "not measured on this wire" in w for w in found.warnings)
    # A ramp is not made for E1: that E1 is missing is no warning.
    assert any("not identified" in note.text for note in found.notes if note.subject == "E1")
    assert not any("E1: not identified" in warning for warning in found.warnings)
    record = staircase()
    record["wire.temperature"].values[100:150] = np.nan
    found = identify([record], DEFAULTS)
    assert any("50 of" in w and "NaN" in w for w in found.warnings)
    assert abs(found.estimates[H].value - 410.0) < 2.0 * found.estimates[H].std


def test_a_record_of_another_program_gives_true_numbers_within_two_stated_errors(shared_data):
    folder = shared_data / "foreign" / "wire"
    truth = json.loads((folder / "truth.json").read_text())
    records = [open_record(folder / "staircase"), open_record(folder / "ramp")]
    found = identify(records, read_parameters(folder / "bench.yaml"))
    for name, key in ((R, "R"), (H, "h"), (CP, "cp"), ("environment.ambient_temperature", "Tinf")):
        estimate = found.estimates[name]
        assert abs(estimate.value - truth[key]) < 2.0 * estimate.std, name
        assert estimate.statistical < 0.01 * truth[key], name
    offset = -found.experiments[0].details["intercept"].value / found.estimates[R].value
    assert offset == pytest.approx(truth["I0"], abs=6e-4)
    assert found.warnings == ()


BARE = Record(Path("empty"), 0, {})


@pytest.mark.parametrize(("records", "message", "experiments"), [
    ([steady_record(3.0)], "1 plateau at 1 voltage, 0 ramps", None),
    ([steady_record(3.0, 5)], "5 samples", None),
    ([steady_record(np.nan)], "nothing to identify", None),
    ([BARE], "signals none", None), ([], "no record", None),
    ([BARE], "'E4', expected one of E0", ["E4"]),
])  # fmt: skip
def test_records_that_give_nothing_are_refused_in_one_line(records, message, experiments):
    with pytest.raises(InputError) as caught:
        identify(records, DEFAULTS, experiments)
    assert message in str(caught.value) and "\n" not in str(caught.value)


# --- Whether the model fits.
@pytest.fixture(scope="module")
def quick():
    return sma_bench.measure(sma_bench.simulate("quick_staircase"))


@pytest.mark.compiled
@pytest.mark.parametrize(
    ("size", "verdict", "status"), [(0.0, "ok", 0), (3.0, "imperfect", 0), (60.0, "misfit", 3)]
)
def test_the_verdict_on_the_fit_comes_first_and_the_file_is_always_written(
    quick, size, verdict, status, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    # A temperature that misses the model with constant h and R, by `size` K at the top.
    bent = changed(quick, temperature=lambda x: x - size * (x - x.min()) ** 2 / np.ptp(x) ** 2)
    sma_bench.write_record("bag", bent.signals.values())
    sma_bench.write_parameters("my lab.yaml", sma_bench.load_parameters({R: 2.7}))
    words = ["identify", "bag", "--params", "my lab.yaml"]
    assert main([*words, "--out", "found.yaml", "--json", "found.json"]) == status
    printed = capsys.readouterr().out
    fit = json.loads(Path("found.json").read_text())["fit"]
    of_heat = fit["temperature"]
    assert fit["current"]["verdict"] == "ok" and of_heat["verdict"] == verdict
    assert set(of_heat) == {"verdict", "rms", "noise", "unit"} and 0.05 < of_heat["noise"] < 0.2
    assert (of_heat["rms"] > 20 * of_heat["noise"]) == (verdict == "misfit")
    first, head = printed.splitlines()[0], Path("found.yaml").read_text().splitlines()[0]
    assert ("temperature" in first) == (verdict == "misfit")
    assert ("temperature" in head) == (verdict != "ok")
    assert sma_bench.load_parameters("found.yaml")[R]
    advice = " ".join(printed[printed.index("\nnext ") :].split("\n\n")[0].split())
    assert ("my lab.yaml" in advice) == (verdict == "misfit")
    assert ("found.yaml" in advice) == (verdict != "misfit") and "--out" not in advice
    # The batch prints and writes the same.
    monkeypatch.setattr(batch, "do_tasks", lambda tasks, *_: (
        (k, run_task(task)) for k, task in enumerate(tasks)
    ))  # fmt: skip
    words = ["batch", "identify", "bag", "--params", "my lab.yaml", "--out", "many"]
    assert main(words) == status
    line = capsys.readouterr().out.splitlines()[1].split()
    assert line[1] == ("misfit" if verdict == "misfit" else "done")
    alone, many = (Path(name).read_text().splitlines() for name in ("found.yaml", "many/bag.yaml"))
    apart = [pair for pair in zip(alone, many, strict=True) if pair[0] != pair[1]]
    assert all("Identified by" in line for pair in apart for line in pair) and len(apart) == 1


@pytest.mark.compiled
def test_a_lag_of_the_thermometer_is_listed_where_the_ramps_determine_it():
    # Two time constants in series: the stated c_p decides which one is the wire's.
    stated = {CP: 350.0, H: 410.0, R: 2.75}
    found = sma_bench.identify(ramp(lag=0.3), stated)
    lag = found.estimates[LAG]
    assert abs(lag.value - 0.3) < 3.0 * lag.std < 0.05
    assert found.fit["temperature"].verdict == "ok"
    assert LAG not in sma_bench.identify(ramp(), stated).estimates
    slow = sma_bench.identify(sma_bench.measure(sma_bench.simulate("triangle")))
    (e3,) = [e for e in slow.experiments if e.name == "E3"]
    assert any("lag_std" in f.numbers and f.subject == CP for f in e3.findings)


@pytest.mark.compiled
def test_numbers_are_compared_with_stated_values_only(quick):
    stated = {R: 4.9, f"uncertainty.{R}": 0.1}
    found = sma_bench.identify(quick, stated)
    entries = found.to_json()["parameters"]
    assert entries[R]["stated"] == {"value": 4.9, "std": 0.1} and "stated" not in entries[H]
    (off,) = [line for line in str(found).splitlines() if line.startswith("off ")]
    assert R in off and "heat_transfer" not in off
    right = sma_bench.identify(quick, stated | {R: 2.72})
    assert not [line for line in str(right).splitlines() if line.startswith("off ")]


def test_a_prompt_shows_one_line_of_a_result_and_a_closed_pipe_is_no_error(
    quick, planted_diagnosis, capsys
):
    found = sma_bench.identify(quick)
    for thing in (found, found.parameters, quick, planted_diagnosis):
        assert len(repr(thing)) < 1000 and "\n" not in repr(thing)
    assert main(["parameters"]) == 0
    assert max(map(len, capsys.readouterr().out.splitlines())) <= 100
    reading, writing = os.pipe()
    os.close(reading)
    command = [sys.executable, "-m", "sma_bench.cli", "parameters"]
    with os.fdopen(writing, "w") as pipe:
        ended = subprocess.run(command, stdout=pipe, stderr=subprocess.PIPE, text=True, check=False)
    assert ended.returncode == 0 and ended.stderr == ""


# --- Stated values combined with measured ones: no error gets larger than the stated one.
START, FINISH, M_S, M_F = TRANSITIONS.values()
JOINT = np.sqrt(1.0 / (1.0 / 16.0 + 1.0 / 64.0))


def run_with(parameters, **estimates):
    run = IdentificationRun(parameters, frozenset())
    run.estimates = {name: Estimate(*e) for name, e in estimates.items()}
    return run


def weighed(name, estimate, stated_std=None, **given):
    """An estimate combined with what a file states, and the run's notes."""
    stated = {} if stated_std is None else {name: stated_std}
    run = run_with(Parameters(given).replace({}, stated), **{name: estimate})
    run.weigh_priors(None)
    return run.estimates[name], run.notes


@pytest.mark.parametrize(("measured", "value", "std", "informed", "contradicted"), [
    ((130.0, 2.0, 1.0), 130.0, 2.0, 0.75, False),  # more accurate: it counts alone
    ((105.0, 8.0, 0.0), 101.0, JOINT, 0.2, False),
    ((150.0, 8.0, 0.0), 110.0, JOINT, 0.2, True),
    ((2e305, 1e305, 1e304), 100.0, 4.0, 0.0, False),
])  # fmt: skip
def test_a_measurement_is_combined_with_a_more_accurate_stated_value(
    measured, value, std, informed, contradicted
):
    known, error, systematic = measured
    found, notes = weighed(R, (known, error, "ohm", "measured", 9, systematic), 4.0, **{R: 100.0})
    assert (found.value, found.std, found.informed) == pytest.approx((value, std, informed))
    assert any("stated more accurately" in note.text for note in notes) == contradicted


def test_a_default_that_nobody_stated_is_never_averaged_with_a_measurement():
    found, notes = weighed(START, (356.0, 6.0, "K", "", 3))
    assert (found.value, found.std) == (356.0, 6.0)
    assert any("not the paper's alloy" in note.text for note in notes)
    assert weighed(START, (356.0, 6.0, "K", "", 3), **{START: 331.0})[0].value < 335.0
    # A number with an error above the spread of all wires is kept, with a warning.
    found, notes = weighed(START, (356.0, 40.0, "K", "", 3))
    assert (found.value, found.std) == (356.0, 40.0)
    assert notes[0].subject == START and notes[0].severity == "warning"
    # A heat transfer coefficient is known only with its area.
    for stated, noted in (({}, True), ({AREA: 4e-4}, False)):
        found, notes = weighed(H, (80.0, 2.0, "W/(m2 K)", "", 9), **stated)
        assert found.value == 80.0
        assert any(AREA in n.text for n in notes if n.severity == "warning") == noted


@pytest.mark.parametrize(("area_std", "own", "sharper"), [
    (120e-6, 0.002, False), (1e-6, 0.06, True),
])  # fmt: skip
def test_factors_of_a_product_stay_consistent(area_std, own, sharper):
    """E2 gives h for the default area, the whole model another area."""
    area = Estimate(150e-6, area_std, "m2")
    both = {H: Estimate(94.0, 94.0 * np.hypot(own, area.relative_std), "W/(m2 K)"), AREA: area}
    run = run_with(Parameters({}), **{H: (36.0, 1.0, "W/(m2 K)", "E2", 9)})
    run.take_sharper(Experiment("E9", "", both))
    loss = run.estimates[H]
    assert (loss is not both[H]) == sharper
    product = 36.0 * run.given[AREA]
    assert loss.value * run.estimates[AREA].value == pytest.approx(product, rel=0.02)
    least = min(own, 1.0 / 36.0)
    assert loss.relative_std == pytest.approx(np.hypot(least, area.relative_std))
    run.weigh_priors(None)
    assert any(AREA in note.text for note in run.notes) == (not sharper)


def test_transition_temperatures_keep_their_order():
    values = {START: (350.0, 1.0), FINISH: (360.0, 4.0), M_S: (364.0, 2.0), M_F: (351.0, 3.0)}
    run = run_with(Parameters(), **{n: (v, s, "K", "", 3) for n, (v, s) in values.items()})
    run.keep_order(None)
    found = {n: e.value for n, e in run.estimates.items()}
    assert found[START] < found[FINISH] and found[M_F] < found[M_S]
    assert found[M_S] < found[FINISH] and found[M_F] < found[START]
    # The more accurate number moves less.
    assert 350.0 < found[START] < 350.3 and 363.0 < found[FINISH] < 363.8
    assert dict(run.improved()) | found == dict(run.improved())


def test_a_number_out_of_its_range_is_named_and_the_others_are_kept():
    # A_s and A_f must be updated in the right order.
    run = run_with(Parameters.of_paper(), **{
        EXPANSION: (9e12, 1e5, "Pa/K", "", 3), R: (2.5, 0.01, "ohm", "", 3),
        START: (370.0, 1.0, "K", "", 3), FINISH: (390.0, 1.0, "K", "", 3)})  # fmt: skip
    improved = run.improved()
    assert improved[R] == 2.5 and improved[START] == 370.0 and EXPANSION not in run.estimates
    (note,) = run.notes
    assert note.severity == "warning" and note.subject == EXPANSION


# --- Measured data override a default that was not stated, for any alloy and noise.
TRUTH = {"A_s": 356.0, "A_f": 372.0, "M_s": 352.0, "M_f": 336.0}
OTHER = Alloy(*TRUTH.values(), 7e6, 7e6, 60e9, 28e9, 0.035, -0.2e6)


def four(params):
    """Value and deviation of the four temperatures."""
    return {n: (params[t], params.std(t)) for n, t in TRANSITIONS.items()}


def test_a_noisy_test_gives_its_alloy_with_no_file_a_template_or_its_own_result(
    tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    random = np.random.default_rng(2)
    (test,) = isobaric_tests(OTHER, random, [100e6], scatter=8.0, cycles=8)
    parts = [branch for cycle in test.cycles for branch in cycle.branches]
    kelvin, strain, stress = (np.concatenate([getattr(branch, kind) for branch in parts])
                              for kind in ("temperature", "strain", "stress"))
    np.savetxt("noisy.csv", np.column_stack([kelvin - 273.15, strain, stress / 1e6]), "%.7f", ",",
               header="Temperature (C),Strain (mm/mm),Stress (MPa)", comments="")
    noisy = open_record("noisy.csv")
    result = identify([noisy], Parameters())
    alone = four(result.parameters)
    for name, (value, std) in alone.items():
        assert 2.0 < std < 9.0 and abs(value - TRUTH[name]) < 2.0 * std
    assert any("not the paper's alloy" in note.text for note in result.notes)
    assert main(["parameters", "--out", "template.yaml"]) == 0
    template = read_parameters("template.yaml")
    assert four(identify([noisy], template).parameters) == alone
    words = ["identify", "noisy.csv", "--params", "template.yaml", "--out", "own.yaml"]
    assert main(words) == 0
    own = read_parameters("own.yaml")
    assert own.given.isdisjoint({R, "wire.martensite_modulus"})
    for name, (value, std) in four(identify([noisy], own).parameters).items():
        assert value == pytest.approx(alone[name][0], abs=0.1)
        assert std == pytest.approx(alone[name][1], rel=0.06)
    # A diagnosis has the same priors with the template as without a file.
    paper = Parameters.of_paper()
    one, other, stated = (unknowns_of_records(p, ("temperature", "deflection"))
                          for p in (Parameters(), template, paper))
    assert one.items == other.items
    (note,) = about_unstated(one, template)
    assert CP in note.text and "wire.mass" in note.text and not about_unstated(stated, paper)


# --- Remarks: every cause of the table is used, with all facts that its text needs.
ROOM = Path(remark.__code__.co_filename).parent
TABLE = yaml.safe_load((ROOM / "remarks.yaml").read_text("utf-8"))


def facts_of(entry):
    """Names that the text and the numbers of an entry need."""
    fields = (field for _, field, _, _ in string.Formatter().parse(entry["text"]) if field)
    names = {field.split("*")[0].split("/")[0].split(".")[0] for field in fields}
    return names | set(entry.get("numbers", ()))


def test_every_cause_has_its_facts_and_is_used():
    used = set()
    for path in ROOM.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                used.add(node.value)
            if not (isinstance(node, ast.Call) and isinstance(node.func, ast.Name)
                    and node.func.id in ("remark", "refusal", "words")):
                continue
            given = {keyword.arg for keyword in node.keywords}
            first = node.args[0]
            causes = (first.body, first.orelse) if isinstance(first, ast.IfExp) else (first,)
            for cause in (c.value for c in causes if isinstance(c, ast.Constant)):
                needed = facts_of(TABLE[cause])
                if "numbers" in given:
                    needed -= set(TABLE[cause].get("numbers", ()))
                assert None in given or needed <= given, (path.name, cause, needed - given)
                named = "subject" in given or "subject" in TABLE[cause] or len(node.args) > 2
                assert named or node.func.id != "remark", (path.name, cause)
    assert set(TABLE) <= used, set(TABLE) - used


def test_a_text_scales_its_facts_and_keeps_numbers_in_si_units():
    found = remark("size of the expansion", "warning", value=-0.3e6, std=1e4, alpha_E_low=0.15e6,
                   alpha_E_high=0.6e6, verdict="plausible")  # fmt: skip
    assert found.severity == "warning" and found.subject == "Theta_T"
    assert "Theta_T = -0.3 +- 0.01 MPa/K against -0.15 to -0.60 MPa/K" in found.text
    assert found.numbers["value"] == -0.3e6
    assert str(refusal("no motion", where="here")).startswith("here: no motion")
