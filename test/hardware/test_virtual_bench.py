"""The simulated bench without ROS: rates, instruments, physics, lockstep with a driver."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sma_bench.hardware.bench_sensors import Instrument
from sma_bench.hardware.safety import CELSIUS_ZERO, Guard, Limits
from sma_bench.live.virtual_bench import NANOSECONDS, Lockstep, VirtualBench
from sma_bench.parameters import Parameters, read_parameters
from sma_bench.parameters.node_tables import NODE_TABLES
from sma_bench.physics import simulate

SETTINGS = {p.name: p.default for p in NODE_TABLES["simulator"]}
PERFECT = SETTINGS | {name: 0.0 for name in SETTINGS if name.endswith(("_noise", "_resolution"))}
WIRE = Parameters.defaults()
COMPOSITE = read_parameters(Path(__file__).resolve().parents[2] / "config" / "composite_rig.yaml")
SLICE = 0.05


def run(bench, voltage, seconds, slice_length=SLICE):
    found = {kind: [] for kind in ("power", "temperature", "mechanics", "ambient")}
    for k in range(1, round(seconds / slice_length) + 1):
        for reading in bench.advance(voltage, round(k * slice_length * NANOSECONDS)):
            found[reading.kind].append(reading)
    return found


def test_every_instrument_keeps_its_own_rate_over_slices_of_any_length():
    for slice_length in (0.01, 0.05, 0.13):
        found = run(VirtualBench(WIRE, SETTINGS), (1.0,), 3.9, slice_length)
        times = {kind: np.array([r.time for r in readings]) for kind, readings in found.items()}
        assert set(np.diff(times["power"])) == {10_000_000}
        assert set(np.diff(times["temperature"])) == {12_500_000}
        assert [len(times[kind]) for kind in times] == [390, 312, 390, 4]


def test_perfect_instruments_read_the_physics_and_pairs_belong_together():
    readings = run(VirtualBench(WIRE, PERFECT), (5.0,), 2.0)["temperature"]
    time = np.array([r.time for r in readings]) / NANOSECONDS
    truth = simulate(WIRE, time, np.full((time.size, 1), 5.0))
    kelvin = np.array([r.values[0] for r in readings]) + 273.15
    assert kelvin == pytest.approx(truth.temperature[:, 0], abs=1e-9)
    bench = VirtualBench(WIRE, PERFECT)
    for k, voltage in enumerate((5.0, 2.0, 0.0, 3.0)):
        readings = bench.advance((voltage,), (k + 1) * 50_000_000)
        pairs = [r.values[0] for r in readings if r.kind == "power"]
        assert pairs == [(voltage, pytest.approx(voltage / 2.6987))] * 5


def test_mechanics_of_every_load_are_read_as_its_sensors_see_them():
    def mechanics(rig, *volts):
        found = run(VirtualBench(rig, PERFECT), volts, 3.0)["mechanics"]
        return np.array([reading.values for reading in found]).T

    elongation, force = mechanics(WIRE, 6.0)
    assert not elongation.any() and force[-1] > 5.0
    spring = {"load.kind": "spring", "load.stiffness": 1000.0, "load.preload": 5.0}
    elongation, force = mechanics(WIRE.replace(spring), 6.0)
    assert force == pytest.approx(5.0 - 1000.0 * elongation, rel=1e-6)
    assert np.ptp(elongation) > 1e-3
    sides = {"bench.channels": ("a", "b"), "bench.channel_sides": ("front", "back")}
    pair = WIRE.replace({**sides, "load.kind": "antagonist", "load.preload": 5.0})
    for rig, volts, bent in ((pair, (6.0, 0.0), 5e-4), (COMPOSITE, (0.0, 0.0, 5.0, 5.0), -1e-3)):
        front, back = mechanics(rig, *volts)
        assert front + back == pytest.approx(np.full(front.size, 0.2))
        assert 0.5 * (back[-1] - front[-1]) / bent > 1.0


def test_noise_and_steps_are_those_of_the_hardware_and_a_seeds_one_by_one_and_many_at_once():
    readings = run(VirtualBench(WIRE, SETTINGS), (3.0,), 20.0)
    volt, ampere = np.array([r.values[0] for r in readings["power"]]).T
    lsb = 10.0 / 1023
    assert np.allclose(volt / lsb, np.round(volt / lsb))
    assert np.std(ampere) == pytest.approx(np.hypot(0.019, 0.0264 / np.sqrt(12)), rel=0.1)
    celsius = np.array([r.values[0] for r in readings["temperature"][400:]])
    assert np.std(celsius) == pytest.approx(np.hypot(0.08, 0.1 / np.sqrt(12)), rel=0.1)
    assert np.allclose(celsius * 10, np.round(celsius * 10))
    true = np.linspace(-0.3, 2.0, 9000)
    apart, together, other = (Instrument(SETTINGS, "temperature", np.random.SeedSequence(seed))
                              for seed in (5, 5, 4))
    one_by_one = np.array([apart.read(value) for value in true.tolist()])
    parts = [together.read_all(true[:10]), [together.read(true[10])], together.read_all(true[11:])]
    assert np.concatenate(parts).tobytes() == one_by_one.tobytes()
    assert not np.array_equal(other.read_all(true), one_by_one)


@pytest.mark.parametrize(("drive", "leads", "count"),
                         [("voltage", 0.0, 1), ("duty", 0.3, 2), ("current", 0.3, 2)])
def test_guard_finds_nothing_in_a_sound_bench_of_any_drive(drive, leads, count):
    rig = {"bench.drive": drive, "bench.lead_resistance": leads, "wire.count": count}
    parameters = WIRE.replace(rig)
    limits = Limits.from_parameters(parameters)
    guard = Guard(("wire",), ("power", "temperature"), 0.5)
    bench = VirtualBench(parameters, SETTINGS)
    # A duty of 3 V of 10 V heats like 5.5 V.
    voltage = (1.0 if drive == "duty" else 3.0,)
    for k in range(1, 101):
        guard.commanded(voltage)
        for reading in bench.advance(voltage, round(SLICE * k * NANOSECONDS)):
            now = reading.time / NANOSECONDS
            if reading.kind == "power":
                power = reading.values[0]
                guard.power("wire", *power, now, now, limits)
            elif reading.kind == "temperature":
                guard.temperature("wire", reading.values[0] + CELSIUS_ZERO, now, now, limits)
        assert k == 1 or guard.fault(SLICE * k) == ""
    for k in range(200):  # and a bench that stays at the last command is found
        now = 5.0 + 0.01 * k
        guard.commanded((2.0 * voltage[0],))
        guard.power("wire", *power, now, now, limits)
    assert "disagreement: wire gets" in guard.fault(now)


TIMEOUT, PATIENCE = 0.5, 2.0


class Simulation:
    """Runs slices whenever allowed, with its own wall clock."""

    def __init__(self, speed):
        self.lockstep = Lockstep(SLICE, speed, TIMEOUT, PATIENCE)
        self.slices, self.wall = 0, 100.0

    def run(self, seconds, tick=0.001):
        end = self.wall + seconds
        while self.wall < end:
            while self.lockstep.may_advance(self.slices * SLICE, self.wall):
                self.slices += 1
            self.wall += tick
        return self.slices * SLICE

    def command(self):
        self.lockstep.commanded(self.slices * SLICE, self.wall)


def test_time_runs_at_the_asked_speed_and_stands_until_all_that_a_driver_sent_is_heard():
    simulation = Simulation(20.0)
    before = simulation.run(2.0)
    assert before == pytest.approx(40.0, abs=2 * SLICE)
    for _ in range(3):  # each for a slice that ran before the first of them came
        simulation.command()
        assert simulation.run(0.02) == before
    assert simulation.run(0.2) - before == pytest.approx(SLICE)
    before = simulation.run(0.8)  # the driver thinks
    simulation.command()
    assert simulation.run(0.02) - before == pytest.approx(SLICE)


@given(st.lists(st.floats(0.001, 1.0), min_size=1, max_size=30))
@settings(max_examples=30, deadline=None)
def test_every_command_is_worth_one_slice_whatever_the_delays(delays):
    simulation = Simulation(1000.0)
    simulation.command()
    simulation.run(0.2, tick=0.01)
    begin = simulation.slices
    for delay in delays:
        simulation.run(delay, tick=0.01)
        simulation.command()
    simulation.run(0.1, tick=0.01)
    assert simulation.slices - begin == len(delays)


def test_a_simulation_waits_for_a_lost_or_slow_driver_only_for_its_patience():
    simulation = Simulation(100.0)
    begin = simulation.run(0.1)
    simulation.command()
    assert simulation.run(PATIENCE - 0.1) == pytest.approx(begin + SLICE)
    # Waited for once as a slow driver, then never again.
    assert simulation.run(2 * PATIENCE + 0.5) > begin + 10 * TIMEOUT
    simulation.command()
    begin = simulation.slices
    simulation.run(1.0)
    assert simulation.slices - begin == 1
    # A driver slower than declared stalls it once: its next command comes two slices later.
    simulation = Simulation(100.0)
    simulation.command()
    simulation.run(PATIENCE + 0.3)
    for _ in range(20):
        due, before = simulation.slices + 2, simulation.wall
        simulation.command()
        while simulation.slices < due:
            simulation.run(0.01)
        assert simulation.wall - before <= PATIENCE
