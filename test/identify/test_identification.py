"""Which experiments a set of records allows, what is said about the others, and the results."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from sma_bench.cli import main
from sma_bench.errors import InputError
from sma_bench.identify import identify
from sma_bench.parameters import Parameters, read_parameters
from sma_bench.parameters.table import EXACT_SENSORS
from sma_bench.records import Record, Signal, open_record

R, H, CP = "wire.resistance", "wire.heat_transfer_coefficient", "wire.specific_heat"
DEFAULTS = Parameters.of_paper().replace(uncertainty=EXACT_SENSORS)
WEIGHED = Parameters(
    {name: DEFAULTS[name] for name in ("wire.mass", "wire.surface_area")}, EXACT_SENSORS
)


def steady_record(voltage, n=2000):
    time = 0.05 * np.arange(n)
    values = {"voltage": voltage, "current": voltage / 2.7, "temperature": 297.0}
    return Record(
        Path("steady"), 0,
        {f"wire.{k}": Signal(f"wire.{k}", "", time, np.full(n, v)) for k, v in values.items()},
    )


def one_line(call):
    with pytest.raises(InputError) as caught:
        call()
    text = str(caught.value)
    assert "\n" not in text
    return text


def test_staircase_and_ramps_in_two_bags_give_the_whole_of_table_one(staircase, ramp):
    found = identify([staircase(seed=6), ramp(seed=6)], DEFAULTS)
    assert [e.name for e in found.experiments] == ["E1", "E2", "E3"]
    for name, truth in ((R, 2.75), (H, 410.0), (CP, 350.0)):
        assert abs(found.estimates[name].value - truth) < 2.0 * found.estimates[name].std
        assert found.estimates[name].std < 0.01 * truth
        assert found.parameters[name] == found.estimates[name].value
        assert found.parameters.std(name) == found.estimates[name].std


def test_result_file_has_the_form_of_the_contract(staircase, ramp):
    document = identify([staircase(), ramp()], DEFAULTS).to_json()
    assert set(document) == {"parameters", "experiments", "warnings", "correlation", "fit", "card"}
    assert set(document["parameters"][R]) == {
        "value", "std", "unit", "method", "n", "statistical", "systematic", "informed",
        "warnings", "stated",
    }
    assert document["parameters"][R]["unit"] == "ohm"
    assert json.loads(json.dumps(document, allow_nan=False)) == document


def test_missing_current_is_said_and_the_rest_identified_with_the_given_resistance(staircase):
    record = staircase()
    del record.signals["wire.current"]
    found = identify([record], DEFAULTS.replace({R: 2.75}, {R: 0.03}))
    assert [e.name for e in found.experiments] == ["E2"]
    assert any("E1: not identified" in w and "no signal wire.current" in w for w in found.warnings)
    # 1.1 % of the resistance is 1.1 % of the coefficient.
    assert found.estimates[H].relative_std == pytest.approx(0.03 / 2.75, rel=0.05)


def test_default_resistance_that_nobody_measured_is_a_warning(ramp):
    found = identify([ramp()], WEIGHED)
    assert any(R in w and "nobody measured it" in w for w in found.warnings)
    # A ramp is not meant for a staircase's experiment: that it gives none is no warning.
    assert any("not identified" in note.text for note in found.notes if note.subject == "E1")
    assert not any("E1: not identified" in warning for warning in found.warnings)


def test_unmeasured_samples_are_left_out_and_counted(staircase):
    record = staircase()
    record["wire.temperature"].values[100:150] = np.nan
    found = identify([record], DEFAULTS)
    assert any("50 of" in w and "NaN" in w for w in found.warnings)
    assert abs(found.estimates[H].value - 410.0) < 2.0 * found.estimates[H].std


def test_constant_voltage_is_one_line_that_says_what_was_found_and_what_is_missing():
    text = one_line(lambda: identify([steady_record(3.0)], DEFAULTS))
    assert "1 plateau at 1 voltage, 0 ramps" in text
    assert "E1 a staircase of 4 voltages or more with current" in text


def test_record_of_five_samples_is_one_line():
    assert "5 samples" in one_line(lambda: identify([steady_record(3.0, 5)], DEFAULTS))


def test_record_of_nan_is_one_line():
    text = one_line(lambda: identify([steady_record(np.nan)], DEFAULTS))
    assert "nothing to identify" in text


def test_record_without_signals_is_one_line():
    text = one_line(lambda: identify([Record(Path("empty"), 0, {})], DEFAULTS))
    assert "signals none" in text


def test_no_record_and_unknown_experiment_are_errors(staircase):
    assert "no record" in one_line(lambda: identify([], DEFAULTS))
    text = one_line(lambda: identify([staircase()], DEFAULTS, ["E4"]))
    assert "'E4', expected one of E0" in text


def test_experiment_asked_for_and_not_possible_is_an_error(staircase):
    text = one_line(lambda: identify([staircase()], DEFAULTS, ["E1", "E3"]))
    assert "no E3" in text
    assert "0 ramps" in text


def test_record_made_elsewhere_gives_its_truth_within_two_stated_errors(shared_data):
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


def test_composite_record_says_what_its_experiments_lack(shared_data):
    record = open_record(shared_data / "foreign" / "composite" / "step")
    text = one_line(lambda: identify([record], DEFAULTS))
    assert "front_1: 5 plateaus at 3 voltages, 0 ramps" in text


def test_cold_beginnings_of_a_composite_triangle_give_its_specific_heat(shared_data):
    folder = shared_data / "foreign" / "composite"
    truth = json.loads((folder / "truth.json").read_text())
    known = read_parameters(folder / "nominal.yaml")
    found = identify([open_record(folder / "triangle")], known, ["E3"])
    cp = found.estimates[CP]
    assert abs(cp.value - truth[CP]) < 2.0 * cp.std
    assert any("above A_s" in w for w in found.warnings)


def run_command(*arguments):
    code = "import sys; from sma_bench.cli import main; sys.exit(main(sys.argv[1:]))"
    return subprocess.run(
        [sys.executable, "-c", code, "identify", *map(str, arguments)],
        capture_output=True, text=True, check=False, cwd=Path(__file__).resolve().parents[2],
    )


def test_command_writes_both_files_and_prints_a_table(shared_data, tmp_path):
    folder = shared_data / "foreign" / "wire"
    done = run_command(
        folder / "staircase", folder / "ramp", "--params", folder / "bench.yaml",
        "--out", tmp_path / "identified.yaml", "--json", tmp_path / "result.json",
    )
    assert done.returncode == 0, done.stderr
    assert "wire.heat_transfer_coefficient" in done.stdout
    document = json.loads((tmp_path / "result.json").read_text())
    written = read_parameters(tmp_path / "identified.yaml")
    told = document["parameters"][CP]  # a file has the digits that the error deserves
    assert written[CP] == pytest.approx(told["value"], abs=0.06 * told["std"])
    assert sorted(p.name for p in tmp_path.iterdir()) == ["identified.yaml", "result.json"]


def test_command_on_bad_input_ends_with_one_line_and_code_2(shared_data, tmp_path, capsys):
    step = shared_data / "foreign" / "composite" / "step"
    for arguments in ([step], [tmp_path / "absent"], [step, "--params", tmp_path / "no.yaml"]):
        assert main(["identify", *map(str, arguments)]) == 2
        assert len(capsys.readouterr().err.strip().splitlines()) == 1
