"""The benchmark runs on tiny sizes and says all that it promises; the figures' own rules."""

import importlib.util
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from examination.perf.figures import Figure, Skipped, as_json, at_least, at_most
from examination.perf.perf import SECTIONS, main
from examination.perf.timing import exponent, interleaved, ratio

PERF = Path(__file__).parents[2] / "examination" / "perf" / "perf.py"
CASES = ("one wire", "four wires, effects on")


def run(tmp_path, *sections):
    file = tmp_path / "perf.json"
    assert main([*sections, "--tiny", "--json", str(file)]) == 0
    return json.loads(file.read_text())


def run_apart(tmp_path, *sections):
    """In a process of its own, as what speaks to nodes."""
    file = tmp_path / "perf.json"
    process = subprocess.run(
        [sys.executable, str(PERF), *sections, "--tiny", "--json", str(file)],
        capture_output=True, text=True, check=False,
    )
    assert process.returncode == 0, process.stderr
    return json.loads(file.read_text())


def measures(document, section):
    found = {}
    for figure in document["sections"][section]["figures"]:
        assert figure["value"] is not None and np.isfinite(figure["value"]), figure
        assert figure["met"] in ((None,) if figure["aim"] is None else (True, False))
        found.setdefault(figure["case"], {})[figure["measure"]] = figure["value"]
    return found


def is_there(module):
    return importlib.util.find_spec(module) is not None


@pytest.mark.slow
def test_simulation_is_held_against_solvers(tmp_path, capsys):
    document = run(tmp_path, "simulation")
    out = capsys.readouterr().out
    found = measures(document, "simulation")
    for case in CASES:
        assert case in out
        assert found[case]["scipy LSODA: times slower"] > 1.0
        assert found[case]["error, of the range"] < (5e-3 if "effects" in case else 1e-6)
        assert found[case]["scipy LSODA: its error"] < 1e-2
        if is_there("sksundae"):
            assert found[case]["scikit-sundae CVODE: times slower"] > 1.0
    assert any("parameter sets" in case for case in found)
    assert list(document["sections"]) == ["simulation"]
    assert document["machine"]["cores"] >= 1 and document["machine"]["versions"]["numpy"]


@pytest.mark.slow
def test_reading_growth_commands_identification_and_batch_are_complete(tmp_path):
    document = run(
        tmp_path, "reading", "growth", "commands", "batch", "solver", "identification"
    )
    for case, found in measures(document, "solver").items():
        assert found["ours: simulations"] < found["least_squares: simulations"], case
    bags = measures(document, "reading")
    for case, found in bags.items():
        assert found["rosbags, message by message: times slower"] > 0.0
        if is_there("mcap_ros2") and "mcap" in case:
            assert found["mcap-ros2-support: times slower"] > 0.0
    assert len(bags) == 2
    growth = measures(document, "growth")
    for what in ("samples", "wires", "parameter sets", "effects"):
        assert f"simulation over {what}" in growth
    assert len(growth) == 6
    commands = measures(document, "commands")
    assert {"--help", "identify --help", "identify a minute's bag"} == set(commands)
    assert all(found["warm: processor"] > 0.0 for found in commands.values())
    assert sum(len(found) for found in measures(document, "batch").values()) == 1
    (of_e10,) = measures(document, "identification").values()
    assert of_e10["identification: processor"] > 0.0 and of_e10["largest memory"] > 0.0


@pytest.mark.slow
def test_nodes_and_the_twin_are_measured(tmp_path, ros_domain):
    pytest.importorskip("rclpy")
    document = run_apart(tmp_path, "nodes", "twin")
    found = measures(document, "nodes")["simulator at 100 Hz"]
    assert found["power readings a second"] > 0.0
    assert found["command to reading, median"] > 0.0
    for rig in ("one wire", "four wires"):
        assert measures(document, "twin")[f"{rig} at 500 Hz"]["twin without ROS"] > 0.0
    assert measures(document, "twin")["one wire at 500 Hz"]["twin node"] > 0.0


def test_an_unknown_section_is_one_line(capsys):
    with pytest.raises(SystemExit) as ended:
        main(["speed"])
    assert ended.value.code == 2
    said = capsys.readouterr().err
    assert "no section speed, expected one of simulation, solver, reading" in said
    assert "nodes" in SECTIONS


def test_aims_are_judged_and_what_was_not_measured_is_kept():
    outcomes = [
        Figure("a", "b", 2.0, "x", at_least(3.0)), Figure("a", "c", 2.0, "x", at_most(3.0)),
        Figure("a", "d", float("nan"), "x"), Skipped("e", "no compiler"),
    ]
    section = as_json({"s": outcomes})["sections"]["s"]
    assert [figure["met"] for figure in section["figures"]] == [False, True, None]
    assert section["figures"][2]["value"] is None
    assert section["skipped"] == [{"what": "e", "why": "no compiler"}]


def test_calls_run_in_turn_a_ratio_is_by_round_and_growth_is_a_slope():
    ran = []
    calls = {"a": lambda: ran.append("a"), "b": lambda: ran.append("b")}
    assert interleaved(calls, 3)["a"].shape == (3,)
    assert ran == ["a", "b"] * 4  # the first round does not count
    assert ratio(np.array([2.0, 20.0, 6.0]), np.array([1.0, 10.0, 2.0])) == 2.0
    sizes = np.array([1.0, 10.0, 100.0])
    assert exponent(sizes, 3.0 * sizes**2) == pytest.approx(2.0)
