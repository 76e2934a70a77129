"""Forms: of every effect three, drawn for every case of the new seeds and named on its label."""

from dataclasses import replace

import pytest

from examination.blind.cases import EFFECTS, IN_FORMS, QUANTITIES, draw_cases
from examination.blind.make import law_distances, make_label, size
from examination.check.forms import try_forms
from sma_bench.parameters.parameters import load_kind

pytest.importorskip("numba", reason="whole records take minutes uncompiled")


def test_every_effect_has_three_forms_and_new_seeds_draw_them():
    assert all(len(symptom.forms) >= 3 for symptom in EFFECTS.values())
    assert not any(case.forms or case.fixed for case in draw_cases(2699, 20))
    drawn = {name: set() for name in EFFECTS}
    for case in draw_cases(2700, 60):
        for name, form in case.forms.items():
            drawn.setdefault(name, set()).add(form)
    assert all(drawn[name] == set(EFFECTS[name].forms) for name in EFFECTS)
    assert len(drawn["kinetics"]) == len(drawn["noise"]) == 3
    assert 2699 not in IN_FORMS and 3000 in IN_FORMS


def test_grains_that_are_spread_have_inner_loops_which_a_smoother_law_has_not():
    case = next(c for c in draw_cases(3000, 20, "force") if c.card.signals == "all")
    nothing = law_distances(case, {}, QUANTITIES["all"])
    smooth = law_distances(case, {"kinetics_smoothness": 0.8}, QUANTITIES["all"])
    grains = law_distances(case, {"grain_spread": 5.0}, QUANTITIES["all"])
    assert nothing == (0.0, 0.0)
    assert smooth[1] < 0.1 < smooth[0] and 1.0 < grains[1] < grains[0] + 0.1
    card = replace(case.card, kind="none", effects=(), targets=(), mild_kinetics=True)
    case = replace(case, card=card, mild_gap=9.0)
    label = make_label(case, size(case))
    assert label["inner_loops"] == (label["loops_distance"] > 1.0)
    older = make_label(replace(case, seed=2800), size(case))  # as it was sat
    assert "inner_loops" not in older and older["law_distance"] == label["law_distance"]


@pytest.mark.slow
def test_a_label_names_forms_and_says_what_the_given_records_and_numbers_can_tell():
    assert try_forms("slack", "hard", "soft", 0) > 3.0
    case = next(c for c in draw_cases(3000, 60) if c.card.effects == ("slack",))
    sized = size(case)
    both, one = make_label(case, sized), make_label(case, sized, ("record",))
    assert both["forms"]["slack"] == case.forms["slack"]
    assert both["transformation_law"] == (both["law_distance"] > 2.0)
    assert one["severity"] == max(one["gap"]["record"].values()) <= both["severity"]
    assert one["separation"]["distance"] < both["separation"]["distance"]
    vague = {n: 30.0 * std for n, std in case.nominal.given_uncertainty.items()}
    unsure = make_label(case, sized, ("record",), case.nominal.replace({}, vague))
    sure, unsure = (lab["separation"]["distances"]["recalibration"] for lab in (one, unsure))
    assert unsure < 0.9 * sure


def test_a_label_takes_no_zero_for_evidence_and_no_bench_for_a_straight_line():
    """A slack that the preload takes up at once is the sensor's zero."""
    cases = draw_cases(3000, 60, "spring")
    slack = next(c for c in cases if c.card.effects == ("slack",))
    sized = size(slack)
    new, older = make_label(slack, sized), make_label(replace(slack, seed=2900), sized)
    assert older["separation"]["distance"] > 5.0 > new["separation"]["distance"]
    assert not new["distinguishable"] and new["severity"] == older["severity"]
    bent = next(c for c in cases if c.card.effects == ("stress_dependent_transition",))
    sized = size(bent)
    new, older = (make_label(replace(bent, seed=s), sized)["separation"] for s in (3000, 2900))
    assert new["distances"]["recalibration"] < 0.95 * older["distances"]["recalibration"]


def test_clamped_wires_are_dealt_with_what_their_current_and_temperature_show():
    assert "clamped" not in {load_kind(c.truth) for c in draw_cases(2799, 40, "all")}
    assert "clamped" in {load_kind(c.truth) for c in draw_cases(2800, 40, "all")}
    cases = draw_cases(3000, 40, "clamped")
    assert {c.card.signals for c in cases} == {"all", "without current"}
    underfill = {c.forms["temperature_underfill"] for c in cases}
    assert underfill == {"surface beside"}  # nothing moves, no wire lies opposite
    wrong = {name for c in cases for name in c.wrong}
    assert wrong <= {"wire.resistance", "wire.heat_transfer_coefficient", "wire.specific_heat",
                     "environment.ambient_temperature"}
    case = next(c for c in cases if c.card.effects == ("ambient_drift",) and c.card.targets[0])
    sized = size(case)
    label = make_label(case, sized)
    assert label["severity"] == pytest.approx(case.card.targets[0], rel=0.3)
    assert set(label["gap"]["record"]) <= {"wire.current", "wire.temperature"}
    seen = {signal.name for signal in case.signals(sized.features, "record")}
    assert seen <= {"wire.voltage", "wire.current", "wire.temperature"}
