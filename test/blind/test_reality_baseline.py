"""With every feature off the reality is the contract's baseline model, which it shares no code
with; the difference vanishes with the step."""

import numpy as np
import pytest
from reality_rig import COMPOSITE, DRIVES, RIGS, drive, needs_numba

from examination.blind.reality import BY_NAME, FEATURES, World, happen
from sma_bench.physics import simulate

# What is left at 16 times the usual fineness.
LEFT = {"temperature": 1e-5, "martensite_fraction": 1e-7, "stress": 10.0, "deflection": 1e-8}


def differences(rig: str, shape: str, fine: float) -> dict[str, float]:
    """Largest difference from the model in K, 1, Pa, m."""
    parameters, scale = RIGS[rig]
    time, voltage = drive(shape, scale=scale)
    model = simulate(parameters, time, voltage)
    outcome = happen(World(parameters), time, voltage, fine)
    return {
        name: float(np.max(np.abs(getattr(outcome, name) - getattr(model, name))))
        for name in LEFT
    }


@needs_numba
@pytest.mark.parametrize("shape", DRIVES)
@pytest.mark.parametrize("rig", RIGS)
def test_difference_from_the_baseline_model_shrinks_with_the_square_of_the_step(
    rig: str, shape: str
) -> None:
    coarse, fine = differences(rig, shape, 0.5), differences(rig, shape, 4.0)
    for name in LEFT:
        order = np.log(coarse[name] / fine[name]) / np.log(8.0)
        assert order > 1.8, (name, coarse[name], fine[name])


@needs_numba
@pytest.mark.parametrize("shape", DRIVES)
@pytest.mark.parametrize("rig", RIGS)
def test_difference_from_the_baseline_model_vanishes(rig: str, shape: str) -> None:
    left = differences(rig, shape, 16.0)
    assert all(left[name] < LEFT[name] for name in LEFT), left


@needs_numba
def test_wires_of_a_side_that_go_different_ways_follow_the_baseline_model_too() -> None:
    time, voltage = drive("triangles")
    voltage *= [1.0, 0.75, 1.05, 0.9]
    model = simulate(COMPOSITE, time, voltage)
    outcome = happen(World(COMPOSITE), time, voltage, 16.0)
    for name, most in LEFT.items():
        assert np.max(np.abs(getattr(outcome, name) - getattr(model, name))) < most


LOADS = {
    "force": {"load.kind": "force", "load.force": 6.0},
    "spring": {"load.kind": "spring", "load.stiffness": 700.0, "load.preload": 5.0},
    "antagonist": {"load.kind": "antagonist", "load.stiffness": 300.0, "load.preload": 6.0},
}  # fmt: skip


@needs_numba
@pytest.mark.parametrize("load", LOADS)
def test_wires_with_a_load_are_the_baseline_models_too(load: str) -> None:
    wires = 2 if load == "antagonist" else 1
    own = {
        "bench.channels": ("a", "b")[:wires], "bench.channel_sides": ("front", "back")[:wires],
        "wire.length": 0.2,
    }
    rig = COMPOSITE.replace({**own, **LOADS[load]})
    time, voltage = drive("nested")
    voltage = 1.15 * voltage[:, ::2][:, :wires]
    model = simulate(rig, time, voltage)
    still = {"detwinning_stress": 1e9}  # the model's martensite does not yield
    outcome = happen(World(rig, still), time, voltage, 16.0)
    assert np.ptp(model.martensite_fraction[:, 0]) > 0.3 and np.ptp(model.deflection) > 5e-4
    for name, most in LEFT.items():
        here, there = getattr(outcome, name), getattr(model, name)
        assert np.max(np.abs(here - there)) < 3.0 * most, name


def test_drives_transform_wholly_and_in_part() -> None:
    for shape in DRIVES:
        outcome = happen(World(COMPOSITE), *drive(shape))
        assert outcome.martensite_fraction.min() < 0.1
        assert outcome.deflection.max() > 0.03
        assert outcome.deflection.min() < -0.02


def test_usual_step_is_far_finer_than_any_instrument() -> None:
    left = differences("composite", "nested", 1.0)
    assert left["temperature"] < 1e-4
    assert left["deflection"] < 1e-7


def test_features_given_as_off_are_as_good_as_none() -> None:
    time, voltage = drive("nested", 20.0)
    none = happen(World(COMPOSITE), time, voltage)
    off = happen(World(COMPOSITE, {f.name: f.off for f in FEATURES}), time, voltage)
    for name in LEFT:
        assert np.array_equal(getattr(off, name), getattr(none, name))


def test_settings_do_nothing_alone() -> None:
    time, voltage = drive("nested", 20.0)
    none = happen(World(COMPOSITE), time, voltage)
    settings = {f.name: 0.5 * (f.low + f.high) for f in FEATURES if f.setting}
    shaped = happen(World(COMPOSITE, settings), time, voltage)
    assert BY_NAME["silicone_share"].setting
    for name, most in LEFT.items():
        assert np.max(np.abs(getattr(shaped, name) - getattr(none, name))) < most
