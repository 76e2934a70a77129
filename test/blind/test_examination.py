"""A program under examination: what it sees, what becomes of whatever it does, and its answers."""

import copy
import json
import sys
from pathlib import Path

import pytest
import yaml

from examination.blind.case_files import checked_answer, read_kept
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
names = dict(no_gap=1.0, recalibration=0.0, unexplained=0.0)
result["candidates"] = [dict(name=name, probability=p) for name, p in names.items()]
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
if order in ("improve", "spoil"):
    good = Path("nominal.yaml").read_text()
    Path("improved.yaml").write_text(good if order == "improve" else "no parameters")
if order != "silent":
    Path("result.json").write_text(json.dumps(result) if order != "babble" else "so {")
"""
FAILURES = {"crash": "exit code 3: ValueError: it hurts", "silent": "no result was written",
            "babble": "result is not JSON", "wrong": "result: verdict 'perhaps'",
            "effect": "verdict effect without improved parameters",
            "spoil": "improved.yaml: expected a ROS parameter file"}


def made(root, *orders):
    """Cases, one an order, in a set: their names."""
    names = tuple(f"{k:04d}" for k in range(1, len(orders) + 1))
    for name, order in zip(names, orders, strict=True):
        for record in ("record", "hold_out"):
            (root / "cases" / name / record).mkdir(parents=True)
            (root / "cases" / name / record / "bag.mcap").write_bytes(b"bag")
        text = f"# {order}\n/**:\n  ros__parameters:\n    wire:\n      resistance: 3.0\n"
        (root / "cases" / name / "nominal.yaml").write_text(text)
    return names


def put(root, names):
    """These cases to the program that follows the orders: the orders so far; where answers lie."""
    log, script, answers = root.parent / "log", root.parent / "fake.py", root / "answers"
    script.write_text(FAKE)
    program = sys.executable, "-S", str(script), str(log)
    examine(Examinee(program, 30.0), names, root / "cases", answers, 2)
    return log.read_text().split(), answers


def test_the_program_sees_the_records_and_nothing_that_tells_the_case(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    root = tmp_path / "secret_set"
    _, answers = put(root, made(root, "look"))
    seen = json.loads((answers / "0001" / "answer.json").read_text())["result"]["seen"]
    files = "hold_out hold_out/bag.mcap nominal.yaml record record/bag.mcap"
    assert seen["files"] == files.split()
    arguments = "record --params nominal.yaml --hold-out hold_out --json result.json"
    assert seen["arguments"] == [*arguments.split(), "--out", "improved.yaml"]
    assert "secret_set" not in seen["folder"]
    assert seen["environment"]["OMP_NUM_THREADS"] == "1"


def test_every_answer_and_failure_is_kept_once_and_asked_for_no_more(tmp_path):
    names = made(tmp_path / "set", *FAILURES, "improve", "look")
    done, answers = put(tmp_path / "set", names[:-1])
    assert sorted(done) == sorted([*FAILURES, "improve"])
    kept = [read_kept(answers, name) for name in names[:-1]]
    for found, line in zip(kept, FAILURES.values(), strict=False):
        assert found.answer is None and found.line.startswith(line)
    assert "resistance: 3.0" in kept[-1].improved.read_text() and kept[-1].line == ""
    assert open_cases(names, answers) == ["0008"]
    assert put(tmp_path / "set", open_cases(names, answers))[0][-1] == "look"
    assert open_cases(names, answers) == [] and read_kept(answers, "0008").improved is None


# --- Answers to the contract are read; every broken clause is one line.

ANSWERS = yaml.safe_load(Path(__file__).with_name("answers.yaml").read_text())
GOOD = ANSWERS["good"]


def test_a_good_answer_is_read_with_the_most_probable_candidate_first():
    answer = checked_answer(GOOD)
    assert [c.name for c in answer.candidates[:2]] == ["slack", "slack+latent_heat"]
    assert answer.candidates[0].parameters["p"]["value"] == 0.004
    assert answer.candidates[1].parts == {"slack", "latent_heat"}
    assert answer.shrinkage["deflection"].ci90 == (0.7, 0.9) and answer.where.side == "back"
    assert answer.shrinkage["current"].fraction is None  # there was nothing to shrink
    quiet = {"verdict": "no_gap", "cause": [], "where": None, "next_experiment": None}
    assert checked_answer(GOOD | quiet).where is None


@pytest.mark.parametrize(("path", "value"), ANSWERS["broken"])
def test_a_broken_clause_is_refused_in_one_line(path, value):
    document = copy.deepcopy(GOOD)
    *way, last = [int(key) if key.isdigit() else key for key in path.split()]
    place = document
    for key in way:
        place = place[key]
    place[last] = value
    missing = {key: held for key, held in GOOD.items() if key != path.split()[0]}
    for wrong in (document, missing):
        with pytest.raises(InputError) as raised:
            checked_answer(wrong)
        assert "\n" not in str(raised.value) and len(str(raised.value)) <= 300
