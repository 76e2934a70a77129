"""The card of a diagnosis: made from the result file, the same wherever it is shown."""

import copy
from pathlib import Path

import pytest

from sma_bench.cards import (
    card_html,
    card_text,
    identification_html,
    identification_text,
    verdict_card,
)
from sma_bench.commands.identify import print_result
from sma_bench.errors import InputError
from sma_bench.results import Invocation, diagnosis_from, identification_from

NUMBER = "effect.supply_drop.resistance"
RESULT = {
    "verdict": "effect",
    "cause": ["supply_drop"],
    "candidates": [
        {"name": "supply_drop", "stage": "electrical", "probability": 0.91,
         "parameters": {NUMBER: {"value": 0.3012, "std": 0.0021, "unit": "ohm"}}},
        {"name": "unexplained", "stage": "", "probability": 0.07, "parameters": {}},
        {"name": "slack", "stage": "mechanical", "probability": 0.004, "parameters": {}},
    ],
    "where": {
        "signal": "wire.current", "phase": "drive", "side": "front", "stage": "electrical",
        "table": [{"signal": "wire.current", "phase": "drive", "side": "front", "gap": 12.0,
                   "share": 0.8, "rms": 0.05}],
    },
    "shrinkage": {
        "temperature": {"rmse_before": 0.2, "rmse_recalibrated": 0.2, "rmse_after": 0.2,
                        "fraction": 0.0, "ci90": [0.0, 0.0], "noise_floor": 0.2},
        "current": {"rmse_before": 0.05, "rmse_recalibrated": 0.02, "rmse_after": 0.005,
                    "fraction": 0.98, "ci90": [0.95, 0.99], "noise_floor": 0.004},
    },
    "why": ["Its log evidence is +90.0 nats over moving the parameters alone.",
            "supply_drop and slack, each at its best, differ most in x: by 3 times the noise.",
            "It needs no parameter farther than two of its standard deviations from where it is "
            "believed.",
            "That something else is at work keeps 7 %: a single event stands out."],
    "next_experiment": None,
}  # fmt: skip


def shown(**changes):
    return diagnosis_from(Path("result"), copy.deepcopy(RESULT) | changes)


def rows(result):
    found, last = {}, ""
    for label, text in verdict_card(result).rows:
        last = label or last
        found.setdefault(last, []).append(text)
    return found


def test_an_effect_stands_with_its_size_its_place_and_what_it_takes_away():
    card = verdict_card(shown())
    assert card.title == "supply_drop explains the gap (probability 91 %)"
    found = rows(shown())
    assert found["cause"] == [
        "supply_drop: leads and contacts between the voltage that is measured and the wire "
        "(electrical stage). resistance 0.3012 ± 0.0021 ohm"
    ]
    assert found["where"] == [
        "wire.current while driven, front side: 80 % of it (50 mA rms, 12 times the noise of a "
        "reading)"
    ]
    assert found["error"] == [  # the worst first
        "current 50 mA as believed -> 20 mA recalibrated -> 5 mA with the effect, noise 4 mA: "
        "98 % [95, 99] of the gap gone",
        "temperature within its noise as believed (0.2 K)",
    ]
    assert found["rivals"] == [f"unexplained (7 %). {RESULT['why'][1]}"]
    assert found["left"] == [RESULT["why"][3]]
    assert "moved" not in found


@pytest.mark.parametrize(
    ("verdict", "title"),
    [("ambiguous", "not settled by these records: supply_drop (91 %), unexplained (7 %)"),
     ("no_gap", "no gap beyond the noise (probability 91 %)"),
     ("recalibration", "no effect is missing, the parameters are off (probability 91 %)"),
     ("unexplained", "a gap that no known effect explains (probability 91 %)")],
)  # fmt: skip
def test_every_verdict_has_its_title_and_a_next_step(verdict, title):
    result = shown(verdict=verdict, cause=[])
    assert verdict_card(result).title == title
    found = rows(result)
    assert len(found["next"]) == 1 and "cause" not in found
    assert ("where" in found) == (verdict != "no_gap")
    assert ("moved" in found) == (verdict == "recalibration")


def test_a_proposed_experiment_is_the_next_step():
    proposed = {"why": "w", "separates": ["slack", "residual_strain"], "chance": 0.8,
                "minutes": 2.5, "protocol": {"name": "long_rests"}}  # fmt: skip
    assert rows(shown(next_experiment=proposed))["next"] == [
        "record long_rests (2.5 min) to separate slack, residual_strain; it settles the matter "
        "with a probability of 80 %"
    ]
    test = proposed | {"kind": "E6", "why": "isobaric tests", "protocol": {}}
    (said,) = rows(shown(next_experiment=test))["next"]
    assert said.startswith("E6 (2.5 min) to separate") and said.endswith("80 %; isobaric tests")


