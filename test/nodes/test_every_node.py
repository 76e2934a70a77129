"""Properties of all nodes, checked on nodes created in this process."""

import gc
import signal
import threading
import time
from pathlib import Path

import json_schema
import pytest
import rclpy
import yaml
from hostile_texts import hostile_values
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter as RosParameter
from rclpy.parameter import parameter_dict_from_yaml_file
from std_msgs.msg import Float64MultiArray, MultiArrayDimension, String

from sma_bench.dashboard.live_state import LiveState
from sma_bench.errors import InputError
from sma_bench.nodes.start import node_class
from sma_bench.parameters.node_tables import NODE_TABLES
from sma_bench.ros.bench_client import BenchClient
from sma_bench.ros.dashboard import listening_node
from sma_bench.ros.node import OneThreadExecutor, end_of_ros, layout_fault, voltage_command

# Created by rclpy before a node can have parameters.
ROS_OWN = ("/parameter_events", "/rosout", "/clock")
COMPOSITE = Path(__file__).resolve().parents[2] / "config" / "composite_rig.yaml"
COMMANDS = "qos_overrides./bench/voltage_command.publisher"
QOS = "qos_overrides./bench/{}.reliability:=best_effort"
CHANNELS = ("front_1", "back_1")
# Required parameters, and images that render quickly.
FILLED = ("-p", "regions:=['', '', '', '']", "-p", "image_width:=96", "-p", "image_height:=72")
# Nodes whose parameters of the bench cannot change while they run.
FROZEN = ("simulator", "serial_bridge", "ir_camera")
CHANGES = yaml.safe_load(Path(__file__).with_name("changes.yaml").read_text())


@pytest.fixture
def make(ros_domain, tmp_path, monkeypatch, as_any_process):
    """Creates a node by its name; further arguments are its command line."""
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


def test_a_process_leaves_ros_when_the_end_of_its_nodes_has_been_read(ros_domain):
    # A peer that reads this after the DDS participant ended keeps the node in its graph for ever.
    own, seen = rclpy.Context(), [set()]
    rclpy.init(args=[], context=own)
    peer = rclpy.create_node("peer", context=own)

    def leave():
        with end_of_ros():
            node.destroy_node()

    rclpy.init(args=[])
    node, ending = rclpy.create_node("node"), threading.Thread(target=leave)
    while "node" in seen[-1] or "_leaving" in seen[-1] or ending.ident is None:
        if "node" in seen[-1] and ending.ident is None:
            ending.start()
        time.sleep(0.01)
        seen.append(set(peer.get_node_names()))
    ending.join()
    assert seen[-6:] == [{"peer", "_leaving"}] * 5 + [{"peer"}]
    peer.destroy_node()
    rclpy.shutdown(context=own)


def assert_overridable(node, best_effort=""):
    """The QoS of every topic can be overridden, and that of `best_effort` is."""
    for kind, endpoints in (("publisher", node.publishers), ("subscription", node.subscriptions)):
        for endpoint in endpoints:
            topic = getattr(endpoint, "topic_name", None) or endpoint.topic
            name = f"qos_overrides.{topic}.{kind}.reliability"
            assert node.has_parameter(name) == (topic not in ROS_OWN), name
            if topic == f"/bench/{best_effort}":
                assert endpoint.qos_profile.reliability.name == "BEST_EFFORT"


