"""The simulator as a process: the topics of the contract, its checks of commands, its clock. Its
lockstep with a driver is tested in test/hardware and in the test of the experiment."""

import math
import signal
import threading
import time
from itertools import count
from types import SimpleNamespace

import pytest
import rclpy
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Float64MultiArray

from sma_bench.live.virtual_bench import VirtualBench
from sma_bench.nodes import simulator
from sma_bench.ros.node import signature, voltage_command


def volts(*values):
    return Float64MultiArray(data=[float(v) for v in values])


def test_wire_rig_speaks_the_contract_and_bad_commands_neither_drive_nor_keep_a_drive(bench):
    power, temperature, joints, ambient = bench.hear(
        "wire/power", "wire/temperature", "joint_states", "ambient/temperature"
    )
    node = bench.start("simulator", bench__command_timeout=0.8)
    bench.until(lambda: ambient and len(power) > 100 and len(temperature) > 80 and joints)
    assert power[0].location == "wire" and math.isnan(power[0].percentage)
    assert abs(power[0].current) < 0.15
    for reading in (temperature[0], ambient[0]):
        assert reading.temperature == pytest.approx(23.0, abs=0.5)
    assert joints[0].name == ["wire"] and joints[0].position[0] == 0.0
    stamps = [m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for m in power]
    assert {b - a for a, b in zip(stamps, stamps[1:], strict=False)} == {10_000_000}
    assert abs(stamps[-1] / 1e9 - time.time()) < 30.0
    # Its subscription is best effort, so the first commands may be lost.
    command = bench.talk("voltage_command", Float64MultiArray)
    bench.until(lambda: command.publish(volts(0.0)) or bench.value("accepted_commands") > "0")
    command.publish(volts(2.0))
    bench.until(lambda: power[-1].voltage > 1.9)
    for bad in (volts(math.nan), volts(math.inf), volts(), volts(1, 2), volts(11), volts(-1)):
        command.publish(bad)
    bench.until(lambda: bench.value("rejected_commands") == "6")
    bench.until(lambda: power[-1].voltage < 0.1)
    bench.until(lambda: bench.value("command_timeouts") > "0")
    driven = [m.voltage for m in power if m.voltage > 1.0]
    assert driven == pytest.approx([2.0] * len(driven), abs=0.02)
    assert len(driven) == pytest.approx(0.8 * 100, abs=3)  # of the wire's time

    # No reading is stamped before the command that it shows, even if the simulator was suspended
    # for a while.
    def shown(level):
        return bench.stamped_after(
            power, lambda m: abs(m.voltage - level) < 0.1, lambda: command.publish(volts(level))
        )

    assert min(shown(1.0), shown(2.0)) >= 0
    node.process.send_signal(signal.SIGSTOP)
    time.sleep(0.4)
    threading.Timer(0.1, node.process.send_signal, [signal.SIGCONT]).start()
    assert shown(3.0) >= 0
    assert node.end(signal.SIGTERM) == 0


def test_a_command_acts_when_it_comes_and_a_late_simulator_catches_up(
    bench, monkeypatch, as_any_process
):
    """Not only at the next reading, or readings of a ramp would be late by half their period."""
    wall, found, milli, looks = 7_000_000_000, [], 1_000_000, count()  # a clock goes on
    monkeypatch.setattr(simulator, "time", SimpleNamespace(
        time_ns=lambda: wall, monotonic=lambda: wall / 1e9,
        monotonic_ns=lambda: wall + next(looks)))  # fmt: skip
    advance, steps = VirtualBench.advance, []
    monkeypatch.setattr(VirtualBench, "advance", lambda *given: steps.append(0) or advance(*given))
    monkeypatch.setattr(simulator.Simulator, "_publish", lambda _, reading: found.append(reading))
    node = simulator.Simulator()
    try:
        node._tick()
        for end, level in ((13, 3.0), (57, 0.0), (457, 0.0)):
            wall = (7000 + end) * milli  # without a tick since the last command
            node.on_command(volts(level))
        assert len(steps) < 60  # a slice or less each
        there = VirtualBench(node.parameters, node.settings)
        expected = [
            reading for volt, end in ((0.0, 13), (3.0, 57), (0.0, 457))
            for reading in there.advance((volt,), end * milli)
        ]  # fmt: skip
    finally:
        node.destroy_node()
    assert [(r.kind, r.time) for r in found] == [(r.kind, r.time) for r in expected]
    for kind in ("power", "temperature"):
        got, wanted = ([r.values[0] for r in all_ if r.kind == kind] for all_ in (found, expected))
        assert got == [pytest.approx(values) for values in wanted]


def test_of_two_commanders_the_second_is_refused_reported_and_takes_over_later(bench):
    """If two publishers do not sign their commands, neither of them drives."""
    power = bench.hear("wire/power")
    bench.start("simulator")
    bench.start("experiment")  # signs: beside it a script may still drive
    topic = bench.talk("voltage_command", Float64MultiArray)
    first, second = (voltage_command((), [v], signature(bench.node)) for v in (3.0, 6.0))

    def sending(messages, condition):
        bench.until(lambda: [topic.publish(message) for message in messages] and condition())

    def applied(level):
        return power and abs(power[-1].voltage - level) < 0.1

    sending([volts(3.0)], lambda: applied(3.0))
    other = rclpy.create_node("other", namespace="/bench")
    other.create_publisher(Float64MultiArray, "voltage_command", 10)
    sending([volts(3.0)], lambda: applied(0.0))
    said = "several nodes may have sent it: /bench/other, /bench/test"
    sending([volts(3.0)], lambda: said in bench.value("last_rejection"))
    other.destroy_node()
    sending([volts(3.0)], lambda: applied(3.0))
    bench.until(lambda: applied(0.0))

    sending([first], lambda: applied(3.0))
    for other in (second, volts(6.0)):
        seen = len(power)
        sending([first, other], lambda: len(power) > seen + 60)  # noqa: B023
        assert max(message.voltage for message in power[seen + 20 :]) < 3.1
    sending([first], lambda: "commands already" in bench.value("last_rejection"))
    assert bench.value("commander") == bench.node.get_fully_qualified_name()
    sending([first, volts(0.0)], lambda: applied(0.0))  # obeyed from anybody
    sending([second], lambda: applied(6.0))


def test_a_second_clock_is_refused_and_a_foreign_one_ends_simulation_run_and_record(
    bench, tmp_path
):
    states = bench.hear("experiment/state")
    simulator = bench.start("simulator", speed=2.0)
    experiment = bench.start("experiment", protocol="staircase", use_sim_time=True, autostart=True)
    recorder = bench.start("recorder", output=str(tmp_path / "bag"), use_sim_time=True)
    bench.until(lambda: states and states[-1].data == "running: staircase")
    second = bench.start("simulator", remap={"__node": "second"}, speed=2.0)
    assert second.ended_with(2, "/clock is there already")
    bench.until(lambda: "recording /bench/wire/power" in recorder.output)
    assert simulator.process.poll() is None and states[-1].data == "running: staircase"
    player = bench.node.create_publisher(Clock, "/clock", 10)
    bench.node.create_timer(0.02, lambda: player.publish(Clock()))
    bench.until(lambda: states[-1].data.startswith("aborted: simulated time went back by"))
    bench.until(lambda: None not in (simulator.process.poll(), recorder.process.poll()))
    assert "/clock has 2 publishers: /bench/simulator, /bench/test" in simulator.output
    assert "bag: simulated time went back by" in recorder.output
    assert not any("Traceback" in node.output for node in (simulator, experiment, recorder))
    assert (tmp_path / "bag" / "metadata.yaml").is_file()
