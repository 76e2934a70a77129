"""The simulator as a process: the contract's topics, its care with commands, and its clock."""

import math
import signal
import time

import pytest
import rclpy
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Range
from std_msgs.msg import Float64MultiArray

from sma_bench.ros.node import signature, voltage_command

COMPOSITE = "config/composite_rig.yaml"
SLICE = 0.05


def volts(*values):
    return Float64MultiArray(data=[float(v) for v in values])


def text(diagnostics, key):
    """Newest text under a key of the simulator's diagnostics, "" before the first."""
    values = (item for array in reversed(diagnostics) for item in array.status[0].values)
    return next((item.value for item in values if item.key == key), "")


def counter(diagnostics, key):
    return float(text(diagnostics, key) or 0.0)


def commander(bench, diagnostics):
    """A publisher of commands that the simulator has heard: it listens to best effort too, and of
    that the first ones are lost."""
    publisher = bench.talk("voltage_command", Float64MultiArray)
    bench.until(lambda: publisher.publish(volts(0.0)) or counter(diagnostics, "accepted_commands"))
    return publisher


def test_wire_rig_speaks_the_contract_and_bad_commands_neither_drive_nor_keep_a_drive(bench):
    power, temperature, joints, ambient, diagnostics = bench.hear(
        "wire/power", "wire/temperature", "joint_states", "ambient/temperature", "/diagnostics"
    )
    node = bench.start("simulator", bench__command_timeout=0.8)
    bench.until(lambda: ambient and len(power) > 100 and len(temperature) > 80 and joints)
    assert power[0].location == "wire" and math.isnan(power[0].percentage)
    assert abs(power[0].current) < 0.15
    assert temperature[0].temperature == pytest.approx(23.0, abs=0.5)
    assert ambient[0].temperature == pytest.approx(23.0, abs=0.5)
    assert joints[0].name == ["wire"] and joints[0].position[0] == 0.0
    stamps = [m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for m in power]
    assert {b - a for a, b in zip(stamps, stamps[1:], strict=False)} == {10_000_000}
    assert abs(stamps[-1] / 1e9 - time.time()) < 30.0
    command = commander(bench, diagnostics)
    command.publish(volts(2.0))
    bench.until(lambda: power[-1].voltage > 1.9)
    for bad in (volts(math.nan), volts(math.inf), volts(), volts(1, 2), volts(11), volts(-1)):
        command.publish(bad)
    bench.until(lambda: counter(diagnostics, "rejected_commands") == 6)
    bench.until(lambda: power[-1].voltage < 0.1)
    bench.until(lambda: counter(diagnostics, "command_timeouts") >= 1)
    driven = [m.voltage for m in power if m.voltage > 1.0]
    assert driven == pytest.approx([2.0] * len(driven), abs=0.02)
    assert len(driven) == pytest.approx(0.8 * 100, abs=3)  # of the wire's time
    assert node.end(signal.SIGTERM) == 0


def test_composite_rig_bends_to_the_front_when_the_front_is_driven(bench):
    front, back, joints = bench.hear("front/range", "back/range", "joint_states")
    power = {c: bench.hear(f"{c}/power") for c in ("front_1", "back_2")}
    bench.start("simulator", COMPOSITE, speed=20.0)
    command = bench.talk("voltage_command", Float64MultiArray)

    def driven():
        command.publish(volts(6, 6, 0, 0))
        return joints and joints[-1].position[0] > 0.005

    bench.until(driven)
    bench.until(lambda: front and back)
    assert joints[-1].name == ["tip"]
    assert front[-1].range < front[0].range < back[-1].range
    assert front[0].radiation_type == Range.INFRARED
    assert power["front_1"][-1].voltage == pytest.approx(6.0, abs=0.02)
    assert power["back_2"][-1].voltage == pytest.approx(0.0, abs=0.02)


def test_simulated_time_takes_one_step_for_every_command_however_slow_the_driver(bench):
    clocks, diagnostics = bench.hear("/clock", "/diagnostics")
    node = bench.start("simulator", speed=1000.0)
    command = commander(bench, diagnostics)

    def now():
        return clocks[-1].clock.sec + clocks[-1].clock.nanosec * 1e-9

    def wait_for_standstill():
        """The clock is repeated while it stands."""
        seen = []
        bench.until(lambda: seen.append(now()) or (len(seen) > 30 and len(set(seen[-30:])) == 1))

    bench.until(lambda: clocks)
    command.publish(volts(1.0))
    wait_for_standstill()
    begin = before = now()
    for _ in range(20):
        command.publish(volts(1.0))
        before = bench.until(lambda: now() > before and now())  # noqa: B023
    wait_for_standstill()
    assert now() - begin == pytest.approx(20 * SLICE, abs=1e-6)
    assert node.end() == 0


