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


def answer(verdict, probabilities, cause=(), where=None, claims=None):
    named = dict.fromkeys(NO_EFFECT, 0.0) | probabilities
    return checked_answer({
        "verdict": verdict,
        "cause": list(cause),
        "candidates": [
            {"name": name, "stage": STAGE_OF.get(name, ""), "probability": p}
            for name, p in named.items()
        ],
        "where": where or {
            "signal": "deflection", "phase": "drive", "side": "front", "stage": "mechanical",
        },
        "shrinkage": {
            signal: {"rmse_before": 2.0, "rmse_after": 1.0, "fraction": fraction,
                     "ci90": [low, high], "noise_floor": 0.1}
            for signal, (fraction, low, high) in (claims or {}).items()
        },
        "next_experiment": None,
    })  # fmt: skip


def label(kind, *effects, severity=8.0, **more):
    right = {"none": {"no_gap", "recalibration"}, "recalibration": {"recalibration"},
             "outside": {"unexplained"}}  # fmt: skip
    return Label("0001", kind, frozenset(right.get(kind, effects)), severity, **more)


def value(name, *cases):
    return MEASURES[name].of([Judged(*case) for case in cases])


SLACK = answer("effect", {"slack": 0.95, "opposing_wires": 0.05}, ["slack"])
QUIET = answer("no_gap", {"no_gap": 0.97, "slack": 0.03})
PUZZLED = answer("unexplained", {"unexplained": 0.7, "slack": 0.3})
TIED = answer("ambiguous", {"slack": 0.5, "opposing_wires": 0.45, "no_gap": 0.05})
UNDECIDED = answer("ambiguous", {"slack": 0.5, "no_gap": 0.5})


def test_detection_counts_gaps_above_twice_the_noise_only():
    found = value(
        "detection of gaps above twice the noise",
        (label("single", "slack"), SLACK),
        (label("pair", "slack", "supply_drop"), QUIET),
        (label("single", "slack", severity=1.9), QUIET),  # too small to count
        (label("none"), QUIET),
        (label("outside"), PUZZLED),
        (label("single", "slack"), UNDECIDED),  # leaves no_gap in its set
    )
    assert (found.hits, found.n) == (2, 4)


def test_a_false_alarm_is_any_verdict_that_sees_something_missing():
    answers = (SLACK, QUIET, PUZZLED, TIED, UNDECIDED, None)
    found = value("false alarms on no effect", *((label("none"), a) for a in answers))
    assert (found.hits, found.n) == (4, 6)  # slack, unexplained, tied, no answer
    assert value("false alarms on benign kinetics mismatch", (label("none"), SLACK)).n == 0
    kinetics = label("none", kinetics=True)
    assert value("false alarms on benign kinetics mismatch", (kinetics, SLACK)).value == 1.0


def test_a_single_is_named_by_a_verdict_and_counts_above_twice_the_noise():
    leading = answer("ambiguous", {"slack": 0.55, "no_gap": 0.45})
    cases = [(label("single", "slack", severity=s), a) for s, a in (
        (8.0, SLACK), (8.0, leading), (8.0, QUIET), (8.0, None), (1.5, SLACK),
    )]  # fmt: skip
    first = value("first choice right, singles above twice the noise", *cases)
    named = value("singles named and right", *cases)
    assert ((first.hits, first.n), (named.hits, named.n)) == ((2, 4), (1, 4))


def test_wrong_parameters_are_said_by_the_verdict_and_by_one_that_was_moved():
    off = label("recalibration", wrong=frozenset(("wire.resistance",)))
    right, other = frozenset(("wire.resistance", "wire.mass")), frozenset(("wire.mass",))
    said = answer("recalibration", {"recalibration": 1.0})
    found = MEASURES["wrong parameters said as such, with the parameter"].of([
        Judged(off, said, moved=right), Judged(off, said, moved=other), Judged(off, said),
        Judged(off, SLACK, moved=right), Judged(off, None),
        Judged(label("recalibration", severity=1.0), said), Judged(label("none"), said),
    ])  # fmt: skip
    assert (found.hits, found.n) == (1, 5)
    nominal = Parameters.of_paper().replace({}, {"wire.resistance": 0.1, "wire.mass": 1e-6})
    values = {"wire.resistance": nominal["wire.resistance"] - 0.25,
              "wire.mass": nominal["wire.mass"] + 1.5e-6}  # fmt: skip
    assert moved_parameters(nominal, nominal.replace(values)) == {"wire.resistance"}


