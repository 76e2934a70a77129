"""Monte Carlo: the stated errors are true ones."""

import numpy as np
import pytest

from sma_bench.identify import identify
from sma_bench.parameters import Parameters
from sma_bench.parameters.table import EXACT_SENSORS

TRIALS = 20
GAIN_STD = 3e-4  # of the voltmeter; that of a calibrated one
KNOWN = Parameters.of_paper().replace(
    uncertainty={**EXACT_SENSORS, "sensor.voltage.gain": GAIN_STD, "sensor.temperature.lag": 0.0}
)
NAMES = ("wire.resistance", "wire.heat_transfer_coefficient", "wire.specific_heat")


def deviation(seed, wire, sensors, staircase, ramp):
    """(3,) errors of R, h and c_p in stated standard errors, for a wire and a bench drawn anew."""
    rng = np.random.default_rng(seed)
    truth = wire(
        resistance=rng.uniform(2.4, 3.2),
        coefficient=rng.uniform(300.0, 500.0),
        specific_heat=rng.uniform(250.0, 450.0),
        ambient=rng.uniform(292.0, 303.0),
    )
    # No supply hits its levels exactly, and no two benches have the same converter errors.
    scale = rng.uniform(0.97, 1.03)
    gain = GAIN_STD * rng.standard_normal()
    steady = sensors(offset=rng.normal(0.0, 0.02), scale_error=gain)
    moving = sensors(100.0, 80.0, offset=0.01, delay=rng.uniform(-0.005, 0.005), scale_error=gain)
    # Nor does a supply know when it will be read: in step with the readings c_p is 0.1 % low.
    lead = 4.0 + rng.uniform(0.0, 1.0 / moving.power_rate)
    records = [
        staircase(truth, steady, seed, 15.0, top=6.25 * scale, increment=0.5 * scale),
        ramp(truth, moving, seed + 5000, top=2.5 * scale, lead=lead),
    ]
    found = identify(records, KNOWN).estimates
    true = (truth.resistance, truth.coefficient, truth.specific_heat)
    return [
        (found[name].value - value) / found[name].std
        for name, value in zip(NAMES, true, strict=True)
    ]


@pytest.mark.slow
def test_intervals_of_95_percent_hold_the_truth_as_often_as_they_say(
    wire, sensors, staircase, ramp
):
    errors = np.array([deviation(s, wire, sensors, staircase, ramp) for s in range(TRIALS)])
    # 60 numbers: 2.5 deviations of a binomial below 95 %.
    assert np.mean(np.abs(errors) < 1.96) >= 0.88
    # And neither a bias that hides in the spread, by three deviations of a mean, nor errors for
    # show.
    assert np.all(np.abs(errors.mean(axis=0)) < 3.0 / np.sqrt(TRIALS)), errors.mean(axis=0)
    assert 0.7 < np.sqrt(np.mean(errors**2)) < 1.2