def test_every_node_has_overridable_qos_latches_texts_and_keeps_results_in_their_root(make):
    nodes = {}
    marker, progress = "experiment/marker", "experiment/progress"
    for name in NODE_TABLES:
        node = nodes[name] = make(name, "--params-file", str(COMPOSITE), *FILLED, "-p",
                                  QOS.format(f"{progress}.publisher"))  # fmt: skip
        # Commands of a best-effort publisher are received.
        drives = name in ("simulator", "serial_bridge")
        assert_overridable(node, "voltage_command" if drives else progress)
        result = node.set_parameters([RosParameter("use_sim_time", value=True)])[0]
        assert not result.successful and "read-only" in result.reason
    # A text topic is a state, the marker, or JSON with a schema.
    texts = {p.topic_name.removeprefix("/bench/") for node in nodes.values()
             for p in node.publishers if p.msg_type is String}  # fmt: skip
    texts -= {marker, *(f"{name}/state" for name in NODE_TABLES if name != "recorder")}
    assert texts == json_schema.topics().keys()
    offered = {p.topic_name: p.qos_profile for p in nodes["experiment"].publishers}
    state = offered["/bench/experiment/state"]
    assert state.reliability.name == "RELIABLE"  # was made from the profile of `progress`
    marker = offered[f"/bench/{marker}"]
    assert (marker.durability.name, marker.depth) == ("TRANSIENT_LOCAL", 1)  # for latecomers
    for name, result in (("diagnosis", "improved"), ("diagnosis", "report"),
                         ("identification", "output_directory"), ("investigation", "folder")):
        before = nodes[name].get_parameter(result).value
        (answer,) = nodes[name].set_parameters([RosParameter(result, value="/etc/x.yaml")])
        assert not answer.successful and "/etc/x.yaml lies outside output_root" in answer.reason
        assert nodes[name].get_parameter(result).value == before


@pytest.mark.parametrize("name", sorted(NODE_TABLES))
def test_what_param_dump_writes_param_load_sets_and_whatever_is_set_is_answered_in_a_line(
    make, tmp_path, name
):
    """As the ros2 commands do: values of the file become text and are parsed again."""
    node = make(name, "--params-file", str(COMPOSITE), *FILLED, "-p", "wire.mass:=9.0e-5")
    executor = OneThreadExecutor()
    executor.add_node(node)
    client = node.create_client(SetParameters, f"{name}/set_parameters")

    def dumped():
        names = sorted(node.list_parameters([], 0).names)
        return {p.name: p.value for p in node.get_parameters(names)}

    def load(values):
        file = tmp_path / f"{name}.yaml"
        plain = {n: list(v) if isinstance(v, (list, tuple)) else v for n, v in values.items()}
        file.write_text(yaml.safe_dump({f"/bench/{name}": {"ros__parameters": plain}}))
        parameters = list(parameter_dict_from_yaml_file(str(file)).values())
        future = client.call_async(SetParameters.Request(parameters=parameters))
        executor.spin_until_future_complete(future, 30.0)
        results = zip(parameters, future.result().results, strict=True)
        return {p.name: result.reason for p, result in results if not result.successful}

    before = dumped()
    assert len(before) > 80 and str(before["wire.mass"]) == "9e-05"  # YAML takes it for a text
    assert load(before) == {}
    assert dumped() == before
    changes = CHANGES.get(name, {}) | ({} if name in FROZEN else {"wire.mass": 8e-05})
    assert load(changes) == {}
    assert {n: dumped()[n] for n in changes} == changes
    held = {"use_sim_time": True} | ({"wire.mass": 8e-05} if name in FROZEN else {})
    assert load(held).keys() == held.keys()
    executor.shutdown()
    for parameter in {p.name for p in NODE_TABLES[name]} | {"bench.channels", "wire.resistance"}:
        usual = node.get_parameter(parameter).value
        for value in hostile_values(usual):
            (answer,) = node.set_parameters([RosParameter(parameter, value=value)])
            assert answer.successful or "\n" not in answer.reason and len(answer.reason) < 1000
            if answer.successful:
                node.set_parameters([RosParameter(parameter, value=usual)])


