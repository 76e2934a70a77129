"""A program under examination: what it sees, and what becomes of whatever it does."""

import json
import sys
import time

import pytest

from examination.blind import examination
from examination.blind.case_files import Examination, read_case_set, read_kept, write_examination
from examination.blind.examination import Examinee, examine, open_cases
from sma_bench.errors import InputError

# Does what the first line of nominal.yaml says.
FAKE = """
import json, os, sys, time
from pathlib import Path
log, *arguments = sys.argv[1:]
order = Path("nominal.yaml").read_text().splitlines()[0].removeprefix("# ")
with open(log, "a") as stream:
    stream.write(order + "\\n")
result = dict(verdict="no_gap", cause=[], where=None, shrinkage={}, next_experiment=None)
result["candidates"] = [
    dict(name="no_gap", probability=1.0), dict(name="recalibration", probability=0.0),
    dict(name="unexplained", probability=0.0),
]
result["seen"] = dict(
    arguments=arguments, folder=os.getcwd(), environment=dict(os.environ),
    files=sorted(str(p) for p in Path(".").rglob("*") if not p.is_symlink()),
)
if order == "crash":
    sys.stderr.write("Traceback ...\\n  much\\nValueError: it hurts\\n\\n")
    sys.exit(3)
if order == "sleep":
    time.sleep(60)
if order == "wrong":
    result["verdict"] = "perhaps"
if order == "effect":
    result |= dict(verdict="effect", cause=["slack"])
    result["candidates"] += [dict(name="slack", stage="mechanical", probability=0.0)]
    result["where"] = dict(signal="deflection", phase="rest", side="", stage="mechanical")
if order == "improve":
    Path("improved.yaml").write_text(Path("nominal.yaml").read_text())
if order == "spoil":
    Path("improved.yaml").write_text("no parameters")
if order != "silent":
    Path("result.json").write_text(json.dumps(result) if order != "babble" else "so {")
"""
FAILURES = {
    "crash": "exit code 3: ValueError: it hurts",
    "silent": "no result was written",
    "babble": "result is not JSON",
    "wrong": "result: verdict 'perhaps'",
    "effect": "verdict effect without improved parameters",
    "spoil": "improved.yaml: expected a ROS parameter file",
}


@pytest.fixture
def make(tmp_path):
    """Cases, one an order, in a set; what puts some to the program that follows the orders."""
    root, log, script = tmp_path / "secret_set", tmp_path / "log", tmp_path / "fake.py"
    script.write_text(FAKE)

    def made(*orders):
        names = tuple(f"{k:04d}" for k in range(1, len(orders) + 1))
        for name, order in zip(names, orders, strict=True):
            for record in ("record", "hold_out"):
                (root / "cases" / name / record).mkdir(parents=True)
                (root / "cases" / name / record / "bag.mcap").write_bytes(b"bag")
            (root / "cases" / name / "nominal.yaml").write_text(
                f"# {order}\n/**:\n  ros__parameters:\n    wire:\n      resistance: 3.0\n"
            )
        return names, root / "answers"

    def run(names, limit=30.0, program=(sys.executable, "-S", str(script), str(log))):
        examine(Examinee(program, limit), names, root / "cases", root / "answers", 2)
        return log.read_text().split()

    made.run = run
    return made


def test_the_program_sees_the_records_and_nothing_that_tells_the_case(make, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names, answers = make("look")
    make.run(names)
    seen = json.loads((answers / "0001" / "answer.json").read_text())["result"]["seen"]
    files = "hold_out hold_out/bag.mcap nominal.yaml record record/bag.mcap"
    assert seen["files"] == files.split()
    arguments = "record --params nominal.yaml --hold-out hold_out --json result.json"
    assert seen["arguments"] == [*arguments.split(), "--out", "improved.yaml"]
    for text in (seen["folder"], *seen["environment"].values()):
        assert "secret_set" not in text and "0001" not in text
    assert seen["environment"]["OMP_NUM_THREADS"] == "1"


def test_every_answer_and_failure_is_kept_once_and_asked_for_no_more(make):
    names, answers = make(*FAILURES, "improve", "look")
    assert sorted(make.run(names[:-1])) == sorted([*FAILURES, "improve"])
    kept = [read_kept(answers, name) for name in names[:-1]]
    for found, line in zip(kept, FAILURES.values(), strict=False):
        assert found.answer is None and found.line.startswith(line)
    assert "resistance: 3.0" in kept[-1].improved.read_text() and kept[-1].line == ""
    assert open_cases(names, answers) == ["0008"]
    assert make.run(open_cases(names, answers))[-1] == "look"
    assert open_cases(names, answers) == [] and read_kept(answers, "0008").improved is None


def test_a_program_that_does_not_exist_fails_no_case_and_one_out_of_time_does(make):
    names, answers = make("sleep")
    with pytest.raises(OSError, match="/no/such/program"):
        make.run(names, program=("/no/such/program",))
    assert open_cases(names, answers) == ["0001"]
    make.run(names, limit=0.3)
    kept = read_kept(answers, "0001")
    assert kept.line == "no answer within 0.3 s" and 0.3 <= kept.seconds < 30.0


def test_an_interrupted_examination_keeps_what_was_answered_and_ends_what_runs(make, monkeypatch):
    names, answers = make("look", "sleep", "look")
    keep = examination.keep

    def interrupt(*given):
        keep(*given)
        raise KeyboardInterrupt

    monkeypatch.setattr(examination, "keep", interrupt)
    begin = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        make.run(names, limit=50.0)
    assert time.monotonic() - begin < 40.0
    assert open_cases(names, answers) == ["0002", "0003"]


def test_answers_are_not_mixed_and_a_damaged_manifest_is_one_line(tmp_path):
    for program, sealed, line in (
        ("fake", "a", ""), ("fake", "a", ""), ("fake", "b", "another set"),
        ("other -x", "a", "answers of fake"),
    ):  # fmt: skip
        given = Examination("fake", tuple(program.split()), 30.0, 64 * sealed)
        if not line:
            write_examination(tmp_path, given)
            continue
        with pytest.raises(InputError, match=line):
            write_examination(tmp_path, given)
    whole = {"seed": 1, "split": "open", "cases": ["1"], "sha256": ""}
    escaping, empty = (json.dumps(whole | {"cases": cases}) for cases in (["../x"], []))
    for manifest in ("", "[]", "{}", escaping, empty):
        (tmp_path / "manifest.json").write_text(manifest)
        with pytest.raises(InputError, match="manifest.json") as raised:
            read_case_set(tmp_path)
        assert "\n" not in str(raised.value)
