"""Firmware, electrics and physics together, in virtual time."""

import math

import numpy as np
import pytest
from uno.emulated_bench import OFFSET, SHIFT, SLOPE, STANDOFF, Plant
from virtual_host import VirtualHost

from sma_bench.hardware.bench_sensors import PowerCalibration, channel_powers
from sma_bench.hardware.calibration import fit_range_calibration
from sma_bench.parameters import Parameters
from sma_bench.physics import Bench

PERIOD = 0.05


def hold(host: VirtualHost, plant: Plant, seconds: float, *millivolts: int) -> None:
    for _ in range(round(seconds / PERIOD)):
        host.drive(*millivolts)
        plant.run(PERIOD)
        host.run(0.0)


def test_pulses_heat_a_wire_as_the_commanded_direct_voltage_would(host: VirtualHost) -> None:
    plant = Plant(host.uno, Parameters.defaults())
    reference = Bench(Parameters.defaults())
    host.arm()
    plant.advance()
    hold(host, plant, 1.5, 3000, 0, 0, 0)
    for _ in range(30):
        reference.advance(np.array([3.0]), PERIOD)
    risen = reference.temperature[0] - 296.15
    assert risen > 10.0
    assert plant.bench.temperature[0] - 296.15 == pytest.approx(risen, rel=0.01)


def test_staircase_gives_the_wires_resistance(host: VirtualHost) -> None:
    """E1 in short: the straight line of volts over amperes."""
    parameters = Parameters.defaults()
    plant = Plant(host.uno, parameters)
    host.arm()
    volts, amperes = [], []
    for millivolts in (1500, 3000, 4500, 6000):
        hold(host, plant, 0.1, millivolts, 0, 0, 0)
        start = len(host.telemetry)
        hold(host, plant, 1.0, millivolts, 0, 0, 0)
        powers = [channel_powers(frame, PowerCalibration())[0] for frame in host.telemetry[start:]]
        volts.append(np.mean([power.voltage for power in powers]))
        amperes.append(np.mean([power.current for power in powers]))
    resistance, intercept = np.polyfit(amperes, volts, 1)
    assert resistance == pytest.approx(parameters["wire.resistance"], rel=0.01)
    assert intercept == pytest.approx(0.0, abs=0.05)


def test_bent_composite_is_seen_by_both_range_sensors(host: VirtualHost) -> None:
    parameters = Parameters.defaults().replace(
        {
            "bench.channels": ("front_1", "front_2", "back_1", "back_2"),
            "bench.channel_sides": ("front", "front", "back", "back"),
        }
    )
    plant = Plant(host.uno, parameters)
    host.arm()
    hold(host, plant, 1.0, 6000, 6000, 0, 0)
    deflection = plant.bench.deflection
    known = np.array([0.05, 0.1, 0.2])
    sensor = fit_range_calibration(SLOPE / (known + SHIFT) + OFFSET, known, shift=SHIFT)
    near, far = (
        sensor.distance(float(np.mean([f.range_voltage[side] for f in host.telemetry[-20:]])))
        for side in (0, 1)
    )
    assert deflection > 1e-3
    assert math.isclose(near, STANDOFF - deflection, abs_tol=1e-3)
    assert math.isclose(far, STANDOFF + deflection, abs_tol=3e-3)
