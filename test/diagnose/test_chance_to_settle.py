"""What an experiment would settle: by the decision's own rule, not by distance."""

from types import SimpleNamespace

import pytest

from sma_bench.diagnose.decision import SCALE, Weights
from sma_bench.diagnose.next_experiment import Matter, taken_up
from sma_bench.diagnose.prospect import Telling, prospect


def after(tellings, signs=-5.0, surprise=-5.0, **gains):
    """Prospect of an experiment on effects that gain so much, each plain to see."""
    weights = Weights(
        gains, dict.fromkeys(gains, 3.0), dict.fromkeys(gains, 0.0), 5.0, signs, surprise
    )
    return prospect(weights, weights.probabilities(), tellings)


def apart(distance, *names):
    telling = Telling(0.5 * distance**2, distance)
    return {(a, b): telling for a in names for b in names if a != b}


BOTH = ("slack", "residual_strain")
ALL = (*BOTH, "recalibration")


def test_a_tie_of_two_that_differ_is_settled_whichever_is_true():
    told = after(apart(8.0, *ALL), slack=14.0, residual_strain=13.5)
    assert told.named > 0.95 and told.given > 0.9


def test_a_tie_of_two_that_hardly_differ_is_not_settled():
    tellings = apart(8.0, *ALL) | apart(0.5, *BOTH)
    told = after(tellings, slack=14.0, residual_strain=13.5)
    before = after(apart(0.0, *ALL), slack=14.0, residual_strain=13.5)
    assert told.named < 0.1 and told.given == pytest.approx(before.given, abs=0.1)


def test_no_distance_settles_what_nothing_explains():
    told = after(apart(1e3, *ALL), signs=1.0, slack=14.0, residual_strain=2.0)
    assert told.named == 0.0
    assert after(apart(1e3, *ALL), slack=14.0, residual_strain=2.0).named > 0.9


def test_a_parameter_that_was_measured_surprises_no_more():
    told = after(apart(8.0, *ALL), surprise=0.4, slack=0.0, residual_strain=-9.0)
    assert told.named < after(apart(8.0, *ALL), slack=0.0, residual_strain=-9.0).named


def test_a_rival_that_was_not_planned_for_stays_in_the_way():
    gains = {"slack": 14.0, "residual_strain": 3.0, "transition_drift": 14.0}
    assert after(apart(1e3, *ALL), **gains).named < 0.1
    assert after(apart(1e3, *ALL, "transition_drift"), **gains).named > 0.9


def test_evidence_counts_as_little_as_the_decision_lets_it():
    # 5 deviations are 12 nats: plenty beside SCALE, little where the model misfits by thousands.
    assert SCALE < 10.0
    well = after(apart(5.0, *ALL), slack=20.0, residual_strain=20.0)
    badly = after(apart(5.0, *ALL), slack=9000.0, residual_strain=9000.0)
    assert well.named > 0.9 and badly.named < 0.1


def matter(minutes, **gains):
    made = Matter.__new__(Matter)
    made.minutes, made.records, made.weights = minutes, 2, SimpleNamespace(gains=gains)
    return made


def test_another_record_tells_of_a_wandering_zero_as_much_as_one_of_the_records_has():
    known = matter(5.0, deflection_drift=16.0, slack=9.0, **{"deflection_drift+slack": 33.0})
    names = ("recalibration", "deflection_drift", "slack", "deflection_drift+slack")
    found = known.wandering(apart(100.0, *names), 10.0)
    assert found["recalibration", "deflection_drift"].evidence == pytest.approx(8.0)
    assert found["deflection_drift+slack", "slack"].evidence == pytest.approx(12.0)
    assert ("slack", "recalibration") not in found  # what a model predicts is simulated
    assert ("slack", "deflection_drift") not in found
    # One half as long tells half of it, and what it tells counts though it is hardly seen.
    little = matter(5.0, deflection_drift=4.0).wandering(apart(9.0, *names[:2]), 1.25)
    assert little["recalibration", "deflection_drift"] == pytest.approx(Telling(1.0, 2.0))
    short = matter(5.0, deflection_drift=-1.0).wandering(apart(9.0, *names[:2]), 10.0)
    assert set(short.values()) == {Telling(0.0, 0.0)}


def test_an_effect_that_is_not_there_takes_up_what_the_model_misses():
    exact = apart(3.0, "slack", "recalibration")
    real = taken_up(exact)
    assert real["slack", "recalibration"] == exact["slack", "recalibration"]
    assert 0.0 < real["recalibration", "slack"].evidence < exact["recalibration", "slack"].evidence
    assert after(real, slack=4.0).named < after(exact, slack=4.0).named
    nothing = apart(0.0, "slack", "recalibration")
    assert taken_up(nothing) == nothing
