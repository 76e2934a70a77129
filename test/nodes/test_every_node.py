"""What holds of every node, seen on the nodes themselves, made in this process."""

import gc
import time
from pathlib import Path

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.parameter import Parameter as RosParameter
from std_msgs.msg import Float64MultiArray, MultiArrayDimension

from sma_bench.dashboard.live_state import LiveState
from sma_bench.errors import InputError
from sma_bench.nodes.arguments import check_arguments
from sma_bench.nodes.start import node_class
from sma_bench.parameters.node_tables import NODE_TABLES
from sma_bench.ros.bench_client import BenchClient
from sma_bench.ros.dashboard import listening_node
from sma_bench.ros.node import OneThreadExecutor, layout_fault, voltage_command

# Made by rclpy before a node's parameters can be.
ROS_OWN = ("/parameter_events", "/rosout", "/clock")
COMPOSITE = Path(__file__).resolve().parents[2] / "config" / "composite_rig.yaml"


@pytest.fixture
def make(ros_domain, tmp_path, monkeypatch):
    """Makes a node by its name; arguments after it are of its command line."""
    monkeypatch.chdir(tmp_path)
    made = []

    def make(name, *arguments):
        if not rclpy.ok():
            rclpy.init(args=["--ros-args", "-r", "__ns:=/bench", *arguments])
        made.append(node_class(name)())
        return made[-1]

    yield make
    for node in made:
        node.close()
        node.destroy_node()
    rclpy.try_shutdown()
    gc.collect()  # a node that was refused has its name until it is no more


def assert_overridable(node):
    for kind, endpoints in (("publisher", node.publishers), ("subscription", node.subscriptions)):
        for endpoint in endpoints:
            topic = getattr(endpoint, "topic_name", None) or endpoint.topic
            overridden = node.has_parameter(f"qos_overrides.{topic}.{kind}.reliability")
            assert overridden == (topic not in ROS_OWN), f"{kind} of {topic}"


def test_qos_of_every_topic_can_be_overridden_and_every_node_gives_diagnostics(make):
    nodes, heard = {}, {name: [] for name in NODE_TABLES}
    executor = OneThreadExecutor()
    for name in NODE_TABLES:
        node = nodes[name] = make(
            name, "--params-file", str(COMPOSITE), "-p", "regions:=['', '', '', '']"
        )
        executor.add_node(node)
        assert_overridable(node)
        result = node.set_parameters([RosParameter("use_sim_time", value=True)])[0]
        assert not result.successful and "read-only" in result.reason

    def on_diagnostics(message):
        for status in message.status:
            heard[status.name.split("/")[2].partition(": ")[0]].append(message.header.stamp.sec)

    listener = rclpy.create_node("listener")
    listener.create_subscription(DiagnosticArray, "/diagnostics", on_diagnostics, 100)
    executor.add_node(listener)
    end = time.monotonic() + 60.0
    while not all(heard.values()) and time.monotonic() < end:
        executor.spin_once(timeout_sec=0.1)
    assert all(stamps and min(stamps) > 0 for stamps in heard.values())
    for name in ("simulator", "serial_bridge"):  # a best-effort commander is heard
        (commands,) = [s for s in nodes[name].subscriptions
                       if s.topic_name == "/bench/voltage_command"]  # fmt: skip
        assert commands.qos_profile.reliability.name == "BEST_EFFORT"
    executor.shutdown()
    listener.destroy_node()


def test_qos_of_what_the_page_and_the_call_command_hear_can_be_overridden(ros_domain):
    best_effort = [
        "--ros-args", "-p", "qos_overrides./bench/experiment/state.subscription.reliability:="
        "best_effort",
    ]
    with BenchClient("/bench", ros_arguments=best_effort) as client:
        client.follow("experiment")
        assert_overridable(client._node)
        (state,) = [s for s in client._node.subscriptions if s.topic_name.endswith("/state")]
        assert state.qos_profile.reliability.name == "BEST_EFFORT"
    with listening_node("/bench", LiveState(), pytest.fail, best_effort) as node:
        node._take("/bench/experiment/state", ["experiment", "state"], ["std_msgs/msg/String"])
        assert_overridable(node)
        (state,) = [s for s in node.subscriptions if s.topic_name.endswith("/state")]
        assert state.qos_profile.reliability.name == "BEST_EFFORT"
    with pytest.raises(InputError, match="-p nothing"), BenchClient(
        "/bench", ros_arguments=["--ros-args", "-p", "nothing"]
    ):
        pass


