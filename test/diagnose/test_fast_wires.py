"""The paper's own wires: a fifth of a second slow, so that a few milliseconds of a jump count."""

import pytest
from planted import few_effects

from sma_bench.diagnose import diagnose
from sma_bench.parameters import read_parameters
from sma_bench.protocols import load_protocol
from sma_bench.records import read_record
from sma_bench.records.bag_writer import write_record
from sma_bench.synthetic.bench_records import read_signals, signals_of, simulate_finely

pytestmark = pytest.mark.slow
pytest.importorskip("numba", reason="diagnoses take minutes uncompiled")


@pytest.fixture(scope="module")
def rig(pytestconfig):
    return read_parameters(pytestconfig.rootpath / "config" / "composite_rig.yaml")


HEAT = 12e3


def synthetic_record(rig, protocol, folder):
    """Of a wire that weighs 1.5 standard deviations more than believed."""
    time, voltage = load_protocol(protocol, rig).sample(0.02)
    mass = rig["wire.mass"] + 1.5 * rig.std("wire.mass")
    bench = rig.replace({"effect.latent_heat.heat": HEAT, "wire.mass": mass})
    write_record(folder, read_signals(signals_of(simulate_finely(bench, time, voltage)), 3))
    return read_record(folder)


def test_what_a_jump_does_is_the_candidates_own_affair(rig, tmp_path):
    # composite_step begins under voltage and jumps between samples that lie 20 ms apart.
    smooth = synthetic_record(rig, "composite_triangle", tmp_path / "smooth")
    jumping = synthetic_record(rig, "composite_step", tmp_path / "jumping")
    with few_effects(("latent_heat", "viscoelastic_matrix")):
        found = diagnose([smooth], rig, [jumping])
    assert found.decision.cause == ("latent_heat",)
    # Records show the product with the mass, whose error that of the heat holds.
    name = "effect.latent_heat.heat"
    heat, std = found.improved[name], found.improved.std(name)
    assert heat == pytest.approx(HEAT, rel=0.01)
    assert abs(heat - HEAT) < 2.0 * std < 0.02 * HEAT
    assert found.search.best.surprise < 16.0
    left = found.search.left_by_best
    assert left.ratio < 4.0 and left.outlier < 6.0
