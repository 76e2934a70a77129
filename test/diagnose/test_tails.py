"""A parameter that is farther off than anybody stated is said to be, and is no effect."""

from types import SimpleNamespace

import numpy as np
import pytest
from planted import believed, few_effects, planted_record
from scipy.integrate import quad
from scipy.stats import norm

from sma_bench.diagnose import diagnose
from sma_bench.diagnose.tails import RARE, WIDE, gain_of_tails
from sma_bench.parameters import Parameters


def fitted(*readings):
    """Fit of parameters read each by itself: (value, error) in stated deviations."""
    x = np.array([value / (1.0 + error**2) for value, error in readings])
    covariance = np.diag([error**2 / (1.0 + error**2) for _, error in readings])
    names, base = "abc"[: len(readings)], Parameters.of_paper()
    unknowns = SimpleNamespace(bench=len(readings), names=tuple(names), base=base)
    return SimpleNamespace(x=x, covariance=covariance, unknowns=unknowns)


def by_integration(value, error):
    """Log of the mixture's evidence over the narrow prior's."""

    def evidence(std):
        return quad(
            lambda x: norm.pdf(x, 0.0, std) * norm.pdf(value, x, error), -60, 60, points=[0, value]
        )[0]

    return np.log((1.0 - RARE) + RARE * evidence(WIDE) / evidence(1.0))


def test_what_tails_add_is_what_integration_says_for_each_parameter_that_is_off():
    for value, error in ((5.0, 0.3), (6.0, 1.0), (-4.5, 0.5)):
        gain, off = gain_of_tails(fitted((value, error)))
        assert off == ("a",) and gain == pytest.approx(by_integration(value, error), rel=1e-3)
    gain, off = gain_of_tails(fitted((1.5, 0.3), (-5.0, 0.3), (4.0, 0.3)))
    assert off == ("b", "c")
    assert gain == pytest.approx(by_integration(-5.0, 0.3) + by_integration(4.0, 0.3), rel=1e-3)
    # None that is as believed, of which no record tells, or that lies beyond all belief.
    with np.errstate(over="raise"):
        for readings in (((1.5, 0.3), (-2.0, 0.3)), ((3.0, 5.0),), ((1000.0, 0.3),)):
            assert gain_of_tails(fitted(*readings)) == (0.0, ())


def test_a_wrong_parameter_is_named_and_no_effect_that_bends_the_readings_likewise(tmp_path):
    pytest.importorskip("numba", reason="diagnoses take minutes uncompiled")
    lab = believed()
    name = "wire.stress_influence_austenite"
    bench = lab.replace({name: lab[name] + 5.0 * lab.std(name)})
    record = planted_record(
        tmp_path / "bag", {}, quantities=("temperature", "deflection"), bench=bench
    )
    with few_effects(("stress_dependent_transition", "side_heat_coupling")):
        result = diagnose([record], lab)
    assert result.decision.verdict == "recalibration" and name in result.search.off
    assert name in {moved.name for moved in result.moved}
    assert result.improved[name] == pytest.approx(bench[name], abs=2.0 * lab.std(name))
