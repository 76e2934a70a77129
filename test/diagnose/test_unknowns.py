"""What a fit may move: it begins at what is believed, and comes back from its own numbers."""

import numpy as np
import pytest
from planted import believed

from sma_bench.estimation.unknowns import (
    BACK,
    FRONT,
    SHAPES,
    number_of_effect,
    unknowns_of_records,
)
from sma_bench.physics.effects import EFFECTS

QUANTITIES = ("current", "temperature", "deflection")
NUMBERS = [number for effect in EFFECTS.values() for number in effect.parameters]


@pytest.mark.parametrize("spread, tail", [(0.0, 0.0), (2.0, 0.15), (20.0, 0.9)])
def test_no_deviation_is_what_is_believed(spread, tail):
    given = {"wire.transition_spread": spread, "wire.transition_tail": tail}
    unknowns = unknowns_of_records(believed().replace(given), QUANTITIES)
    x = np.zeros(unknowns.baseline)
    found = unknowns.parameters(x)
    assert {name: found[name] for name in given} == given
    low, high = unknowns.bounds()
    assert np.all((low <= x) & (x <= high))


def test_a_shape_moves_by_its_deviation_and_stays_within_its_range():
    unknowns = unknowns_of_records(believed(), QUANTITIES)
    for k, (name, (std, _, high)) in enumerate(SHAPES.items(), unknowns.bench):
        x = np.zeros(unknowns.baseline)
        x[k] = 0.5
        assert unknowns.parameters(x)[name] == pytest.approx(0.5 * std)
        x[k] = 1e3
        assert unknowns.parameters(x)[name] == high


@pytest.mark.parametrize("number", NUMBERS, ids=[n.name for n in NUMBERS])
def test_an_effects_number_comes_back_from_its_deviation(number):
    unknown = number_of_effect(number)
    assert unknown.value(0.0) == number.default
    for x in (0.2, 0.7):
        assert unknown.x_of(unknown.value(x)) == pytest.approx(x)


def test_sides_believed_alike_are_recalibrated_together():
    unknowns = unknowns_of_records(believed(), QUANTITIES)
    assert BACK not in unknowns.bench_names
    x = np.zeros(unknowns.baseline)
    x[unknowns.bench_names.index(FRONT)] = 2.0
    moved = unknowns.parameters(x)
    assert moved[FRONT] == moved[BACK] > 1.05 * believed()[FRONT]


def test_sides_believed_to_differ_are_recalibrated_apart():
    unknowns = unknowns_of_records(believed().replace({BACK: 5.2e9}), QUANTITIES)
    x = np.zeros(unknowns.baseline)
    x[unknowns.bench_names.index(FRONT)] = 2.0
    moved = unknowns.parameters(x)
    assert moved[FRONT] > 1.05 * believed()[FRONT]
    assert moved[BACK] == pytest.approx(5.2e9)


def test_what_is_known_of_both_factors_of_a_product_is_carried_by_one():
    believed_of = believed().replace({}, {"wire.mass": 0.1 * believed()["wire.mass"]})
    unknowns = unknowns_of_records(believed_of, QUANTITIES)
    heat = next(item for item in unknowns.items if item.name == "wire.specific_heat")
    own = believed_of.std("wire.specific_heat")
    assert heat.partner == "wire.mass" and heat.own_std == own
    assert heat.std == pytest.approx(np.hypot(own, 0.1 * heat.mean))
    assert "wire.mass" not in unknowns.names
