"""Forms: of every effect three, drawn for every case of the new seeds and named on its label."""

import json
from dataclasses import replace

import numpy as np
import pytest
import yaml

from examination.blind import learn
from examination.blind.cases import EFFECTS, IN_FORMS, QUANTITIES, draw_cases
from examination.blind.make import law_distances, make_label, size
from examination.blind.reality import happen
from examination.blind.rigs import COMMAND_PERIOD, world_of
from examination.check.forms import try_forms
from sma_bench.errors import InputError
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


def test_a_form_is_named_on_the_label_and_does_what_another_does_not():
    case = next(c for c in draw_cases(3000, 60) if c.card.effects == ("slack",))
    label = make_label(case, size(case))
    assert label["forms"]["slack"] == case.forms["slack"]
    assert label["transformation_law"] == (label["law_distance"] > 2.0)
    assert try_forms("slack", "hard", "soft", 0) > 3.0


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


def test_a_label_says_what_the_given_records_and_numbers_can_tell():
    case = next(c for c in draw_cases(3000, 60) if c.card.effects == ("slack",))
    sized = size(case)
    both, one = make_label(case, sized), make_label(case, sized, ("record",))
    assert one["severity"] == max(one["gap"]["record"].values()) <= both["severity"]
    assert one["separation"]["distance"] < both["separation"]["distance"]
    vague = {n: 30.0 * std for n, std in case.nominal.given_uncertainty.items()}
    unsure = make_label(case, sized, ("record",), case.nominal.replace({}, vague))
    assert unsure["separation"]["distances"]["recalibration"] < (
        0.9 * one["separation"]["distances"]["recalibration"]
    )


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
                     "environment.ambient_temperature"}  # fmt: skip
    case = next(c for c in cases if c.card.effects == ("ambient_drift",) and c.card.targets[0])
    sized = size(case)
    label = make_label(case, sized)
    assert label["severity"] == pytest.approx(case.card.targets[0], rel=0.3)
    assert set(label["gap"]["record"]) <= {"wire.current", "wire.temperature"}
    seen = {signal.name for signal in case.signals(sized.features, "record")}
    assert seen <= {"wire.voltage", "wire.current", "wire.temperature"}


def test_off_every_setting_does_nothing():
    """The single form of old seeds is what a world without settings is."""
    case = draw_cases(1000, 4)[0]
    time = case.drives["record"].grid(COMMAND_PERIOD)
    volts = case.drives["record"].voltage(time, case.sides)
    plain = happen(world_of(case.truth, {"slack": 0.004, "supply_resistance": 0.2}), time, volts)
    off = {"slack": 0.004, "supply_resistance": 0.2, "slack_soft": 0.0, "supply_memory": 0.0}
    same = happen(world_of(case.truth, off), time, volts)
    assert np.array_equal(plain.deflection, same.deflection)


# --- The decision learnt from what is known of cases.


def line(index, rng):
    """A made-up case whose right effect gains most, takes most away and is steady."""
    names = ("slack", "latent_heat", "supply_drop")
    true = names[index % 3]
    candidates = {}
    for name in names:
        right = name == true
        candidates[name] = {
            "gain": float(np.exp(rng.normal(5.0 if right else 3.0, 1.0))), "gap": 10.0,
            "parts": {name: 10.0}, "own": 1.0,
            "unsteady": float(rng.uniform(0.5, 2.0) if right else rng.uniform(1.0, 6.0)),
        }  # fmt: skip
    facts = {
        "candidates": candidates, "moved": 5.0, "surprise": 30.0,
        "as_stated": -50.0, "ratio": 1.0, "outlier": 3.0, "beyond": 5.0, "input": 2.0, "records": 2,
    }  # fmt: skip
    form = list(EFFECTS[true].forms)[(index // 3) % 3]
    label = {"kind": "single", "effects": [true], "severity": 10.0, "severities": {true: 10.0},
             "forms": {true: form}, "distinguishable": True, "inner_loops": False,
             "beyond_parameters": 50.0}  # fmt: skip
    return {"index": index, "label": label, "facts": facts, "library": "none",
            "today": dict.fromkeys((*names, "recalibration", "no_gap", "unexplained"), 1 / 6)}


def test_weights_are_learnt_with_their_signs_and_predict_left_out_forms(tmp_path, capsys):
    rng = np.random.default_rng(1)
    path = tmp_path / "features.jsonl"
    path.write_text("".join(json.dumps(line(k, rng)) + "\n" for k in range(120)))
    learn.learn([path], tmp_path / "weights.yaml", tmp_path / "learnt.md")
    said = capsys.readouterr().out
    assert said.strip() in (tmp_path / "learnt.md").read_text()
    row = next(s for s in said.splitlines() if "log probability of the truth" in s)
    today, forms, rigs = map(float, row.strip("| ").split(" | ")[-3:])
    assert abs(today - np.log(1 / 6)) < 1e-3 and min(forms, rigs) > -0.8
    weights = learn.fit_weights([learn.Known(line(k, rng)) for k in range(90)], 1.0, 0.1)[0]
    known = dict(zip(learn.NAMES, weights, strict=True))
    assert known["effect.lead"] + known["effect.gain"] > 0.0 >= known["effect.unsteady"]
    table = yaml.safe_load((tmp_path / "weights.yaml").read_text())
    assert 0.0 < table["least"] < 1.0 and set(table["weights"]) == set(learn.NAMES)


def test_features_go_on_where_they_ended_and_refuse_another_library(tmp_path, capsys):
    path = tmp_path / "features.jsonl"
    learn.keep_features(path, 3002, 1)
    kept = path.read_text()
    learn.keep_features(path, 3002, 1)
    assert path.read_text() == kept and kept.count("\n") == 1
    known = json.loads(kept)
    assert abs(sum(known["today"].values()) - 1.0) < 1e-3
    assert learn.Known(known).right.any()
    path.write_text(kept.replace(known["library"], "0" * 16))
    with pytest.raises(InputError, match="another library"):
        learn.keep_features(path, 3002, 1)
