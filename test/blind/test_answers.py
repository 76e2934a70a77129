"""Answers to the contract are read; every broken clause is one line that names it."""

import copy
import json
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from examination.blind.case_files import checked_answer
from sma_bench.errors import InputError

GOOD = {
    "verdict": "effect",
    "cause": ["slack"],
    "candidates": [
        {"name": "no_gap", "stage": "", "probability": 0.02, "parameters": {}},
        {
            "name": "slack", "stage": "mechanical", "probability": 0.9,
            "parameters": {"p": {"value": 0.004, "std": 0.001, "unit": "1"}},
        },
        {"name": "slack+latent_heat", "stage": "mechanical", "probability": 0.05, "parameters": {}},
        {"name": "recalibration", "stage": "", "probability": 0.02, "parameters": {}},
        {"name": "unexplained", "stage": "", "probability": 0.01, "parameters": {}},
    ],
    "where": {
        "signal": "deflection", "phase": "drive", "side": "back", "stage": "mechanical",
        "table": [],
    },
    "shrinkage": {
        "deflection": {
            "rmse_before": 2e-3, "rmse_after": 5e-4, "fraction": 0.8, "ci90": [0.7, 0.9],
            "noise_floor": 1e-4,
        }
    },
    "next_experiment": {"why": "", "separates": ["slack", "no_gap"], "protocol": {}},
}  # fmt: skip


def changed(path, value):
    document = copy.deepcopy(GOOD)
    *way, last = path
    place = document
    for key in way:
        place = place[key]
    if value is ...:
        del place[last]
    else:
        place[last] = value
    return document


def test_a_good_answer_is_read_with_the_most_probable_candidate_first():
    answer = checked_answer(GOOD)
    assert [c.name for c in answer.candidates[:2]] == ["slack", "slack+latent_heat"]
    assert answer.candidates[0].parameters["p"].value == 0.004
    assert answer.candidates[1].parts == {"slack", "latent_heat"}
    assert answer.shrinkage["deflection"].ci90 == (0.7, 0.9)
    assert answer.where.side == "back"


def test_no_gap_needs_neither_place_nor_shrinkage_nor_experiment():
    document = changed(["verdict"], "no_gap") | {"cause": [], "where": None, "shrinkage": {}}
    answer = checked_answer(document | {"next_experiment": None})
    assert answer.where is None and answer.shrinkage == {} and answer.next_experiment is None


def test_a_gap_that_cannot_shrink_has_no_fraction():
    claim = {**GOOD["shrinkage"]["deflection"], "fraction": None, "ci90": None}
    answer = checked_answer(changed(["shrinkage", "deflection"], claim))
    assert math.isnan(answer.shrinkage["deflection"].fraction)


BROKEN = {
    "no verdict": (["verdict"], ..., "answer: verdict is missing"),
    "unknown verdict": (["verdict"], "maybe", "verdict is 'maybe', expected one of effect"),
    "cause without effect": (["verdict"], "ambiguous", "with the verdict ambiguous, expected none"),
    "effect without cause": (["cause"], [], "with the verdict effect, expected one effect"),
    "cause not a list": (["cause"], "slack", "cause is 'slack', expected a list"),
    "cause no candidate": (["cause"], ["supply_drop"], "'supply_drop' is not among"),
    "cause no effect": (["cause"], ["no_gap"], "'no_gap' is not among"),
    "no candidates": (["candidates"], [], "candidates is [], expected a list"),
    "probability above one": (
        ["candidates", 1, "probability"], 1.2, "candidates[1]: probability of slack is 1.2",
    ),
    "probability not a number": (["candidates", 1, "probability"], "high", "'high', expected 0 to"),
    "probability missing": (["candidates", 1, "probability"], ..., "probability is missing"),
    "probabilities do not sum": (["candidates", 1, "probability"], 0.5, "sum to 0.6000"),
    "twice": (["candidates", 0, "name"], "recalibration", "recalibration is listed twice"),
    "unexplained not listed": (["candidates", 4, "name"], "supply_drop+slack", "unexplained is mi"),
    "stage of another effect": (["candidates", 1, "stage"], "thermal", "expected mechanical"),
    "no stage": (["candidates", 1, "stage"], "", "stage of slack is ''"),
    "estimate without unit": (
        ["candidates", 1, "parameters", "p", "unit"], ..., "parameters: p: unit is missing",
    ),
    "estimate infinite": (
        ["candidates", 1, "parameters", "p", "value"], math.inf, "p: value is inf, expected a fin",
    ),
    "negative std": (["candidates", 1, "parameters", "p", "std"], -1.0, "std is -1.0, expected 0"),
    "nowhere": (["where"], None, "where is empty"),
    "unknown phase": (["where", "phase"], "hold", "phase is 'hold', expected one of drive, rest"),
    "unknown side": (["where", "side"], "left", "side is 'left'"),
    "unknown stage": (["where", "stage"], "optical", "stage is 'optical'"),
    "no signal": (["where", "signal"], "", "where: signal is '', expected a name"),
    "shrinkage not a mapping": (["shrinkage"], [1], "shrinkage: is [1], expected a mapping"),
    "interval reversed": (["shrinkage", "deflection", "ci90"], [0.9, 0.7], "expected to hold 0.8"),
    "interval of three": (["shrinkage", "deflection", "ci90"], [0, 1, 2], "expected [low, high]"),
    "more than all": (["shrinkage", "deflection", "fraction"], 1.1, "fraction is 1.1, expected 1"),
    "no floor": (["shrinkage", "deflection", "noise_floor"], ..., "noise_floor is missing"),
    "separates a stranger": (
        ["next_experiment", "separates"], ["x"], "'x', which is not among the candidates",
    ),
    "protocol a text": (["next_experiment", "protocol"], "ramp", "protocol: is 'ramp', expected a"),
}  # fmt: skip


@pytest.mark.parametrize("case", BROKEN)
def test_a_broken_clause_is_named_in_one_line(case):
    path, value, expected = BROKEN[case]
    with pytest.raises(InputError) as raised:
        checked_answer(changed(path, value))
    assert expected in str(raised.value)
    assert "\n" not in str(raised.value)


_ANYTHING = st.recursive(
    st.none() | st.booleans() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=2) | st.dictionaries(st.text(max_size=5), inner,
                                                                max_size=2),
    max_leaves=4,
)  # fmt: skip


@given(key=st.sampled_from(list(GOOD)), value=_ANYTHING)
def test_whatever_stands_in_a_field_is_read_or_refused_in_one_line(key, value):
    document = json.loads(json.dumps(GOOD)) | {key: value}
    try:
        checked_answer(document)
    except InputError as error:
        assert "\n" not in str(error)