def test_set_is_the_fewest_candidates_that_make_90_percent():
    cases = [(label("single", "opposing_wires"), TIED), (label("single", "opposing_wires"), SLACK)]
    assert value("90 % set holds the truth", *cases).hits == 1
    assert value("90 % set, mean size", *cases).value == 1.5


def test_probability_of_the_truth_is_summed_over_what_is_nothing_but_true():
    probabilities = {"slack": 0.2, "slack+supply_drop": 0.5, "supply_drop+latent_heat": 0.3}
    joint = answer("effect", probabilities, ["slack", "supply_drop"])
    name = "probability given to the truth"
    assert value(name, (label("pair", "slack", "supply_drop"), joint)).value == pytest.approx(0.7)
    assert value(name, (label("single", "slack"), joint)).value == pytest.approx(0.2)
    assert value(name, (label("none"), UNDECIDED)).value == pytest.approx(0.5)
    assert value(name, (label("outside"), PUZZLED)).value == pytest.approx(0.7)
    assert value(name, (label("single", "slack"), None)).value == 0.0


def test_out_of_library_abstains_or_flags():
    flagged = answer("effect", {"slack": 0.85, "unexplained": 0.15}, ["slack"])
    answers = (SLACK, PUZZLED, TIED, flagged, None, QUIET)
    name = "out-of-library: abstains or flags"
    found = value(name, *((label("outside"), a) for a in answers))
    assert (found.hits, found.n) == (3, 6)


def test_confident_and_wrong_is_a_strange_cause_or_a_sure_wrong_candidate():
    doubtful = answer("effect", {"slack": 0.5, "supply_drop": 0.5}, ["slack"])
    sure = answer("recalibration", {"recalibration": 0.8, "slack": 0.2})
    found = value(
        "confident and wrong",
        (label("single", "supply_drop"), doubtful),  # wrong cause
        (label("single", "slack"), sure),  # sure of something wrong
        (label("pair", "slack", "latent_heat"), SLACK),  # half right is not wrong
        (label("none"), sure),
        (label("outside"), TIED),
        (label("single", "slack"), None),
    )
    assert (found.hits, found.n) == (2, 6)


def test_pairs_by_cause_or_by_the_most_probable_candidate():
    both = answer("ambiguous", {"slack+supply_drop": 0.6, "slack": 0.4})
    pair = label("pair", "slack", "supply_drop")
    cases = [(pair, SLACK), (pair, both), (pair, QUIET)]
    assert value("pairs: at least one", *cases).hits == 2
    assert value("pairs: both", *cases).hits == 1


def test_where_compares_quantities_not_channels():
    place = {"signal": "front_1.temperature", "phase": "rest", "side": "front", "stage": "thermal"}
    said = answer("effect", {"side_heat_coupling": 1.0}, ["side_heat_coupling"], place)
    true = {"signal": "back_2.temperature", "phase": "rest", "side": "back", "stage": "thermal"}
    case = (label("single", "side_heat_coupling", where=true), said)
    found = [value(f"where: {key}", case).value for key in ("signal", "phase", "side", "stage")]
    assert found == [1.0, 1.0, 0.0, 1.0]


def shrunk(fraction, noise=0.1):
    return Shrunk(1.0, 1.0 - fraction, noise)


