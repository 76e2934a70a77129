"""`./bench check golden` fails on a number that moved, and says which and how far."""

import json

from examination.check import golden

ONE_RESULT = ("simulate", "--only", "plain, wire", "--processes", "1")


def test_a_changed_number_fails_and_a_failed_command_too(tmp_path, capsys, monkeypatch):
    def again(*more):
        status = golden.main([*ONE_RESULT, *more])
        return status, capsys.readouterr().out

    monkeypatch.setattr(golden, "KEPT", tmp_path)
    assert again("--write")[0] == 0
    status, out = again()
    assert status == 0 and "0 moved, gone or new, 0 outside" in out
    file = tmp_path / "simulate.json"
    document = json.loads(file.read_text())
    numbers = document["results"]["plain, wire"]["numbers"]
    value, tolerance, reason = numbers["wire.temperature, largest"]
    numbers["wire.temperature, largest"] = [value + 3.0 * tolerance, tolerance, reason]
    file.write_text(json.dumps(document))
    status, out = again()
    assert status == 1 and "1 outside" in out and "-3.00 tolerances (span)" in out
    assert "OUTSIDE  plain, wire: wire.temperature, largest" in out
    failed = {"numbers": {}, "seconds": 0.0, "problem": "FAILED: no"}
    monkeypatch.setattr(golden, "made", lambda *_: failed)
    status, out = again()
    assert status == 1 and "FAILED: no: plain, wire" in out
    file.unlink()
    assert again()[0] == 0  # what never worked is no failure


def test_kept_numbers_are_compared_with_what_makes_them():
    files = sorted(golden.KEPT.glob("*.json"))
    assert {"identify", "paper", "simulate"} <= {file.stem for file in files} <= {*golden.SECTIONS}
    for file in files:
        kept = golden.read(file.stem)
        assert set(kept) <= set(golden.TASKS[file.stem])
        reasons = {n.reason for result in kept.values() for n in result["numbers"].values()}
        assert reasons <= {*golden.REASONS, "exact"}
