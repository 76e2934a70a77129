"""Every effect can be seen, where it acts, and is sized for its target."""

from functools import cache

import numpy as np
import pytest

from examination.blind.cases import (
    ALL,
    EFFECTS,
    OUTSIDE,
    QUANTITIES,
    Card,
    amount_for,
    draw,
    draw_case,
)
from examination.blind.pages import write_symptom
from examination.blind.pages import write_symptoms_index as write_page
from examination.blind.reality import BY_NAME, World
from examination.blind.rigs import COARSE, RECORDS, Stage, gaps, quantity_of, where
from examination.blind.severity import Separation, measured, separation, size

SYMPTOMS = {**EFFECTS, **OUTSIDE}
PNG_LIMIT = 60_000


@cache
def rig(name="", target=None, signals=ALL):
    card = Card("single" if name else "none", (name,) * bool(name), (target,) * bool(name),
                signals, "white")  # fmt: skip
    case = draw_case(11, 0, card, "0001")
    return case, Stage(case.truth, case.sensors, case.drives)


def drawn(name):
    case, stage = rig()
    return draw(SYMPTOMS[name], case.stream("effect"), stage.peak_current())


@pytest.mark.parametrize("name", SYMPTOMS)
def test_effect_shows_and_grows_with_its_amount(name):
    _, stage = rig()
    effect = drawn(name)
    low, high = SYMPTOMS[name].natural
    small, large = (
        measured(stage, effect.features({}, amount), {}, fine=COARSE) for amount in (low, high)
    )
    assert small > 0.02
    assert large > 1.5 * small
    assert large > 1.0


@pytest.mark.parametrize("name", SYMPTOMS)
def test_deflection_alone_shows_what_is_said_to_show_there(name):
    _, stage = rig()
    features = drawn(name).features({}, SYMPTOMS[name].natural[1])
    one, two = (stage.read(f, "record", COARSE) for f in (features, {}))
    seen = gaps(one, two, stage.sensors, ("deflection",))["deflection"] > 0.0
    assert seen == SYMPTOMS[name].in_deflection


@pytest.mark.parametrize("name", SYMPTOMS)
def test_features_stay_within_what_a_world_takes(name):
    case, _ = rig()
    for amount in (SYMPTOMS[name].natural[0], 1.5 * SYMPTOMS[name].natural[1]):
        world = World(case.truth, drawn(name).features({}, amount))
        assert world.feature(SYMPTOMS[name].moves[0].feature) != BY_NAME[
            SYMPTOMS[name].moves[0].feature
        ].off


@pytest.mark.parametrize("power", [0.5, 1.0, 2.0])
@pytest.mark.parametrize("target", [1.0, 16.0])
def test_amount_is_found_for_any_power_law(power, target):
    effect = drawn("latent_heat")

    def gap(amount):
        return 40.0 * (amount / 25e3) ** power

    amount = amount_for(effect, target, gap)
    assert gap(amount) == pytest.approx(target, rel=0.13)


def test_amount_beyond_what_is_natural_is_not_asked_for():
    amount = amount_for(drawn("latent_heat"), 16.0, lambda amount: amount / 1e6)
    assert amount == pytest.approx(1.5 * 25e3)


@pytest.mark.parametrize("target", [2.0, 8.0])
def test_measured_severity_is_near_its_target(target):
    case, stage = rig("viscoelastic_matrix", target)
    found = size(case, stage)
    assert measured(stage, found.features, found.base) == pytest.approx(target, rel=0.15)
    assert found.nuisance_gap <= 0.3
    assert measured(stage, found.base, {}) == pytest.approx(found.nuisance_gap)


def test_mild_kinetics_are_measured():
    card = Card("none", (), (), ALL, "white", mild_kinetics=True)
    case = draw_case(11, 1, card, "0002")
    found = size(case, Stage(case.truth, case.sensors, case.drives))
    assert found.kinetics_gap == pytest.approx(case.mild_gap, rel=0.6)
    assert found.features == found.base


def test_drift_of_the_tip_shows_in_the_deflection_most_while_nothing_is_driven():
    _, stage = rig()
    one, two = (stage.read(f, "record") for f in ({"deflection_drift": 1e-3}, {}))
    table = where(one, two, stage, "record", QUANTITIES[ALL])
    assert sum(row["share"] for row in table) == pytest.approx(1.0)
    assert {row["signal"] for row in table if row["share"] > 0} == {"deflection"}


def separated(name, amount, own=None):
    _, stage = rig()
    features = drawn(name).features({}, amount)
    one, two = ({record: stage.read(f, record) for record in RECORDS} for f in (features, {}))
    return separation(stage, {}, one, two, QUANTITIES[ALL], name if own is None else own)


@cache
def asymmetric_by_2_percent():
    return separated("side_asymmetry", 0.02)


def test_an_effect_that_is_its_own_rival_is_not_distinguishable():
    mine = separated("side_asymmetry", 0.02, own="")
    assert mine.rival == "side_asymmetry"
    assert not mine.distinguishable
    others = asymmetric_by_2_percent()
    assert others.distance > 5.0 * mine.distance
    assert others.distinguishable


def test_distance_grows_with_the_size():
    larger = separated("side_asymmetry", 0.08)
    assert larger.distance == pytest.approx(4.0 * asymmetric_by_2_percent().distance, rel=0.2)


def test_squared_distance_of_25_is_the_limit():
    assert not Separation({"a": 4.9, "b": 9.0}).distinguishable
    assert Separation({"a": 5.1, "b": 9.0}).distinguishable


def test_figure_shows_with_and_without_in_a_small_file(tmp_path):
    seen = write_symptom(tmp_path, "residual_strain")
    write_page(tmp_path, [seen], 1)
    assert 5_000 < (tmp_path / seen.file).stat().st_size < PNG_LIMIT
    assert max(seen.gap, key=lambda n: seen.gap[n]) == "deflection"
    assert 80.0 < seen.gap["deflection"] < 160.0
    assert quantity_of(next(iter(seen.gap))) == "current"
    text = (tmp_path / "README.md").read_text()
    assert "![residual_strain](residual_strain.png)" in text
    assert np.isclose(seen.gap["deflection"], float(text.split("deflection ")[-1][:4]), atol=0.1)
