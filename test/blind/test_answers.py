"""Answers to the contract are read; every broken clause is one line."""

import copy
import math

import pytest

from examination.blind.case_files import checked_answer
from sma_bench.errors import InputError

GOOD = {
    "verdict": "effect",
    "cause": ["slack"],
    "candidates": [
        {"name": "no_gap", "stage": "", "probability": 0.02, "parameters": {}},
        {"name": "slack", "stage": "mechanical", "probability": 0.9,
         "parameters": {"p": {"value": 0.004, "std": 0.001, "unit": "1"}}},
        {"name": "slack+latent_heat", "stage": "mechanical", "probability": 0.05, "parameters": {}},
        {"name": "recalibration", "stage": "", "probability": 0.02, "parameters": {}},
        {"name": "unexplained", "stage": "", "probability": 0.01, "parameters": {}},
    ],
    "where": {"signal": "deflection", "phase": "drive", "side": "back", "stage": "mechanical"},
    "shrinkage": {"deflection": {"fraction": 0.8, "ci90": [0.7, 0.9]},
                  "current": {"fraction": None, "ci90": None}},
    "next_experiment": {"why": "", "separates": ["slack", "no_gap"], "protocol": {}},
}  # fmt: skip


def test_a_good_answer_is_read_with_the_most_probable_candidate_first():
    answer = checked_answer(GOOD)
    assert [c.name for c in answer.candidates[:2]] == ["slack", "slack+latent_heat"]
    assert answer.candidates[0].parameters["p"].value == 0.004
    assert answer.candidates[1].parts == {"slack", "latent_heat"}
    assert answer.shrinkage["deflection"].ci90 == (0.7, 0.9) and answer.where.side == "back"
    assert answer.shrinkage["current"].fraction is None  # there was nothing to shrink
    quiet = {"verdict": "no_gap", "cause": [], "where": None, "next_experiment": None}
    assert checked_answer(GOOD | quiet).where is None


BROKEN = (
    ("verdict", "maybe"), ("verdict", "ambiguous"), ("cause", []), ("cause", "slack"),
    ("cause", ["supply_drop"]), ("cause", ["no\ngap"]), ("candidates", []),
    ("candidates 1 probability", 1.2), ("candidates 1 probability", "high"),
    ("candidates 1 probability", 0.5), ("candidates 0 name", "recalibration"),
    ("candidates 4 name", "supply_drop+slack"), ("candidates 1 stage", "thermal"),
    ("candidates 1 parameters p value", math.inf), ("where", None), ("where signal", ""),
    ("shrinkage", [1]), ("shrinkage deflection ci90", [0.9, 0.7]),
    ("shrinkage deflection ci90", [0, 1, 2]), ("next_experiment separates", ["x"]),
    ("next_experiment protocol", "ramp"),
)  # fmt: skip


@pytest.mark.parametrize(("path", "value"), BROKEN)
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
