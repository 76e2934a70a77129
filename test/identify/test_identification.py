"""Which experiments a set of records allows, what is said about the others, and the results."""

import json
from pathlib import Path

import numpy as np
import pytest
from wire_records import ramp, staircase

from sma_bench.errors import InputError
from sma_bench.identify import identify
from sma_bench.parameters import Parameters, read_parameters
from sma_bench.parameters.parameter import EXACT_SENSORS
from sma_bench.records import Record, Signal, open_record

R, H, CP = "wire.resistance", "wire.heat_transfer_coefficient", "wire.specific_heat"
DEFAULTS = Parameters.of_paper().replace(uncertainty=EXACT_SENSORS)
WEIGHED = Parameters(
    {name: DEFAULTS[name] for name in ("wire.mass", "wire.surface_area")}, EXACT_SENSORS
)


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


def test_missing_current_is_said_and_the_rest_identified_with_the_given_resistance():
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
def test_default_resistance_that_nobody_measured_is_a_warning():
    found = identify([ramp()], WEIGHED)
    assert any(R in w and "nobody measured it" in w for w in found.warnings)
    # A ramp is not meant for a staircase's experiment: that it gives none is no warning.
    assert any("not identified" in note.text for note in found.notes if note.subject == "E1")
    assert not any("E1: not identified" in warning for warning in found.warnings)


@pytest.mark.compiled
def test_unmeasured_samples_are_left_out_and_counted():
    record = staircase()
    record["wire.temperature"].values[100:150] = np.nan
    found = identify([record], DEFAULTS)
    assert any("50 of" in w and "NaN" in w for w in found.warnings)
    assert abs(found.estimates[H].value - 410.0) < 2.0 * found.estimates[H].std


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


BARE = Record(Path("empty"), 0, {})
REFUSED = {"constant": ([steady_record(3.0)], "1 plateau at 1 voltage, 0 ramps"),
           "five samples": ([steady_record(3.0, 5)], "5 samples"),
           "NaN": ([steady_record(np.nan)], "nothing to identify"),
           "no signals": ([BARE], "signals none"), "no record": ([], "no record"),
           "no such experiment": ([BARE], "'E4', expected one of E0", ["E4"])}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_identified_is_one_line_that_says_why(case):
    records, said, *experiments = REFUSED[case]
    with pytest.raises(InputError) as caught:
        identify(records, DEFAULTS, *experiments)
    assert said in str(caught.value) and "\n" not in str(caught.value)
