"""Whether an experiment would settle a tie: by the decision's own rule, not by distance."""

import pytest

from sma_bench.diagnose.decision import NAMED, SCALE, Candidate
from sma_bench.diagnose.next_experiment import WORTH, NextExperiment, Telling, chance_to_settle


def tied(gain=10.0, **probabilities):
    """Candidates that gain as much each; what is left is what nothing explains."""
    named = [Candidate(name, p, None, 1.0, gain) for name, p in probabilities.items()]
    rest = 1.0 - sum(probabilities.values())
    return [*named, Candidate("unexplained", rest, None, 1.0, 0.0)]


def apart(distance, *names):
    telling = Telling(0.5 * distance**2, distance)
    return {(a, b): telling for a in names for b in names if a != b}


BOTH = ("slack", "residual_strain")


def test_a_tie_of_two_that_differ_is_settled_whichever_is_true():
    candidates = tied(slack=0.5, residual_strain=0.45)
    assert chance_to_settle(candidates, apart(8.0, *BOTH)) == pytest.approx(0.95)


def test_a_tie_of_two_that_hardly_differ_is_not_settled():
    assert chance_to_settle(tied(slack=0.5, residual_strain=0.45), apart(0.5, *BOTH)) == 0.0


def test_no_distance_settles_what_nothing_explains():
    # Beside 0.42 for what nothing explains, the better one can come to 0.48/(0.48 + 0.42) only.
    candidates = tied(slack=0.48, residual_strain=0.1)
    assert NAMED > 0.48 / 0.90
    assert chance_to_settle(candidates, apart(1e3, *BOTH)) == 0.0


def test_a_rival_that_was_not_planned_for_stays_in_the_way():
    candidates = tied(slack=0.4, residual_strain=0.1, transition_drift=0.35)
    assert chance_to_settle(candidates, apart(1e3, *BOTH)) == 0.0
    everyone = apart(1e3, *BOTH, "transition_drift")
    assert chance_to_settle(candidates, everyone) == pytest.approx(0.85)


def test_evidence_counts_as_little_as_the_decision_lets_it():
    # 6 deviations are 18 nats, 10 with bad luck: plenty beside SCALE, little where the model
    # misfits by thousands.
    well, badly = (tied(gain, slack=0.5, residual_strain=0.45) for gain in (10.0, 3000.0))
    assert SCALE < 10.0
    assert chance_to_settle(well, apart(6.0, *BOTH)) == pytest.approx(0.95)
    assert chance_to_settle(badly, apart(6.0, *BOTH)) == 0.0


@pytest.mark.parametrize("distance", [2.0, 2.5])
def test_noise_may_go_against_the_true_cause(distance):
    # What 2.5 deviations give on average would do, but noise scatters it by as much.
    assert chance_to_settle(tied(slack=0.5, residual_strain=0.45), apart(distance, *BOTH)) == 0.0


def test_an_effect_that_is_not_there_is_refitted_away_and_stays_possible():
    # Recalibration cannot do what the effect does; the effect can do what recalibration does.
    candidates = tied(recalibration=0.5, slack=0.35)
    tellings = {("slack", "recalibration"): Telling(30.0, 8.0)}
    free = tellings | {("recalibration", "slack"): Telling(0.0, 0.0)}
    assert chance_to_settle(candidates, free) == pytest.approx(0.35)
    costly = tellings | {("recalibration", "slack"): Telling(5.0, 1.0)}
    assert chance_to_settle(candidates, costly) == pytest.approx(0.85)


def test_freedom_alone_settles_nothing_where_neither_would_be_seen():
    candidates = tied(recalibration=0.57, slack=0.35)
    blind = {
        ("recalibration", "slack"): Telling(8.0, 0.02),
        ("slack", "recalibration"): Telling(0.1, 0.1),
    }
    assert chance_to_settle(candidates, blind) == 0.0
    seeing = blind | {("slack", "recalibration"): Telling(30.0, 8.0)}
    assert chance_to_settle(candidates, seeing) == pytest.approx(0.92)


@pytest.mark.parametrize("chance, settles", [(0.9, True), (WORTH, True), (0.3, False)])
def test_only_what_settles_the_matter_is_worth_the_bench_s_time(chance, settles):
    assert NextExperiment("", BOTH, {}, 8.0, chance, 1.0).settles is settles
