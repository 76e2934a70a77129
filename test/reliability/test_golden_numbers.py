"""`./bench check golden` fails on a number that moved, and says which and how far."""

import json

import pytest

from examination.check import golden

ONE_RESULT = ("simulate", "--only", "plain, wire", "--jobs", "1")


def results(**numbers):
    return {"a wire": golden.Result({k: golden.Number(*v) for k, v in numbers.items()})}


def test_one_that_moved_or_ends_badly_fails_where_it_was_kept(tmp_path, capsys, monkeypatch):
    again = [*ONE_RESULT, "--kept", str(tmp_path)]
    assert golden.main([*again, "--write"]) == 0
    assert golden.main(again) == 0
    assert "0 moved, 0 outside" in capsys.readouterr().out
    file = tmp_path / "simulate.json"
    document = json.loads(file.read_text())
    numbers = document["results"]["plain, wire"]["numbers"]
    value, tolerance, reason = numbers["wire.temperature, largest"]
    numbers["wire.temperature, largest"] = [value + 3.0 * tolerance, tolerance, reason]
    file.write_text(json.dumps(document))
    assert golden.main(again) == 1
    out = capsys.readouterr().out
    assert "1 moved, 1 outside" in out and "-3.00 tolerances (span)" in out
    assert "OUTSIDE  plain, wire: wire.temperature, largest" in out

    monkeypatch.setattr(golden.Task, "make", lambda task: golden.Result({}, failed="no wire"))
    assert golden.main(again) == 1
    assert "FAILED   plain, wire: no wire" in capsys.readouterr().out
    file.unlink()
    assert golden.main(again) == 0
    assert "skipped  plain, wire: no wire" in capsys.readouterr().out


@pytest.mark.parametrize(("number", "now", "outside"), [
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
])  # fmt: skip
def test_each_number_has_its_own_tolerance(number, now, outside):
    moves = golden.compare(results(x=number), results(x=now))
    assert any(move.outside for move in moves) is outside
    # One that is gone fails, and a new one does not.
    moves = golden.compare(results(x=number), results(y=number))
    assert [(move.name, move.outside) for move in moves] == [("x", True), ("y", False)]


def test_kept_numbers_are_compared_with_what_makes_them():
    files = sorted(golden.KEPT.glob("*.json"))
    assert {"identify", "paper", "simulate"} <= {file.stem for file in files} <= {*golden.SECTIONS}
    for file in files:
        kept = golden.read(file)
        assert set(kept) <= {task.name for task in golden.tasks(file.stem)}
        reasons = {number.reason for result in kept.values() for number in result.numbers.values()}
        assert reasons <= {*golden.REASONS, "exact"}
