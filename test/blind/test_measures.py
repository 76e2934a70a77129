"""Measures on hand-made cases whose numbers are known."""

import math

import numpy as np
import pytest

from examination.blind.case_files import NO_EFFECT, STAGE_OF, checked_answer
from examination.blind.judgement import Judged, Label, Shrunk, moved_parameters
from examination.blind.measures import (
    OTHERS,
    TARGETS,
    calibration_error,
    mean,
    proportion,
    quantile,
)
from sma_bench.parameters import Parameters

MEASURES = {measure.name: measure for measure in (*TARGETS, *OTHERS)}
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
    }  # fmt: skip


def answer(*words, **more):
    return checked_answer(answer_of(*words, **more))


def label(kind, *effects, severity=8.0, **more):
    return Label("0001", kind, effects, severity, **more)


def shrunk(fraction, noise=0.1):
    return Shrunk(1.0, 1.0 - fraction, noise)


SLACK = answer("effect", {"slack": 0.95, "opposing_wires": 0.05}, ["slack"])
QUIET = answer("no_gap", {"no_gap": 0.97, "slack": 0.03})
PUZZLED = answer("unexplained", {"unexplained": 0.7, "slack": 0.3})
TIED = answer("ambiguous", {"slack": 0.5, "opposing_wires": 0.45, "no_gap": 0.05})
UNDECIDED = answer("ambiguous", {"slack": 0.5, "no_gap": 0.5})
LEADING = answer("ambiguous", {"slack": 0.55, "no_gap": 0.45})
DOUBTFUL = answer("effect", {"slack": 0.5, "supply_drop": 0.5}, ["slack"])
SURE = answer("recalibration", {"recalibration": 0.8, "slack": 0.2})
FLAGGED = answer("effect", {"slack": 0.85, "unexplained": 0.15}, ["slack"])
BOTH = answer("ambiguous", {"slack+supply_drop": 0.6, "slack": 0.4})
SAID = answer("recalibration", {"recalibration": 1.0})
CLAIMS = answer("effect", {"slack": 1.0}, ["slack"],
                claims={"deflection": (0.8, 0.7, 0.9), "current": (0.5, 0.4, 0.6)})  # fmt: skip

SINGLE, NONE, OUTSIDE = label("single", "slack"), label("none"), label("outside")
SMALL, TWO = label("single", "slack", severity=1.5), label("pair", "slack", "supply_drop")
OFF = label("recalibration", wrong={"wire.resistance": 3.0})
RESISTANCE, MASS = (frozenset((f"wire.{name}",)) for name in ("resistance", "mass"))
SEEN = {"deflection": shrunk(0.75), "current": shrunk(0.1)}
IN_NOISE = {"deflection": shrunk(0.75, noise=2.0), "current": shrunk(0.1)}
SINGLES = [(SINGLE, SLACK), (SINGLE, LEADING), (SINGLE, QUIET), (SINGLE, None), (SMALL, SLACK)]
PAIRS = [(TWO, SLACK), (TWO, BOTH), (TWO, QUIET)]
CLAIMED = [(SINGLE, CLAIMS, SEEN), (SINGLE, CLAIMS, IN_NOISE), (SINGLE, CLAIMS)]
# Quantities are compared, not channels; the stage is that of the larger effect, or of any wrong
# parameter.
BACK_REST = {"signal": "back_2.temperature", "phase": "rest", "side": "back", "stage": "sensor"}
LAID = [(label("single", "slack", where=BACK_REST), answer("effect", {"slack": 1.0}, ["slack"], {
    "signal": "front_1.temperature", "phase": "rest", "side": "front", "stage": "sensor"}))]
BOTH_STAGES = {"where": BACK_REST, "stages": ("mechanical", "thermal")}
IN_ONE = label("single", "slack", where=BACK_REST, stages=("mechanical",))
IN_LARGER = label("pair", "slack", "latent_heat", **BOTH_STAGES,
                  severities={"slack": 2.0, "latent_heat": 9.0})  # fmt: skip
IN_ANY = label("recalibration", **BOTH_STAGES)
MECHANICAL, THERMAL = (answer("effect", {"slack": 1.0}, ["slack"], PLACE | {"stage": stage})
                       for stage in ("mechanical", "thermal"))  # fmt: skip

COUNTED = [  # measure, its cases, how many of how many
    # A gap that is too small does not count; an answer that leaves no_gap in its set sees none.
    ("detection of gaps above twice the noise", [
        (SINGLE, SLACK), (TWO, QUIET), (SMALL, QUIET), (NONE, QUIET), (OUTSIDE, PUZZLED),
        (SINGLE, UNDECIDED)], (2, 4)),
    ("false alarms on no effect", [
        (NONE, said) for said in (SLACK, QUIET, PUZZLED, TIED, UNDECIDED, None)], (4, 6)),
    ("false alarms on benign kinetics mismatch", [
        (label("none", kinetics=True), SLACK), (NONE, SLACK)], (1, 1)),
    ("first choice right, singles above twice the noise", SINGLES, (2, 4)),
    ("singles named and right", SINGLES, (1, 4)),
    ("wrong parameters said as such, with the parameter", [
        (OFF, SAID, {}, RESISTANCE | MASS), (OFF, SAID, {}, MASS), (OFF, SAID),
        (OFF, SLACK, {}, RESISTANCE), (OFF, None), (NONE, SAID),
        (label("recalibration", severity=1.0), SAID)], (1, 5)),
    ("90 % set holds the truth", [
        (label("single", "opposing_wires"), said) for said in (TIED, SLACK)], (1, 2)),
    ("out-of-library: abstains or flags", [
        (OUTSIDE, said) for said in (SLACK, PUZZLED, TIED, FLAGGED, None, QUIET)], (3, 6)),
    # A strange cause, and one that is sure of something wrong; half right is not wrong.
    ("confident and wrong", [
        (label("single", "supply_drop"), DOUBTFUL), (SINGLE, SURE), (NONE, SURE), (OUTSIDE, TIED),
        (label("pair", "slack", "latent_heat"), SLACK), (SINGLE, None)], (2, 6)),
    *((f"where: {key}", LAID, (right, 1)) for key, right in
      (("signal", 1), ("phase", 1), ("side", 0), ("stage", 1))),
    ("where: stage", [(IN_ONE, MECHANICAL), (IN_LARGER, THERMAL), (IN_ANY, MECHANICAL),
                      (IN_ANY, THERMAL)], (4, 4)),
    ("where: stage", [(IN_ONE, THERMAL), (IN_LARGER, MECHANICAL), (IN_ONE, None)], (0, 3)),
    ("pairs: at least one", PAIRS, (2, 3)),
    ("pairs: both", PAIRS, (1, 3)),
    ("90 % interval of shrinkage covers", CLAIMED, (1, 2)),
    ("of the ambiguous, settled rightly", [
        *((SINGLE, TIED, {}, MASS, second, True) for second in (SLACK, TIED, None)),
        (SINGLE, SLACK)], (1, 3)),
]  # fmt: skip


