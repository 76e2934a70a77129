"""Cases are dealt in balance, and what is drawn knows nothing of what is dealt."""

from collections import Counter

import numpy as np
import pytest

from examination.blind.case_files import STAGE_OF
from examination.blind.cases import EFFECTS, OUTSIDE, SHARES, deal, draw_cases, split_of
from examination.blind.reality import BY_NAME
from examination.blind.rigs import (
    BELIEVED,
    COMMAND_PERIOD,
    WRONG_BY,
    draw_drives,
    draw_nominal,
    draw_truth,
    hottest,
    phases,
)
from sma_bench.physics.effects import EFFECTS as LIBRARY


def cards(n=400, seed=5):
    return deal(n, np.random.default_rng(seed))


def test_the_check_and_the_library_speak_of_the_same_effects_and_stages():
    assert {name: effect.stage for name, effect in LIBRARY.items()} == STAGE_OF


def test_every_effect_of_the_contract_and_eleven_outside_occur():
    assert set(EFFECTS) == set(STAGE_OF)
    assert len(OUTSIDE) >= 6
    dealt = Counter(name for card in cards() for name in card.effects)
    assert set(dealt) == {*EFFECTS, *OUTSIDE}
    for symptom in OUTSIDE.values():
        assert all(BY_NAME[move.feature].outside for move in symptom.moves)


def test_kinds_have_their_shares():
    kinds = Counter(card.kind for card in cards())
    assert kinds == {kind: pytest.approx(share * 400, abs=1) for kind, share in SHARES.items()}
    assert sum(len(deal(n, np.random.default_rng(n))) for n in range(1, 12)) == 66


def test_singles_are_balanced_over_effects_severities_and_signals():
    singles = [card for card in cards() if card.kind == "single"]
    counts = Counter(card.effects[0] for card in singles)
    assert max(counts.values()) - min(counts.values()) <= 1
    for name in EFFECTS:
        own = [card for card in singles if card.effects == (name,)]
        assert len({card.targets[0] for card in own}) >= 5
        paper = sum(card.signals == "paper" for card in own)
        if EFFECTS[name].in_deflection:
            assert 3 <= paper <= len(own) - 3
        else:
            assert paper == 0


def test_noise_and_signals_are_dealt_alike_to_every_kind():
    for kind in SHARES:
        own = [card for card in cards() if card.kind == kind]
        noises = Counter(card.noise for card in own)
        assert max(noises.values()) - min(noises.values()) <= 1
        assert sum(card.signals == "paper" for card in own) == pytest.approx(len(own) / 2, abs=1)


def test_a_quarter_of_the_cases_without_effect_have_other_kinetics():
    mild = [card for card in cards() if card.mild_kinetics]
    assert {card.kind for card in mild} == {"none"}
    assert len(mild) == 16


def test_pairs_are_of_two_different_effects():
    assert all(len(set(card.effects)) == 2 for card in cards() if card.kind == "pair")


def test_seeds_belong_to_their_split():
    names = [split_of(seed) for seed in (999, 1000, 1999, 2000, 2999, 3000)]
    assert names == ["open", "development", "development", "frozen-test", "frozen-test", "open"]


def test_beliefs_are_wrong_by_one_draw_of_what_they_state():
    errors = []
    for seed in range(150):
        rng = np.random.default_rng(seed)
        truth = draw_truth(rng)
        nominal = draw_nominal(truth, rng)
        assert nominal.given_uncertainty.keys() >= set(BELIEVED)
        errors += [(nominal[n] - truth[n]) / nominal.std(n) for n in BELIEVED]
    assert np.std(errors) == pytest.approx(1.0, abs=0.05)
    assert np.mean(errors) == pytest.approx(0.0, abs=0.07)


def test_mistaken_owners_are_wrong_by_many_standard_deviations():
    mistaken = [c for c in draw_cases(3001, 200) if c.card.kind == "recalibration"]
    assert len(mistaken) == 16
    for case in mistaken:
        assert 1 <= len(case.wrong) <= 3
        for name in case.wrong:
            error = abs(case.nominal[name] - case.truth[name]) / case.nominal.std(name)
            assert 0.8 * WRONG_BY[0] < error < 1.35 * WRONG_BY[1]


def test_drives_rest_between_pulses_end_in_time_and_reach_both_sides():
    for seed in range(40):
        rng = np.random.default_rng(seed)
        truth = draw_truth(rng)
        drives = draw_drives(truth, rng)
        assert drives["record"].family != drives["hold_out"].family
        for drive in drives.values():
            volts = drive.voltage(drive.grid(COMMAND_PERIOD))
            assert volts.max() < 3.2 and volts.min() >= 0.0
            assert not ((volts[:, 0] > 0) & (volts[:, 2] > 0)).any()
            assert {pulse.side for pulse in drive.pulses} == {"front", "back"}
            assert drive.pulses[-1].times[-1] < drive.duration <= 120.0
            phase, side = phases(drive)
            assert set(phase) == {"initial", "drive", "rest"}
            assert phase[0] == "initial" and side[0] == "" and phase[-1] == "rest"


def test_first_pulses_are_hot_enough_to_finish():
    rng = np.random.default_rng(9)
    truth = draw_truth(rng)
    loss = truth["wire.heat_transfer_coefficient"] * truth["wire.surface_area"]
    for drive in draw_drives(truth, rng).values():
        for pulse in drive.pulses[:2]:
            power = max(pulse.volts) ** 2 / truth["wire.resistance"]
            steady = truth["environment.ambient_temperature"] + power / loss
            assert steady > hottest(truth) + 5.0
