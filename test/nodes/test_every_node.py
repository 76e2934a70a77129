"""What holds of every node, seen on the nodes themselves, made in this process."""

import gc
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


@pytest.mark.parametrize("name", NODE_TABLES)
def test_qos_of_every_topic_can_be_overridden_and_every_node_gives_diagnostics(make, name):
    rig = ["--params-file", str(COMPOSITE)] if name == "deflection_controller" else []
    node = make(name, *rig)
    assert_overridable(node)
    result = node.set_parameters([RosParameter("use_sim_time", value=True)])[0]
    assert not result.successful and "read-only" in result.reason
    heard = []
    node.create_subscription(DiagnosticArray, "/diagnostics", heard.append, 10)
    executor = OneThreadExecutor()
    executor.add_node(node)
    for _ in range(200):
        executor.spin_once(timeout_sec=0.1)
        if heard:
            break
    assert heard[0].status and all(s.name.startswith(f"/bench/{name}: ") for s in heard[0].status)
    assert heard[0].header.stamp.sec > 0
    executor.shutdown()


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


@pytest.mark.parametrize("name", ["simulator", "serial_bridge"])
def test_a_best_effort_commander_is_heard(make, name):
    node = make(name)
    (heard,) = [s for s in node.subscriptions if s.topic_name == "/bench/voltage_command"]
    assert heard.qos_profile.reliability.name == "BEST_EFFORT"


@pytest.mark.parametrize(
    ("policy", "value"), [("reliability", "rather"), ("depth", "-3"), ("depth", "many")]
)
def test_an_override_that_is_no_qos_is_one_line(make, policy, value):
    with pytest.raises(InputError, match="voltage_command") as refused:
        make(
            "experiment",
            "-p",
            f"qos_overrides./bench/voltage_command.publisher.{policy}:={value}",
        )
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("node", "name"),
    [("diagnosis", "improved"), ("diagnosis", "report"), ("identification", "output_directory"),
     ("investigation", "folder")],
)
def test_a_result_outside_its_root_is_refused_when_it_is_set(make, node, name):
    made = make(node)
    before = made.get_parameter(name).value
    (result,) = made.set_parameters([RosParameter(name, value="/etc/x.yaml")])
    assert not result.successful and "/etc/x.yaml lies outside output_root" in result.reason
    assert made.get_parameter(name).value == before


@pytest.mark.parametrize("stray", [["--params-file", "lab.yaml"], ["speed:=2.0"], ["--", "x"]])
def test_an_argument_that_ros_would_pass_over_is_refused(stray):
    with pytest.raises(InputError, match="unknown argument '(--params-file|speed:=2.0|x)'"):
        check_arguments("simulator", ["--ros-args", "-r", "__ns:=/bench", "--", *stray])
    with pytest.raises(InputError, match="after --ros-args"):
        check_arguments("simulator", stray)


CHANNELS = ("front_1", "back_1")


def test_a_command_says_which_channels_it_is_for():
    command = voltage_command(CHANNELS, [1.0, 2.0])
    (dim,) = command.layout.dim
    assert (dim.label, dim.size, dim.stride) == ("front_1 back_1", 2, 2)
    assert layout_fault(command, CHANNELS) == ""
    assert layout_fault(voltage_command(CHANNELS, [1.0, 2.0], "/bench/a#1"), CHANNELS) == ""
    assert layout_fault(voltage_command((), [1.0, 2.0], "/bench/a#1"), CHANNELS) == ""
    assert layout_fault(Float64MultiArray(data=[1.0, 2.0]), CHANNELS) == ""  # says nothing


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda layout: setattr(layout.dim[0], "label", "back_1 front_1"), "expected 'front_1 b"),
        (lambda layout: setattr(layout.dim[0], "size", 3), "a dimension of 3, expected 2"),
        (lambda layout: layout.dim.append(MultiArrayDimension()), "expected one dimension"),
        (lambda layout: setattr(layout, "data_offset", 1), "no offset"),
    ],
)
def test_a_command_for_other_channels_is_refused(change, words):
    command = voltage_command(CHANNELS, [1.0, 2.0])
    change(command.layout)
    assert words in layout_fault(command, CHANNELS)