JOINT = answer("effect", {"slack": 0.2, "slack+supply_drop": 0.5, "supply_drop+latent_heat": 0.3},
               ["slack", "supply_drop"])  # fmt: skip
TRUTH, ERROR = "probability given to the truth", "claimed against true shrinkage, median"
VALUES = [  # measure, case, value
    ("90 % set, mean size", (SINGLE, TIED), 2.0), (TRUTH, (TWO, JOINT), 0.7),
    (TRUTH, (SINGLE, JOINT), 0.2), (TRUTH, (NONE, UNDECIDED), 0.5),
    (TRUTH, (OUTSIDE, PUZZLED), 0.7), (TRUTH, (SINGLE, None), 0.0),
    (ERROR, CLAIMED[0], 0.05), (ERROR, CLAIMED[1], 0.4), (ERROR, CLAIMED[2], math.nan),
]  # fmt: skip


def test_shares_and_values_are_what_is_worked_out_by_hand_from_the_definition():
    for name, cases, expected in COUNTED:
        found = MEASURES[name].of([Judged(*case) for case in cases])
        assert (found.hits, found.n) == expected, name
    for name, case, expected in VALUES:
        found = MEASURES[name].of([Judged(*case)])
        assert found.value == pytest.approx(expected, nan_ok=True), (name, case)


def test_a_parameter_is_moved_by_twice_its_stated_deviation():
    nominal = Parameters.of_paper().replace({}, {"wire.resistance": 0.1, "wire.mass": 1e-6})
    values = {"wire.resistance": nominal["wire.resistance"] - 0.25,
              "wire.mass": nominal["wire.mass"] + 1.5e-6}  # fmt: skip
    assert moved_parameters(nominal, nominal.replace(values)) == {"wire.resistance"}


def test_a_perfect_examinee_reaches_every_aim_and_one_that_always_names_one_effect_two():
    said = answer("effect", {"slack": 1.0}, ["slack"], claims={"deflection": (0.9, 0.8, 1.0)})
    both = answer("effect", {"slack+supply_drop": 1.0}, ["slack", "supply_drop"])
    cases = [Judged(label("single", "slack", where=PLACE), said,
                    {"deflection": shrunk(0.9 if k % 10 else 0.7)}) for k in range(200)]
    cases += [
        Judged(label("pair", "slack", "supply_drop", where=PLACE), both),
        Judged(NONE, answer("no_gap", {"no_gap": 1.0})),
        Judged(label("none", kinetics=True), answer("no_gap", {"no_gap": 1.0})),
        Judged(OFF, SAID, moved=RESISTANCE),
        Judged(OUTSIDE, answer("unexplained", {"unexplained": 1.0})),
        Judged(SMALL, TIED, second=SLACK, followed=True),
    ]  # fmt: skip
    met = {m.name: m.met(m.of(cases)) for m in TARGETS}
    assert met == dict.fromkeys(met, "aim")
    kinds = [NONE, label("none", kinetics=True), OUTSIDE, label("recalibration"),
             label("single", "supply_drop"), label("pair", "latent_heat", "supply_drop")]
    always = [Judged(kind, SLACK) for kind in kinds]
    assert [m.name for m in TARGETS if m.met(m.of(always)) == "aim"] == [
        "detection of gaps above twice the noise", "90 % set, mean size",
    ]  # fmt: skip


def test_intervals_are_exact_and_repeatable():
    share = proportion([True] * 5 + [False] * 5)
    assert (share.low, share.high) == pytest.approx((0.1871, 0.8129), abs=5e-5)  # of the tables
    assert math.isnan(proportion([]).value)
    # Of 20 values the 6th and the 15th bound the median with 95.86 %.
    found = quantile([float(k) for k in range(1, 21)], 0.5)
    assert (found.value, found.low, found.high) == (10.5, 6.0, 15.0)
    assert quantile([1.0, 2.0, 3.0], 0.9).high == math.inf
    values = list(np.random.default_rng(1).normal(2.0, 1.0, 400))
    width = mean(values).high - mean(values).low
    assert width == pytest.approx(2 * 1.96 * np.std(values) / 20, rel=0.1)
    coin = calibration_error([0.9] * 100, [True, False] * 50)
    assert coin.value == pytest.approx(0.4) and coin.low < 0.4 < coin.high
    assert calibration_error([0.25] * 4, [True, False, False, False]).value == 0.0
