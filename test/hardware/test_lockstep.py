"""Simulated time and its driver, on a clock that the test turns by hand."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sma_bench.live.virtual_bench import Lockstep

SLICE = 0.05
TIMEOUT = 0.5
PATIENCE = 2.0


class Simulation:
    """Runs slices whenever allowed, and turns its own wall clock."""

    def __init__(self, speed):
        self.lockstep = Lockstep(SLICE, speed, TIMEOUT, PATIENCE)
        self.slices = 0
        self.wall = 100.0

    @property
    def simulated(self):
        return self.slices * SLICE

    def run(self, seconds, tick=0.001):
        end = self.wall + seconds
        while self.wall < end:
            while self.lockstep.may_advance(self.simulated, self.wall):
                self.slices += 1
            self.wall += tick
        return self.simulated

    def command(self):
        self.lockstep.commanded(self.simulated, self.wall)


def test_without_a_driver_time_runs_at_the_asked_speed():
    assert Simulation(20.0).run(2.0) == pytest.approx(40.0, abs=2 * SLICE)


def test_real_time_waits_for_nobody_and_catches_up():
    simulation = Simulation(1.0)
    simulation.run(1.0)
    simulation.command()
    simulation.wall += 3.0
    assert simulation.run(1.0) == pytest.approx(5.0, abs=2 * SLICE)


def test_a_driver_that_begins_finds_time_standing_until_all_it_sent_is_heard():
    simulation = Simulation(20.0)
    before = simulation.run(1.0)
    for _ in range(3):  # each for a slice that ran before the first of them came
        simulation.command()
        assert simulation.run(0.02) == before
    assert simulation.run(0.2) - before == pytest.approx(SLICE)


def test_time_lost_in_waiting_is_not_caught_up():
    simulation = Simulation(20.0)
    simulation.run(1.0)
    simulation.command()
    simulation.run(1.0)  # the driver thinks
    before = simulation.simulated
    simulation.command()
    simulation.run(0.02)
    assert simulation.simulated - before == pytest.approx(SLICE)


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


def test_a_driver_that_left_is_waited_for_no_longer_than_its_patience():
    simulation = Simulation(100.0)
    simulation.run(0.1)
    simulation.command()
    begin = simulation.simulated
    assert simulation.run(PATIENCE - 0.1) == pytest.approx(begin + SLICE)
    # Once as a slow driver, once for good.
    assert simulation.run(2 * PATIENCE + 0.5) > begin + 10 * TIMEOUT


def test_a_driver_slower_than_declared_stalls_the_simulation_once():
    simulation = Simulation(100.0)
    simulation.command()
    simulation.run(PATIENCE + 0.3)  # its next command is due two slices later
    assert simulation.slices >= 2
    stalls = 0
    for _ in range(20):
        due = simulation.slices + 2
        simulation.command()
        before = simulation.wall
        while simulation.slices < due:
            simulation.run(0.01)
        stalls += simulation.wall - before > PATIENCE
    assert stalls == 0


def test_a_driver_that_comes_back_is_in_lockstep_again():
    simulation = Simulation(100.0)
    simulation.command()
    simulation.run(3 * PATIENCE)
    simulation.command()
    begin = simulation.slices
    simulation.run(1.0)
    assert simulation.slices - begin == 1
