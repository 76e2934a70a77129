"""What a fit may move: it begins at what is believed, and comes back from its own numbers."""

import numpy as np
import pytest
from planted import believed

from sma_bench.diagnose.unknowns import BACK, FRONT, SHAPES, baseline_unknowns, value_of, x_of
from sma_bench.physics.effects import EFFECTS

QUANTITIES = ("current", "temperature", "deflection")
NUMBERS = [number for effect in EFFECTS.values() for number in effect.parameters]


@pytest.mark.parametrize("spread, tail", [(0.0, 0.0), (2.0, 0.15), (20.0, 0.9)])
def test_no_deviation_is_what_is_believed(spread, tail):
    given = {"wire.transition_spread": spread, "wire.transition_tail": tail}
    unknowns = baseline_unknowns(believed().replace(given), QUANTITIES)
    x = np.zeros(unknowns.baseline)
    found = unknowns.parameters(x)
    assert {name: found[name] for name in given} == given
    low, high = unknowns.bounds()
    assert np.all((low <= x) & (x <= high))


def test_a_shape_moves_by_its_deviation_and_stays_within_its_range():
    unknowns = baseline_unknowns(believed(), QUANTITIES)
    for k, (name, (std, _, high)) in enumerate(SHAPES.items(), len(unknowns.prior.names)):
        x = np.zeros(unknowns.baseline)
        x[k] = 0.5
        assert unknowns.parameters(x)[name] == pytest.approx(0.5 * std)
        x[k] = 1e3
        assert unknowns.parameters(x)[name] == high


@pytest.mark.parametrize("number", NUMBERS, ids=[n.name for n in NUMBERS])
def test_an_effects_number_comes_back_from_its_deviation(number):
    assert value_of(number, 0.0) == number.default
    for x in (0.2, 0.7):
        assert x_of(number, value_of(number, x)) == pytest.approx(x)


def test_sides_believed_alike_are_recalibrated_together():
    unknowns = baseline_unknowns(believed(), QUANTITIES)
    assert BACK not in unknowns.prior.names
    x = np.zeros(unknowns.baseline)
    x[unknowns.prior.names.index(FRONT)] = 2.0
    moved = unknowns.parameters(x)
    assert moved[FRONT] == moved[BACK] > 1.05 * believed()[FRONT]


def test_sides_believed_to_differ_are_recalibrated_apart():
    unknowns = baseline_unknowns(believed().replace({BACK: 5.2e9}), QUANTITIES)
    x = np.zeros(unknowns.baseline)
    x[unknowns.prior.names.index(FRONT)] = 2.0
    moved = unknowns.parameters(x)
    assert moved[FRONT] > 1.05 * believed()[FRONT]
    assert moved[BACK] == pytest.approx(5.2e9)
