"""The whole demo: nodes as processes, bags, services, table, diagnosis, true parameters."""

import importlib.util
import json
from pathlib import Path

import numpy as np
import pytest

from examination.blind.case_files import checked_answer
from sma_bench.cli import main
from sma_bench.commands import demo
from sma_bench.parameters import read_parameters
from sma_bench.physics import simulate
from sma_bench.protocols import load_protocol
from sma_bench.ros.processes import USERS_VARIABLES

FIGURES = ("02_resistance", "03_heat_transfer", "04_ramp", "05_specific_heat")
LAB = read_parameters(Path(__file__).resolve().parents[2] / "config" / "demo_rig.yaml")
TRUTH = LAB.replace({"effect.slack.strain": 0.004})


def test_every_effect_can_be_hidden_in_a_bench_with_the_labs_stated_errors():
    drawn = [demo.hidden_bench(LAB, seed) for seed in range(60)]
    assert {demo.hidden_effect(bench)[0] for bench in drawn} == set(demo.HIDEABLE)
    assert dict(drawn[3]) == dict(demo.hidden_bench(LAB, 3))
    for bench in drawn:
        effect, numbers = demo.hidden_effect(bench)
        for name, value in numbers.items():
            low, high = demo.HIDEABLE[effect][name.rpartition(".")[2]]
            assert low <= abs(value) <= high
        # The bench's file states no uncertainties.
        assert bench.given_uncertainty == {} and bench["bench.channels"] == LAB["bench.channels"]
    stated = LAB.given_uncertainty.items()
    errors = np.array([[(bench[n] - LAB[n]) / std for n, std in stated] for bench in drawn])
    assert np.abs(errors).max() <= 2.0 + 1e-6
    assert errors.std() == pytest.approx(0.95, abs=0.05)
    assert abs(errors.mean()) < 0.1


def answer(probabilities, verdict="effect"):
    """A diagnosis result with these candidates; the first is the cause if the verdict is effect."""
    candidates = [{"name": n, "probability": p, "parameters": {}} for n, p in probabilities.items()]
    cause = candidates[0]["name"].split("+") if verdict == "effect" else []
    return {"verdict": verdict, "cause": cause, "candidates": candidates}


OTHER = {"opposing_wires": 0.6, "slack": 0.3, "ambient_drift+slack": 0.05}


@pytest.mark.parametrize(("said", "wrong", "words"), [
    (answer({"slack": 0.97}), False, "slack, probability 0.97: right."),
    (answer({"slack+ambient_drift": 0.9}), False, "right, but not alone."),
    (answer(OTHER), True, "WRONG; it gave the true cause 0.35."),
    (answer(OTHER, "ambiguous"), False, "it gave the true cause 0.35."),
    (answer({"recalibration": 0.9, "slack": 0.1}, "recalibration"), True, "the true cause 0.10."),
])  # fmt: skip
def test_the_reveal_says_whether_the_first_choice_was_right(said, wrong, words):
    """Confidently wrong: a cause or a nearly certain candidate that is not the true one."""
    assert demo.confidently_wrong(said, TRUTH) is wrong
    first, second, *_ = demo.reveal(said, TRUTH)
    assert first == "The bench hid slack (mechanical): slack.strain 0.004."
    assert second.endswith(words)


@pytest.mark.slow
@pytest.mark.usefixtures("nodes_forked")
def test_the_demo_identifies_a_wire_and_names_what_a_bench_hides(tmp_path, capsys, monkeypatch):
    if importlib.util.find_spec("rclpy") is None:
        pytest.skip("rclpy is not installed")
    for variable in ("ROS_DOMAIN_ID", *USERS_VARIABLES):
        monkeypatch.setenv(variable, "")  # the demo sets them; monkeypatch restores them
        monkeypatch.delenv(variable)
    monkeypatch.setenv("ROS_PYTHON_CHECK_FIELDS", "1")
    out = tmp_path / "demo"
    answer_file = tmp_path / "demo.json"
    words = ["--draw", "3", "--out", str(out), "--json", str(answer_file)]
    assert main(["demo", *words]) == 0
    printed = capsys.readouterr().out
    assert "errors under 1%: yes" in printed
    truth, found = (read_parameters(out / f"{name}.yaml") for name in ("truth", "identified"))
    ohm = truth["wire.resistance"]
    assert ohm != pytest.approx(2.6987, rel=0.01)
    assert found["wire.resistance"] == pytest.approx(ohm, rel=0.005)
    assert {path.parent.name for path in (out / "bags").glob("*/metadata.yaml")} == {*demo.QUICK}
    assert all((out / "report" / f"figure_{name}.png").is_file() for name in FIGURES)
    found = checked_answer(json.loads((out / "simulated_gap" / "diagnosis.json").read_text()))
    hidden = read_parameters(out / "simulated_gap" / "hidden.yaml")
    assert demo.hidden_effect(hidden)[0] == "slack"
    assert (found.verdict, found.cause) == ("effect", ("slack",))
    verdict, _, revealed = printed.partition("True parameters, from")
    assert "slack explains the gap" in " ".join(verdict.split())
    assert "The bench hid" not in verdict
    assert "The bench hid slack (mechanical)" in revealed and ": right." in revealed
    said = json.loads(answer_file.read_text())
    assert said["holds"] == {"table_one": True, "gap": True}
    assert said["truth"]["table_one"]["wire.resistance"] == pytest.approx(ohm)
    assert said["truth"]["gap"]["effect"] == "slack" == said["diagnosis"]["cause"][0]
    assert said["estimates"]["wire.resistance"]["std"] > 0.0
    assert all(Path(page).stat().st_size > 100_000 for page in said["report"].values())
    improved = read_parameters(out / "simulated_gap" / "improved.yaml")
    drive = load_protocol(demo.HOLD_OUT, LAB).sample(0.02)
    true, before, after = (simulate(p, *drive).deflection for p in (hidden, LAB, improved))
    assert np.std(after - true) < 0.2 * np.std(before - true)
