"""A program under examination: what it sees, and what becomes of whatever it does."""

import json
import sys
import time
from pathlib import Path

import pytest

from examination.blind.case_files import Examination, read_case_set, read_kept, write_examination
from examination.blind.examination import Examinee, examine, open_cases
from sma_bench.errors import InputError

RESULT = {
    "verdict": "no_gap", "cause": [], "where": None, "shrinkage": {}, "next_experiment": None,
    "candidates": [
        {"name": name, "stage": "", "probability": p}
        for name, p in (("no_gap", 1.0), ("recalibration", 0.0), ("unexplained", 0.0))
    ],
}  # fmt: skip

# Does what the first line of nominal.yaml says.
FAKE = f"""
import json, os, sys, time
from pathlib import Path
log, *arguments = sys.argv[1:]
order = Path("nominal.yaml").read_text().splitlines()[0].removeprefix("# ")
with open(log, "a") as stream:
    stream.write(order + "\\n")
result = {RESULT!r}
result["seen"] = dict(
    arguments=arguments, folder=os.getcwd(), environment=dict(os.environ),
    files=sorted(str(p) for p in Path(".").rglob("*")), links=[
        str(p) for p in Path(".").rglob("*") if p.is_symlink()],
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
    Path("result.json").write_text(json.dumps(result) if order != "babble" else "so {{")
"""


@pytest.fixture
def bench(tmp_path):
    """A set of cases, one an order, and the program that follows them."""
    return Bench(tmp_path)


class Bench:
    def __init__(self, folder: Path) -> None:
        self.root, self.log = folder / "secret_set", folder / "log"
        self.script = folder / "fake.py"
        self.script.write_text(FAKE)
        self.answers = self.root / "answers" / "fake"
        self.program = (sys.executable, "-S", str(self.script), str(self.log))

    def make(self, *orders: str) -> tuple[str, ...]:
        names = tuple(f"{k:04d}" for k in range(1, len(orders) + 1))
        for name, order in zip(names, orders, strict=True):
            case = self.root / "cases" / name
            for record in ("record", "hold_out"):
                (case / record).mkdir(parents=True)
                (case / record / "bag.mcap").write_bytes(b"bag")
            (case / "nominal.yaml").write_text(
                f"# {order}\n/**:\n  ros__parameters:\n    wire:\n      resistance: 3.0\n"
            )
        manifest = {"seed": 1, "split": "open", "cases": names, "sha256": "0" * 64}
        (self.root / "manifest.json").write_text(json.dumps(manifest))
        return names

    def run(self, names, jobs=2, time_limit=30.0):
        examine(Examinee(self.program, time_limit), names, self.root / "cases", self.answers, jobs)

    def asked(self) -> list[str]:
        return self.log.read_text().split() if self.log.exists() else []


def test_the_program_sees_the_records_and_nothing_that_tells_the_case(bench, monkeypatch):
    monkeypatch.chdir(bench.root.parent)
    bench.run(bench.make("look"))
    document = json.loads((bench.answers / "0001" / "answer.json").read_text())
    seen = document["result"]["seen"]
    assert seen["files"] == [
        "hold_out", "hold_out/bag.mcap", "nominal.yaml", "record", "record/bag.mcap",
    ]  # fmt: skip
    assert seen["links"] == []
    assert seen["arguments"] == [
        "record", "--params", "nominal.yaml", "--hold-out", "hold_out", "--json", "result.json",
        "--out", "improved.yaml",
    ]  # fmt: skip
    for text in (seen["folder"], *seen["environment"].values()):
        assert "secret_set" not in text and "0001" not in text
    assert seen["environment"]["OMP_NUM_THREADS"] == "1"


FAILURES = {
    "crash": "exit code 3: ValueError: it hurts",
    "silent": "no result was written",
    "babble": "result is not JSON: Expecting value: line 1 column 1 (char 0)",
    "wrong": "result: verdict 'perhaps'",
    "effect": "verdict effect without improved parameters",
    "spoil": "improved.yaml: expected a ROS parameter file ('/**: ros__parameters:')",
}


def test_every_failure_is_kept_with_its_line(bench):
    names = bench.make(*FAILURES)
    bench.run(names)
    kept = [read_kept(bench.answers, name) for name in names]
    assert [k.answer for k in kept] == [None] * len(FAILURES)
    assert [k.line for k in kept] == list(FAILURES.values())


def test_a_program_that_does_not_exist_fails_no_case(bench):
    (name,) = bench.make("look")
    bench.program = ("/no/such/program",)
    with pytest.raises(InputError, match="/no/such/program: cannot be started: No such file"):
        bench.run([name])
    assert open_cases([name], bench.answers) == [name]


def test_a_case_out_of_time_is_ended_and_failed(bench):
    (name,) = bench.make("sleep")
    bench.run([name], time_limit=0.3)
    kept = read_kept(bench.answers, name)
    assert kept.line == "no answer within 0.3 s"
    assert 0.3 <= kept.seconds < 30.0


def test_improved_parameters_are_kept_beside_the_answer(bench):
    bench.run(bench.make("improve", "look"))
    assert "resistance: 3.0" in read_kept(bench.answers, "0001").improved.read_text()
    assert read_kept(bench.answers, "0002").improved is None


def test_what_is_answered_is_not_asked_again(bench):
    names = bench.make("look", "crash", "look")
    bench.run(names[:2])
    assert open_cases(names, bench.answers) == ["0003"]
    assert open_cases(names, bench.answers, again=True) == ["0002", "0003"]
    bench.run(open_cases(names, bench.answers))
    assert sorted(bench.asked()) == ["crash", "look", "look"]
    assert open_cases(names, bench.answers) == []


def test_an_interrupted_examination_keeps_what_was_answered_and_ends_what_runs(bench):
    names = bench.make("look", "sleep", "look")

    def interrupt(done: int, line: str) -> None:
        raise KeyboardInterrupt

    begin = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        examine(
            Examinee(bench.program, 50.0), names, bench.root / "cases", bench.answers, 2, interrupt
        )
    assert time.monotonic() - begin < 40.0
    assert open_cases(names, bench.answers) == ["0002", "0003"]


def test_answers_to_another_set_or_of_another_program_are_not_mixed(tmp_path):
    one = Examination("fake", ("fake",), 30.0, "a" * 64)
    write_examination(tmp_path, one)
    write_examination(tmp_path, one)
    for other, expected in (
        (Examination("fake", ("fake",), 30.0, "b" * 64), "another set"),
        (Examination("fake", ("other", "-x"), 30.0, "a" * 64), "answers of fake"),
    ):
        with pytest.raises(InputError, match=expected):
            write_examination(tmp_path, other)


@pytest.mark.parametrize(
    "manifest",
    ["", "[]", "{}", '{"seed": 1, "split": "open", "cases": ["../x"], "sha256": ""}',
     '{"seed": 1, "split": "open", "cases": [], "sha256": ""}'],
)  # fmt: skip
def test_a_damaged_manifest_is_one_line(tmp_path, manifest):
    (tmp_path / "manifest.json").write_text(manifest)
    with pytest.raises(InputError) as raised:
        read_case_set(tmp_path)
    assert "manifest.json" in str(raised.value) and "\n" not in str(raised.value)