def test_shrinkage_is_compared_on_the_deflection_where_it_has_a_gap():
    claims = {"deflection": (0.8, 0.7, 0.9), "current": (0.5, 0.4, 0.6)}
    said = answer("effect", {"slack": 1.0}, ["slack"], claims=claims)
    true = {"deflection": shrunk(0.75), "current": shrunk(0.1)}
    beside = {"deflection": shrunk(0.75, noise=2.0), "current": shrunk(0.1)}
    single = label("single", "slack")
    name = "claimed against true shrinkage, median"
    assert value(name, (single, said, true)).value == pytest.approx(0.05)
    assert value(name, (single, said, beside)).value == pytest.approx(0.4)
    assert value(name, (single, said, {})).n == 0
    covered = value("90 % interval of shrinkage covers", (single, said, true),
                    (single, said, beside))  # fmt: skip
    assert (covered.hits, covered.n) == (1, 2)


def test_the_tie_is_settled_when_the_last_answer_is_sure_and_right():
    single = label("single", "slack")
    first = {"label": single, "answer": TIED, "followed": True}
    cases = [
        Judged(**first, second=SLACK), Judged(**first, second=TIED), Judged(**first),
        Judged(single, SLACK),
    ]  # fmt: skip
    found = MEASURES["of the ambiguous, settled rightly"].of(cases)
    assert (found.hits, found.n) == (1, 3)


@pytest.mark.parametrize(
    ("document", "stages"),
    [
        ({"kind": "single", "effects": ["slack"], "stages": ["mechanical"],
          "severities": {"slack": 2.0}}, {"mechanical"}),
        ({"kind": "pair", "effects": ["slack", "latent_heat"], "stages": ["mechanical", "thermal"],
          "severities": {"slack": 2.0, "latent_heat": 9.0}}, {"thermal"}),
        ({"kind": "recalibration", "effects": [], "stages": ["mechanical", "thermal"],
          "severities": {}}, {"mechanical", "thermal"}),
    ],
)  # fmt: skip
def test_the_stage_is_that_of_the_larger_effect_or_of_any_wrong_parameter(document, stages):
    found = Label.of({"id": "1", "where": {"stage": "sensor"}, **document})
    assert found.own_stages == stages
    for stage in ("mechanical", "thermal"):
        place = {"signal": "deflection", "phase": "rest", "side": "back", "stage": stage}
        said = answer("effect", {"slack": 1.0}, ["slack"], place)
        assert Judged(found, said).place_right("stage") == (stage in stages)


def test_a_perfect_examinee_reaches_every_aim():
    where = {"signal": "deflection", "phase": "rest", "side": "back", "stage": "mechanical"}
    claims = {"deflection": (0.9, 0.8, 1.0)}
    cases = []
    for k in range(200):
        covered = {"deflection": shrunk(0.9 if k % 10 else 0.7)}
        said = answer("effect", {"slack": 1.0}, ["slack"], where, claims)
        cases.append(Judged(label("single", "slack", where=where), said, covered))
    pair = answer("effect", {"slack+supply_drop": 1.0}, ["slack", "supply_drop"], where)
    cases += [
        Judged(label("pair", "slack", "supply_drop", where=where), pair),
        Judged(label("none"), answer("no_gap", {"no_gap": 1.0})),
        Judged(label("none", kinetics=True), answer("no_gap", {"no_gap": 1.0})),
        Judged(label("recalibration", wrong=frozenset(("wire.mass",))),
               answer("recalibration", {"recalibration": 1.0}), moved=frozenset(("wire.mass",))),
        Judged(label("outside"), answer("unexplained", {"unexplained": 1.0})),
        Judged(label("single", "slack", severity=1.0), TIED, second=SLACK, followed=True),
    ]
    met = {m.name: m.met(m.of(cases)) for m in TARGETS}
    assert met == dict.fromkeys(met, "aim")


def test_an_examinee_that_always_names_one_effect_misses_what_it_must():
    kinds = [label("none"), label("none", kinetics=True), label("outside"), label("recalibration"),
             label("single", "supply_drop"), label("pair", "latent_heat", "supply_drop")]
    cases = [Judged(kind, SLACK) for kind in kinds]
    met = {m.name: m.met(m.of(cases)) for m in TARGETS}
    assert [name for name, how in met.items() if how == "aim"] == [
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
