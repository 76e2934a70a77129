"""`import sma_bench` in a notebook: the answers of the command line, from arrays and frames."""

import json
import subprocess
import sys

import numpy as np
import pytest
from planted import few_effects

import sma_bench
from sma_bench import InputError
from sma_bench.cli import main

COMPOSITE = "config/composite_rig.yaml"
RATE = 20.0


@pytest.fixture(scope="module")
def staircase():
    return sma_bench.measure(sma_bench.simulate("quick_staircase", rate=RATE))


def arrays(record):
    """The same record as a notebook's own arrays."""
    return {name: (s.time, s.values) for name, s in record.signals.items()}


# --- the package --------------------------------------------------------------------------------


def test_importing_the_package_imports_nothing_heavy():
    code = "import sma_bench, sys; print(sorted({'numpy', 'scipy', 'numba', 'pandas', 'yaml', "
    code += "'sma_bench.api'} & set(sys.modules)))"
    process = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert process.stdout.strip() == "[]", process.stderr


def test_functions_are_not_hidden_by_the_rooms_of_their_names():
    code = "import sma_bench.identify.run, sma_bench.diagnose.chain\n"
    code += "from sma_bench.identify import identify as room\n"
    code += "import sma_bench, inspect\n"
    code += "for f in (sma_bench.identify, sma_bench.diagnose): print(inspect.signature(f))\n"
    code += "from sma_bench.diagnose.chain import Link; from sma_bench import identify\n"
    code += "print(identify is sma_bench.api.identify, identify is room)"
    process = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    lines = process.stdout.splitlines()
    assert lines[0].startswith("(records: Any, parameters"), process.stderr
    assert "hold_out" in lines[1] and lines[2] == "True False"


def test_every_name_is_there_and_explained():
    import sma_bench.api as api

    assert sorted(api.__all__) == sorted(sma_bench.__all__)
    for name in sma_bench.__all__:
        assert getattr(sma_bench, name) is getattr(api, name)
        assert (getattr(sma_bench, name).__doc__ or "").strip(), f"{name} has no docstring"


def test_what_is_printed_is_short_and_has_the_numbers(staircase):
    simulated = sma_bench.simulate("quick_staircase", rate=RATE)
    found = sma_bench.identify(staircase)
    for thing in (staircase, staircase["wire.voltage"], simulated):
        assert len(repr(thing)) < 300 and "\n" not in repr(thing)
    assert "wire.voltage" in repr(staircase) and "wire (clamped)" in repr(simulated)
    lines = str(found).splitlines()
    assert len(lines) <= len(found.estimates) + 8
    resistance = next(line for line in lines if line.startswith("wire.resistance"))
    assert f"{found.estimates['wire.resistance'].std:.2g} ohm" in resistance
    assert "<td>" in found._repr_html_() and "wire.resistance" in found._repr_html_()


# --- the same as the commands -------------------------------------------------------------------


def test_identification_is_that_of_the_command(tmp_path, staircase):
    bag, result = tmp_path / "bag", tmp_path / "r.json"
    words = ["simulate", "--protocol", "quick_staircase", "--rate", str(RATE), "--noise", "1"]
    assert main([*words, "--out", str(bag)]) == 0
    assert main(["identify", str(bag), "--json", str(result)]) == 0
    by_command = json.loads(result.read_text())["parameters"]
    assert sma_bench.identify(str(bag)).to_json()["parameters"] == by_command
    by_arrays = sma_bench.identify(arrays(staircase)).to_json()["parameters"]
    assert by_arrays.keys() == by_command.keys() >= {"wire.resistance"}
    for name, entry in by_command.items():  # a bag keeps 7 digits of a voltage
        assert by_arrays[name]["value"] == pytest.approx(entry["value"], rel=1e-4)
        assert by_arrays[name]["std"] == pytest.approx(entry["std"], rel=1e-2)


def test_a_bag_and_its_voltages_drive_the_same_simulation(tmp_path, pytestconfig):
    believed = str(pytestconfig.rootpath / COMPOSITE)
    first = sma_bench.simulate("composite_triangle", believed, rate=RATE)
    again = sma_bench.simulate((first.time, first.voltage), believed)
    np.testing.assert_array_equal(again.deflection, first.deflection)
    sma_bench.write_record(tmp_path / "bag", sma_bench.load(first))
    replayed = sma_bench.simulate(tmp_path / "bag", believed)
    np.testing.assert_allclose(replayed.deflection, first.deflection, atol=1e-6)


