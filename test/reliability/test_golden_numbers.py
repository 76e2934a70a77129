"""`./bench check golden` fails on a number that moved, and says which and how far."""

import json
from pathlib import Path

import pytest

from examination.check import golden

ONE_RESULT = ("simulate", "--only", "plain, wire", "--jobs", "1")


@pytest.fixture
def kept(tmp_path: Path) -> Path:
    """A folder with one result, as this machine makes it."""
    assert golden.main([*ONE_RESULT, "--kept", str(tmp_path), "--write"]) == 0
    return tmp_path


def results(**numbers: tuple) -> dict:
    return {"a wire": golden.Result({k: golden.Number(*v) for k, v in numbers.items()})}


def test_the_same_numbers_pass_and_one_that_moved_fails(
    kept: Path, capsys: pytest.CaptureFixture
) -> None:
    again = [*ONE_RESULT, "--kept", str(kept)]
    assert golden.main(again) == 0
    assert "0 moved, 0 outside" in capsys.readouterr().out
    file = kept / "simulate.json"
    document = json.loads(file.read_text())
    numbers = document["results"]["plain, wire"]["numbers"]
    value, tolerance, reason = numbers["wire.temperature, largest"]
    numbers["wire.temperature, largest"] = [value + 3.0 * tolerance, tolerance, reason]
    file.write_text(json.dumps(document))
    assert golden.main(again) == 1
    out = capsys.readouterr().out
    assert "1 moved, 1 outside" in out
    assert "OUTSIDE  plain, wire: wire.temperature, largest" in out
    assert "-3.00 tolerances (span)" in out


@pytest.mark.parametrize(
    ("number", "now", "outside"),
    [
        ((2.0, 0.1, "span"), (2.09, 0.1, "span"), False),
        ((2.0, 0.1, "span"), (2.11, 0.1, "span"), True),
        ((2.0, 0.1, "span"), (1.89, 9.0, "span"), True),  # the kept tolerance counts
        ((2.0, 0.1, "span"), (None, 0.0, "exact"), True),
        ((2.0, 0.1, "span"), (float("nan"), 0.1, "span"), True),
        ((8.0, 0.1, "time", "+"), (5.0, 0.1, "time", "+"), False),
        ((8.0, 0.1, "time", "+"), (8.2, 0.1, "time", "+"), True),
        ((0.9, 0.01, "case", "-"), (0.95, 0.01, "case", "-"), False),
        ((0.9, 0.01, "case", "-"), (0.88, 0.01, "case", "-"), True),
        (("effect", 0.0, "exact"), ("effect", 0.0, "exact"), False),
        (("effect", 0.0, "exact"), ("no_gap", 0.0, "exact"), True),
        ((7, 0.0, "exact"), (8, 0.0, "exact"), True),
    ],
)
def test_each_number_has_its_own_tolerance(
    number: tuple, now: tuple, outside: bool
) -> None:
    moves = golden.compare(results(x=number), results(x=now))
    assert any(move.outside for move in moves) is outside


def test_a_number_that_is_gone_fails_and_a_new_one_does_not() -> None:
    one, two = results(x=(2.0, 0.1, "span")), results(y=(2.0, 0.1, "span"))
    moves = golden.compare(one, two)
    assert [(move.name, move.outside) for move in moves] == [("x", True), ("y", False)]


def test_a_result_that_ends_badly_fails_where_it_was_kept(
    kept: Path, capsys: pytest.CaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(golden.Task, "make", lambda task: golden.Result({}, failed="no wire"))
    assert golden.main([*ONE_RESULT, "--kept", str(kept)]) == 1
    assert "FAILED   plain, wire: no wire" in capsys.readouterr().out
    (kept / "simulate.json").unlink()
    assert golden.main([*ONE_RESULT, "--kept", str(kept)]) == 0
    assert "skipped  plain, wire: no wire" in capsys.readouterr().out


def test_kept_numbers_are_compared_with_what_makes_them() -> None:
    files = sorted(golden.KEPT.glob("*.json"))
    assert {"identify", "paper", "simulate"} <= {file.stem for file in files} <= {*golden.SECTIONS}
    for file in files:
        kept = golden.read(file)
        assert set(kept) <= {task.name for task in golden.tasks(file.stem)}
        reasons = {number.reason for result in kept.values() for number in result.numbers.values()}
        assert reasons <= {*golden.REASONS, "exact"}