def test_simulated_time_goes_on_without_a_driver_that_left_and_its_silence_times_out(bench):
    power, diagnostics = bench.hear("wire/power", "/diagnostics")
    bench.start("simulator", speed=10.0, lockstep_patience=0.2)
    commander(bench, diagnostics).publish(volts(3.0))
    bench.until(lambda: power and power[-1].voltage > 2.9)
    bench.until(lambda: power[-1].voltage < 0.1)
    bench.until(lambda: counter(diagnostics, "command_timeouts") >= 1)
    assert len([m for m in power if m.voltage > 1.0]) == pytest.approx(0.5 * 100, abs=6)


def test_of_two_commanders_the_second_is_refused_reported_and_takes_over_later(bench):
    power, diagnostics = bench.hear("wire/power", "/diagnostics")
    bench.start("simulator")
    topic = bench.talk("voltage_command", Float64MultiArray)
    first, second = signature(bench.node), signature(bench.node)

    def both(*extra):
        topic.publish(voltage_command((), [3.0], first))
        for message in extra:
            topic.publish(message)

    def applied(low, high):
        return power and low < power[-1].voltage < high

    bench.until(lambda: both() or applied(2.9, 3.1))
    for other in (voltage_command((), [6.0], second), volts(6.0)):
        seen = len(power)
        bench.until(lambda: both(other) or len(power) > seen + 60)  # noqa: B023
        assert max(message.voltage for message in power[seen + 20:]) < 3.1
    bench.until(lambda: both() or "commands already" in text(diagnostics, "last_rejection"))
    assert text(diagnostics, "commander") == bench.node.get_fully_qualified_name()
    # 0 V is obeyed from anybody.
    bench.until(lambda: both(volts(0.0)) or applied(-0.1, 0.1))
    bench.until(lambda: topic.publish(voltage_command((), [6.0], second)) or applied(5.9, 6.1))


def test_unsigned_commands_of_two_nodes_are_refused(bench):
    power, diagnostics = bench.hear("wire/power", "/diagnostics")
    bench.start("simulator")
    bench.start("experiment")  # signs: beside it a script may still drive
    topic = bench.talk("voltage_command", Float64MultiArray)

    def driving_until(condition):
        bench.until(lambda: topic.publish(volts(3.0)) or condition())

    driving_until(lambda: power and power[-1].voltage > 2.9)
    other = rclpy.create_node("other", namespace="/bench")
    other.create_publisher(Float64MultiArray, "voltage_command", 10)
    driving_until(lambda: power[-1].voltage < 0.1)
    said = "several nodes may send them: /bench/other, /bench/test"
    driving_until(lambda: said in text(diagnostics, "last_rejection"))
    other.destroy_node()
    driving_until(lambda: power[-1].voltage > 2.9)


def test_a_second_clock_is_refused_and_a_foreign_one_ends_simulation_run_and_record(
    bench, tmp_path
):
    states = bench.hear("experiment/state")
    simulator = bench.start("simulator", speed=2.0)
    experiment = bench.start("experiment", protocol="staircase", use_sim_time=True, autostart=True)
    recorder = bench.start("recorder", output=str(tmp_path / "bag"), use_sim_time=True)
    bench.until(lambda: states and states[-1].data == "running: staircase")
    second = bench.start("simulator", remap={"__node": "second"}, speed=2.0)
    assert second.process.wait(30.0) == 2
    assert "/clock is there already" in second.output.splitlines()[-1]
    bench.until(lambda: "recording /bench/wire/power" in recorder.output)
    assert simulator.process.poll() is None and states[-1].data == "running: staircase"
    player = bench.node.create_publisher(Clock, "/clock", 10)
    bench.node.create_timer(0.02, lambda: player.publish(Clock()))
    bench.until(lambda: states[-1].data.startswith("aborted: simulated time went back by"))
    bench.until(lambda: None not in (simulator.process.poll(), recorder.process.poll()))
    assert "/clock has a second publisher: /bench/test" in simulator.output
    assert "bag: simulated time went back by" in recorder.output
    for node in (simulator, experiment, recorder, second):
        assert "Traceback" not in node.output
    assert (tmp_path / "bag" / "metadata.yaml").is_file()
