"""The diagnosis service as a process: an answer, the gap's diagnostics, the improved file."""

import json

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from planted import supply_drop_lab
from std_msgs.msg import String

from examination.blind.case_files import checked_answer
from sma_bench.diagnose.result import diagnosis_from
from sma_bench.parameters import read_parameters

pytest.importorskip("numba", reason="diagnoses take minutes uncompiled")

ANSWER = {
    "verdict": "effect", "cause": ["slack"],
    "candidates": [{"name": "slack", "probability": 0.9}],
    "where": {"signal": "deflection", "phase": "drive", "side": "front", "stage": "mechanical"},
    "shrinkage": {
        "deflection": {"rmse_before": 3e-3, "rmse_after": 2e-4, "noise_floor": 1e-4,
                       "fraction": 0.94, "ci90": [0.9, 0.97]},
        "current": {"rmse_before": 1e-2, "rmse_after": 1e-2, "noise_floor": 1e-2,
                    "fraction": None, "ci90": [None, None]},
    },
}


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    """Folder with a bag of a wire whose leads drop voltage, and the lab's parameters."""
    return supply_drop_lab(tmp_path_factory.mktemp("rig"))


def test_a_bag_is_diagnosed_its_gap_published_and_the_improvement_written(bench, rig, tmp_path):
    results = bench.latched("diagnosis/result", String)
    gaps = bench.latched("diagnosis/gap", DiagnosticArray)
    states = bench.latched("diagnosis/state", String)
    improved = tmp_path / "improved.yaml"
    node = bench.start(
        "diagnosis", rig / "lab.yaml", record_root=rig, record="[bag]", improved=improved,
        output_root=tmp_path,
    )
    first = bench.trigger_later("diagnosis/diagnose")
    bench.until(lambda: states and states[-1].data.startswith("busy"))
    second = bench.trigger("diagnosis/diagnose")
    assert not second.success and second.message == "busy: another diagnosis is running"
    bench.until(first.done, patience=120.0)
    answer = first.result()
    assert answer.success, answer.message
    found = checked_answer(json.loads(answer.message))
    assert (found.verdict, found.cause) == ("effect", ("supply_drop",))
    bench.until(lambda: results and gaps)
    assert results[-1].data == answer.message
    whole, *quantities = gaps[-1].status
    assert whole.level == DiagnosticStatus.WARN
    assert whole.name == "diagnosis: sim-to-real gap"
    assert whole.message == "explained by supply_drop"
    assert {v.key: v.value for v in whole.values}["stage"] == "electrical"
    assert {s.name.rpartition(" ")[2] for s in quantities} == {"current", "temperature"}
    saved = read_parameters(improved)
    assert saved["effect.supply_drop.resistance"] == pytest.approx(0.3, abs=0.05)
    assert saved["bench.channels"] == ("wire",)
    assert node.end() == 0
    assert "Traceback" not in node.output


def test_bad_requests_are_answered_in_one_line_and_the_node_ends_while_it_works(bench, rig):
    node = bench.start("diagnosis", rig / "lab.yaml", record_root=rig)
    answer = bench.trigger("diagnosis/diagnose")
    assert not answer.success and answer.message.startswith("record: is empty")
    result = bench.set_parameter("diagnosis", "improved", "Makefile")
    assert not result.successful and "ends in .yaml" in result.reason
    bench.set_parameter("diagnosis", "record", ["bag"])
    bench.set_parameter("diagnosis", "hold_out", ["../../etc"])
    answer = bench.trigger("diagnosis/diagnose")
    assert not answer.success and answer.message.startswith("hold_out: ")
    assert "lies outside record_root" in answer.message
    bench.set_parameter("diagnosis", "hold_out", ["no_such_bag"])
    answer = bench.trigger("diagnosis/diagnose")
    assert not answer.success and "no_such_bag" in answer.message and "\n" not in answer.message
    bench.set_parameter("diagnosis", "hold_out", [""])
    states = bench.latched("diagnosis/state", String)
    bench.trigger_later("diagnosis/diagnose")
    bench.until(lambda: states and states[-1].data.startswith("busy"))
    assert node.end() == 0
    assert "Traceback" not in node.output


def gap(**changes):
    return diagnosis_from(ANSWER | changes, "answer").to_json()["gap"]


def test_the_gap_warns_where_it_is_and_only_there():
    whole, deflection, current = gap()
    assert (whole["is_gap"], deflection["is_gap"], current["is_gap"]) == (True, True, False)
    assert whole["values"]["phase"] == "drive"
    assert "94 %" in deflection["message"]
    assert current["values"]["fraction"] == "nan"


@pytest.mark.parametrize("verdict", ["no_gap", "recalibration", "ambiguous", "unexplained"])
def test_every_verdict_has_its_level(verdict):
    whole, deflection, _ = gap(verdict=verdict, cause=[])
    assert whole["is_gap"] == deflection["is_gap"] == (verdict != "no_gap")
    assert whole["message"] != gap()[0]["message"]
