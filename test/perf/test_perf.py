"""The benchmark runs on tiny sizes and says all that it promises."""

import json
import math
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("sksundae", reason="what is compared with is not installed")

PERF = Path(__file__).parents[2] / "examination" / "perf" / "perf.py"


@pytest.mark.slow
def test_every_section_compares_the_package_with_the_usual_alternative(tmp_path, ros_domain):
    file, sections = tmp_path / "perf.json", ["simulation", "reading", "commands", "nodes"]
    words = [sys.executable, str(PERF), *sections, "--tiny", "--json", str(file)]
    process = subprocess.run(words, capture_output=True, text=True, check=False)
    assert process.returncode == 0 and "not measured" not in process.stdout, process.stderr
    found = json.loads(file.read_text())
    assert list(found) == sections
    every = [value for cases in found.values() for of in cases.values() for value in of.values()]
    assert all(math.isfinite(value) for value in every)
    for case, error in (("one wire", 1e-6), ("four wires, effects on", 5e-3)):
        one = found["simulation"][case]
        assert case in process.stdout and one["error, of the range"] < error
        for rival in ("scipy LSODA", "scikit-sundae CVODE"):
            assert one[f"{rival}: times slower"] > 1.0 and one[f"{rival}: its error"] < 1e-2
    mcap, sqlite3 = found["reading"].values()
    assert mcap["mcap-ros2-support: times slower"] > 0.0
    assert min(mcap["rosbags: times slower"], sqlite3["rosbags: times slower"]) > 0.0
    assert set(found["commands"]) == {"--help", "identify --help", "identify a minute's bag"}
    assert all(of["warm: processor"] > 0.0 for of in found["commands"].values())
    node = found["nodes"]["simulator at 100 Hz"]
    for who in ("command to reading", "bare pair of rclpy: command to reading"):
        assert node[f"{who}, 99 %"] >= node[f"{who}, 50 %"] > 0.0
    assert node["power readings a second"] > 0.0
    assert node["arrival after stamp, 50 %"] > 0.0  # no reading is from the future