def test_a_result_of_an_older_version_has_its_card_too():
    old = copy.deepcopy(RESULT)
    del old["why"]
    for quantity in old["shrinkage"].values():
        del quantity["rmse_recalibrated"]
    found = rows(diagnosis_from(Path("result"), old))
    assert "50 mA as believed -> 5 mA with the effect" in found["error"][0]
    assert found["rivals"] == ["unexplained (7 %)"] and "left" not in found


def test_text_and_page_hold_the_same_and_no_markup_of_a_name():
    hostile = shown(cause=["<b>x\x1b[2J"])
    text, page = card_text(hostile), card_html(hostile)
    assert "\x1b" not in text and "<b>" not in page and "&lt;b&gt;" in page
    lines = card_text(shown()).splitlines()
    assert max(map(len, lines)) <= 96
    narrow = card_text(shown(), 60).splitlines()
    assert max(map(len, narrow)) <= 60 and " ".join(narrow).split() == " ".join(lines).split()
    assert " ".join(" ".join(lines).split()).startswith("supply_drop explains the gap")


def test_a_sensor_that_is_missing_stands_on_the_card():
    found = rows(shown(findings=[
        "info: deflection: not compared: nothing mechanical could be seen", "info: mass: odd",
    ]))  # fmt: skip
    assert found["missing"] == ["deflection was not compared: nothing mechanical could be seen"]


IDENTIFIED = {
    "parameters": {
        "wire.resistance": {"value": 2.8, "std": 0.025, "statistical": 0.007, "systematic": 0.024,
                            "informed": 0.98, "unit": "ohm", "method": "line", "n": 25,
                            "stated": {"value": 2.7, "std": 0.01}},
        "environment.ambient_temperature": {"value": 296.4, "std": 0.5, "unit": "K", "n": 25,
                                            "method": "<b>"},
    },
    "correlation": {"names": ["wire.resistance", "environment.ambient_temperature"],
                    "matrix": [[1.0, -0.7], [-0.7, 1.0]]},
    "experiments": [{"name": "E1", "title": "Resistance", "source": "monday", "details": {},
                     "estimates": {"wire.resistance": {"value": 2.8, "std": 0.02, "unit": "ohm"}}}],
    "warnings": ["E2: not settled"],
}  # fmt: skip


def test_an_identification_has_its_errors_apart_and_says_what_surprises_and_hangs_together():
    result = identification_from(Path("r.json"), copy.deepcopy(IDENTIFIED))
    title, head, resistance, ambient, *below = identification_text(result).splitlines()
    assert title == "2 parameters identified by E1" and head.startswith("parameter")
    assert " ".join(resistance.split()) == (
        "wire.resistance 2.8 ± 0.007 ± 0.024 ohm 98 % 2.7 ± 0.01 +3.7 % (+3.7 std) E1"
    )
    assert " ".join(ambient.split()) == (
        "environment.ambient_temperature 296.4 ± 0.5 K"
    )
    assert below[0] == "off     wire.resistance +3.7 % (+3.7 std)"
    linked = "errors of environment.ambient_temperature and wire.resistance (-0.70)"
    assert below[1] == f"linked  {linked}"
    assert below[2] == "beware  1 warning, the first: E2: not settled"
    page = identification_html(result)
    assert linked in page and "2.8 ± 0.007 ± 0.024 ohm" in page and "<b>" not in page


@pytest.mark.parametrize("columns", [80, 200])
def test_numbers_fit_the_terminal(columns, capsys, monkeypatch):
    class Identified:
        shown = identification_from(Path("r.json"), copy.deepcopy(IDENTIFIED))
        notes = experiments = ()

        def __str__(self):
            return identification_text(self.shown)

    monkeypatch.setenv("COLUMNS", str(columns))
    print_result(Identified(), Invocation())
    printed = capsys.readouterr().out
    assert max(map(len, printed.splitlines())) <= columns
    said = " ".join(printed.split())
    assert "2.8 ± 0.007 ± 0.024 ohm" in said and "off wire.resistance +3.7 % (+3.7 std)" in said


def test_what_is_rounded_to_nothing_has_no_sign():
    found = copy.deepcopy(IDENTIFIED)
    found["parameters"]["environment.ambient_temperature"] |= {
        "value": 296.15 - 1e-4, "stated": {"value": 296.15, "std": 0.5}}
    said = identification_text(identification_from(Path("r.json"), found))
    assert "(0.0 std)" in said and "-0.0 " not in said and "+0.0 " not in said


def test_a_correlation_that_is_no_matrix_is_one_line():
    damaged = IDENTIFIED | {"correlation": {"names": ["a"], "matrix": [[1.0, 0.5]]}}
    with pytest.raises(InputError, match=r"r\.json: damaged result: correlation of 1 names"):
        identification_from(Path("r.json"), damaged)
