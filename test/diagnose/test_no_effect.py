"""Where no effect is, none is declared, whatever colour the noise has."""

import pytest
from planted import believed, few_effects, planted_pair

from sma_bench.diagnose import diagnose

pytestmark = pytest.mark.slow
pytest.importorskip("numba", reason="diagnoses take minutes uncompiled")

BENIGN = ("recalibration", "no_gap")


@pytest.mark.parametrize("kind", ("coloured", "drifting"))
def test_parameters_that_are_off_are_not_taken_for_an_effect(kind, tmp_path):
    seen, unseen = planted_pair(tmp_path, kind=kind, quantities=("temperature", "deflection"))
    with few_effects():
        result = diagnose(seen, believed(), unseen)
    assert result.decision.verdict in BENIGN
    assert result.decision.cause == ()
    assert sum(c.probability for c in result.decision.candidates if c.effects) < 0.35


def test_a_bench_that_is_as_believed_has_no_gap(tmp_path):
    seen, unseen = planted_pair(tmp_path, quantities=("deflection",), bench=believed())
    with few_effects():
        result = diagnose(seen, believed(), unseen)
    assert result.decision.verdict == "no_gap"
    assert result.improved == result.parameters
    deflection = result.shrinkage["deflection"]
    assert deflection.rmse_after == deflection.rmse_before
    assert deflection.rmse_before == pytest.approx(deflection.noise_floor, rel=0.1)
