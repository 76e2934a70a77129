"""Measures on hand-made cases whose numbers are known."""

import math
from pathlib import Path

import msgspec
import numpy as np
import pytest
import yaml

from examination.blind import judgement
from examination.blind.case_files import NO_EFFECT, STAGE_OF, checked_answer

MEASURES = {measure.name: measure for measure in (*judgement.TARGETS, *judgement.OTHERS)}
PLACE = {"signal": "deflection", "phase": "drive", "side": "front", "stage": "mechanical"}


def answer_of(verdict, probabilities, cause=(), where=PLACE, claims=None):
    """The plain document of an answer."""
    named = dict.fromkeys(NO_EFFECT, 0.0) | probabilities
    return {
        "verdict": verdict, "cause": list(cause), "where": where, "next_experiment": None,
        "candidates": [{"name": name, "stage": STAGE_OF.get(name, ""), "probability": p}
                       for name, p in named.items()],
        "shrinkage": {signal: {"fraction": fraction, "ci90": [low, high]}
                      for signal, (fraction, low, high) in (claims or {}).items()},
    }


BY_HAND = yaml.safe_load(Path(__file__).with_name("measures_by_hand.yaml").read_text())
ANSWERS = {"-": None}
ANSWERS |= {name: checked_answer(answer_of(**how)) for name, how in BY_HAND["answers"].items()}
LABELS = {name: msgspec.convert({"id": "0001", "severity": 8.0, **how}, judgement.Label)
          for name, how in BY_HAND["labels"].items()}


def judged(case):
    more = {"of": case} if isinstance(case, str) else dict(case)
    of, said = more.pop("of").split()
    seen = BY_HAND["shrunk"].get(more.pop("shrunk", ""), {})
    shrunk = {signal: judgement.Shrunk(*numbers) for signal, numbers in seen.items()}
    moved, second = frozenset(more.pop("moved", ())), ANSWERS[more.pop("second", "-")]
    return judgement.Judged(LABELS[of], ANSWERS[said], shrunk, moved, second, **more)


def test_shares_and_values_are_what_is_worked_out_by_hand_from_the_definition():
    for name, cases, expected in BY_HAND["counted"]:
        found = MEASURES[name].of([judged(case) for case in cases])
        assert [found.hits, found.n] == expected, name
    for name, case, expected in BY_HAND["values"]:
        found = MEASURES[name].of([judged(case)])
        assert found.value == pytest.approx(expected, nan_ok=True), (name, case)


def test_intervals_are_exact_and_repeatable():
    share = judgement.proportion([True] * 5 + [False] * 5)
    assert (share.low, share.high) == pytest.approx((0.1871, 0.8129), abs=5e-5)  # of the tables
    assert math.isnan(judgement.proportion([]).value)
    # Of 20 values the 6th and the 15th bound the median with 95.86 %.
    found = judgement.quantile([float(k) for k in range(1, 21)], 0.5)
    assert (found.value, found.low, found.high) == (10.5, 6.0, 15.0)
    assert judgement.quantile([1.0, 2.0, 3.0], 0.9).high == math.inf
    values = list(np.random.default_rng(1).normal(2.0, 1.0, 400))
    width = judgement.mean(values).high - judgement.mean(values).low
    assert width == pytest.approx(2 * 1.96 * np.std(values) / 20, rel=0.1)
    coin = judgement.calibration_error([0.9] * 100, [True, False] * 50)
    assert coin.value == pytest.approx(0.4) and coin.low < 0.4 < coin.high
    assert judgement.calibration_error([0.25] * 4, [True, False, False, False]).value == 0.0