def test_an_effect_is_switched_on_by_its_size():
    drive = (np.arange(0.0, 6.0, 0.05), np.full(120, 6.0))
    plain = sma_bench.simulate(drive)
    given = sma_bench.simulate(drive, {"effect.latent_heat.heat": 12e3})
    named = sma_bench.simulate(drive, effects={"latent_heat": 12e3})
    np.testing.assert_array_equal(named.temperature, given.temperature)
    assert np.max(np.abs(named.temperature - plain.temperature)) > 1.0


def test_a_protocol_may_be_written_in_the_notebook():
    steps = [{"kind": "hold", "level": 3.0, "duration": 5.0}, {"kind": "rest", "duration": 5.0}]
    run = sma_bench.simulate({"steps": steps}, rate=10.0)
    assert run.time[-1] == pytest.approx(10.0, abs=0.2)
    assert run.voltage[10, 0] == 3.0 and run.voltage[-2, 0] == 0.0


@pytest.mark.slow
def test_diagnosis_of_frames_is_that_of_the_bags(planted_diagnosis):
    pytest.importorskip("pandas")
    told = planted_diagnosis
    seen, unseen = (sma_bench.to_frame(view.path) for view in told.observations)
    with few_effects():
        found = sma_bench.diagnose(seen, told.parameters, unseen)
    assert found.decision.cause == told.decision.cause == ("side_heat_coupling",)
    table = sma_bench.to_frame(found)
    assert table.loc["side_heat_coupling", "probability"] > 0.9
    assert table["probability"].sum() == pytest.approx(1.0)
    for quantity, numbers in told.shrinkage.items():
        assert found.shrinkage[quantity].fraction == pytest.approx(numbers.fraction, abs=1e-6)


# --- arrays and frames --------------------------------------------------------------------------


def test_what_was_not_measured_is_left_out():
    time = np.arange(4.0)
    record = sma_bench.load({
        "time": time, "wire.voltage": time, "wire.current": [0.0, np.nan, 1.0, np.nan],
        "force": np.full(4, np.nan), "wire.temperature": (time[:2] + 0.5, [300.0, 301.0]),
    })  # fmt: skip
    assert set(record.signals) == {"wire.voltage", "wire.current", "wire.temperature"}
    assert record["wire.current"].time.tolist() == [0.0, 2.0]
    assert record["wire.temperature"].time.tolist() == [0.5, 1.5]
    assert record["wire.temperature"].unit == "K"
    assert [f.subject for f in record.findings] == ["force"]


def test_a_frame_holds_every_signal_on_its_own_clock(staircase):
    pandas = pytest.importorskip("pandas")
    shifted = {n: (t + 0.013 * k, v) for k, (n, (t, v)) in enumerate(arrays(staircase).items())}
    record = sma_bench.load(shifted)
    frame = sma_bench.to_frame(record)
    assert isinstance(frame, pandas.DataFrame) and frame.attrs["units"]["wire.voltage"] == "V"
    back = sma_bench.load(frame)
    assert back.signals.keys() == record.signals.keys()
    for name, signal in record.signals.items():
        np.testing.assert_array_equal(back[name].time, signal.time)
        np.testing.assert_array_equal(back[name].values, signal.values)


def test_commands_of_a_bag_survive_a_frame():
    pytest.importorskip("pandas")
    volts = np.array([[0.0, 1.0], [2.0, 3.0]])
    record = sma_bench.load({"voltage_command": ([0.0, 1.0], volts)})
    frame = sma_bench.to_frame(record)
    assert list(frame.columns) == ["voltage_command.0", "voltage_command.1"]
    np.testing.assert_array_equal(sma_bench.load(frame)["voltage_command"].values, volts)


