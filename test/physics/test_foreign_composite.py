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
PERIOD = 0.002
# The voltages without noise: the shapes are seen in the records, their corners were fitted to the
# deflection (9 and 12 numbers to 6000 samples each). A side's two wires are driven alike.
STEPS = {  # start, end, volts
    "front": ((3.99372, 23.18228, 2.27238), (78.86940, 97.54179, 2.04665)),
    "back": ((36.16995, 53.95809, 2.05327),),
}
TRIANGLES = {  # start, peak, end, volts
    "front": ((4.00128, 14.79987, 25.60807, 2.10170), (73.36939, 83.62822, 93.98037, 2.04514)),
    "back": ((45.85273, 51.97343, 58.10084, 2.19573),),
}


@pytest.fixture
def truth(shared_data):
    numbers = json.loads((shared_data / "foreign" / "composite" / "truth.json").read_text())
    return Parameters.of_paper().replace({
        **numbers,
        "bench.channels": CHANNELS,
        "bench.channel_sides": ("front", "front", "back", "back"),
    })


def step_voltage(time, start, end, volts):
    # A sample that a corner cuts carries the power of the part that is on.
    def share(since):
        return np.clip((time + PERIOD - since) / PERIOD, 0.0, 1.0)
    return volts * np.sqrt(np.clip(share(start) - share(end), 0.0, 1.0))


def triangle_voltage(time, start, peak, end, volts):
    middle = time + 0.5 * PERIOD
    rise, fall = (middle - start) / (peak - start), (end - middle) / (end - peak)
    return volts * np.clip(np.minimum(rise, fall), 0.0, 1.0)


@pytest.mark.parametrize(("name", "shape", "corners"), [
    ("step", step_voltage, STEPS), ("triangle", triangle_voltage, TRIANGLES),
])
def test_true_parameters_leave_white_noise_only(shared_data, truth, name, shape, corners):
    record = read_record(shared_data / "foreign" / "composite" / name)
    time = np.arange(0.0, 120.0, PERIOD)
    sides = [sum(shape(time, *c) for c in corners[side]) for side in ("front", "back")]
    run = simulate(truth, time, np.stack(sides, axis=1)[:, [0, 0, 1, 1]])

    deflection = record["deflection"]
    left = deflection.values - np.interp(deflection.time, time, run.deflection)
    assert np.std(left) < 4.2e-5, "0.04 mm of noise on 14 to 37 mm"
    assert abs(np.mean(left)) < 2e-6
    assert abs(autocorrelation(left)) < 0.04
    for i, channel in enumerate(CHANNELS):
        kelvin = record[f"{channel}.temperature"]
        left = kelvin.values - np.interp(kelvin.time, time, run.temperature[:, i])
        assert np.std(left) < 0.265
        assert abs(np.mean(left)) < 0.02
        assert abs(autocorrelation(left)) < 0.06


@pytest.mark.parametrize(("name", "deflection_noise"), [("step", 1.2e-4), ("triangle", 5.5e-5)])
def test_measured_voltages_do_nearly_as_well(shared_data, truth, name, deflection_noise):
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