def test_every_node_announces_itself_once_then_its_status_and_its_name_if_it_cannot_start(
    bench, tmp_path
):
    def speaking():
        return {status.name.split("/")[2].partition(": ")[0] for message in bench.diagnostics
                if message.header.stamp.sec > 0 for status in message.status}  # fmt: skip

    given = {"ir_camera": {"regions": [""] * 4}, "recorder": {"output": tmp_path / "bag"}}
    nodes = {name: bench.start(name, COMPOSITE, **given.get(name, {})) for name in NODE_TABLES}
    bench.until(lambda: all("ready\n" in node.output for node in nodes.values()), 60.0)
    bench.until(lambda: speaking() == nodes.keys(), 60.0)
    for node in nodes.values():
        node.process.send_signal(signal.SIGINT)
    for name, node in nodes.items():
        assert node.process.wait(60.0) == 0
        assert node.output.count("ready\n") == node.output.count(f"[bench.{name}]: ready\n") == 1
    for name, arguments, said in (
        ("twin", ["--params-file", "none.yaml"], "[twin]: none.yaml: cannot read"),
        ("ir_camera", ["-p", "wires:=['']"], "[ir_camera]: -p: unknown parameter wires"),
        ("recorder", ["-r", "a:b:c"], "[recorder]: "),
        ("simulator", ["-r", "__ns:=/cell/twin"], "[simulator]: namespace /cell/twin: "),
        ("serial_bridge", ["-r", "__node:=uno"], "[serial_bridge]: renamed to uno: "),
        ("recorder", ["-p", f"output:={tmp_path}"], f"[recorder]: {tmp_path}: exists already"),
    ):
        node = bench.start_with(name, ["--ros-args", *arguments])
        assert node.ended_with(2, said)
        assert node.output.splitlines()[-1].startswith("[FATAL] ")
    broken = "sys.modules['sma_bench.nodes.twin'] = None; start._run('twin', [])"
    node = bench.run("twin", ["-c", f"import sys; from sma_bench.nodes import start; {broken}"])
    assert node.ended_with(2, "[twin]: import of sma_bench.nodes.twin halted")


@pytest.mark.usefixtures("ros_domain")
def test_qos_of_what_the_page_and_the_call_command_hear_can_be_overridden():
    state = "experiment/state"
    best_effort = ["--ros-args", "-p", QOS.format(f"{state}.subscription")]
    with BenchClient("/bench", ros_arguments=best_effort) as client:
        client.follow("experiment")
        assert_overridable(client._node, state)
    with listening_node("/bench", LiveState(), pytest.fail, best_effort) as node:
        node._take(f"/bench/{state}", ["experiment", "state"], ["std_msgs/msg/String"])
        assert_overridable(node, state)
    with pytest.raises(InputError, match="-p nothing"):
        BenchClient("/bench", ros_arguments=["--ros-args", "-p", "nothing"])


@pytest.mark.parametrize(("name", "given", "said"), [
    ("experiment", f"{COMMANDS}.reliability:=rather", "voltage_command"),
    ("experiment", f"{COMMANDS}.depth:=-3", "voltage_command"),
    ("serial_bridge", "telemetry_rate:=300", "telemetry_rate is 300 Hz, expected a divisor"),
    ("serial_bridge", "use_sim_time:=true", "but hardware runs in real time"),
    ("deflection_controller", "wire.count:=1", "clamped"),
    ("simulator", "bench.channels:=[ambient]", "'ambient' cannot name a channel"),
    ("simulator", f"bench.channels:=[{'x' * 300}]", "Invalid topic name"),
    ("ir_camera", "statistic:=mode", "statistic: 'mode', expected mean, median, hottest"),
    ("serial_bridge", "feedback:=[]", "feedback: '', expected power, temperature or both"),
    ("experiment", "feedback:=[power, heat]", "feedback: 'power, heat', expected power"),
    ("recorder", 'output:="a\\nb"', r"output: 'a\\nb', expected printable text"),
    ("recorder", "output:=.", "exists already"), ("recorder", "output:=/proc/bag", "/proc/bag"),
])  # fmt: skip
def test_a_node_refuses_impossible_parameters_in_one_line(make, name, given, said):
    with pytest.raises(InputError, match=f"^[^\n]*{said}[^\n]*$"):
        node = make(name, "-p", given)
        raise node.failure or AssertionError("it can")


def test_a_remapped_state_of_the_bridge_is_found(make):
    node = make("experiment", "-r", "serial_bridge/state:=/cell/uno")
    node.create_publisher(String, "/cell/uno", 1)
    end = time.monotonic() + 10.0
    while "serial_bridge/state" not in node.surroundings().present:
        assert time.monotonic() < end
        time.sleep(0.05)


def test_a_command_says_which_channels_it_is_for_and_one_for_others_is_refused():
    (dim,) = voltage_command(CHANNELS, [1.0, 2.0]).layout.dim
    assert (dim.label, dim.size, dim.stride) == ("front_1 back_1", 2, 2)
    signed = (voltage_command(channels, [1.0, 2.0], "/bench/a#1") for channels in (CHANNELS, ()))
    for command in (*signed, Float64MultiArray(data=[1.0, 2.0])):  # which says nothing
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
