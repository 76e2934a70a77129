"""The recorder as a process: it records all of its bench, in bags that a crash leaves readable."""

import itertools
import json
import resource
import signal

import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import BatteryState, Temperature
from std_msgs.msg import Float64MultiArray, String

from sma_bench.records import read_record
from sma_bench.ros.node import LATCHED

BEST_EFFORT = QoSProfile(depth=50, reliability=ReliabilityPolicy.BEST_EFFORT)


def recording(bench, folder, *topics):
    """A running recorder that has subscribed to the topics, and its counts of their messages."""
    states = bench.hear("recorder/state")
    node = bench.start("recorder", output=folder)

    def counts():
        messages = json.loads(states[-1].data)["messages"] if states else {}
        return {t: n for t, n in messages.items() if t != "/diagnostics"}  # its own among them

    bench.until(lambda: set(topics) <= set(counts()))
    return node, counts


def temperature(k):
    message = Temperature(temperature=20.0 + k)
    message.header.stamp.sec = 1000 + k
    return message


def test_everything_published_is_in_the_bag_and_nothing_of_another_bench(bench, tmp_path):
    burst = 2000
    reliable = bench.node.create_publisher(Temperature, "wire/temperature", burst)
    hasty = bench.node.create_publisher(BatteryState, "wire/power", BEST_EFFORT)
    other = bench.node.create_publisher(Temperature, "/elsewhere/wire/temperature", 10)
    chatter = bench.node.create_publisher(String, "chatter", 10)
    power = BatteryState(voltage=2.0)
    power.header.stamp.sec = 1000
    topics = "/bench/wire/temperature", "/bench/wire/power"
    node, counts = recording(bench, tmp_path / "bag", *topics)
    bench.until(lambda: reliable.get_subscription_count() and hasty.get_subscription_count())
    # With simulated time, which never begins here, messages would get no stamps.
    assert not bench.set_parameter("recorder", "use_sim_time", True).successful
    other.publish(temperature(0))
    chatter.publish(String(data="x"))
    hasty.publish(power)
    bench.until(lambda: counts() == dict(zip(topics, (0, 1), strict=True)))
    second = bench.node.create_publisher(BatteryState, "wire/power", 10)
    two = "wire/power has 2 publishers: /bench/test, /bench/test"
    bench.until(lambda: two in str(bench.status("recorder: publishers")))
    assert node.output.count(two) == 1
    bench.node.destroy_publisher(second)
    # Messages sent before the end are written, even if they were still queued.
    node.process.send_signal(signal.SIGSTOP)
    for k in range(burst):
        reliable.publish(temperature(k))
    node.process.send_signal(signal.SIGCONT)
    # Messages that do not fit into a buffer are sent again.
    assert node.end(signal.SIGTERM) == 0
    record = read_record(tmp_path / "bag")
    assert record["wire.temperature"].values == pytest.approx([293.15 + k for k in range(burst)])
    assert record["wire.voltage"].values == pytest.approx([2.0])
    assert not [f for f in record.findings if f.severity != "info"]


def test_a_publisher_that_comes_later_and_offers_less_is_recorded_too(bench, tmp_path):
    """A best-effort driver instead of a reliable one; a volatile marker beside a latched one."""
    first = bench.node.create_publisher(Temperature, "wire/temperature", 10)
    latched = bench.node.create_publisher(String, "experiment/marker", LATCHED)
    topics = "/bench/wire/temperature", "/bench/experiment/marker"
    node, counts = recording(bench, tmp_path / "bag", *topics)
    bench.until(lambda: first.get_subscription_count() and latched.get_subscription_count())
    first.publish(temperature(0))
    latched.publish(String(data="a/1"))
    bench.until(lambda: counts() == dict(zip(topics, (1, 1), strict=True)))
    bench.node.destroy_publisher(first)
    later = bench.node.create_publisher(Temperature, "wire/temperature", BEST_EFFORT)
    marker = bench.node.create_publisher(String, "experiment/marker", 10)
    bench.until(lambda: later.get_subscription_count() and marker.get_subscription_count())
    later.publish(temperature(1))
    marker.publish(String(data="a/2"))
    bench.until(lambda: counts() == dict(zip(topics, (2, 2), strict=True)))
    assert node.output.count("subscribed again") == 2


