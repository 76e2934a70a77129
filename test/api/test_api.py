"""`import sma_bench` in a notebook: the answers of the command line, from arrays and frames."""

import json
import subprocess
import sys
import warnings
from itertools import product

import numpy as np
import pytest

import sma_bench
from sma_bench import InputError, api
from sma_bench.cli import main

RATE = 20.0
# The package imports nothing heavy; its functions hide subpackages of the same name.
CODE = """
import sma_bench, sys
print({"numpy", "scipy", "numba", "pandas", "yaml", "sma_bench.api"} & set(sys.modules))
import sma_bench.identify.run, sma_bench.diagnose.diagnosis
from sma_bench.identify import identify as room
from sma_bench import diagnose, identify
print(identify is sma_bench.api.identify is not room, diagnose is sma_bench.api.diagnose)
"""


@pytest.fixture(scope="module")
def staircase():
    return sma_bench.measure(sma_bench.simulate("quick_staircase", rate=RATE))


def arrays(record):
    """The same record as plain arrays."""
    return {name: (s.time, s.values) for name, s in record.signals.items()}


def test_the_package_imports_nothing_heavy_and_every_name_is_there_and_explained():
    process = subprocess.run([sys.executable, "-c", CODE], capture_output=True, text=True)
    assert process.stdout.splitlines() == ["set()", "True True"], process.stderr
    assert sorted(api.__all__) == sorted(sma_bench.__all__)
    for name in sma_bench.__all__:
        assert getattr(sma_bench, name) is getattr(api, name)
        assert (getattr(sma_bench, name).__doc__ or "").strip(), f"{name} has no docstring"


def test_identification_is_that_of_the_command_and_prints_its_numbers(tmp_path, staircase):
    bag, result = tmp_path / "bag", tmp_path / "r.json"
    words = f"simulate --protocol quick_staircase --rate {RATE} --noise 1 --out {bag}"
    assert main(words.split()) == 0
    assert main(["identify", str(bag), "--json", str(result)]) == 0
    by_command = json.loads(result.read_text())["parameters"]
    assert sma_bench.identify(str(bag)).to_json()["parameters"] == by_command
    found = sma_bench.identify(arrays(staircase))
    by_arrays = found.to_json()["parameters"]
    assert by_arrays.keys() == by_command.keys() >= {"wire.resistance"}
    for name, entry in by_command.items():  # a bag keeps 7 digits of a voltage
        assert by_arrays[name]["value"] == pytest.approx(entry["value"], rel=1e-4)
        assert by_arrays[name]["std"] == pytest.approx(entry["std"], rel=1e-2)
    resistance = next(line for line in str(found).splitlines() if "wire.resistance" in line)
    assert f"{found.estimates['wire.resistance'].std:.2g} ohm" in resistance
    assert "<td>" in found._repr_html_() and "wire.resistance" in found._repr_html_()


@pytest.mark.slow
def test_a_diagnosis_becomes_a_table(planted_diagnosis):
    pytest.importorskip("pandas")
    table = sma_bench.to_frame(planted_diagnosis)
    assert table.loc["side_heat_coupling", "probability"] > 0.9
    assert table["probability"].sum() == pytest.approx(1.0)


def test_models_have_names_one_experiment_may_be_chosen_a_missing_motion_is_a_warning(staircase):
    model = {"wire.resistance": 3.0}
    assert list(sma_bench.compare(staircase, {"m": model}).records)[1:] == ["m"]
    nested, known = {"wire": {"resistance": 3.0}}, sma_bench.load_parameters(model)
    arrays = {"time": [0.0, 1.0, 2.0], "wire.voltage": [0.0, 1.0, 1.0]}
    for own, one in product((staircase, arrays), ([nested], nested, model, known)):
        assert list(sma_bench.compare(own, one).records)[1:] == ["model 1"]
    assert {e.name for e in sma_bench.identify(staircase, {}, "E1").experiments} == {"E1"}
    machine, moved = {"load.kind": "displacement"}, ([0.0, 1.0], [0.0, 0.0], [0.0, 1e-4])
    with pytest.warns(UserWarning, match="the elongation is held at 0"):
        sma_bench.simulate(moved[:2], machine)
    with warnings.catch_warnings(action="error"):
        sma_bench.simulate(moved, machine)


def test_what_was_not_measured_is_left_out():
    time = np.arange(4.0)
    record = sma_bench.load({
        "time": time, "wire.voltage": time, "wire.current": [0.0, np.nan, 1.0, np.nan],
        "force": np.full(4, np.nan), "wire.temperature": (time[:2] + 0.5, [300.0, 301.0]),
    })  # fmt: skip
    times = {name.split(".")[1]: s.time.tolist() for name, s in record.signals.items()}
    assert times.pop("voltage") == [0.0, 1.0, 2.0, 3.0]
    assert times == {"current": [0.0, 2.0], "temperature": [0.5, 1.5]}
    assert record["wire.temperature"].unit == "K"
    assert [f.subject for f in record.findings] == ["force"]


