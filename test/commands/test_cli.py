"""The command line: results on good input, one line and exit code 2 on bad input."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest

from sma_bench.cli import LONGEST_LINE, main
from sma_bench.identify import identify
from sma_bench.parameters import Parameters
from sma_bench.records import Signal, open_record, read_record
from sma_bench.records.bag_writer import write_record

WIRE_FILE = "/**:\n  ros__parameters:\n    wire:\n      resistance: {}\n"


def refuse(capsys, *arguments):
    """Exit code 2 and exactly one line on standard error, which is returned."""
    assert main([str(argument) for argument in arguments]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and error.startswith("sma-bench: ")
    assert "Traceback" not in error
    return error


def constant_bag(path, voltage=1.0):
    time = np.arange(0.0, 30.0, 0.05)
    current = voltage / 2.7
    levels = (("voltage", "V", voltage), ("current", "A", current), ("temperature", "K", 300.0))
    signals = [
        Signal(f"wire.{name}", unit, time, np.full_like(time, value))
        for name, unit, value in levels
    ]
    write_record(path, signals)
    return path


def test_audit_writes_what_it_prints(capsys, tmp_path):
    result = tmp_path / "audit.json"
    assert main(["audit", "--set", "wire.resistance=2.8", "--json", str(result)]) == 0
    printed = " ".join(capsys.readouterr().out.split())
    findings = json.loads(result.read_text())["findings"]
    assert {finding["subject"] for finding in findings} >= {"resistivity", "current"}
    for finding in findings:
        assert " ".join(finding["text"].split()) in printed
    assert "2.8 ohm" in printed


def test_simulated_bag_holds_the_protocol_and_its_steady_state(tmp_path, capsys):
    bag = tmp_path / "bag"
    assert main(["simulate", "--protocol", "ramp", "--rate", "20", "--out", str(bag)]) == 0
    record = read_record(bag)
    assert record["wire.voltage"].values.max() == pytest.approx(2.7, abs=0.02)
    assert record.duration == pytest.approx(76.0, abs=0.1)
    again = tmp_path / "again"
    assert main(["simulate", "--input", str(bag), "--out", str(again)]) == 0
    # Voltages travel as 32-bit floats: 3e-7 relative, of a rise of 17 K.
    assert read_record(again)["wire.temperature"].values == pytest.approx(
        record["wire.temperature"].values, abs=1e-4
    )


def test_wrong_units_in_a_file_are_one_line_that_names_the_file(tmp_path, capsys):
    path = tmp_path / "p.yaml"
    path.write_text(WIRE_FILE.format("2.7 ohm"))
    line = refuse(capsys, "identify", constant_bag(tmp_path / "bag"), "--params", path)
    assert str(path) in line and "expected a number in ohm" in line
    # Whatever names are in it, a line can be read.
    assert len(refuse(capsys, "info", "x" * 5000)) < LONGEST_LINE + 30


def test_a_record_that_identifies_nothing_says_what_is_missing(tmp_path, capsys):
    bag = constant_bag(tmp_path / "bag")
    line = refuse(capsys, "identify", bag)
    assert "E1" in line and "staircase" in line


@pytest.mark.parametrize(
    "words",
    ["audit --json", "simulate --protocol ramp --out", "parameters --out", "identify IN --out"],
)
def test_an_output_folder_that_cannot_be_written_is_one_line(words, tmp_path, capsys, shared_data):
    (tmp_path / "file").write_text("not a folder")
    words = words.replace("IN", str(shared_data / "foreign" / "wire" / "staircase")).split()
    assert "result" in refuse(capsys, *words, tmp_path / "file" / "result")
    assert os.listdir(tmp_path) == ["file"]


def test_a_number_is_said_to_be_from_the_experiment_whose_value_it_is(measured_data):
    folder = measured_data / "sma_react" / "input" / "cal_sample_1"
    records = [open_record(folder / f"{stress} MPa.txt") for stress in (7, 50, 150)]
    result = identify(records, Parameters.defaults(), ["E6", "E9"])
    name = "wire.austenite_start_temperature"
    by_tangents, jointly = (e.estimates[name] for e in result.experiments)
    assert by_tangents.value != jointly.value
    assert result.estimates[name].value == jointly.value and result.origin(name) == "E9"


def test_a_node_without_ros_says_what_is_missing(tmp_path):
    (tmp_path / "rclpy.py").write_text("raise ModuleNotFoundError('no rclpy', name='rclpy')")
    command = [sys.executable, "-m", "sma_bench.cli", "run", "simulator"]
    environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
    found = subprocess.run(command, capture_output=True, text=True, env=environment, timeout=60.0)
    said = "rclpy is not installed: source a ROS 2 Jazzy setup file, or use ./bench"
    assert (found.returncode, found.stderr) == (2, f"sma-bench: run: {said}\n")


def test_parameters_of_another_rig_say_which_rig_either_is(tmp_path, capsys):
    bag = constant_bag(tmp_path / "bag")
    four = ["--set", "bench.channels=[a, b]", "--set", "bench.channel_sides=[front, back]"]
    line = refuse(capsys, "simulate", "--input", bag, *four, "--out", tmp_path / "again")
    assert "2 channels (a, b)" in line and "1 channel (wire)" in line
    assert "config/wire_rig.yaml" in line


def test_a_simulation_says_where_the_bench_would_switch_off_and_its_plateau_is_no_clipping(
    tmp_path, capsys, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "hot.yaml").write_text(
        "steps: [{kind: hold, level: 7.9, duration: 30.0}, {kind: rest, duration: 5.0}]"
    )
    assert main(["simulate", "--protocol", "hot.yaml", "--rate", "20", "--out", "hot"]) == 0
    said = capsys.readouterr().out
    assert "warning limit: over-temperature: wire at 167.9 degC, limit 150.0 degC" in said
    assert main(["info", "hot"]) == 0
    assert "clipped" not in capsys.readouterr().out
