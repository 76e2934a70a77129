"""Calibration of sensors from known loads, and calibrated readings."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sma_bench.errors import InputError
from sma_bench.hardware.bench_sensors import BenchSensors, Calibration, fit_sensor
from sma_bench.hardware.serial_messages import Telemetry
from sma_bench.parameters.node_tables import SERIAL_BRIDGE

TABLE = {parameter.name: parameter for parameter in SERIAL_BRIDGE}
SETTINGS = {name: parameter.default for name, parameter in TABLE.items()}
SIDES, RANGE_NUMBERS = ("front", "back"), ("gain", "offset", "shift")
FOUR = ("front", "front", "back", "back")


def read(duty=(0.0, 0.0, 0.0, 0.0), front=0.0, back=0.0, ranges=(1.5, 1.5), sides=FOUR, **settings):
    telemetry = Telemetry(1, 0, 1, 0, 12.0, (front, back), ranges, duty, 0)
    return BenchSensors(sides, SETTINGS | settings).reading(telemetry)


def test_stated_errors_cover_the_true_values():
    random = np.random.default_rng(1)
    readings, name = np.linspace(0.0, 3.0, 7), "calibration.front_current"
    within = {"gain": 0, "offset": 0}
    for _ in range(200):
        known = 1.04 * readings - 0.1 + random.normal(0.0, 0.02, 7)
        fit = fit_sensor("front_current", readings, known)
        for key, true in (("gain", 1.04), ("offset", -0.1)):
            within[key] += abs(fit.parameters[f"{name}.{key}"] - true) < fit.std[f"{name}.{key}"]
    # Student's t with 5 degrees of freedom: 63.7 % lie within one standard error.
    assert list(within.values()) == pytest.approx([127, 127], abs=28)
    two = fit_sensor("front_current", [0.0, 2.0], [0.1, 2.1])  # fit, but have no error
    assert list(two.parameters.values()) == pytest.approx([1.0, 0.1])
    assert math.isnan(two.std[f"{name}.gain"]) and two.uncertainty == {}


def test_triangulation_sensor_is_fitted_over_the_inverse_distance_and_bad_loads_are_refused():
    distances = np.array([0.04, 0.06, 0.10, 0.15, 0.30])
    voltages = 0.12 / (distances + 0.0042) - 0.05
    fitted = Calibration(*fit_sensor("back_range", voltages, distances,
                                     shift=0.0042).parameters.values())
    assert [fitted.apply(volt) for volt in voltages] == pytest.approx(distances, rel=1e-9)
    assert fitted.apply(-0.1) == math.inf
    for sensor, readings, known, complaint in (
        ("supply", [1.0, 1.0], [1.0, 2.0], "1 different readings"),
        ("supply", [1.0, 2.0], [1.0], "2 readings for 1 known loads"),
        ("supply", [1.0, math.nan], [1.0, 2.0], "not finite"),
        ("supply", [1.0, 2.0], [3.0, 3.0], "do not follow the known loads"),
        ("front_range", [1.0, 2.0], [-0.01, 0.1], "distance -0.01 m with shift 0.004 m"),
    ):
        with pytest.raises(InputError, match=complaint):
            fit_sensor(sensor, readings, known, 0.004)


@given(st.floats(0.01, 0.9), st.floats(0.01, 0.9))
def test_volts_over_amperes_is_the_resistance_and_their_product_the_heat(one, other):
    resistance = 2.7
    powers = read((one, other, 0.0, 0.0), front=(one + other) * 12.0 / resistance).powers
    for power, duty in zip(powers, (one, other), strict=False):
        assert power.voltage / power.current == pytest.approx(resistance)
        assert power.voltage * power.current == pytest.approx(duty * 12.0**2 / resistance)


def test_readings_and_commands_go_through_the_calibrations():
    driven, idle, *_ = read((0.25, 0.0, 0.0, 0.0), front=1.1).powers
    assert (idle.voltage, idle.current, driven.current) == (0.0, 0.0, pytest.approx(2.2))
    faint = read((4e-4, 0.0, 0.0, 0.0)).powers[0]
    assert faint.voltage == pytest.approx(0.24) and math.isnan(faint.current)
    supply = {"calibration.supply.gain": 1.05, "calibration.supply.offset": 0.1}
    back = {"calibration.back_current.gain": 2.0, "calibration.back_current.offset": -0.5}
    third = read((0.0, 0.0, 0.25, 0.0), back=0.75, **supply, **back).powers[2]
    assert (third.voltage, third.current) == pytest.approx((0.5 * 12.7, 2.0))
    sensors = BenchSensors(["back"], SETTINGS | supply)
    *off, millivolts, last = sensors.millivolts([6.0], 12.0)
    assert [*off, last] == [0, 0, 0]
    duty = (1e-3 * millivolts / 12.0) ** 2
    assert math.sqrt(duty) * sensors.supply.apply(12.0) == pytest.approx(6.0, abs=1e-3)
    assert sensors.millivolts([6.0], 0.0)[2] == 6000


def test_sensors_and_outputs_are_those_of_the_sides():
    sides = {"front": (0,), "front front back back": (0, 1, 2, 3), "back front back": (2, 0, 3)}
    for names, channels in sides.items():
        assert BenchSensors(names.split(), SETTINGS).channels == channels
    with pytest.raises(InputError, match="2 channels at the front"):
        BenchSensors(["front"] * 3, SETTINGS)
    shared = [BenchSensors(["front", side], SETTINGS).shared for side in SIDES]
    assert shared == [((0, 1),), ()]
    assert BenchSensors(["front"], SETTINGS).range_sensors == ()
    with pytest.raises(InputError, match="'top', expected front or back"):
        BenchSensors(["front"], {**SETTINGS, "range.sensors": ("top",)})
    settings = {"range.front_standoff": 0.09, "range.back_standoff": 0.1}
    for side in SIDES:  # that read 1 V m / V
        settings |= {f"calibration.{side}_range.{n}": float(n == "gain") for n in RANGE_NUMBERS}
    for mounted, front, back, metres in (
        (SIDES, 0.08, 0.112, 0.011), (SIDES, math.inf, 0.112, 0.012),
        (SIDES, math.inf, math.inf, math.nan),
        (("front",), 0.08, 0.2, 0.010),
    ):  # fmt: skip
        settings["range.sensors"] = mounted
        found = read(ranges=(1.0 / front, 1.0 / back), sides=SIDES, **settings)
        assert found.deflection == pytest.approx(metres, nan_ok=True)


@pytest.mark.parametrize("sensor", ["supply", "front_current", "back_current"])
def test_a_calibration_far_from_nominal_is_refused(sensor):
    for name, values in (("gain", (-1.0, 0.0, 0.4, 2.1, 100.0)), ("offset", (-2.1, 2.1))):
        for value in values:
            with pytest.raises(InputError, match=f"calibration.{sensor}.{name} is"):
                TABLE[f"calibration.{sensor}.{name}"].validated(value, "test")
