"""A simulated bench in one process: its nodes work as in separate processes, and end together."""

import json
import re
import signal

import pytest
from rosgraph_msgs.msg import Clock

from sma_bench.errors import InputError
from sma_bench.installation import share_directory
from sma_bench.nodes.start import contained
from sma_bench.records import read_record

WIRE = share_directory() / "config" / "wire_rig.yaml"
PATIENCE = 120.0  # s, for several nodes on a busy machine
SHARED = ["--ros-args", "-r", "__ns:=/bench", "--params-file", str(WIRE)]
RAMP = """
name: short_ramp
steps:
  - {kind: ramp, name: heat, start: 0.0, stop: 2.7, duration: 5.0}
  - {kind: rest, name: cool, duration: 2.0}
"""
WARM = "name: warm\nsteps: [{kind: hold, level: 3.0, duration: 600.0}]\n"


def container(bench, tmp_path, protocol, *more, speed=1.0):
    """A bench that runs and records a protocol, with `more` nodes in the same process."""
    file = tmp_path / "protocol.yaml"
    file.write_text(protocol)
    clock = ["-p", "use_sim_time:=true"] if speed > 1.0 else []
    words = ["simulator", "-p", f"speed:={speed}"]
    words += ["experiment", "-p", f'protocol:="{file}"', "-p", "autostart:=true", *clock]
    words += ["-p", "require_recorder:=true"]
    words += ["recorder", "-p", f'output:="{tmp_path / "bag"}"', *clock, *more]
    return bench.start_with("bench", [*words, *SHARED])


@pytest.mark.slow
def test_nodes_of_one_process_run_record_and_work_as_ever_and_their_bag_is_on_one_clock(
    bench, tmp_path
):
    states, markers, commands = bench.hear(
        "experiment/state", "experiment/marker", "voltage_command"
    )
    roots = [w for r in ("record", "output") for w in ("-p", f'{r}_root:="{tmp_path}"')]
    work = ["identification", *roots, "-p", "experiments:=[E3]"]
    node = container(bench, tmp_path, RAMP, *work)
    bench.until(lambda: states and states[-1].data == "running: short_ramp", PATIENCE)
    expected = {"simulator", "experiment", "recorder", "identification"}
    bench.until(lambda: expected <= set(bench.node.get_node_names()))  # the graph is told apart
    # Parameters after a name are that node's, those of the file are shared.
    assert not bench.set_parameter("simulator", "speed", 2.0).successful
    held = bench.set_parameter("experiment", "bench.maximum_voltage", 9.0)
    assert "bench.maximum_voltage cannot change" in held.reason
    assert bench.set_parameter("identification", "bench.maximum_voltage", 9.0).successful
    bench.until(lambda: states[-1].data == "done: short_ramp")
    assert markers[-1].data == "short_ramp/done"
    bench.trigger("recorder/stop")
    bench.set_parameter("identification", "record", ["bag"])
    later = bench.trigger_later("identification/identify")
    bench.until(later.done, PATIENCE)
    answer = later.result()
    assert answer.success, answer.message
    assert node.end() == 0 and "Traceback" not in node.output
    assert commands[-1].data[0] == 0.0

    # All on one clock: no temperature is late.
    (ramps,) = json.loads(answer.message)["experiments"]
    delay = ramps["details"]["delay"]
    # The simulator applies a command at a reading's instant, the fit expects it between two.
    half_a_period = 0.005
    assert abs(delay["value"]) < min(half_a_period + 4.0 * delay["std"], 0.03)
    assert delay["std"] < 0.01


@pytest.mark.parametrize("how", ["a signal", "a node that fails"])
def test_the_end_of_one_node_ends_all_at_0_v_with_a_whole_bag(bench, tmp_path, how):
    commands, states = bench.hear("voltage_command", "experiment/state")
    node = container(bench, tmp_path, WARM, "diagnosis", speed=4.0)
    bench.until(lambda: commands and commands[-1].data[0] == 3.0, PATIENCE)
    if how == "a signal":
        assert node.end(signal.SIGTERM) == 0, node.output
        bench.until(lambda: states[-1].data == "aborted: the node was ended")
    else:
        other = bench.node.create_publisher(Clock, "/clock", 10)
        message = Clock()
        message.clock.nanosec = 7  # no tick of the simulator's
        bench.node.create_timer(0.02, lambda: other.publish(message))
        bench.until(lambda: node.process.poll() is not None)
        assert node.process.returncode == 2
        # Any of them may notice it first.
        first = r"simulator\]: .* second pub|recorder\]: .* another pub"
        assert re.search(first, node.output)
    bench.until(lambda: commands[-1].data[0] == 0.0)
    assert "Traceback" not in node.output
    assert (tmp_path / "bag" / "metadata.yaml").is_file()
    volts = read_record(tmp_path / "bag")["voltage_command"].values
    assert volts.max() == 3.0 and volts.reshape(-1)[-1] == 0.0


def test_if_one_node_cannot_be_created_none_starts_and_the_line_names_it(bench, tmp_path):
    bad = ["ir_camera", "-p", "statistic:=mode"]
    node = container(bench, tmp_path, WARM, *bad)
    assert node.ended_with(2, "[ir_camera]: statistic: 'mode', expected mean, median, hottest")
    assert (tmp_path / "bag" / "metadata.yaml").is_file()  # of a recorder that was there already
    for words, said in (
        (["-p", "wire.resistence:=2.0"], "[twin]: -p: unknown parameter wire.resistence"),
        (["-r", "no rule:="], "[twin]: "),
    ):
        node = bench.start_with("bench", ["experiment", "twin", *words, *SHARED])
        assert node.ended_with(2, said)


def test_a_containers_command_line_is_nodes_each_with_its_own_arguments():
    nodes, shared = contained(["simulator", "-p", "speed:=2.0", "twin", *SHARED])
    assert nodes == {"simulator": ["--ros-args", "-p", "speed:=2.0"], "twin": ["--ros-args"]}
    assert shared == SHARED
    for words, said in (
        ([], "no node"), (["--ros-args"], "no node"), (["serial_bridge"], "'serial_bridge', exp"),
        (["twin", "twin"], "'twin', expected"), (["-p", "speed:=2.0", "twin"], "'-p', expected"),
        (["twin", "lamp"], "'lamp', expected names of nodes"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=said):
            contained(words)
