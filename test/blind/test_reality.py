"""The examination's own physics against references of its own, and with all off the paper's."""

from types import SimpleNamespace

import numpy as np
import pytest

from examination.blind.reality import FEATURES, World, happen
from examination.blind.rigs import draw_truth
from sma_bench.physics import simulate

pytest.importorskip("numba", reason="whole records take minutes uncompiled")

# The middle of the population: wire in silicone, transformation 307 to 353 K, 1.7 s slow.
MIDDLE = SimpleNamespace(uniform=lambda *_: 0.0)
RIG = draw_truth(MIDDLE)
OHM, AMBIENT = RIG["wire.resistance"], RIG["environment.ambient_temperature"]
LOSS = RIG["wire.heat_transfer_coefficient"] * RIG["wire.surface_area"]  # W/K
# Corner times [s] and volts of a side, which turn back within a transformation.
FRONT = [(1, 0), (8, 2.5), (13, 1.25), (18, 1.95), (23, 1.3), (28, 2.4), (34, 0)]
BACK = [(20, 0), (26, 2.3), (30, 1.2), (34, 2.35), (38, 0)]
# What is left of the difference from the paper's model at 16 times the usual fineness.
LEFT = {"temperature": 1e-5, "martensite_fraction": 1e-7, "stress": 10.0, "deflection": 1e-8}


def drive(end=40.0):
    """Time (n,) s every 20 ms and voltage (n, 4)."""
    time = np.arange(0.0, end, 0.02)
    front, back = (np.interp(time, *zip(*corners, strict=True), 0.0, 0.0)
                   for corners in (FRONT, BACK))
    return time, np.column_stack([front, front, back, back])


def differences(rig, time, voltage, fine, features=None):
    """Largest difference from the paper's model in K, 1, Pa, m."""
    model = simulate(rig, time, voltage)
    found = happen(World(rig, features or {}), time, voltage, fine)
    return {n: float(np.max(np.abs(getattr(found, n) - getattr(model, n)))) for n in LEFT}


def test_with_all_off_it_is_the_papers_model_whose_difference_goes_with_the_square_of_the_step():
    coarse, fine = (differences(RIG, *drive(), f) for f in (0.5, 4.0))
    assert all(np.log(coarse[n] / fine[n]) / np.log(8.0) > 1.8 for n in LEFT), (coarse, fine)
    time, voltage = drive()
    left = differences(RIG, time, voltage * [1.0, 0.75, 1.05, 0.9], 16.0)
    assert all(left[n] < most for n, most in LEFT.items()), left
    assert differences(RIG, time, voltage, 1.0)["temperature"] < 1e-4  # no instrument sees it


@pytest.mark.parametrize("features", [
    {}, {"silicone_heat_capacity": 0.5, "silicone_share": 0.8},
    {"latent_heat": 15e3, "transformation_lag": 0.5, "silicone_heat_capacity": 0.05},
    {"resistance_austenite_change": -0.2, "supply_resistance": 0.3, "side_conductance": 0.05},
])
def test_all_heat_leaves_by_the_film(features):
    time, voltage = drive()
    time = np.concatenate([time, np.arange(40.0, 400.0, 0.1)])
    voltage = np.concatenate([voltage, np.zeros((len(time) - len(voltage), 4))])
    found = happen(World(RIG, features), time, voltage)
    step = np.diff(time)[:, None]
    supplied = np.sum((found.voltage * found.current)[:-1] * step)
    leads = np.sum(found.current[:-1] ** 2 * step) * features.get("supply_resistance", 0.0)
    excess = found.surface - found.ambient[:, None]
    lost = np.sum(0.5 * (excess[:-1] + excess[1:]) * step)
    film = LOSS / (1.0 - features.get("silicone_share", 0.5))
    # The resistance is a sample old in `current`, hence no more than 0.1 %.
    assert film * lost == pytest.approx(supplied - leads, rel=1e-3 if leads else 2e-4)


@pytest.fixture(scope="module")
def bare():
    return happen(World(RIG), *drive(), 0.5)


def change(bare, features):
    """Largest change over what the difference from the paper's model is, and what happens."""
    found = happen(World(RIG, features), *drive(), 0.5)
    moved = (np.max(np.abs(getattr(found, n) - getattr(bare, n))) / most
             for n, most in LEFT.items())
    return max(moved), found


def test_every_feature_does_something_settings_and_sensors_alone_nothing_and_all_stay_sound(bare):
    idle = {f.name: 0.5 * (f.low + f.high) for f in FEATURES if f.setting or f.stage == "sensor"}
    assert change(bare, idle)[0] < 1.0
    for feature in FEATURES:
        if feature.name in idle:
            continue
        size = 0.8 * feature.off + 0.2 * feature.high
        size = 0.6 if feature.name == "current_limit" else size
        changed, found = change(bare, {feature.name: size, "clamp_slip_time": 20.0})
        assert changed > 1e3 and np.isfinite(found.stress).all(), feature.name
        fraction = found.martensite_fraction
        assert ((fraction >= 0.0) & (fraction <= 1.0)).all(), feature.name
