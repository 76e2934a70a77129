"""The scorer: sealed until the last answer, true shrinkage, second experiments, result pages."""

import json
import shutil
import sys
from dataclasses import asdict

import pytest
from test_measures import answer_of

from examination.blind import case_files as files
from examination.blind.cases import Card, draw_case
from examination.blind.command import main
from examination.blind.examination import Examinee, follow_up
from examination.blind.rigs import true_values
from examination.blind.score import score
from sma_bench.parameters import write_parameters
from sma_bench.records import read_record

pytest.importorskip("numba", reason="whole records take minutes uncompiled")

WHERE = {"signal": "temperature", "phase": "drive", "side": "front", "stage": "electrical"}
TIE = {"steps": [{"kind": "triangle", "drive": "front", "peak": 2.0, "rise": 4.0, "fall": 4.0},
                 {"kind": "rest", "duration": 2.0}]}


def document(verdict, *cause, protocol=None, **probabilities):
    wanted = {"why": "", "separates": [], "protocol": protocol} if protocol else None
    claims = {"temperature": (0.9, 0.8, 1.0)}
    return answer_of(verdict, probabilities, cause, WHERE, claims) | {"next_experiment": wanted}


CASES = {  # kind, effects, features
    "0001": ("single", ("supply_drop",), {"supply_resistance": 0.3}),
    "0002": ("none", (), {}),
    "0003": ("outside", ("friction",), {"pickup": 1e-3}),
}


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A set of three cases whose labels are sealed; the records are of no matter here."""
    root, labels, drawn = tmp_path_factory.mktemp("set"), {}, {}
    for k, (name, (kind, effects, features)) in enumerate(CASES.items()):
        case = drawn[name] = draw_case(5, k, Card(kind, effects, (), "all", "white"), name)
        for record in ("record", "hold_out"):
            (root / "cases" / name / record).mkdir(parents=True)
        nominal = root / "cases" / name / "nominal.yaml"
        write_parameters(nominal, case.nominal, names=sorted(case.nominal.given))
        labels[name] = {"id": name, "kind": kind, "effects": list(effects), "severity": 9.0,
                        "where": WHERE, "signals": "all", "features": features,
                        "truth": true_values(case.truth), "sensors": asdict(case.sensors),
                        "drives": {n: vars(d) for n, d in case.drives.items()}}
    sha256 = files.seal(root / "labels.sealed", list(labels.values()))
    manifest = {"seed": 5, "split": "open", "cases": list(CASES), "sha256": sha256}
    (root / "manifest.json").write_text(json.dumps(manifest))
    return root, labels, drawn


def hand_in(made, folder, answers):
    """A copy of the set with these answers."""
    root, _, drawn = made
    cases = files.read_case_set(shutil.copytree(root, folder / "set"))
    for case, result in answers.items():
        right = None
        if result and result["verdict"] == "effect":
            better = drawn[case].truth.replace({"effect.supply_drop.resistance": 0.3})
            write_parameters(folder / "better.yaml", better)
            right = (folder / "better.yaml").read_text()
        files.keep(cases.answers, case, result, "" if result else "exit code 1: it hurts", 2.0,
                   right)
    return cases


GOOD = {"0001": document("effect", "supply_drop", supply_drop=1.0),
        "0002": document("no_gap", no_gap=1.0) | {"shrinkage": {}},
        "0003": document("ambiguous", protocol=TIE, slack=0.5, residual_strain=0.5)}


def test_labels_stay_sealed_until_the_last_answer_to_this_set(made, tmp_path, monkeypatch, capsys):
    cases = hand_in(made, tmp_path, {n: GOOD[n] for n in ("0001", "0003")})
    touched = []
    monkeypatch.setattr("examination.blind.case_files.unseal", lambda *a: touched.append(a))
    assert main(["score", str(cases.root)]) == 2
    error = capsys.readouterr().err
    assert "1 of 3 cases have no answer yet, the first is 0002: the labels stay sealed" in error
    assert error.count("\n") == 1 and touched == []


SECOND_ANSWER = """
import shutil, sys
from pathlib import Path
records = sys.argv[1:sys.argv.index("--params")]
assert records == ["record", "experiment_1"], records
shutil.copytree("experiment_1", Path(__file__).with_suffix(".seen"))
Path("result.json").write_text(Path(__file__).with_suffix(".json").read_text())
"""


def test_what_is_asked_for_is_recorded_on_the_own_bench_and_the_program_asked_again(made, tmp_path):
    _, labels, _ = made
    script = tmp_path / "second.py"
    script.write_text(SECOND_ANSWER)
    script.with_suffix(".json").write_text(json.dumps(document("unexplained", unexplained=1.0)))
    program = (sys.executable, "-S", str(script))
    asks = document("effect", "supply_drop", protocol=TIE, supply_drop=1.0)  # and is no tie
    cases = hand_in(made, tmp_path, {**GOOD, "0001": asks})
    answers = cases.answers
    follow_up(cases, labels, Examinee(program, 30.0), answers, ties_only=True)
    assert [path.name for path in (answers / files.FOLLOW_UPS[0]).iterdir()] == ["0003"]
    assert files.read_kept(answers / files.FOLLOW_UPS[0], "0003").line == ""
    record = read_record(script.with_suffix(".seen"))
    assert record.duration == pytest.approx(10.0, abs=0.1)
    volts, amps = record["front_1.voltage"].values, record["front_1.current"].values
    resistance = labels["0003"]["truth"]["wire.resistance"]
    assert volts.max() / amps.max() == pytest.approx(resistance, rel=0.03)
    assert record["back_1.voltage"].values.max() == 0.0
    found, after = score(cases, labels, answers)
    resolved = found.measured["of the ambiguous, settled rightly"]
    assert (resolved.hits, resolved.n) == (1, 1)
    nobody = Examinee(("/no/such",), 30.0)
    follow_up(cases, labels, nobody, answers, ties_only=True)  # nothing is left
    assert after.name == "diagnosis, followed up"
    assert [case.answer.verdict for case in after.cases] == ["effect", "no_gap", "unexplained"]


def test_one_command_prints_every_measure_and_writes_json_and_pages(made, tmp_path, capsys):
    cases = hand_in(made, tmp_path / "a", GOOD)
    markdown, result = tmp_path / "docs" / "r.md", tmp_path / "r.json"

    def arguments(cases):
        words = ["score", str(cases.root), "--no-follow-up", "--json", str(result)]
        return [*words, "--markdown", str(markdown)]

    assert main(arguments(cases)) == 0
    text = markdown.read_text()
    assert capsys.readouterr().out == text + "\n"
    for part in ("false alarms on no effect", "Truth against first choice", "by severity",
                 "by signals", "All cases by kind", "./bench blind run cases\n",
                 "./bench blind make --seed 5 --n 3 --out cases"):
        assert part in text
    error = json.loads(result.read_text())["scores"]["diagnosis"]["measures"][
        "claimed against true shrinkage, median"]
    assert error["n"] == 2 and 0.1 < error["value"] < 0.9  # of one all was found, of one nothing
    always = {name: document("effect", "slack", slack=0.9, no_gap=0.1) for name in CASES}
    always = hand_in(made, tmp_path / "b", always)
    assert main(arguments(always)) == 2 and markdown.read_text() == text
    assert main([*arguments(always), "--force"]) == 0 and markdown.read_text() != text
    score = json.loads(result.read_text())["scores"]["diagnosis"]
    row = score["measures"]["false alarms on no effect"]
    assert (row["value"], row["n"], row["met"], row["floor"]) == (1.0, 1, "missed", 0.015)
    assert row["low"] == pytest.approx(0.025) and row["high"] == 1.0
    assert score["confusion"]["supply_drop"]["slack"] == 1
