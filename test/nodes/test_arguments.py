"""What a node's command line may bring, checked before ROS starts."""

import logging
import subprocess
import sys

import pytest

from sma_bench.errors import InputError
from sma_bench.nodes.arguments import check_arguments
from sma_bench.nodes.start import run as run_here
from sma_bench.parameters.node_tables import NODE_TABLES


def arguments(tmp_path, text):
    path = tmp_path / "rig.yaml"
    path.write_text("/**:\n  ros__parameters:\n" + text)
    return ["--ros-args", "--params-file", str(path)]


BAD = {
    "wire.resistence: 2.0": "unknown parameter wire.resistence, did you mean wire.resistance?",
    "wire.resistance: 3": "wire.resistance is the integer 3, ROS expects 3.0",
    "wire.diameter: 0.3": "times 0.001 it would fit: wrong unit prefix?",
    "environment.ambient_temperature: 23.0": "degrees Celsius?",
    "wire.resistance: .nan": "expected a finite number",
    "bench.channels: [a, b]": "bench.channel_sides has 1 entries, expected 2",
    "seed: 1.5": "seed is 1.5, expected a whole number",
    "managed: true": "managed: nodes are no lifecycle nodes any more: they start active",
}


@pytest.mark.parametrize("text", BAD)
def test_a_slip_in_a_parameter_file_is_one_line_with_the_file(tmp_path, text):
    with pytest.raises(InputError) as error:
        check_arguments("simulator", arguments(tmp_path, f"    {text}\n"))
    line = str(error.value)
    assert BAD[text] in line and "rig.yaml" in line and "\n" not in line


def test_lists_are_read_as_launch_writes_them_and_no_other_type_of_python_is(tmp_path):
    written = "    feedback: !!python/tuple\n    - power\n"
    check_arguments("experiment", arguments(tmp_path, written))
    with pytest.raises(InputError, match="feedback"):
        check_arguments("experiment", arguments(tmp_path, written.replace("power", "1")))
    with pytest.raises(InputError, match="not YAML"):
        check_arguments(
            "experiment", arguments(tmp_path, "    protocol: !!python/object/apply:os.getcwd []\n")
        )


def test_foreign_names_are_warned_of_and_those_of_other_nodes_are_not(tmp_path, caplog):
    text = "    use_sim_time: true\n    protocol: ramp\n    gain: 2\n    wyre: 1\n"
    with caplog.at_level(logging.WARNING):
        check_arguments("simulator", arguments(tmp_path, text))
    warned = [record.getMessage() for record in caplog.records]
    assert len(warned) == 2
    assert "gain is not a parameter of this package" in warned[0]


def test_a_node_sees_its_own_section_and_later_sources_win(tmp_path):
    text = "    wire.resistance: 2.0\n/**/experiment:\n  ros__parameters: {speeed: 1}\n"
    check_arguments("simulator", arguments(tmp_path, text))
    with pytest.raises(InputError, match="wire.resistance is -1"):
        check_arguments(
            "simulator", [*arguments(tmp_path, text), "-p", "wire.resistance:=-1.0"]
        )
    with pytest.raises(InputError, match="unknown parameter bench.chanels"):
        check_arguments("simulator", ["--ros-args", "-p", "bench.chanels:=[a]"])
    two = arguments(tmp_path, "    bench: {channels: [a, b], channel_sides: [front, back]}\n")
    check_arguments("simulator", [*two, "-p", "bench.channel_sides:=[back, front]"])


def run(name, *arguments):
    return subprocess.run(
        [sys.executable, "-m", "sma_bench.nodes.start", name, *arguments],
        capture_output=True, text=True, timeout=60, check=False,
    )


@pytest.mark.parametrize(
    ("name", "given", "expected"),
    [
        ("experiment", ["-p", "protocol:=stairs"], "protocol stairs: not one of"),
        ("recorder", ["--params-file", "none.yaml"], "none.yaml: cannot read"),
        ("simulator", ["-p", "speed"], "-p speed: expected name:=value"),
    ],
)
def test_a_node_refuses_a_bad_argument_with_one_line_and_status_2(
    name, given, expected, ros_domain
):
    done = run(name, "--ros-args", *given)
    assert done.returncode == 2
    assert expected in done.stderr and done.stderr.count("\n") == 1


@pytest.mark.parametrize("node", sorted(NODE_TABLES))
def test_help_ends_at_once_and_lists_the_nodes_own_parameters(node, capsys):
    assert run_here(node, ["--help"]) == 0
    printed = capsys.readouterr().out
    assert printed.startswith(f"usage: {node} ")
    assert [p.name for p in NODE_TABLES[node] if f"  {p.name} " not in printed] == []
