"""From features and gains to probabilities and stages, without a fit; and the outcome of an
experiment by the same rule."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from sma_bench.diagnose import decision, search
from sma_bench.diagnose.decision import (
    NAMES,
    SIGNS,
    Candidate,
    Utilities,
    learnt,
    named,
    verdict_of,
)
from sma_bench.diagnose.diagnosis import stages_of
from sma_bench.diagnose.next_experiment import Separation, prospect
from sma_bench.diagnose.sizes import DecisionInputs, Facts
from sma_bench.parameters.parameter import TRANSITIONS

# How much more it scatters in motion than at rest, and the largest outlier.
QUIET, LOUD = (0.5, 3.5), (60.0, 12.0)


def of_effect(gain, gap=20.0, partner=None, unsteady=1.0):
    """A clearly visible effect, with a size within its prior."""
    return Facts(gain, gap, unsteady, 0.8, {"better": gap, "worse": partner or gap})


def weighed(gains, beyond=0.0, left=QUIET, records=2):
    """Effects with these gains, on a bench that is otherwise as stated."""
    facts = {}
    for name, gain in gains.items():
        own = gain if isinstance(gain, Facts) else of_effect(gain)
        parts = dict(zip(name.split("+"), own.parts.values(), strict=False))
        facts[name] = replace(own, parts=parts)
    return DecisionInputs(facts, 1.0, 10.0, 5.0, *left, beyond, beyond, records)


def utilities(gains, **options):
    return Utilities(weighed(gains, **options))


def probabilities(gains, **options):
    own = utilities(gains, **options)
    return dict(zip(own.names, own.probabilities().tolist(), strict=True))


def test_the_table_of_weights_has_every_feature_with_an_error_and_the_sign_that_physics_demands():
    table = learnt()
    assert set(table.weights) == set(NAMES)
    assert all(error > 0.0 for _, error in table.weights.values())
    for name in NAMES:
        kind, _, feature = name.partition(".")
        assert table.weights[name][0] * SIGNS[kind][feature] >= 0.0, name
    assert 0.0 < table.lapse < 0.3 and 0.0 < table.least < 0.2


def test_probabilities_sum_to_one_and_match_the_reported_nats():
    own = utilities({"slack": 40.0, "latent_heat": 30.0, "latent_heat+slack": 60.0})
    shares, lapse = own.probabilities(), learnt().lapse
    assert shares.sum() == pytest.approx(1.0)
    sums = np.array([sum(row.values()) for row in own.nats().values()])
    raw = (shares - lapse / len(shares)) / (1.0 - lapse)
    assert np.diff(np.log(raw)) == pytest.approx(np.diff(sums), abs=1e-6)


def test_the_better_of_two_is_named_and_one_that_is_nearly_as_good_stays_probable():
    assert probabilities({"slack": 600.0, "latent_heat": 9.0})["slack"] > 0.8
    close = probabilities({"latent_heat": 400.0, "opposing_wires": 392.0})
    assert close["latent_heat"] < 0.8 < sum(close[n] for n in list(close)[:2])
    assert probabilities({"latent_heat": 400.0})["latent_heat"] > close["latent_heat"] + 0.2
    pair = {"slack": 60.0, "latent_heat": 50.0}
    together = {**pair, "latent_heat+slack": of_effect(700.0, partner=12.0)}
    assert probabilities(together)["latent_heat+slack"] > 0.8


def test_a_bent_curve_of_the_sensor_that_explains_more_is_a_rival_of_every_effect():
    facts = weighed({"opposing_wires": 500.0})
    alone, bent = Utilities(facts), Utilities(replace(facts, curve=900.0))
    assert alone.probabilities()[0] > 0.9 and bent.probabilities()[0] < 0.6
    assert bent.probabilities()[-1] > 5.0 * alone.probabilities()[-1]  # unexplained


def test_an_effect_that_contributes_less_than_a_tenth_of_its_partner_is_a_remark():
    singles = {"slack": 300.0, "latent_heat": 9.0}
    for partner, found in ((1.9, {"slack+latent_heat": ("slack", "latent_heat")}), (2.1, {})):
        pair = {"slack+latent_heat": of_effect(400.0, partner=partner)}
        assert weighed(singles | pair).remarks() == found


def test_a_negligible_gain_is_no_cause_and_a_large_residual_means_unexplained():
    faint = probabilities({"slack": 1.0, "latent_heat": 0.5})
    assert faint["recalibration"] + faint["no_gap"] > 0.6 > 0.2 > faint["slack"]
    left = probabilities({"slack": 30.0}, beyond=900.0, left=LOUD)
    assert left["unexplained"] > 0.6 > left["slack"]


def test_gains_count_less_with_more_records_unsteady_or_small_sizes_and_more_effects():
    def slack(gain, others=(), **options):
        found = of_effect(gain, **options.pop("own", {}))
        return probabilities({"slack": found, **dict.fromkeys(others, -3.0)}, **options)["slack"]

    assert slack(20.0) == slack(20.0, records=1) > slack(20.0, records=6)
    assert slack(20.0) > slack(20.0, own={"unsteady": 4.0})
    assert slack(20.0) > slack(20.0, own={"gap": 0.3})
    assert slack(20.0, [f"effect_{k}" for k in range(60)]) < slack(20.0)
    gains = [slack(g) for g in (0.0, 5.0, 20.0, 80.0, 320.0)]
    assert gains == sorted(gains) and gains[0] < 0.15 < 0.8 < gains[-1]


# --- The stage of a gap.

RESISTANCE, LOSS = "wire.resistance", "wire.heat_transfer_coefficient"
STARTS = tuple(TRANSITIONS.values())
STROKE = "composite.deflection_per_strain"
NUMBERS = (RESISTANCE, LOSS, "wire.specific_heat", *STARTS, STROKE)


def stages(moved, inputs=None, **probabilities):
    """Stages of candidates, if recalibration has moved parameters by these deviations."""
    x = np.array([*(moved.get(name, 0.0) for name in NUMBERS), 5.0])  # a shape, without a stage
    candidates = []
    for name, probability in probabilities.items():
        candidates.append(Candidate(name.replace("_and_", "+"), probability))
    search = SimpleNamespace(
        recalibrated=SimpleNamespace(unknowns=SimpleNamespace(bench_names=NUMBERS), x=x),
        ranked=["slack", "latent_heat"],
        gain={"slack": 9.0, "latent_heat": 5.0}.get,
        inputs={stage: SimpleNamespace(gain=gain) for stage, gain in (inputs or {}).items()},
    )
    return stages_of(candidates, search)


@pytest.mark.parametrize(("moved", "stage"), [
    ({RESISTANCE: 3.0, LOSS: 1.0, STROKE: 1.0}, "electrical"),
    ({RESISTANCE: 0.5, LOSS: -3.0, "wire.specific_heat": 2.0, STROKE: 2.0}, "thermal"),
    ({RESISTANCE: 1.5, STARTS[0]: 4.0, STARTS[3]: -2.5}, "transformation"),
    ({STROKE: -3.0, STARTS[1]: 1.5}, "mechanical"),
    # Each within its prior, whatever their sum: no stage.
    (dict.fromkeys(STARTS, 1.2), ""),
])
def test_recalibration_has_the_stage_whose_parameters_moved_beyond_their_priors(moved, stage):
    found = stages(moved, recalibration=0.7, temperature_lag=0.2, no_gap=0.1)
    assert found == ({stage: 0.7, "sensor": 0.2} if stage else {"sensor": 0.2})
    # `unexplained` has the same stage, or else that of the best effect.
    assert stages(moved, unexplained=0.7, temperature_lag=0.3)[stage or "mechanical"] == 0.7
    # Or the stages at which a smooth input gains, by its gain.
    inputs = {"electrical": 400.0, "thermal": 4.0, "sensor": 0.0}
    shares = stages(moved, inputs, unexplained=0.7, temperature_lag=0.3)
    assert shares["electrical"] > 0.69 and shares["sensor"] == 0.3
    assert stages(moved, slack=0.1, latent_heat=0.3, latent_heat_and_slack=0.6) == {
        "mechanical": 0.7,
        "thermal": 0.3,
    }


def test_an_effect_is_named_by_its_total_probability_and_the_larger_gain_first():
    pair, weighed = "latent_heat+slack", utilities({"latent_heat": 20.0, "slack": 90.0})
    alone = [Candidate("slack", 0.35), Candidate(pair, 0.3), Candidate("unexplained", 0.35)]
    assert verdict_of(alone) == "effect" and named(alone, weighed) == ("slack",)
    both = [Candidate(pair, 0.7), Candidate("no_gap", 0.3)]
    assert verdict_of(both) == "effect" and named(both, weighed) == ("slack", "latent_heat")
    open_still = [Candidate("slack", 0.55), Candidate("latent_heat", 0.45)]
    assert verdict_of(open_still) == "ambiguous" and named(open_still, weighed) == ()
    benign = [Candidate("no_gap", 0.4), Candidate("recalibration", 0.35), Candidate("slack", 0.25)]
    assert verdict_of(benign) == "no_gap"


# --- The outcome of an experiment.


def after(separations, **gains):
    """Prospect of an experiment on effects with these gains."""
    return prospect(utilities(gains), probabilities(gains), separations)


def apart(distance, *names):
    separation = Separation(0.5 * distance**2, distance)
    return {(a, b): separation for a in names for b in names if a != b}


BOTH = ("slack", "residual_strain")
ALL = (*BOTH, "recalibration")


def test_an_experiment_settles_a_tie_only_if_it_separates_all_causes():
    tie = {"slack": 12.0, "residual_strain": 11.5}
    now, settled = probabilities(tie), after(apart(8.0, *ALL), **tie)
    possible = sum(now[name] for name in (*ALL, "no_gap"))
    assert settled.named == pytest.approx(possible, abs=1e-6) and settled.given > 0.8
    partly = after(apart(8.0, *ALL) | apart(0.5, *BOTH), **tie)
    before = after(apart(0.0, *ALL), **tie)
    # Only recalibration or no gap could be named, neither of both.
    assert partly.named < now["recalibration"] + now["no_gap"] + 0.01
    assert before.named == 0.0 and partly.given < settled.given - 0.1
    rival = {"slack": 14.0, "residual_strain": 3.0, "transition_drift": 14.0}
    assert after(apart(1e3, *ALL), **rival).named < 0.1
    assert after(apart(1e3, *ALL, "transition_drift"), **rival).named > 0.9


def test_candidates_stay_complete_if_another_law_replaces_recalibration(monkeypatch):
    monkeypatch.setattr(decision, "law_of", lambda fitted: (10.0, 50.0, {}))
    shares = {"recalibration": 0.6, "slack": 0.3, "unexplained": 0.06, "no_gap": 0.04}
    given = [
        Candidate(name, p, gap_over_noise=8.0, fit=None if name == "unexplained" else object())
        for name, p in shares.items()
    ]
    found = {one.name: one.probability for one in decision.with_law(given)}
    assert found == {"transformation_law": 0.6, "slack+transformation_law": 0.3,
                     "unexplained": 0.06, "no_gap": 0.04, "recalibration": 0.0}


def test_a_spot_sees_wires_of_the_other_side_only_where_there_are_two():
    for sides, seen in ((("front",), False), (("front", "back"), True)):
        record = SimpleNamespace(before=None, sides=sides)
        assert ("opposite" in search._forms("temperature_underfill", [record])) == seen
