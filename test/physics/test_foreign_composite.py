"""A record made elsewhere with the contract's model: the simulation leaves noise only.

The strongest check that the contract is read as others read it: signs, ramps, coupled stress.
"""

import json

import numpy as np
import pytest

from sma_bench.parameters import Parameters
from sma_bench.physics import simulate
from sma_bench.records import read_record

CHANNELS = ("front_1", "front_2", "back_1", "back_2")


@pytest.fixture
def truth(shared_data):
    numbers = json.loads((shared_data / "foreign" / "composite" / "truth.json").read_text())
    return Parameters.of_paper().replace(
        {
            **numbers,
            "bench.channels": CHANNELS,
            "bench.channel_sides": ("front", "front", "back", "back"),
        }
    )


@pytest.mark.parametrize(("name", "deflection_noise"), [("step", 1.2e-4), ("triangle", 5.5e-5)])
def test_the_truth_under_measured_voltages_leaves_noise(shared_data, truth, name, deflection_noise):
    """Noise and 20 ms sampling of the measured voltage itself are all that is added."""
    record = read_record(shared_data / "foreign" / "composite" / name)
    time = np.arange(0.0, 120.0, 0.005)
    voltage = np.stack([held(record[f"{channel}.voltage"], time) for channel in CHANNELS], axis=1)
    run = simulate(truth, time, voltage)
    deflection = record["deflection"]
    left = deflection.values - np.interp(deflection.time, time, run.deflection)
    assert np.std(left) < deflection_noise
    for i, channel in enumerate(CHANNELS):
        kelvin = record[f"{channel}.temperature"]
        left = kelvin.values - np.interp(kelvin.time, time, run.temperature[:, i])
        assert np.std(left) < 0.285
        current = record[f"{channel}.current"].values
        left = current - record[f"{channel}.voltage"].values / truth["wire.resistance"]
        assert np.std(left) < 8.6e-3
        assert abs(autocorrelation(left)) < 0.04


def held(signal, time):
    return signal.values[np.clip(np.searchsorted(signal.time, time, "right") - 1, 0, None)]


def autocorrelation(values):
    centred = values - values.mean()
    return float(np.sum(centred[1:] * centred[:-1]) / np.sum(centred**2))
