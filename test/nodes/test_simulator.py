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
    for reading in (temperature[0], ambient[0]):
        assert reading.temperature == pytest.approx(23.0, abs=0.5)
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
    front, back, joints, driven = bench.hear(
        "front/range", "back/range", "joint_states", "front_1/power"
    )
    bench.start("simulator", "config/composite_rig.yaml", speed=20.0)
    command = bench.talk("voltage_command", Float64MultiArray)
    bench.until(lambda: front and back and driven and joints)
    bench.until(lambda: command.publish(volts(6, 6, 0, 0)) or joints[-1].position[0] > 0.005)
    assert joints[-1].name == ["tip"] and front[0].radiation_type == Range.INFRARED
    assert front[-1].range < front[0].range < back[-1].range
    assert driven[-1].voltage == pytest.approx(6.0, abs=0.02)


def test_simulated_time_takes_a_step_for_each_command_and_goes_on_when_the_driver_has_left(bench):
    clocks, diagnostics = bench.hear("/clock", "/diagnostics")
    node = bench.start("simulator", speed=1000.0, lockstep_patience=3.0)
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
    standing = now()
    bench.until(lambda: now() > standing + 1.0)
    bench.until(lambda: counter(diagnostics, "command_timeouts") >= 1)
    assert node.end() == 0


def test_of_two_commanders_the_second_is_refused_reported_and_takes_over_later(bench):
    """And of two that do not sign, and might be two, neither drives."""
    power, diagnostics = bench.hear("wire/power", "/diagnostics")
    bench.start("simulator")
    bench.start("experiment")  # signs: beside it a script may still drive
    topic = bench.talk("voltage_command", Float64MultiArray)
    first, second = (
        voltage_command((), [level], signature(bench.node)) for level in (3.0, 6.0)
    )

    def sending(messages, condition):
        bench.until(lambda: [topic.publish(message) for message in messages] and condition())

    def applied(level):
        return power and abs(power[-1].voltage - level) < 0.1

    sending([volts(3.0)], lambda: applied(3.0))
    other = rclpy.create_node("other", namespace="/bench")
    other.create_publisher(Float64MultiArray, "voltage_command", 10)
    sending([volts(3.0)], lambda: applied(0.0))
    said = "several nodes may send them: /bench/other, /bench/test"
    sending([volts(3.0)], lambda: said in text(diagnostics, "last_rejection"))
    other.destroy_node()
    sending([volts(3.0)], lambda: applied(3.0))
    bench.until(lambda: applied(0.0))

    sending([first], lambda: applied(3.0))
    for other in (second, volts(6.0)):
        seen = len(power)
        sending([first, other], lambda: len(power) > seen + 60)  # noqa: B023
        assert max(message.voltage for message in power[seen + 20:]) < 3.1
    sending([first], lambda: "commands already" in text(diagnostics, "last_rejection"))
    assert text(diagnostics, "commander") == bench.node.get_fully_qualified_name()
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
