"""Sensors against known loads, and what becomes of their readings."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sma_bench.errors import InputError
from sma_bench.hardware.bench_sensors import PowerCalibration, channel_powers, commanded_millivolts
from sma_bench.hardware.calibration import Calibration, fit_calibration, fit_range_calibration
from sma_bench.hardware.serial_messages import Telemetry


def telemetry(duty, front=0.0, back=0.0):
    return Telemetry(1, 0, 1, 0, 12.0, (front, back), (1.5, 1.5), duty, 0)  # type: ignore[arg-type]


# --- fitting ------------------------------------------------------------------------------------


@given(st.floats(0.1, 10.0), st.floats(-5.0, 5.0))
def test_exact_loads_give_exact_gain_and_offset(gain, offset):
    readings = np.array([0.0, 1.0, 2.0, 3.0])
    fit = fit_calibration(readings, gain * readings + offset)
    assert fit.calibration.gain == pytest.approx(gain)
    assert fit.calibration.offset == pytest.approx(offset, abs=1e-9)
    assert fit.residual_std == pytest.approx(0.0, abs=1e-9)
    assert fit.n == 4
    two = fit_calibration([0.0, 2.0], [0.1, 2.1])  # fit, but have no error
    assert two.calibration == Calibration(pytest.approx(1.0), pytest.approx(0.1))
    assert math.isnan(two.gain_std)


def test_stated_errors_cover_the_truth():
    random = np.random.default_rng(1)
    readings = np.linspace(0.0, 3.0, 7)
    within = [0, 0]
    for _ in range(200):
        fit = fit_calibration(readings, 1.04 * readings - 0.1 + random.normal(0.0, 0.02, 7))
        within[0] += abs(fit.calibration.gain - 1.04) < fit.gain_std
        within[1] += abs(fit.calibration.offset + 0.1) < fit.offset_std
    # Student's t with 5 degrees of freedom: 63.7 % lie within one standard error.
    assert within == pytest.approx([127, 127], abs=28)


def test_triangulation_sensor_is_fitted_over_the_inverse_distance_and_bad_loads_are_refused():
    distances = np.array([0.04, 0.06, 0.10, 0.15, 0.30])
    voltages = 0.12 / (distances + 0.0042) - 0.05
    fitted = fit_range_calibration(voltages, distances, shift=0.0042)
    found = [fitted.distance(voltage) for voltage in voltages]
    assert found == pytest.approx(distances, rel=1e-9)
    assert fitted.distance(-0.1) == math.inf
    for readings, known, complaint in (
        ([1.0, 1.0], [1.0, 2.0], "1 different readings"),
        ([1.0, 2.0], [1.0], "2 readings for 1 known loads"),
        ([1.0, math.nan], [1.0, 2.0], "not finite"),
        ([1.0, 2.0], [3.0, 3.0], "do not follow the known loads"),
    ):
        with pytest.raises(InputError, match=complaint):
            fit_calibration(readings, known)
    with pytest.raises(InputError, match="distance -0.01 m with shift 0.004 m"):
        fit_range_calibration([1.0, 2.0], [-0.01, 0.1], shift=0.004)


# --- using it -----------------------------------------------------------------------------------


@given(st.floats(0.01, 0.9), st.floats(0.01, 0.9))
def test_volts_over_amperes_is_the_resistance_and_their_product_the_heat(one, other):
    resistance = 2.7
    mean = (one + other) * 12.0 / resistance
    powers = channel_powers(telemetry((one, other, 0.0, 0.0), front=mean), PowerCalibration())
    for power, duty in zip(powers, (one, other), strict=False):
        assert power.voltage / power.current == pytest.approx(resistance)
        assert power.voltage * power.current == pytest.approx(duty * 12.0**2 / resistance)


def test_readings_and_commands_go_through_the_calibrations():
    powers = channel_powers(telemetry((0.25, 0.0, 0.0, 0.0), front=1.1), PowerCalibration())
    assert powers[1].voltage == 0.0
    assert powers[1].current == 0.0
    assert powers[0].current == pytest.approx(2.2)
    powers = channel_powers(telemetry((4e-4, 0.0, 0.0, 0.0)), PowerCalibration())
    assert powers[0].voltage == pytest.approx(0.24)
    assert math.isnan(powers[0].current)
    calibration = PowerCalibration(Calibration(1.05, 0.1), (Calibration(), Calibration(2.0, -0.5)))
    powers = channel_powers(telemetry((0.0, 0.0, 0.25, 0.0), back=0.75), calibration)
    assert powers[2].voltage == pytest.approx(0.5 * 12.7)
    assert powers[2].current == pytest.approx(2.0)
    supply = Calibration(1.05, 0.1)
    millivolts = commanded_millivolts(6.0, 12.0, supply)
    duty = (1e-3 * millivolts / 12.0) ** 2
    assert math.sqrt(duty) * supply.apply(12.0) == pytest.approx(6.0, abs=1e-3)
    assert commanded_millivolts(6.0, 0.0, supply) == 6000
