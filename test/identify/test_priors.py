"""What was known beside what was measured: nothing ends less sure than it was."""

import numpy as np
import pytest

from sma_bench.estimation.estimate import Estimate
from sma_bench.identify.result import Experiment
from sma_bench.identify.run import IdentificationRun
from sma_bench.parameters import Parameters
from sma_bench.parameters.parameter import TRANSITIONS

START, FINISH, M_S, M_F = TRANSITIONS.values()
LOSS, AREA = "wire.heat_transfer_coefficient", "wire.surface_area"
JOINT = np.sqrt(1.0 / (1.0 / 16.0 + 1.0 / 64.0))


def weighed(name, estimate, stated_std=None, **given):
    """What is left of an estimate beside what a file states, and the run's notes."""
    stated = {} if stated_std is None else {name: stated_std}
    run = IdentificationRun(Parameters(given).replace({}, stated), frozenset())
    run.estimates = {name: Estimate(*estimate)}
    run.weigh_priors(None)
    return run.estimates[name], run.notes


@pytest.mark.parametrize(("measured", "value", "std", "informed", "contradicted"), [
    ((130.0, 2.0, 1.0), 130.0, 2.0, 0.75, False),  # surer: it counts alone
    ((105.0, 8.0, 0.0), 101.0, JOINT, 0.2, False),
    ((150.0, 8.0, 0.0), 110.0, JOINT, 0.2, True),
    ((2e305, 1e305, 1e304), 100.0, 4.0, 0.0, False),
])  # fmt: skip
def test_a_measurement_is_joined_with_what_was_known_better(
    measured, value, std, informed, contradicted
):
    known, error, systematic = measured
    estimate = (known, error, "ohm", "measured", 9, systematic)
    found, notes = weighed("wire.resistance", estimate, 4.0, **{"wire.resistance": 100.0})
    assert (found.value, found.std, found.informed) == pytest.approx((value, std, informed))
    assert any("stated to be surer" in note.text for note in notes) == contradicted


def test_a_default_that_nobody_stated_is_never_averaged_with_a_measurement():
    found, notes = weighed(START, (356.0, 6.0, "K", "", 3))
    assert (found.value, found.std) == (356.0, 6.0)
    assert any("another alloy" in note.text for note in notes)
    assert weighed(START, (356.0, 6.0, "K", "", 3), **{START: 331.0})[0].value < 335.0
    # One that says less than is known of every wire stands, and is warned of.
    found, notes = weighed(START, (356.0, 40.0, "K", "", 3))
    assert (found.value, found.std) == (356.0, 40.0)
    assert notes[0].subject == START and notes[0].severity == "warning"
    # A heat loss is known only with its area.
    for stated, noted in (({}, True), ({AREA: 4e-4}, False)):
        found, notes = weighed(LOSS, (80.0, 2.0, "W/(m2 K)", "", 9), **stated)
        assert found.value == 80.0
        assert any(AREA in n.text for n in notes if n.severity == "warning") == noted


@pytest.mark.parametrize(("area_std", "own", "sharper"), [
    (120e-6, 0.002, False), (1e-6, 0.06, True),
])  # fmt: skip
def test_factors_of_a_product_go_with_each_other(area_std, own, sharper):
    """E2 has h with the area that the file does not state, the whole model another area."""
    run = IdentificationRun(Parameters({}), frozenset())
    alone = Estimate(36.0, 1.0, "W/(m2 K)", "E2", 9)
    area = Estimate(150e-6, area_std, "m2")
    both = {LOSS: Estimate(94.0, 94.0 * np.hypot(own, area.relative_std), "W/(m2 K)"), AREA: area}
    run.estimates = {LOSS: alone}
    run.take_sharper(Experiment("E9", "", both))
    loss = run.estimates[LOSS]
    assert (loss is not both[LOSS]) == sharper
    product = alone.value * run.given[AREA]
    assert loss.value * run.estimates[AREA].value == pytest.approx(product, rel=0.02)
    least = min(own, 1.0 / 36.0)
    assert loss.relative_std == pytest.approx(np.hypot(least, area.relative_std))
    run.weigh_priors(None)
    assert any(AREA in note.text for note in run.notes) == (not sharper)


def test_transition_temperatures_keep_their_order():
    run = IdentificationRun(Parameters(), frozenset())
    values = {START: (350.0, 1.0), FINISH: (360.0, 4.0), M_S: (364.0, 2.0), M_F: (351.0, 3.0)}
    run.estimates = {n: Estimate(v, s, "K", "", 3) for n, (v, s) in values.items()}
    run.keep_order(None)
    found = {n: e.value for n, e in run.estimates.items()}
    assert found[START] < found[FINISH] and found[M_F] < found[M_S]
    assert found[M_S] < found[FINISH] and found[M_F] < found[START]
    # The surer number moves less.
    assert 350.0 < found[START] < 350.3 and 363.0 < found[FINISH] < 363.8
    assert dict(run.improved()) | found == dict(run.improved())


def test_a_number_out_of_its_range_is_named_and_ends_nothing_else():
    run = IdentificationRun(Parameters.of_paper(), frozenset())
    run.estimates = {
        "wire.thermal_expansion_factor": Estimate(9e12, 1e5, "Pa/K", "", 3),
        "wire.resistance": Estimate(2.5, 0.01, "ohm", "", 3),
        START: Estimate(370.0, 1.0, "K", "", 3),  # its other end comes after it
        FINISH: Estimate(390.0, 1.0, "K", "", 3),
    }
    improved = run.improved()
    assert improved["wire.resistance"] == 2.5 and improved[START] == 370.0
    assert "wire.thermal_expansion_factor" not in run.estimates
    (note,) = run.notes
    assert note.severity == "warning" and note.subject == "wire.thermal_expansion_factor"