@pytest.mark.parametrize("zone", [None, "Europe/Zurich"])
@pytest.mark.parametrize("as_column", [False, True])
def test_dates_become_seconds_since_the_first(zone, as_column):
    pandas = pytest.importorskip("pandas")
    dates = pandas.date_range("2024-05-01 12:00", periods=3, freq="500ms", tz=zone)
    frame = pandas.DataFrame({"wire.voltage": [0.0, 1.0, 2.0]}, index=dates)
    if as_column:
        frame = frame.rename_axis("time").reset_index()
    record = sma_bench.load(frame)
    assert record["wire.voltage"].time.tolist() == [0.0, 0.5, 1.0]
    assert record.start_ns == int(dates[0].timestamp()) * 10**9


def test_without_pandas_there_is_one_clear_line(monkeypatch, staircase):
    monkeypatch.setitem(sys.modules, "pandas", None)
    for thing in (staircase, sma_bench.identify(staircase)):
        with pytest.raises(InputError, match="pandas is not installed: pip install") as caught:
            sma_bench.to_frame(thing)
        assert "\n" not in str(caught.value)


# --- what can be wrong --------------------------------------------------------------------------


GOOD = {"time": [0.0, 1.0, 2.0], "wire.voltage": [0.0, 1.0, 2.0]}


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: sma_bench.load({**GOOD, "wire.volts": [1, 2, 3]}), "'wire.volts', expected <chan"),
        (lambda: sma_bench.load({**GOOD, "wire.current": [1.0]}), r"current has shape \(1,\) on"),
        (lambda: sma_bench.load({**GOOD, "time": [0.0, 2.0, 1.0]}), "times 2, 1 s, expected"),
        (lambda: sma_bench.load({**GOOD, "time": [0.0, 1.0, np.inf]}), "finite and increasing"),
        (lambda: sma_bench.load({**GOOD, "wire.voltage": ["a", "b", "c"]}), "numbers only"),
        (lambda: sma_bench.load({"wire.voltage": [0.0]}), "without times, expected 'time'"),
        (lambda: sma_bench.load({"time": [0.0]}), "no signals, expected"),
        (lambda: sma_bench.load(3), "load: int given, expected a path"),
        (lambda: sma_bench.load("nowhere"), "nowhere: no such file"),
        (lambda: sma_bench.simulate("stairs"), "neither a bag nor a protocol, expected one of"),
        (lambda: sma_bench.simulate("ramp", rate=0.0), "rate is 0 Hz"),
        (lambda: sma_bench.simulate("ramp", effects={"laten_heat": 1}), "did you mean latent_heat"),
        (lambda: sma_bench.simulate(([0.0, 1.0], [[1.0, 1.0]] * 2)), r"expected \(2, 1\)"),
        (lambda: sma_bench.simulate(([0.0],) * 3), "3 arrays given"),
        (lambda: sma_bench.simulate("ramp", {"wire.mas": 1.0}), "did you mean wire.mass"),
        (lambda: sma_bench.simulate("ramp", 3), "parameters: int given"),
        (lambda: sma_bench.identify(GOOD, experiments=["E99"]), "experiment 'E99', expected"),
        (lambda: sma_bench.identify([]), "no record"),
        (lambda: sma_bench.diagnose(GOOD, signals=["force"]), "signals 'force', expected"),
        (lambda: sma_bench.diagnose(GOOD, signals="current"), "signals 'current', expected"),
        (lambda: sma_bench.measure(sma_bench.simulate("ramp", rate=1.0), -1), "seed is -1"),
    ],
)
def test_mistakes_get_one_clear_line(call, said):
    with pytest.raises(InputError, match=said) as caught:
        call()
    assert "\n" not in str(caught.value)


def test_an_instruments_file_cannot_be_diagnosed(tmp_path):
    file = tmp_path / "tensile.csv"
    file.write_text("strain [%],stress [MPa]\n" + "".join(f"{k / 50},{k}\n" for k in range(60)))
    with pytest.raises(InputError, match="an instrument's file"):
        sma_bench.diagnose(str(file))


def test_models_are_compared_under_the_names_that_they_are_given(staircase):
    softer = sma_bench.load_parameters({"wire.resistance": 3.0})
    shown = sma_bench.compare(staircase, models={"as built": "config/wire_rig.yaml",
                                                 "softer": softer})  # fmt: skip
    assert {d.record for d in shown.differences} == {"as built", "softer"}
    one = sma_bench.compare(staircase, models={"wire.resistance": 3.0})
    assert len(one.differences) < len(shown.differences)
