"""The bench in software, without ROS: its rates, its instruments, its physics."""

import numpy as np
import pytest

from sma_bench.hardware.safety import CELSIUS_ZERO, Guard, Limits
from sma_bench.live.virtual_bench import NANOSECONDS, VirtualBench
from sma_bench.parameters import Parameters
from sma_bench.parameters.node_tables import NODE_TABLES
from sma_bench.physics import simulate
from sma_bench.physics.effects import effect_values

SETTINGS = {p.name: p.default for p in NODE_TABLES["simulator"]}
PERFECT = SETTINGS | {
    name: 0.0 for name in SETTINGS if name.endswith(("_noise", "_resolution"))
}
WIRE = Parameters.defaults()
COMPOSITE = WIRE.replace(
    {
        "bench.channels": ("front_1", "front_2", "back_1", "back_2"),
        "bench.channel_sides": ("front", "front", "back", "back"),
    }
)


def run(bench, voltage, seconds, slice_length=0.05):
    """Readings by kind of `seconds` in slices, as the node runs them."""
    found = {kind: [] for kind in ("power", "temperature", "mechanics", "ambient")}
    for k in range(1, round(seconds / slice_length) + 1):
        for reading in bench.advance(voltage, round(k * slice_length * NANOSECONDS)):
            found[reading.kind].append(reading)
    return found


def test_every_instrument_keeps_its_own_rate_over_slices_of_any_length():
    for slice_length in (0.01, 0.05, 0.13):
        found = run(VirtualBench(WIRE, SETTINGS), (1.0,), 13.0, slice_length)
        times = {kind: np.array([r.time for r in readings]) for kind, readings in found.items()}
        assert set(np.diff(times["power"])) == {10_000_000}
        assert set(np.diff(times["temperature"])) == {12_500_000}
        assert [len(times[kind]) for kind in times] == [1300, 1040, 1300, 13]


def test_perfect_instruments_read_the_physics():
    readings = run(VirtualBench(WIRE, PERFECT), (5.0,), 2.0)
    time = np.array([r.time for r in readings["temperature"]]) / NANOSECONDS
    truth = simulate(WIRE, time, np.full((time.size, 1), 5.0))
    celsius = np.array([r.values[0] for r in readings["temperature"]])
    assert celsius + 273.15 == pytest.approx(truth.temperature[:, 0], abs=1e-9)
    assert readings["power"][7].values == [(5.0, 5.0 / 2.6987)]


def test_a_clamped_wire_pulls_when_it_transforms_and_keeps_its_length():
    readings = run(VirtualBench(WIRE, PERFECT), (6.0,), 3.0)["mechanics"]
    elongation, force = np.array([r.values for r in readings]).T
    assert not elongation.any()
    assert force[-1] > 5.0


def test_a_wire_against_a_spring_shortens_as_its_force_grows():
    spring = WIRE.replace(
        {"load.kind": "spring", "load.stiffness": 1000.0, "load.preload": 5.0}
    )
    readings = run(VirtualBench(spring, PERFECT), (6.0,), 3.0)["mechanics"]
    elongation, force = np.array([r.values for r in readings]).T
    assert force == pytest.approx(5.0 - 1000.0 * elongation, rel=1e-6)
    assert np.ptp(elongation) > 1e-3


def test_two_wires_on_a_slider_move_a_tip():
    pair = WIRE.replace({
        "bench.channels": ("a", "b"), "bench.channel_sides": ("front", "back"),
        "load.kind": "antagonist", "load.preload": 5.0,
    })  # fmt: skip
    readings = run(VirtualBench(pair, PERFECT), (6.0, 0.0), 3.0)["mechanics"]
    front, back = np.array([r.values for r in readings]).T
    assert front + back == pytest.approx(np.full(front.size, 0.2))
    assert 0.5 * (back[-1] - front[-1]) > 5e-4


def test_range_sensors_see_the_tip_from_both_sides():
    readings = run(VirtualBench(COMPOSITE, PERFECT), (0.0, 0.0, 5.0, 5.0), 3.0)["mechanics"]
    front, back = np.array([r.values for r in readings]).T
    assert front + back == pytest.approx(np.full(front.size, 0.2))
    assert front[-1] > 0.101  # bent to the back


def test_readings_of_a_pulse_do_not_depend_on_the_wait_before_it_and_pulses_differ():
    pulses = []
    for wait in (1.0, 7.5):
        bench = VirtualBench(WIRE, SETTINGS)
        run(bench, (0.0,), wait)
        begin = round(wait / 0.05)
        for length in (begin, begin + 400):
            found = [
                reading.values
                for k in range(length + 1, length + 41)
                for voltage in [(2.0,)]
                for reading in bench.advance(voltage, k * 50_000_000)
                if reading.kind != "ambient"
            ]
            pulses.append(found)
            list(bench.advance((0.0,), (begin + 400) * 50_000_000))
    first, second, first_late, second_late = pulses
    assert first == first_late
    assert second == second_late
    assert first != second