HANGS_AT_ITS_END = """
import ctypes, sys
import rclpy.node
from sma_bench.nodes import start
start._LEAVING = 0.5
rclpy.node.Node.destroy_node = lambda _: ctypes.PyDLL(None).sleep(600)  # with Python's lock held
start.recorder(sys.argv[1:])
"""


def test_a_node_that_the_middleware_does_not_let_go_ends_with_a_whole_bag(bench, tmp_path):
    arguments = ["--ros-args", "-r", "__ns:=/bench", "-p", f"output:={tmp_path / 'bag'}"]
    publisher = bench.node.create_publisher(Temperature, "wire/temperature", 10)
    node = bench.run("hangs", ["-c", HANGS_AT_ITS_END, *arguments])
    bench.until(publisher.get_subscription_count)
    publisher.publish(temperature(0))
    assert node.end(signal.SIGINT) == -signal.SIGALRM
    assert read_record(tmp_path / "bag")["wire.temperature"].values == pytest.approx([293.15])


def test_a_full_disk_is_one_line_and_what_was_written_stays_readable(bench, tmp_path):
    publisher = bench.node.create_publisher(Float64MultiArray, "voltage_command", 1000)
    states = bench.hear("recorder/state")
    node = bench.start("recorder", output=tmp_path / "bag")
    resource.prlimit(node.process.pid, resource.RLIMIT_FSIZE, (60_000, 60_000))
    bench.until(lambda: publisher.get_subscription_count() and bench.diagnostics)  # it is heard
    numbers = itertools.count()

    def publish_until_it_ends():
        for k in itertools.islice(numbers, 20):
            publisher.publish(Float64MultiArray(data=[float(k * 37 % 101)] * 40))
        return node.process.poll() is not None

    bench.until(publish_until_it_ends, patience=120.0)
    said = "cannot be written: File too large"
    assert node.ended_with(2, said)
    assert said in [line for line in node.output.splitlines() if "recorder]: " in line][-1]
    bench.until(lambda: json.loads(states[-1].data)["state"] == "failed")
    bench.until(lambda: bench.status("recorder: bag").level == DiagnosticStatus.ERROR)
    assert said in bench.status("recorder: bag").message
    assert len(read_record(tmp_path / "bag")["voltage_command"].time) > 100


def test_start_stop_and_split_give_a_bag_each_and_a_killed_recorder_leaves_a_readable_one(
    bench, tmp_path
):
    publisher = bench.node.create_publisher(Temperature, "wire/temperature", 1000)
    topic = "/bench/wire/temperature"
    node, counts = recording(bench, tmp_path / "bag", topic)
    bench.until(publisher.get_subscription_count)

    def publish(n):
        for k in range(n):
            publisher.publish(temperature(k))
        # The count comes with the flush of every second.
        bench.until(lambda: counts().get(topic) == n)

    publish(3)
    split = bench.trigger("recorder/split")
    assert split.success and split.message.endswith(f"recording {tmp_path / 'bag_2'}")
    publish(4)
    for service, success in (("stop", True), ("stop", False), ("split", False)):
        assert bench.trigger(f"recorder/{service}").success == success
    publisher.publish(temperature(0))  # nobody writes it
    for success in (True, False):
        assert bench.trigger("recorder/start").success == success
    publish(100)
    node.end(signal.SIGKILL)
    for name, count in (("bag", 3), ("bag_2", 4), ("bag_3", 100)):
        assert len(read_record(tmp_path / name)["wire.temperature"]) == count
