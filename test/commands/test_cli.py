"""The command line: results on good input, one line and exit code 2 on bad input."""

import os
import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml
from hostile_texts import VALUES

import sma_bench
from sma_bench.cli import LONGEST_LINE, main
from sma_bench.records import read_record
from sma_bench.records.bag_writer import write_record
from sma_bench.synthetic.bench_records import signals_of

LONGEST_NAME = 255  # characters of a file name on Linux
ROOT = Path(__file__).resolve().parents[2]
REFUSED = yaml.safe_load(Path(__file__).with_name("refused.yaml").read_text())


def refuse(capsys, *arguments):
    """Require exit code 2 and one line on standard error; returns the line."""
    assert main([str(argument) for argument in arguments]) == 2
    printed = capsys.readouterr()
    assert printed.err.count("\n") == 1 and printed.err.startswith("sma-bench: ")
    assert printed.out == ""
    return printed.err


@pytest.mark.parametrize("line", REFUSED)
def test_wrong_commands_are_one_line_and_write_nothing(line, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sma_bench.commands.calibrate._CONNECTING", 0.3)
    said = refuse(capsys, *shlex.split(line.replace("ROOT", str(ROOT))))
    assert REFUSED[line] in said and os.listdir(tmp_path) == []


def test_simulated_bag_holds_the_protocol_and_its_steady_state(tmp_path, capsys):
    bag, again = tmp_path / "bag", tmp_path / "again"
    assert main(["simulate", "--protocol", "ramp", "--rate", "20", "--out", str(bag)]) == 0
    record = read_record(bag)
    assert record["wire.voltage"].values.max() == pytest.approx(2.7, abs=0.02)
    assert record.duration == pytest.approx(76.0, abs=0.1)
    assert main(["simulate", "--input", str(bag), "--out", str(again)]) == 0
    # Voltages are stored as 32-bit floats: 3e-7 relative, of a rise of 17 K.
    assert read_record(again)["wire.temperature"].values == pytest.approx(
        record["wire.temperature"].values, abs=1e-4
    )
    # Voltages above the limit, and effects of other loads, are reported.
    capsys.readouterr()
    words = ["--set", "bench.maximum_voltage=1.5", "--set", "effect.slack.strain=0.003", "--force"]
    assert main(["simulate", "--input", str(bag), *words, "--out", str(again)]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "over-voltage: wire gets 2.68 V, limit 1.5 V" in said
    assert "slack: does nothing: effect slack with load.kind clamped" in said
    # With parameters of another rig, the error names both rigs, in one line whatever the names.
    four = ["--set", "bench.channels=[a, b]", "--set", "bench.channel_sides=[front, back]"]
    line = refuse(capsys, "simulate", "--input", bag, *four, "--out", tmp_path / "other")
    assert "the channels a, b" in line and "voltages of wire" in line
    assert "config/wire_rig.yaml" in line
    assert len(refuse(capsys, "info", "x" * 5000)) < LONGEST_LINE + 30


def test_an_imposed_elongation_is_that_of_the_bag_and_zero_in_a_protocol(tmp_path, capsys):
    machine, bag, again = {"load.kind": "displacement"}, tmp_path / "bag", tmp_path / "again"
    time = np.arange(0.0, 30.0, 0.05)
    moved = np.interp(time, [3.0, 12.0, 24.0], [0.0, 5e-4, 1e-4])
    true = sma_bench.simulate((time, 0.1 * time, moved), machine)
    without = [s for s in signals_of(true) if s.name != "force"]
    write_record(bag, without)
    words = ["--set", "load.kind=displacement", "--out"]
    assert main(["simulate", "--input", str(bag), *words, str(again)]) == 0
    found = read_record(again)
    for name, exact in (("force", true.force[:, 0]), ("elongation", moved)):
        actual = np.interp(time, found[name].time, found[name].values)
        assert actual == pytest.approx(exact, abs=1e-5 * np.ptp(exact)), name
    capsys.readouterr()
    ramp = ["simulate", "--protocol", "ramp", "--rate", "20", *words, str(tmp_path / "ramp")]
    assert main(ramp) == 0
    assert "the elongation is held at 0" in " ".join(capsys.readouterr().out.split())
    assert not np.any(read_record(tmp_path / "ramp")["elongation"].values)
    write_record(tmp_path / "bare", [s for s in without if s.name != "elongation"])
    line = refuse(capsys, "simulate", "--input", tmp_path / "bare", *words, tmp_path / "no")
    assert "no elongation, expected the imposed one with load.kind displacement" in line


@pytest.mark.parametrize("words", ["audit --json", "simulate --protocol ramp --out",
                                   "parameters --out"])  # fmt: skip
def test_an_output_folder_that_cannot_be_written_is_refused_in_one_line(words, tmp_path, capsys):
    (tmp_path / "file").write_text("not a folder")
    assert "result" in refuse(capsys, *words.split(), tmp_path / "file" / "result")
    assert os.listdir(tmp_path) == ["file"]


@pytest.mark.parametrize("words", [
    "simulate --protocol ramp --out", "parameters --out", "audit --json", "demo --out",
    "identify nothing --report", "example ten_tasks --out", "calibrate supply 5=6 9=10 --out",
    "investigate nothing --simulated nothing --folder", "import nothing --out", "info",
    "simulate --protocol ramp --out bag --params", "simulate --out bag --protocol",
])  # fmt: skip
def test_a_name_that_no_file_can_have_is_one_line(words, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in VALUES[str]:
        if len(name) > LONGEST_NAME or words.endswith("--protocol"):
            assert len(refuse(capsys, *words.split(), name)) < LONGEST_LINE + 30
    assert os.listdir(tmp_path) == []


def test_a_node_without_ros_says_what_is_missing(tmp_path):
    (tmp_path / "rclpy.py").write_text("raise ModuleNotFoundError('no rclpy', name='rclpy')")
    command = [sys.executable, "-m", "sma_bench.cli", "run", "simulator"]
    environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
    found = subprocess.run(command, capture_output=True, text=True, env=environment, timeout=60.0)
    said = "rclpy is not installed: source a ROS 2 Jazzy setup file, or use ./bench"
    assert (found.returncode, found.stderr) == (2, f"sma-bench: run: {said}\n")


def test_a_simulation_says_where_the_bench_would_switch_off_and_its_plateau_is_no_clipping(
    tmp_path, capsys, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    steps = "[{kind: hold, level: 7.9, duration: 30.0}, {kind: rest, duration: 5.0}]"
    (tmp_path / "hot.yaml").write_text(f"steps: {steps}")
    assert main(["simulate", "--protocol", "hot.yaml", "--rate", "20", "--out", "hot"]) == 0
    said = capsys.readouterr().out
    assert "warning limit: over-temperature: wire at 167.9 degC, limit 150.0 degC" in said
    assert main(["info", "hot"]) == 0
    assert "clipped" not in capsys.readouterr().out
