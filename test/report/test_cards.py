"""Cards of results: made from facts by templates, the same wherever they are shown."""

import copy
import json
import re
import shutil

import pytest

from sma_bench import cards
from sma_bench.cards import card, card_html, card_text, number_rows, two_errors
from sma_bench.diagnose.result import diagnosis_from
from sma_bench.errors import InputError
from sma_bench.estimation.estimate import Estimate
from sma_bench.identify.result import identification_from
from sma_bench.results import Invocation, json_text, percent, with_error

NUMBER = "effect.supply_drop.resistance"
PLACE = {"signal": "wire.current", "phase": "drive", "side": "front", "stage": "electrical"}
FOUND = {**PLACE, "gap": 12.0, "share": 0.8, "rms": 0.05}


def shrunk(fraction, ci90, *rms):
    names = ("rmse_before", "rmse_recalibrated", "rmse_after", "noise_floor")
    return {"fraction": fraction, "ci90": ci90, **dict(zip(names, rms, strict=True))}


def explanation(name, stage, probability, **more):
    return {"name": name, "stage": stage, "probability": probability, "parameters": {}, **more}


SIZE = {NUMBER: {"value": 0.3012, "std": 0.0021, "unit": "ohm"}}
DIAGNOSED = {
    "verdict": "effect",
    "cause": ["supply_drop"],
    "candidates": [
        explanation("supply_drop", "electrical", 0.91, log_evidence=90.0, parameters=SIZE),
        explanation("unexplained", "", 0.07),
        explanation("slack", "mechanical", 0.004, log_evidence=2.0),
        explanation("recalibration", "", 0.004, gap_over_noise=1.0),
    ],
    "where": {**PLACE, "stages": {"electrical": 1.0}, "table": [FOUND]},
    "shrinkage": {
        "temperature": shrunk(0.0, [0.0, 0.0], 0.2, 0.2, 0.2, 0.2),
        "current": shrunk(0.98, [0.95, 0.99], 0.05, 0.02, 0.005, 0.004),
    },
    "difference": {"between": ["supply_drop", "slack"], "place": FOUND},
    "left": {"by": "the best model", "gain": 0.4},
    "unexplained_sign": "a single event stands out",
    "not_compared": ["deflection"],
    "next_experiment": None,
    "findings": ["warning: wire.mass: odd"],
}
WIRE, ROOM = "wire.resistance", "environment.ambient_temperature"
LINE = {"value": 2.8, "std": 0.025, "unit": "ohm", "n": 25}
OHM = {**LINE, "statistical": 0.007, "systematic": 0.024, "informed": 0.98, "method": "line"}
OHM |= {"stated": {"value": 2.7, "std": 0.01}, "warnings": ["E2: odd"]}
KELVIN = {"value": 296.4, "std": 0.5, "unit": "K", "n": 25, "method": "<b>"}
E1 = {"name": "E1", "title": "Resistance", "source": "monday", "details": {}}
IDENTIFIED = {
    "parameters": {WIRE: OHM, ROOM: KELVIN},
    "fit": {"current": {"verdict": "ok", "rms": 0.1, "noise": 0.1, "unit": "A"}},
    "correlation": {"names": [WIRE, ROOM], "matrix": [[1.0, -0.7], [-0.7, 1.0]]},
    "experiments": [{**E1, "estimates": {WIRE: LINE}}],
    "warnings": ["E2: not settled"],
}


def diagnosed(**changes):
    return diagnosis_from(copy.deepcopy(DIAGNOSED) | changes, "gap.json")


def identified(**changes):
    return identification_from(copy.deepcopy(IDENTIFIED) | changes, "found.json")


def rows(result, asked=None):
    found, last = {}, ""
    for label, text in card(result, asked).rows:
        last = label or last
        found.setdefault(last, []).append(text)
    return found


def test_a_card_carries_the_facts_of_a_diagnosis():
    found = rows(diagnosed())
    assert list(found) == ["cause", "where", "error", "rivals", "left", "missing", "next"]
    assert "0.3012 ± 0.0021 ohm" in found["cause"][0] and "80 %" in found["where"][0]
    worst, quiet = found["error"]
    assert worst.startswith("current") and "98 % [95, 99]" in worst and "temperature" in quiet
    moved = {"name": "wire.mass", "change": 1e-6, "unit": "kg", "deviations": 4.0}
    assert "wire.mass" in rows(diagnosed(moved=[moved]))["moved"][0]
    proposed = {"kind": "E6", "why": "isobaric tests", "separates": ["slack", "supply_drop"]}
    proposed |= {"chance": 0.8, "minutes": 2.5}
    (said,) = rows(diagnosed(next_experiment=proposed))["next"]
    for fact in ("E6", "isobaric tests", "slack", "80 %", "2.5 min"):
        assert fact in said


