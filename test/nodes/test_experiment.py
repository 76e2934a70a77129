"""The experiment node as a process: it follows the protocol and ends at 0 V."""

import json
import os
import signal
import time
from pathlib import Path

import pytest
import yaml
from fake_bench import FakeBench
from rclpy.time import Time
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Temperature
from std_msgs.msg import String

from sma_bench.ros.node import LATCHED

RUNS = yaml.safe_load((Path(__file__).parents[1] / "runs.yaml").read_text())
SHORT, LONG, HOT = (RUNS[name] for name in ("short", "long", "hot"))


@pytest.fixture
def protocol(tmp_path):
    def write(document):
        path = tmp_path / f"{document['name']}.yaml"
        path.write_text(yaml.safe_dump(document))
        return str(path)

    return write


def test_protocol_is_followed_on_a_bench_faster_than_real_time(bench, protocol):
    """In lockstep: simulated time advances by 50 ms for each command."""
    markers, states, commands = bench.hear(
        "experiment/marker", "experiment/state", "voltage_command"
    )
    bench.start("simulator", speed=50.0)
    node = bench.start("experiment", protocol=protocol(SHORT), use_sim_time=True)
    bench.until(lambda: states and states[-1].data == "idle")
    bench.until(lambda: bench.trigger("experiment/start").success)
    bench.until(lambda: states[-1].data == "done: short")
    bench.until(lambda: len(markers) == 4)
    assert [m.data for m in markers] == ["short/warm", "short/heat", "short/cool", "short/done"]
    sent = [m.data[0] for m in commands]
    assert sent[0] == 0.0
    sent = sent[sent.index(2.0) :]
    assert sent[:40] == [2.0] * 40
    assert sent[40:80] == pytest.approx([2.0 + 0.05 * k for k in range(40)], abs=1e-6)
    assert sent[80:100] == [0.0] * 20
    assert node.end() == 0
    bench.start("experiment")
    why = "simulator publishes /clock, but use_sim_time is not set here"
    bench.until(lambda: bench.value("obstacle") == why)


def test_a_clock_of_finer_steps_than_the_commands_has_one_command_a_period(bench, protocol):
    fake = FakeBench(bench)
    bench.start("experiment", protocol=protocol(LONG), use_sim_time=True, command_rate=20.0)
    clock, moments = bench.talk("/clock", Clock), []

    def step():  # of 20 ms, each said twice
        moments.append(20_000_000 * (len(moments) + 1))
        for _ in range(2):
            clock.publish(Clock(clock=Time(nanoseconds=moments[-1]).to_msg()))

    bench.node.create_timer(0.01, step)
    bench.until(lambda: fake.state == "idle")
    bench.until(lambda: bench.trigger("experiment/start").success)
    bench.until(lambda: fake.volts == [3.0])
    sent, begun = len(fake.commands), len(moments)
    bench.until(lambda: len(moments) == begun + 150)
    assert 55 <= len(fake.commands) - sent <= 62  # 60, and 50 if each period began with its command


