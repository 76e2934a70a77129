"""An effect planted in a record is named, and its size found, whatever is measured; and where none
is, none is declared, whatever colour the noise has."""

import pytest
from planted import ALL, FEW, believed, few_effects, planted_pair

from sma_bench.diagnose import diagnose
from sma_bench.physics.effects import EFFECTS

pytest.importorskip("numba", reason="diagnoses take minutes uncompiled")

PLANTED = {
    "residual_strain": {"effect.residual_strain.share": 0.12},
    "viscoelastic_matrix": {
        "effect.viscoelastic_matrix.relaxation": 0.25,
        "effect.viscoelastic_matrix.time_constant": 5.0,
    },
}
CASES = [("viscoelastic_matrix", ALL), ("residual_strain", ("deflection",))]
DEVIATIONS = 4.0


def expect(result, name, numbers):
    assert (result.decision.verdict, result.decision.cause) == ("effect", (name,))
    first = result.to_json()["candidates"][0]
    assert first["stage"] == EFFECTS[name].stage
    for number, true in numbers.items():
        found = first["parameters"][number]
        assert abs(found["value"] - true) < DEVIATIONS * found["std"], number
        assert found["std"] < 0.15 * true, number


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "quantities"), CASES, ids=[f"{n}-{'all' if q == ALL else q[0]}" for n, q in CASES]
)
def test_a_planted_effect_is_named_and_measured(name, quantities, tmp_path):
    seen, unseen = planted_pair(tmp_path, PLANTED[name], quantities=quantities)
    with few_effects():
        result = diagnose(seen, believed(), unseen)
    expect(result, name, PLANTED[name])
    deflection = result.shrinkage["deflection"]
    assert deflection.fraction > 0.8
    assert deflection.rmse_after < 0.3 * deflection.rmse_before


@pytest.mark.slow
def test_the_whole_library_competes(tmp_path):
    effect = {"effect.side_heat_coupling.conductance": 0.002}
    seen, unseen = planted_pair(tmp_path, effect, quantities=("deflection",))
    result = diagnose(seen, believed(), unseen)
    expect(result, "side_heat_coupling", effect)
    names = {c.name for c in result.decision.candidates}
    seen = {name for name, e in EFFECTS.items() if "deflection" in e.acts_on}
    assert seen | {"recalibration", "no_gap", "unexplained"} <= names


def test_sides_that_heat_each_other_are_found_with_every_sensor(planted_diagnosis):
    expect(
        planted_diagnosis, "side_heat_coupling", {"effect.side_heat_coupling.conductance": 0.002}
    )
    assert set(FEW) <= {c.name for c in planted_diagnosis.decision.candidates}


def test_the_place_of_a_thermal_effect_is_found(planted_diagnosis):
    where = planted_diagnosis.to_json()["where"]
    assert where["stage"] == "thermal"
    currents = [c for c in planted_diagnosis.where.table if c.signal.endswith("current")]
    warm = [c for c in planted_diagnosis.where.table if c.signal.endswith("temperature")]
    assert max(c.gap for c in currents) < 0.05 < 2.0 < max(c.gap for c in warm)
    assert sum(c.share for c in planted_diagnosis.where.table) == pytest.approx(1.0)


def test_the_gap_shrinks_on_the_record_that_was_held_out(planted_diagnosis):
    assert [v.path.endswith("unseen") for v in planted_diagnosis.held_out] == [True]
    for quantity in ("temperature", "deflection"):
        s = planted_diagnosis.shrinkage[quantity]
        assert s.fraction > 0.9 and s.ci90[0] <= s.fraction <= s.ci90[1] <= 1.0
        assert s.rmse_after == pytest.approx(s.noise_floor, rel=0.15)
        assert s.rmse_before > 3.0 * s.noise_floor


def test_what_the_effect_leaves_is_noise(planted_diagnosis):
    problem, left = planted_diagnosis.model.problem, planted_diagnosis.model.left
    white = problem.whiten(left)
    assert white.std() == pytest.approx(1.0, abs=0.1)
    assert planted_diagnosis.search.beyond.gain < 10.0


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["coloured", "drifting"])
def test_parameters_that_are_off_are_not_taken_for_an_effect(kind, tmp_path):
    seen, unseen = planted_pair(tmp_path, kind=kind, quantities=("temperature", "deflection"))
    with few_effects():
        result = diagnose(seen, believed(), unseen)
    assert result.decision.verdict in ("recalibration", "no_gap")
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