def test_noise_and_steps_are_those_of_the_hardware():
    readings = run(VirtualBench(WIRE, SETTINGS), (3.0,), 40.0)
    volt, ampere = np.array([r.values[0] for r in readings["power"]]).T
    lsb = 10.0 / 1023
    assert np.allclose(volt / lsb, np.round(volt / lsb))
    assert np.std(ampere) == pytest.approx(np.hypot(0.019, 0.0264 / np.sqrt(12)), rel=0.1)
    celsius = np.array([r.values[0] for r in readings["temperature"][800:]])
    assert np.std(celsius) == pytest.approx(np.hypot(0.08, 0.1 / np.sqrt(12)), rel=0.1)
    assert np.allclose(celsius * 10, np.round(celsius * 10))


def test_voltage_and_current_of_a_reading_belong_together():
    """Also where the voltage has just been changed, at the instant of the reading."""
    bench = VirtualBench(WIRE, PERFECT)
    for k, voltage in enumerate((5.0, 2.0, 0.0, 3.0)):
        readings = list(bench.advance((voltage,), (k + 1) * 50_000_000))
        pairs = [r.values[0] for r in readings if r.kind == "power"]
        assert pairs == [(voltage, pytest.approx(voltage / 2.6987))] * 5


def test_instruments_show_the_effects_that_are_on():
    effects = {
        name: number
        for effect, size in (("supply_drop", 0.3), ("ambient_drift", 0.01),
                             ("temperature_underfill", 0.4), ("deflection_drift", 1e-5))
        for name, number in effect_values(effect, size).items()
    }
    readings = run(VirtualBench(COMPOSITE.replace(effects), PERFECT), (3.0, 0.0, 0.0, 0.0), 20.0)
    volt, ampere = readings["power"][-1].values[0]
    assert ampere == pytest.approx(volt / (2.6987 + 0.3))
    seconds = readings["ambient"][-1].time / NANOSECONDS
    air = readings["ambient"][-1].values[0]
    assert air == pytest.approx(23.0 + 0.01 * seconds, abs=1e-9)
    wire = 9.0 * 2.6987 / 2.9987**2 / (403.26 * 395.84e-6)
    hot, cold = readings["temperature"][-1].values[:3:2]
    assert 0.6 * wire < hot - cold < 0.75 * wire
    assert cold == pytest.approx(23.2, abs=0.01)
    time = readings["mechanics"][-1].time / NANOSECONDS
    front, back = readings["mechanics"][-1].values
    still = run(VirtualBench(COMPOSITE, PERFECT), (0.0,) * 4, 1.0)["mechanics"][-1].values
    assert back - still[1] == pytest.approx(still[0] - front)
    drift = 0.5 * (back - front)
    plain = simulate(COMPOSITE.replace(effects), np.arange(0.0, 20.0, 0.01),
                     np.tile([3.0, 0.0, 0.0, 0.0], (2000, 1)))
    assert drift == pytest.approx(plain.deflection[-1] + 1e-5 * time, abs=1e-9)


@pytest.mark.parametrize("count", [1, 2])
@pytest.mark.parametrize("leads", [0.0, 0.3])
@pytest.mark.parametrize("drive", ["voltage", "duty", "current"])
def test_guard_finds_nothing_in_a_sound_bench_of_any_drive(drive, leads, count):
    parameters = WIRE.replace(
        {"bench.drive": drive, "bench.lead_resistance": leads, "wire.count": count}
    )
    limits = Limits.from_parameters(parameters)
    guard = Guard(("wire",), ("power", "temperature"), 0.5)
    bench = VirtualBench(parameters, SETTINGS)
    # A duty of 3 V of 10 V heats like 5.5 V.
    voltage = (1.0 if drive == "duty" else 3.0,)
    for k in range(1, 101):
        guard.commanded(voltage)
        for reading in bench.advance(voltage, round(0.05 * k * NANOSECONDS)):
            now = reading.time / NANOSECONDS
            if reading.kind == "power":
                power = reading.values[0]
                guard.power("wire", *power, now, now, limits)
            elif reading.kind == "temperature":
                kelvin = reading.values[0] + CELSIUS_ZERO
                guard.temperature("wire", kelvin, now, now, limits)
        if k > 1:
            assert guard.fault(0.05 * k) == ""
    for k in range(200):  # and a bench that stays at the last command is found
        now = 5.0 + 0.01 * k
        guard.commanded((2.0 * voltage[0],))
        guard.power("wire", *power, now, now, limits)
    assert "disagreement: wire gets" in guard.fault(now)
