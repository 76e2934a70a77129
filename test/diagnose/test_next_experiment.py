"""A tie, the protocol that is proposed to break it, and what that protocol's record says."""

from dataclasses import replace

import numpy as np
import pytest
from planted import believed, few_effects, planted_record

from sma_bench.diagnose import diagnose, next_experiment
from sma_bench.diagnose.decision import weigh
from sma_bench.protocols import parse_protocol

pytest.importorskip("numba", reason="diagnoses take minutes uncompiled")

# 1 K a minute hides in 20 s of deflection: other parameters explain it nearly as well.
WARMING = {"effect.ambient_drift.rate": 0.016}
LIBRARY = ("side_heat_coupling", "transition_drift", "ambient_drift", "viscoelastic_matrix")
ONLY = {"quantities": ("deflection",)}


@pytest.fixture(scope="module")
def short_record(tmp_path_factory):
    return planted_record(tmp_path_factory.mktemp("short") / "bag", WARMING, **ONLY)


def diagnosed(records):
    with few_effects(LIBRARY):
        return diagnose(records, believed())


def test_the_proposed_experiment_breaks_the_tie_when_it_is_run(short_record, tmp_path):
    tied = diagnosed([short_record])
    assert tied.decision.verdict == "ambiguous"
    proposed = tied.next_experiment
    assert {"recalibration", "ambient_drift"} <= set(proposed.separates)
    assert proposed.kind == "protocol" and proposed.worth >= next_experiment.WORTH
    protocol = parse_protocol(proposed.protocol, believed())
    longer = planted_record(tmp_path / "bag", WARMING, protocol=protocol, seed=3, **ONLY)
    assert diagnosed([short_record, longer]).decision.cause == ("ambient_drift",)


def test_of_what_no_effect_explains_a_drive_is_proposed_that_shows_it(planted_diagnosis):
    found = planted_diagnosis
    puzzled = replace(found.decision, verdict="unexplained")
    smooth = found.search.flexible
    missing = replace(smooth, gain=9.0, weights=np.ones_like(smooth.weights))
    proposed = next_experiment.next_experiment(
        puzzled,
        replace(found.search, flexible=missing),
        weigh(found.search),
        found.observations,
        found.parameters,
    )
    assert proposed.separates == () and "what no effect explains" in proposed.why
    assert parse_protocol(dict(proposed.protocol), found.parameters).duration > 30.0
