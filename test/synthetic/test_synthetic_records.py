"""Synthetic records are what the model says, seen through the simulator's instruments."""

import numpy as np
import pytest

from sma_bench.parameters import Parameters
from sma_bench.parameters.table import DSC_CYCLES
from sma_bench.physics.heat import steady_temperature
from sma_bench.physics.material import modulus
from sma_bench.records.bag_writer import write_record
from sma_bench.synthetic import paper_specimens as specimens
from sma_bench.synthetic.bench_records import PRETENSION, protocol_record
from sma_bench.synthetic.paper_specimens import (
    LATENT_HEAT,
    RATE,
    SAMPLE_MASS,
    isobaric_test,
    tensile_test,
)

PAPER = Parameters.defaults()
WIRE = specimens.wire_rig(PAPER)


def test_staircase_settles_at_the_temperatures_of_eq_4_and_a_clamped_wire_stays_tight():
    record = protocol_record("staircase", WIRE)
    kelvin = record["wire.temperature"]
    late = (kelvin.time > 3.0 + 24 * 30.0 + 15.0) & (kelvin.time < 3.0 + 25 * 30.0 - 1.0)
    expected = float(steady_temperature(6.0, WIRE))
    assert np.mean(kelvin.values[late]) == pytest.approx(expected, abs=0.02)
    assert np.std(kelvin.values[late]) == pytest.approx(0.085, abs=0.02)
    record = specimens.clamped_record(PAPER)
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
    composites = specimens.composite_records(PAPER)
    assert all(str(record.path).startswith("synthetic ") for record in (one, *composites))
    front, back = (composites[1][f"{side}.range"].values for side in ("front", "back"))
    assert np.max(np.abs(front + back - 0.2)) < 1e-3
    largest = composites[1]["deflection"].values.max()
    assert largest == pytest.approx(0.1 - front.min(), abs=5e-4)


def test_dsc_takes_the_latent_heat_up_and_gives_it_back():
    record = specimens.dsc_record(PAPER)
    assert [s.kind for s in record.segments] == ["heating", "cooling"] * 2
    for segment, cycle in zip(record.segments[::2], DSC_CYCLES, strict=True):
        assert segment.rate == pytest.approx(RATE)
        inside = (segment.temperature > cycle["A_s"]) & (segment.temperature < cycle["A_f"])
        sensible = SAMPLE_MASS * PAPER["wire.specific_heat"] * RATE
        heat = np.sum(segment.heat_flow[inside] - sensible) * 0.5 / SAMPLE_MASS
        assert heat == pytest.approx(LATENT_HEAT, rel=0.05)
    assert record.endothermic_up


def test_isobaric_test_contracts_by_the_recoverable_strain_and_back():
    (cycle,) = isobaric_test(WIRE, 100e6, "test").cycles
    heating, cooling = (cycle.get(direction) for direction in ("heating", "cooling"))
    soft, stiff = (100e6 / float(modulus(xi, WIRE)) for xi in (1.0, 0.0))
    step = heating.strain[:20].mean() - heating.strain[-20:].mean()
    expansion = -WIRE["wire.thermal_expansion_factor"] * np.ptp(heating.temperature)
    expected = 0.044 + soft - stiff - expansion / WIRE["wire.austenite_modulus"]
    assert step == pytest.approx(expected, abs=5e-5)
    assert cooling.strain[-20:].mean() == pytest.approx(heating.strain[:20].mean(), abs=5e-5)


def test_hot_tensile_test_follows_the_constitutive_law():
    test = tensile_test(PAPER, 403.15, "hot", seed=1)
    # Stress-induced martensite begins where eq. (11) begins at this temperature.
    onset = (403.15 - 353.39) * PAPER["wire.stress_influence_martensite"]
    rising = (test.strain > 0.003) & (test.stress < 0.9 * onset) & (test.strain < 0.008)
    slope = np.polyfit(test.strain[rising], test.stress[rising], 1)[0]
    assert slope == pytest.approx(PAPER["wire.austenite_modulus"], rel=0.01)
    late = (test.strain > 0.02) & (test.strain < 0.05)
    assert test.stress[late].min() > onset
    assert np.polyfit(test.strain[late], test.stress[late], 1)[0] < 0.1 * slope