def test_an_override_of_one_topic_is_that_topics_alone_and_the_marker_is_there_for_latecomers(make):
    override = "qos_overrides./bench/experiment/progress.publisher"
    node = make(
        "experiment", "-p", f"{override}.reliability:=best_effort", "-p", f"{override}.depth:=7"
    )

    def offered(topic):
        return next(p.qos_profile for p in node.publishers if p.topic_name.endswith(topic))

    assert offered("/progress").depth == 7
    assert offered("/progress").reliability.name == "BEST_EFFORT"
    assert offered("experiment/state").depth == 1  # was made from the same profile
    assert offered("experiment/state").reliability.name == "RELIABLE"
    (marker,) = [p for p in node.publishers if p.topic_name == "/bench/experiment/marker"]
    assert marker.qos_profile.durability.name == "TRANSIENT_LOCAL"
    assert marker.qos_profile.depth == 1


@pytest.mark.parametrize(
    ("policy", "value"), [("reliability", "rather"), ("depth", "-3")]
)
def test_an_override_that_is_no_qos_is_one_line(make, policy, value):
    with pytest.raises(InputError, match="voltage_command") as refused:
        topic = "qos_overrides./bench/voltage_command.publisher"
        make("experiment", "-p", f"{topic}.{policy}:={value}")
    assert "\n" not in str(refused.value)


def test_a_result_outside_its_root_is_refused_when_it_is_set(make):
    for node, name in (("diagnosis", "improved"), ("diagnosis", "report"),
                       ("identification", "output_directory"), ("investigation", "folder")):
        made = make(node)
        before = made.get_parameter(name).value
        (result,) = made.set_parameters([RosParameter(name, value="/etc/x.yaml")])
        assert not result.successful and "/etc/x.yaml lies outside output_root" in result.reason
        assert made.get_parameter(name).value == before
        made.destroy_node()


@pytest.mark.parametrize("stray", [["--params-file", "lab.yaml"], ["speed:=2.0"], ["--", "x"]])
def test_an_argument_that_ros_would_pass_over_is_refused(stray):
    with pytest.raises(InputError, match="unknown argument '(--params-file|speed:=2.0|x)'"):
        check_arguments("simulator", ["--ros-args", "-r", "__ns:=/bench", "--", *stray])
    with pytest.raises(InputError, match="after --ros-args"):
        check_arguments("simulator", stray)


CHANNELS = ("front_1", "back_1")


def test_a_command_says_which_channels_it_is_for_and_one_for_others_is_refused():
    (dim,) = voltage_command(CHANNELS, [1.0, 2.0]).layout.dim
    assert (dim.label, dim.size, dim.stride) == ("front_1 back_1", 2, 2)
    for command in (
        voltage_command(CHANNELS, [1.0, 2.0]), voltage_command(CHANNELS, [1.0, 2.0], "/bench/a#1"),
        voltage_command((), [1.0, 2.0], "/bench/a#1"),
        Float64MultiArray(data=[1.0, 2.0]),  # says nothing
    ):
        assert layout_fault(command, CHANNELS) == ""
    for change, words in (
        (lambda layout: setattr(layout.dim[0], "label", "back_1 front_1"), "expected 'front_1 b"),
        (lambda layout: setattr(layout.dim[0], "size", 3), "a dimension of 3, expected 2"),
        (lambda layout: layout.dim.append(MultiArrayDimension()), "expected one dimension"),
        (lambda layout: setattr(layout, "data_offset", 1), "no offset"),
    ):
        command = voltage_command(CHANNELS, [1.0, 2.0])
        change(command.layout)
        assert words in layout_fault(command, CHANNELS)
