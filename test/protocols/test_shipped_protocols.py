"""Every protocol that comes with the package runs on its rig within the rig's limits."""

from pathlib import Path

import numpy as np
import pytest

from sma_bench.parameters import read_parameters
from sma_bench.physics import simulate
from sma_bench.physics.operating_point import maximum_deflection
from sma_bench.protocols import load_protocol, protocol_names

CONFIG = Path(__file__).resolve().parents[2] / "config"
RIGS = {name: read_parameters(CONFIG / f"{name}_rig.yaml") for name in ("wire", "composite")}
VOLTAGE_DRIVEN = {  # experiment: protocols
    "E1": "staircase", "E2": "staircase", "E3": "ramp", "E4": "triangle", "E6": "isobaric",
    "E7": "tensile", "E8": "thermal_expansion", "E10": "composite_step",
    "E11": "composite_operating_point", "E12": "composite_triangle",
}


def rig_of(name):
    return RIGS["composite" if name.startswith("composite") else "wire"]


def course(name):
    rig = rig_of(name)
    return simulate(rig, *load_protocol(name, rig).sample(0.05))


def test_every_voltage_driven_experiment_has_its_protocol():
    assert set(VOLTAGE_DRIVEN.values()) <= set(protocol_names())


@pytest.mark.parametrize("name", protocol_names())
def test_protocol_loads_for_its_rig_and_stays_within_its_limits(name):
    run, rig = course(name), rig_of(name)
    assert run.voltage.max() > 1.0
    assert run.voltage.max() <= rig["bench.maximum_voltage"]
    assert run.current.max() < rig["bench.maximum_current"]
    assert run.temperature.max() < rig["bench.maximum_temperature"]


def test_isobaric_goes_through_the_whole_transformation_at_200_megapascal():
    wire = RIGS["wire"]
    finish = wire["wire.austenite_finish_temperature"]
    shift = 200e6 / wire["wire.stress_influence_austenite"]
    assert course("isobaric").temperature.max() > finish + shift + 10.0
    assert course("isobaric").temperature[-1, 0] < wire["wire.martensite_finish_temperature"]


def test_thermal_expansion_stays_below_the_austenite_start():
    hottest = course("thermal_expansion").temperature.max()
    assert 320.0 < hottest < RIGS["wire"]["wire.austenite_start_temperature"] - 4.0


def test_small_steps_lie_about_half_of_the_largest_deflection_and_never_turn_back():
    run = course("composite_operating_point")
    half = 0.5 * maximum_deflection(RIGS["composite"])
    steps = (run.voltage[:, 0] >= 4.6) & (run.time < 65.0)
    assert run.deflection[steps].min() < half < run.deflection[steps].max()
    assert np.all(np.diff(run.deflection[steps]) >= -1e-12)
