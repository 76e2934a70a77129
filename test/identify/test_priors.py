"""What was known beside what was measured: nothing ends less sure than it was."""

from types import SimpleNamespace

import numpy as np
import pytest

from sma_bench.estimation.estimate import Estimate
from sma_bench.estimation.result import result_of
from sma_bench.estimation.unknowns import unknowns_of
from sma_bench.identify.estimate import with_prior
from sma_bench.identify.run import IdentificationRun
from sma_bench.parameters import Parameters

START, FINISH = "wire.austenite_start_temperature", "wire.austenite_finish_temperature"
M_S, M_F = "wire.martensite_start_temperature", "wire.martensite_finish_temperature"
LOSS, AREA = "wire.heat_transfer_coefficient", "wire.surface_area"
PRIOR = Estimate(100.0, 4.0, "1", "given", 0)


def measured(value, std, systematic=0.0):
    return Estimate(value, std, "1", "measured", 9, systematic)


def test_a_surer_measurement_counts_alone():
    found, remark = with_prior(measured(130.0, 2.0, 1.0), PRIOR)
    assert (found.value, found.std, found.systematic, remark) == (130.0, 2.0, 1.0, "")
    assert found.informed == pytest.approx(0.75)
    assert found.statistical == pytest.approx(np.sqrt(3.0))


def test_a_less_sure_one_is_joined_with_what_was_known():
    found, remark = with_prior(measured(105.0, 8.0), PRIOR)
    assert found.value == pytest.approx(101.0)
    assert found.std < 4.0
    assert found.std == pytest.approx(np.sqrt(1.0 / (1.0 / 16.0 + 1.0 / 64.0)))
    assert (found.informed, remark) == (pytest.approx(0.2), "")


def test_a_contradiction_of_a_statement_is_said():
    found, remark = with_prior(measured(150.0, 8.0), PRIOR)
    assert "+5.6 standard errors" in remark
    assert found.value == pytest.approx(110.0)


def weighed(std, **given):
    run = IdentificationRun(Parameters(given), frozenset())
    run.estimates = {START: Estimate(356.0, std, "K", "", 3)}
    run.weigh_priors(None)
    return run.estimates.get(START), run.notes


def test_a_default_that_nobody_stated_is_never_averaged_with_a_measurement():
    found, notes = weighed(6.0)
    assert (found.value, found.std) == (356.0, 6.0)
    assert any("another alloy" in note.text for note in notes)
    assert weighed(6.0, **{START: 331.0})[0].value < 335.0


@pytest.mark.parametrize("stated, noted", [({}, True), ({AREA: 4e-4}, False)])
def test_a_heat_loss_is_known_only_with_its_area(stated, noted):
    run = IdentificationRun(Parameters(stated), frozenset())
    run.estimates = {LOSS: Estimate(80.0, 2.0, "W/(m2 K)", "", 9)}
    run.weigh_priors(None)
    assert run.estimates[LOSS].value == 80.0
    assert any(AREA in note.text for note in run.notes if note.severity == "warning") == noted


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


def test_a_measurement_that_says_less_than_is_known_of_every_wire_stands_and_is_warned_of():
    found, notes = weighed(40.0)
    assert (found.value, found.std) == (356.0, 40.0)
    assert notes[0].subject == START and notes[0].severity == "warning"


def test_a_number_out_of_its_range_is_named_and_ends_nothing_else():
    run = IdentificationRun(Parameters.of_paper(), frozenset())
    run.estimates = {
        "wire.thermal_expansion_factor": Estimate(9e12, 1e5, "Pa/K", "", 3),
        "wire.resistance": Estimate(2.5, 0.01, "ohm", "", 3),
        # Its other end comes after it.
        "wire.austenite_start_temperature": Estimate(370.0, 1.0, "K", "", 3),
        "wire.austenite_finish_temperature": Estimate(390.0, 1.0, "K", "", 3),
    }
    improved = run.improved()
    assert improved["wire.resistance"] == 2.5
    assert improved["wire.austenite_start_temperature"] == 370.0
    assert "wire.thermal_expansion_factor" not in run.estimates
    (note,) = run.notes
    assert note.severity == "warning" and note.subject == "wire.thermal_expansion_factor"


def fitted(parameters, x, covariance):
    """A fit of the heat loss alone, x prior deviations up."""
    unknowns = unknowns_of(parameters, [LOSS], shapes={})
    problem = SimpleNamespace(observations=(), nuisances=(), blocks=())
    fit = SimpleNamespace(
        unknowns=unknowns, x=np.array([x]), z=np.zeros(0), problem=problem, evidence=0.0,
        covariance=np.array([[covariance]]), joint=np.array([[covariance]]),
    )
    elsewhere = SimpleNamespace(evidence=-9.0, x=fit.x + 3.0)
    return result_of(fit, [fit, elsewhere])


def test_two_factors_known_only_as_a_product_are_split_by_their_priors():
    known = Parameters.of_paper()
    known = known.replace({}, {LOSS: 0.04 * known[LOSS], AREA: 0.03 * known[AREA]})
    found = fitted(known, 2.0, 1e-6)
    loss, area = found.numbers
    assert (loss.name, area.name, found.agreed, found.starts) == (LOSS, AREA, 1, 2)
    # The product has moved by 2 of its 5 %: each factor by its share of the variance.
    assert np.log(loss.value / known[LOSS]) == pytest.approx(2.0 * 0.05 * 0.64)
    assert np.log(area.value / known[AREA]) == pytest.approx(2.0 * 0.05 * 0.36)
    (product,) = found.products
    assert product.value == pytest.approx(loss.value * area.value)
    assert product.std < 1e-3 * product.value
    # What is left open of one is left open of the other, the other way.
    assert found.correlation[0, 1] == pytest.approx(-1.0, abs=1e-4)
    assert loss.informed == pytest.approx(0.64, abs=1e-4)
    assert loss.std <= known.std(LOSS) and area.std <= known.std(AREA)


def test_records_that_say_nothing_leave_everything_as_it_was():
    known = Parameters.of_paper()
    known = known.replace({}, {LOSS: 0.04 * known[LOSS], AREA: 0.03 * known[AREA]})
    for number in fitted(known, 0.0, 1.0).numbers:
        assert number.informed == pytest.approx(0.0, abs=1e-9)
        assert number.std == pytest.approx(number.prior_std)


def test_a_measurement_beyond_all_measure_says_nothing_beside_what_was_known():
    wild = measured(2e305, 1e305, 1e304)
    assert wild.statistical == pytest.approx(1e305, rel=0.01)
    found, remark = with_prior(wild, PRIOR)
    assert (found.value, found.std) == pytest.approx((PRIOR.value, PRIOR.std))
    assert not remark