def test_limits_and_clock_stay_and_any_report_of_a_fault_ends_the_run(
    bench, protocol
):
    """The rules are tested in test/live; here, that each topic and service takes effect."""
    fake = FakeBench(bench)
    long = {"protocol": protocol(LONG), "feedback_timeout": 1.5, "command_rate": 50.0}
    recorder = bench.node.create_publisher(String, "recorder/state", LATCHED)

    def running():
        node, begin = bench.start("experiment", autostart=True, **long), time.monotonic()
        bench.until(lambda: "running: long" in node.output and fake.volts == [3.0])
        assert time.monotonic() - begin > 2.0  # for which readings have come in time first
        return node

    def start():
        bench.until(lambda: bench.trigger("experiment/start").success)
        bench.until(lambda: fake.volts == [3.0])

    def aborts(line):
        bench.until(lambda: fake.state.startswith(f"aborted: {line}"))
        fake.until_zero()
        fake.celsius, fake.ampere = 25.0, None
        assert bench.refused("experiment/start", line)
        assert bench.refused("experiment/start", "reset first")
        assert bench.trigger("experiment/reset").message == "idle"

    node = running()
    bench.until(recorder.get_subscription_count)
    recorder.publish(String(data="not what a recorder says"))
    heat_transfer, limit = "wire.heat_transfer_coefficient", "bench.maximum_temperature"
    for name, value in ((limit, 700.0), ("bench.maximum_current", 3.5),
                        ("bench.temperature_tolerance", 400.0), (heat_transfer, 200.0)):
        result = bench.set_parameter("experiment", name, value)
        assert not result.successful
        assert result.reason == f"{name} cannot change while the node runs"
    assert not bench.set_parameter("experiment", "use_sim_time", True).successful
    fake.until_sent(3.0, count=20)
    told = json.loads(fake.progress[-1].data)
    assert (told["protocol"], told["step"], told["duration"]) == ("long", "hold", 1000.0)

    fake.celsius = 160.0
    aborts("over-temperature: wire at 160.0 degC")
    assert not bench.set_parameter("experiment", limit, 700.0).successful
    assert bench.set_parameter("experiment", heat_transfer, 200.0).successful
    start()
    for celsius in (160.0, 25.0):  # before the next command is due
        fake.celsius = celsius
        fake.publish()
    aborts("over-temperature: wire at 160.0 degC")
    start()
    second = bench.talk("wire/temperature", Temperature)
    two = "wire/temperature has 2 publishers: /bench/test, /bench/test"
    bench.until(lambda: two in str(bench.status("experiment: publishers")))
    bench.node.destroy_publisher(second)
    fake.late = 1e6
    aborts("wire/power has timestamps 1000000.0 s before their arrival")
    fake.late = 5.0  # a clock that differs
    start()
    bench.until(lambda: bench.status("experiment: clocks"))
    fake.late = 8.0
    aborts("stale feedback: wire/")
    start()
    fake.ampere = 3.5
    aborts("over-current: wire at 3.50 A, limit 3 A")
    start()
    assert bench.trigger("experiment/reset").message == "running: stop first"
    assert bench.trigger("experiment/start").message == "already running long"
    assert bench.trigger("experiment/stop").success
    aborts("stopped on request")
    bridge = bench.node.create_publisher(String, "serial_bridge/state", LATCHED)
    bridge.publish(String(data="idle"))
    idle = "serial_bridge is not enabled: idle"
    bench.until(lambda: bench.trigger("experiment/start").message == idle)
    bridge.publish(String(data="enabled"))
    start()
    bridge.publish(String(data="stopped: supply at 5.1 V"))
    aborts("serial_bridge: stopped: supply at 5.1 V")
    bridge.publish(String(data="enabled"))
    start()
    failed = {"state": "failed", "failure": "bag: cannot be written: No space left on device"}
    recorder.publish(String(data=json.dumps(failed)))
    aborts("recording failed: bag: cannot be written")
    start()  # without it

    second = bench.start("experiment")
    assert second.ended_with(2, "/bench/experiment is there already in ROS domain")
    assert f"process {node.process.pid}" in second.output
    fake.until_sent(3.0, count=20)
    node.end(signal.SIGKILL)  # whoever was killed holds no name
    recorder.publish(String(data=""))
    node = running()
    assert node.end() == 0 and "Traceback" not in node.output  # with 0 V as its last word
    bench.until(lambda: fake.volts == [0.0] and fake.state == "aborted: the node was ended")


def test_start_is_refused_without_feedback_and_a_bad_protocol_is_refused_with_the_reason(
    bench, protocol, tmp_path
):
    bench.hear("voltage_command")
    # Stated explicitly, as a default would be replaced.
    stated = {"wire__austenite_finish_temperature": 353.61}
    bench.start("experiment", protocol_root=str(tmp_path), **stated)
    # After it has discovered the test's subscription to its commands.
    unfed = "no feedback: wire/power was never"
    bench.until(lambda: bench.refused("experiment/start", unfed))
    pipe, link, huge = (tmp_path / f"{name}.yaml" for name in ("pipe", "link", "huge"))
    os.mkfifo(pipe)
    link.symlink_to("/dev/zero")
    huge.write_bytes(b"#" * (1 << 20) + b"\n")
    for value, reason in (
        ("stairs", "not one of"), (protocol(HOT), "level is 12 V, expected 0 to 10 V"),
        (pipe, "expected a regular file"), (link, "lies outside protocol_root"),
        (huge, "larger than 1048576 bytes"), (f"{tmp_path}/../x.yaml", "lies outside protocol_r"),
    ):  # fmt: skip
        result = bench.set_parameter("experiment", "protocol", str(value))
        assert not result.successful and reason in result.reason
    result = bench.set_parameter("experiment", "wire.austenite_start_temperature", 400.0)
    assert not result.successful and "must lie below" in result.reason
    assert bench.trigger("experiment/stop").success
