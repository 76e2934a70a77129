"""Synthetic records are what the model says, seen through the simulator's instruments; those of
E5 to E8 are identified in test/report/test_paper.py."""

import numpy as np
import pytest

from sma_bench.parameters import Parameters
from sma_bench.physics.material import steady_temperature
from sma_bench.records.bag_writer import write_record
from sma_bench.synthetic import paper_specimens as specimens
from sma_bench.synthetic.bench_records import PRETENSION, protocol_record

PAPER = Parameters.defaults()
WIRE = specimens.wire_rig(PAPER)


def test_staircase_settles_at_the_temperatures_of_eq_4_and_a_clamped_wire_stays_tight():
    record = protocol_record("staircase", WIRE)
    kelvin = record["wire.temperature"]
    late = (kelvin.time > 3.0 + 24 * 30.0 + 15.0) & (kelvin.time < 3.0 + 25 * 30.0 - 1.0)
    expected = float(steady_temperature(6.0, WIRE))
    assert np.mean(kelvin.values[late]) == pytest.approx(expected, abs=0.02)
    assert np.std(kelvin.values[late]) == pytest.approx(0.085, abs=0.02)
    (record,) = specimens.papers_records("clamped", PAPER)
    kelvin, force = record["wire.temperature"], record["force"]
    late = (kelvin.time > 57.0) & (kelvin.time < 59.9)
    assert np.mean(kelvin.values[late]) == pytest.approx(328.15, abs=0.1)
    at_rest = PRETENSION * PAPER["wire.martensite_modulus"] * np.pi * 0.15e-3**2
    assert force.values[:20].mean() == pytest.approx(at_rest, abs=0.1)
    assert force.values.min() > 0.5 * at_rest


def test_a_record_is_its_seeds_is_called_synthetic_and_can_be_written_as_a_bag(tmp_path):
    one, same, other = (protocol_record("ramp", WIRE, seed) for seed in (1, 1, 2))
    for name, signal in one.signals.items():
        assert np.array_equal(signal.values, same[name].values)
        assert not np.array_equal(signal.values, other[name].values)
    write_record(tmp_path / "bag", one)
    assert (tmp_path / "bag" / "metadata.yaml").is_file()
    composites = specimens.papers_records("composite", PAPER)
    assert all(str(record.path).startswith("synthetic ") for record in (one, *composites))
    front, back = (composites[1][f"{side}.range"].values for side in ("front", "back"))
    assert np.max(np.abs(front + back - 0.2)) < 1e-3
    largest = composites[1]["deflection"].values.max()
    assert largest == pytest.approx(0.1 - front.min(), abs=5e-4)
