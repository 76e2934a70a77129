"""From signs and gains to probabilities and stages, without a fit; and what an experiment would
settle, by the same rule."""

from types import SimpleNamespace

import numpy as np
import pytest

from sma_bench.diagnose.decision import (
    Candidate,
    Weights,
    named,
    signs_of_unexplained,
    verdict_of,
)
from sma_bench.diagnose.diagnosis import stages_of
from sma_bench.diagnose.left_over import Left
from sma_bench.diagnose.next_experiment import Telling, prospect
from sma_bench.parameters.parameter import TRANSITIONS

SMOOTH = "a smooth response of free form is left"
BELIEF = "parameters are needed that nobody believes in"
SCATTER = "deflection scatters more in motion than at rest"


def signs(gain, *, beyond=0.0, flexible=0.0, surprise=(10.0, 10.0), sizes=(0.0, 0.0), gap=5.0):
    """Of what a search found: gain of the best, each sign before (recalibrated) and after."""
    return signs_of_unexplained(
        SimpleNamespace(recalibrated=SimpleNamespace(evidence=0.0, surprise=surprise[0]),
                        best=SimpleNamespace(evidence=gain, surprise=surprise[1]),
                        flexible=SimpleNamespace(gain=flexible),
                        beyond=SimpleNamespace(gain=beyond, gap=gap),
                        left=Left(9.0, "deflection", sizes[0], 3.0, 0.0),
                        left_by_best=Left(9.0, "deflection", sizes[1], 12.0, 11.0))  # fmt: skip
    )


def test_a_sign_counts_by_the_share_of_it_that_an_effect_leaves():
    assert signs(30.0, flexible=400.0, beyond=40.0)[SMOOTH] < -2.0
    assert signs(30.0, flexible=400.0, beyond=300.0)[SMOOTH] > 2.0
    assert signs(4000.0, flexible=400.0, beyond=300.0)[SMOOTH] < -2.0
    assert signs(30.0, surprise=(900.0, 70.0))[BELIEF] < -2.0
    assert signs(30.0, surprise=(90.0, 70.0))[BELIEF] > 0.0
    assert signs(30.0, sizes=(5.0, 0.5))[SCATTER] < -2.0
    assert signs(30.0, sizes=(5.0, 4.0))[SCATTER] > 0.0
    # Smaller than the noise it says little, however sure it is.
    assert signs(1.0, beyond=36.0, gap=0.4)[SMOOTH] < 0.0


def weights_of(gains, signs=-5.0, **options):
    """Of effects that gain so much, each plain to see."""
    none, three = dict.fromkeys(gains, 0.0), dict.fromkeys(gains, 3.0)
    return Weights(gains, three, none, 5.0, signs, -5.0, **options)


def probabilities(gains, signs=-5.0, remains=0.0, **options):
    return weights_of(gains, signs, remains=remains, **options).probabilities()


def test_an_effect_that_leaves_what_was_to_be_explained_is_not_the_cause_whatever_it_gains():
    assert probabilities({"slack": 160.0}, 3.0, 3.0)["unexplained"] > 0.9
    # An event beside an effect that took the rest away may be a second cause.
    assert 0.3 < probabilities({"slack": 160.0}, 6.0, -4.0)["unexplained"] < 0.5


def test_the_better_of_two_is_named_and_one_that_is_nearly_as_good_stays_a_rival():
    singles = {"slack": 600.0, "latent_heat": 9.0, "residual_strain": 5.0}
    pairs = {"latent_heat+slack": 2000.0, "residual_strain+slack": 1900.0}
    assert probabilities(singles | pairs)["latent_heat+slack"] > 0.9
    close = probabilities({"latent_heat": 400.0, "opposing_wires": 392.0})
    assert close["latent_heat"] < 0.8 < sum(close[n] for n in list(close)[:2])
    assert probabilities({"latent_heat": 400.0, "opposing_wires": 300.0})["latent_heat"] > 0.98


def test_what_gains_must_do_so_with_each_record_and_everywhere():
    def latent_heat(gain, **options):
        return probabilities({"latent_heat": gain}, **options)["latent_heat"]

    assert latent_heat(9.0, records=1) == latent_heat(9.0, records=2) > 0.6
    assert latent_heat(9.0, records=4) < 0.6 < 0.9 < latent_heat(18.0, records=4)
    assert latent_heat(18.0) > 0.9 and latent_heat(18.0, unsteady={"latent_heat": 5.0}) < 0.5


# --- The stage of a gap.

