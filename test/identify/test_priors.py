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
from sma_bench.parameters.table import TRANSITIONS

START, FINISH, M_S, M_F = TRANSITIONS.values()
LOSS, AREA = "wire.heat_transfer_coefficient", "wire.surface_area"
PRIOR = Estimate(100.0, 4.0, "1", "given", 0)
JOINT = np.sqrt(1.0 / (1.0 / 16.0 + 1.0 / 64.0))


@pytest.mark.parametrize(
    ("measured", "value", "std", "informed", "said"),
    [
        ((130.0, 2.0, 1.0), 130.0, 2.0, 0.75, ""),  # surer: it counts alone
        ((105.0, 8.0, 0.0), 101.0, JOINT, 0.2, ""),
        ((150.0, 8.0, 0.0), 110.0, JOINT, 0.2, "+5.6 standard errors"),
        ((2e305, 1e305, 1e304), 100.0, 4.0, 0.0, ""),
    ],
)
def test_a_measurement_is_joined_with_what_was_known_better(measured, value, std, informed, said):
    known, error, systematic = measured
    found, remark = with_prior(Estimate(known, error, "1", "measured", 9, systematic), PRIOR)
    assert (found.value, found.std, found.informed) == pytest.approx((value, std, informed))
    assert said in remark and bool(said) == bool(remark)


def weighed(name, estimate, **given):
    """What is left of an estimate beside what a file states, and the run's notes."""
    run = IdentificationRun(Parameters(given), frozenset())
    run.estimates = {name: Estimate(*estimate)}
    run.weigh_priors(None)
    return run.estimates[name], run.notes


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


KNOWN = Parameters.of_paper()
KNOWN = KNOWN.replace({}, {LOSS: 0.04 * KNOWN[LOSS], AREA: 0.03 * KNOWN[AREA]})


def fitted(x, covariance):
    """A fit of the heat loss alone, x prior deviations up."""
    unknowns = unknowns_of(KNOWN, [LOSS], shapes={})
    problem = SimpleNamespace(observations=(), nuisances=(), blocks=())
    whole = np.array([[covariance]])
    fit = SimpleNamespace(
        unknowns=unknowns, x=np.array([x]), z=np.zeros(0), problem=problem, evidence=0.0,
        covariance=whole, joint=whole,
    )  # fmt: skip
    return result_of(fit, [fit, SimpleNamespace(evidence=-9.0, x=fit.x + 3.0)])


def test_two_factors_known_only_as_a_product_are_split_by_their_priors():
    found = fitted(2.0, 1e-6)
    loss, area = found.numbers
    assert (loss.name, area.name, found.agreed, found.starts) == (LOSS, AREA, 1, 2)
    # The product has moved by 2 of its 5 %: each factor by its share of the variance.
    assert np.log(loss.value / KNOWN[LOSS]) == pytest.approx(2.0 * 0.05 * 0.64)
    assert np.log(area.value / KNOWN[AREA]) == pytest.approx(2.0 * 0.05 * 0.36)
    (product,) = found.products
    assert product.value == pytest.approx(loss.value * area.value)
    assert product.std < 1e-3 * product.value
    # What is left open of one is left open of the other, the other way.
    assert found.correlation[0, 1] == pytest.approx(-1.0, abs=1e-4)
    assert loss.informed == pytest.approx(0.64, abs=1e-4)
    assert loss.std <= KNOWN.std(LOSS) and area.std <= KNOWN.std(AREA)
    for number in fitted(0.0, 1.0).numbers:  # records that say nothing
        assert number.informed == pytest.approx(0.0, abs=1e-9)
        assert number.std == pytest.approx(number.prior_std)
