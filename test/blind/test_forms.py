"""Forms: of every effect three, drawn for every case of the new seeds and named on its label."""

import pytest

from examination.blind.cases import EFFECTS, IN_FORMS, draw_cases
from examination.blind.make import make_label, size
from examination.check.effects import claims_of
from examination.check.forms import try_forms

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


@pytest.mark.slow
def test_a_label_names_forms_and_says_what_the_given_records_can_tell():
    assert try_forms("slack", "hard", "soft", 0) > 3.0
    case = next(c for c in draw_cases(3000, 60, "force") if c.card.effects == ("supply_drop",))
    sized = size(case)
    both, one = make_label(case, sized), make_label(case, sized, ("record",))
    assert both["forms"]["supply_drop"] == case.forms["supply_drop"]
    assert both["transformation_law"] == (both["law_distance"] > 2.0)
    assert one["severity"] == max(one["gap"]["record"].values()) <= both["severity"]
    assert one["separation"]["distance"] < both["separation"]["distance"]


@pytest.mark.slow
def test_the_numbers_of_an_effect_are_compared_with_the_best_fit_without_noise():
    case = next(c for c in draw_cases(1000, 60) if c.card.kind == "single")
    claims = claims_of(case)
    assert len(claims) == 3 and not any(claim.same_meaning for claim in claims)
    assert all(abs(claim.value - claim.true) < 3.0 * claim.std for claim in claims)
