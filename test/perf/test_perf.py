"""The benchmark runs on tiny sizes and says all that it promises; the figures' own rules."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("sksundae", reason="what is compared with is not installed")

from examination.perf.perf import main

PERF = Path(__file__).parents[2] / "examination" / "perf" / "perf.py"


def measures(file: Path, section: str) -> dict:
    """Values by case and measure, all finite."""
    found: dict = {}
    held = json.loads(file.read_text())[section]
    assert not held["missing"]
    for figure in held["figures"]:
        assert figure["value"] is not None, figure
        assert bool(figure["aim"]) == bool(figure["verdict"]), figure
        found.setdefault(figure["case"], {})[figure["measure"]] = figure["value"]
    return found


@pytest.mark.slow
def test_sections_hold_solvers_readers_and_commands_against_their_limits(tmp_path, capsys):
    file = tmp_path / "perf.json"
    sections = ["simulation", "reading", "commands"]
    assert main([*sections, "--tiny", "--json", str(file)]) == 0
    assert list(json.loads(file.read_text())) == sections
    found, out = measures(file, "simulation"), capsys.readouterr().out
    for case, error in (("one wire", 1e-6), ("four wires, effects on", 5e-3)):
        assert case in out
        assert found[case]["error, of the range"] < error
        for rival in ("scipy LSODA", "scikit-sundae CVODE"):
            assert found[case][f"{rival}: times slower"] > 1.0
            assert found[case][f"{rival}: its error"] < 1e-2
    mcap, sqlite3 = measures(file, "reading").values()
    assert mcap["mcap-ros2-support: times slower"] > 0.0
    assert min(mcap["rosbags: times slower"], sqlite3["rosbags: times slower"]) > 0.0
    commands = measures(file, "commands")
    assert set(commands) == {"--help", "identify --help", "identify a minute's bag"}
    assert all(found["warm: processor"] > 0.0 for found in commands.values())


@pytest.mark.slow
def test_nodes_and_the_twin_are_measured(tmp_path, ros_domain):
    file = tmp_path / "perf.json"
    # In a process of its own, as what speaks to nodes.
    words = [sys.executable, str(PERF), "nodes", "bench", "twin", "--tiny", "--json", str(file)]
    process = subprocess.run(words, capture_output=True, text=True, check=False)
    assert process.returncode == 0, process.stderr
    found = measures(file, "nodes")["simulator at 100 Hz"]
    assert found["power readings a second"] > 0.0
    for who in ("command to reading", "bare pair of rclpy: command to reading"):
        assert found[f"{who}, 99 %"] >= found[f"{who}, 50 %"] > 0.0
    assert found["arrival after stamp, 50 %"] > 0.0  # no reading is from the future
    six, one = measures(file, "bench").values()
    assert one["memory, shared pages once"] < six["memory, shared pages once"]
    assert measures(file, "twin")["one wire at 500 Hz"]["twin node"] > 0.0