@pytest.mark.parametrize(
    "verdict", ["effect", "ambiguous", "no_gap", "recalibration", "unexplained"]
)
def test_every_verdict_has_a_title_of_its_own_and_a_next_step_that_knows_what_was_given(verdict):
    cause = ["supply_drop"] if verdict == "effect" else []
    result = diagnosed(verdict=verdict, cause=cause)
    assert (card(result).title == card(diagnosed()).title) == bool(cause)
    found = rows(result)
    assert ("cause" in found) == bool(cause) and ("where" in found) == (verdict != "no_gap")
    plain, given = Invocation(("a bag",)), Invocation(("a bag",), "", "better.yaml", "page")
    (before,), (after,), (nothing,) = (rows(result, i)["next"] for i in (plain, given, None))
    if verdict in ("effect", "recalibration", "unexplained"):
        option = "--report" if verdict == "unexplained" else "--out"
        assert option in before and option not in after.replace("--out simulated", "")
        assert option not in nothing.replace("--out simulated", "")
        assert ("page" if verdict == "unexplained" else "better.yaml") in after


def test_numbers_stand_with_their_errors_apart_and_what_was_stated():
    resistance, ambient = number_rows(identified())
    off = ("2.7 ± 0.01", "+3.7 % (+3.7 std)")
    assert resistance == (WIRE, "2.8 ± 0.007 ± 0.024 ohm", "98 %", *off, "E1, warned")
    assert ambient == (ROOM, "296.4 ± 0.5 K", "", "", "", "")
    found = rows(identified())
    assert WIRE in found["off"][0] and "-0.70" in found["linked"][0]
    assert two_errors(Estimate(2.0, 0.0)) == "2"
    # What is rounded to nothing has no sign.
    near = KELVIN | {"value": 296.15 - 1e-4, "stated": {"value": 296.15, "std": 0.5}}
    (row,) = number_rows(identified(parameters={ROOM: near}))
    assert "(0.0 std)" in row[4]
    assert (percent(0.001), percent(0.5), percent(0.9999)) == ("below 1 %", "50 %", "above 99 %")
    for value, std, text in (
        (3.11755, 0.0004, "3.11755 ± 0.0004"),
        (0.25, 0.65, "0.25 ± 0.65"),
        (57.61e9, 1.6e9, "5.76e+10 ± 1.6e+09"),
        (1.5, 0.0, "1.5"),
        (2.0, float("nan"), "2"),
    ):
        assert with_error(value, std) == text


def test_a_result_that_is_read_back_shows_what_the_fresh_one_did():
    for result, read in ((diagnosed(), diagnosis_from), (identified(), identification_from)):
        again = read(json.loads(json_text(result.to_json())), "again.json")
        assert str(again) == str(result)
        assert json_text(again.to_json()) == json_text(result.to_json())
        assert again.to_json()["card"][0] == ["", card(result).title]


def reworded(folder, target):
    """The templates with every word of their own replaced by another."""
    shutil.copytree(folder, target)
    for path in target.glob("*.j2"):
        tokens = cards._templates(folder).lex(path.read_text())
        words = (re.sub(r"[^\W\d_]", "ж", t) if kind == "data" else t for _, kind, t in tokens)
        path.write_text("".join(words))
    return target


def test_no_program_reads_a_sentence(tmp_path, monkeypatch):
    before = [r.to_json() for r in (diagnosed(), identified())]
    monkeypatch.setattr(cards, "TEMPLATES", reworded(cards.TEMPLATES, tmp_path / "other"))
    after = [r.to_json() for r in (diagnosed(), identified())]
    for one, other in zip(before, after, strict=True):
        assert one["card"] != other["card"]
        told = {"card", "gap", "why"}  # what is shown and no more
        assert {k: v for k, v in one.items() if k not in told} == {
            k: v for k, v in other.items() if k not in told
        }
    states = [(s["is_gap"], s["values"]) for s in after[0]["gap"]]
    assert states == [(s["is_gap"], s["values"]) for s in before[0]["gap"]]
    assert diagnosis_from(after[0], "r").verdict == "effect"
    for result in (diagnosed(), identified()):
        assert "ж" in card_text(result) and "ж" in card_html(result)


def test_text_and_page_hold_the_same_and_no_markup_of_a_name():
    hostile = diagnosed(cause=["<b>x\x1b[2J\n| y"])
    text, page = card_text(hostile), card_html(hostile)
    assert "\x1b" not in text and "<b>" not in page and "&lt;b&gt;" in page
    assert len(rows(hostile)) == len(rows(diagnosed()))
    assert "<b>" not in card_html(identified())
    lines = card_text(diagnosed()).splitlines()
    narrow = card_text(diagnosed(), 60).splitlines()
    assert max(map(len, lines)) <= 96 and max(map(len, narrow)) <= 60
    assert " ".join(narrow).split() == " ".join(lines).split()


@pytest.mark.parametrize(
    ("read", "document", "named"),
    [
        (identification_from, {"correlation": {"names": ["a"], "matrix": [[1, 0]]}}, "correlation"),
        (identification_from, {"parameters": {"a": {"value": "2", "std": 1}}}, "value"),
        (diagnosis_from, {"verdict": "guilty"}, "verdict"),
        (diagnosis_from, {"where": 3}, "where"),
        (diagnosis_from, {"cause": [1e200]}, "1e+200"),
        (diagnosis_from, [], "damaged"),
    ],
)
def test_a_damaged_result_is_one_line_that_names_the_field(read, document, named):
    whole = IDENTIFIED if read is identification_from else DIAGNOSED
    with pytest.raises(InputError) as refused:
        read(whole | document if document else document, "r.json")
    line = str(refused.value)
    assert line.startswith("r.json: ") and named in line and "\n" not in line