RESISTANCE, LOSS = "wire.resistance", "wire.heat_transfer_coefficient"
STARTS = tuple(TRANSITIONS.values())
STROKE = "composite.deflection_per_strain"
NAMES = (RESISTANCE, LOSS, "wire.specific_heat", *STARTS, STROKE)


def stages(moved, **probabilities):
    """Of candidates, where recalibration has moved parameters by so many deviations."""
    x = np.array([*(moved.get(name, 0.0) for name in NAMES), 5.0])  # a shape, of no stage
    candidates = []
    for name, probability in probabilities.items():
        candidates.append(Candidate(name.replace("_and_", "+"), probability))
    search = SimpleNamespace(
        recalibrated=SimpleNamespace(unknowns=SimpleNamespace(bench_names=NAMES), x=x),
        ranked=["slack", "latent_heat"],
        gain={"slack": 9.0, "latent_heat": 5.0}.get,
    )
    return stages_of(candidates, search)


@pytest.mark.parametrize(("moved", "stage"), [
    ({RESISTANCE: 3.0, LOSS: 1.0, STROKE: 1.0}, "electrical"),
    ({RESISTANCE: 0.5, LOSS: -3.0, "wire.specific_heat": 2.0, STROKE: 2.0}, "thermal"),
    ({RESISTANCE: 1.5, STARTS[0]: 4.0, STARTS[3]: -2.5}, "transformation"),
    ({STROKE: -3.0, STARTS[1]: 1.5}, "mechanical"),
    # As far as believed, whatever their sum: that tells of no stage.
    (dict.fromkeys(STARTS, 1.2), ""),
])  # fmt: skip
def test_what_names_no_effect_has_the_stage_whose_parameters_moved_beyond_belief(moved, stage):
    found = stages(moved, recalibration=0.7, temperature_lag=0.2, no_gap=0.1)
    assert found == ({stage: 0.7, "sensor": 0.2} if stage else {"sensor": 0.2})
    # What nothing explains has that of the best effect else.
    assert stages(moved, unexplained=0.7, temperature_lag=0.3)[stage or "mechanical"] == 0.7
    assert stages(moved, slack=0.1, latent_heat=0.3, latent_heat_and_slack=0.6) == {
        "mechanical": 0.7,
        "thermal": 0.3,
    }


def test_an_effect_is_named_from_the_sum_of_what_holds_it_and_the_larger_one_first():
    pair, weights = "latent_heat+slack", weights_of({"latent_heat": 20.0, "slack": 90.0})
    alone = [Candidate("slack", 0.35), Candidate(pair, 0.3), Candidate("unexplained", 0.35)]
    assert verdict_of(alone) == "effect" and named(alone, weights) == ("slack",)
    both = [Candidate(pair, 0.7), Candidate("no_gap", 0.3)]
    assert verdict_of(both) == "effect" and named(both, weights) == ("slack", "latent_heat")
    open_still = [Candidate("slack", 0.55), Candidate("latent_heat", 0.45)]
    assert verdict_of(open_still) == "ambiguous" and named(open_still, weights) == ()
    benign = [Candidate("no_gap", 0.4), Candidate("recalibration", 0.35), Candidate("slack", 0.25)]
    assert verdict_of(benign) == "no_gap"


# --- What an experiment would settle.


def after(tellings, **gains):
    """Prospect of an experiment on effects that gain so much."""
    weights = weights_of(gains)
    return prospect(weights, weights.probabilities(), tellings)


def apart(distance, *names):
    telling = Telling(0.5 * distance**2, distance)
    return {(a, b): telling for a in names for b in names if a != b}


BOTH = ("slack", "residual_strain")
ALL = (*BOTH, "recalibration")


def test_a_tie_of_two_is_settled_where_they_differ_and_a_rival_does_not_stay_in_the_way():
    tie = {"slack": 14.0, "residual_strain": 13.5}
    told = after(apart(8.0, *ALL), **tie)
    assert told.named > 0.95 and told.given > 0.9
    told = after(apart(8.0, *ALL) | apart(0.5, *BOTH), **tie)
    before = after(apart(0.0, *ALL), **tie)
    assert told.named < 0.1 and told.given == pytest.approx(before.given, abs=0.1)
    rival = {"slack": 14.0, "residual_strain": 3.0, "transition_drift": 14.0}
    assert after(apart(1e3, *ALL), **rival).named < 0.1
    assert after(apart(1e3, *ALL, "transition_drift"), **rival).named > 0.9