def test_a_frame_holds_every_signal_on_its_own_clock_and_the_commands(staircase, monkeypatch):
    pandas = pytest.importorskip("pandas")
    shifted = {n: (t + 0.013 * k, v) for k, (n, (t, v)) in enumerate(arrays(staircase).items())}
    shifted["voltage_command"] = ([0.0, 1.0], np.array([[0.0, 1.0], [2.0, 3.0]]))
    record = sma_bench.load(shifted)
    frame = sma_bench.to_frame(record)
    assert isinstance(frame, pandas.DataFrame) and frame.attrs["units"]["wire.voltage"] == "V"
    assert {"voltage_command.0", "voltage_command.1"} <= set(frame.columns)
    back = sma_bench.load(frame)
    assert back.signals.keys() == record.signals.keys()
    for name, signal in record.signals.items():
        np.testing.assert_array_equal(back[name].time, signal.time)
        np.testing.assert_array_equal(back[name].values, signal.values)
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(InputError, match="^pandas is not installed: pip install[^\n]*$"):
        sma_bench.to_frame(record)


@pytest.mark.parametrize(("zone", "as_column"), [(None, False), ("Europe/Zurich", True)])
def test_dates_become_seconds_since_the_first(zone, as_column):
    pandas = pytest.importorskip("pandas")
    dates = pandas.date_range("2024-05-01 12:00", periods=3, freq="500ms", tz=zone)
    frame = pandas.DataFrame({"wire.voltage": [0.0, 1.0, 2.0]}, index=dates)
    if as_column:
        frame = frame.rename_axis("time").reset_index()
    record = sma_bench.load(frame)
    assert record["wire.voltage"].time.tolist() == [0.0, 0.5, 1.0]
    assert record.start_ns == int(dates[0].timestamp()) * 10**9


GOOD = {"time": [0.0, 1.0, 2.0], "wire.voltage": [0.0, 1.0, 2.0]}
STILL = sma_bench.simulate(([0.0, 1.0], [0.0, 0.0]))


@pytest.mark.parametrize(("call", "given", "said"), [
    (sma_bench.load, {**GOOD, "wire.volts": [1, 2, 3]}, "'wire.volts', expected <chan"),
    (sma_bench.load, {**GOOD, "wire.current": [1.0]}, r"current has shape \(1,\) on"),
    (sma_bench.load, {**GOOD, "time": [0.0, 2.0, 1.0]}, "times 2, 1 s, expected"),
    (sma_bench.load, {**GOOD, "wire.voltage": ["a", "b", "c"]}, "numbers only"),
    (sma_bench.load, {"wire.voltage": [0.0]}, "without times, expected 'time'"),
    (sma_bench.load, 3, "load: int given, expected a path"),
    (sma_bench.simulate, "stairs", "neither a bag nor a protocol, expected one of"),
    (sma_bench.simulate, ([0.0, 1.0], [[1.0, 1.0]] * 2), r"expected \(2, 1\)"),
    (lambda rate: sma_bench.simulate("ramp", rate=rate), 0.0, "rate is 0 Hz"),
    (lambda size: sma_bench.simulate("ramp", effects={"laten_heat": size}), 1, "latent_heat"),
    (lambda given: sma_bench.simulate("ramp", given), {"wire.mas": 1.0}, "mean wire.mass"),
    (lambda names: sma_bench.diagnose(GOOD, signals=names), "pressure", "signals 'pressure'"),
    (sma_bench.simulate, ([0.0, 1.0], [20.0, 0.0]), "voltage is 20 V, expected at most 10 V"),
    (sma_bench.simulate, ([0.0, 1.0], ["a", "b"]), "expected an array of numbers"),
    (lambda size: sma_bench.simulate("ramp", effects={"latent_heat": size}), "x", "not a number"),
    (lambda size: sma_bench.simulate("ramp", effects={"slack": size}), 0.01, "expected beam or sp"),
    (sma_bench.measure, None, "NoneType given, expected a simulation"),
    (sma_bench.measure, sma_bench.load(GOOD), "Record given, expected a simulation"),
    (lambda seed: sma_bench.measure(STILL, seed), 1.5, "seed is 1.5, expected a whole number"),
    (sma_bench.load_parameters, {"wire.mass": 1e-4, "wire": {"mass": 1e-4}}, "mass stands twice"),
])  # fmt: skip
def test_mistakes_get_one_clear_line(call, given, said):
    with pytest.raises(InputError, match=said) as caught:
        call(given)
    assert "\n" not in str(caught.value)
