"""What a node's command line may bring, checked before ROS starts."""

import logging

import pytest

from sma_bench.errors import InputError
from sma_bench.nodes.arguments import check_arguments
from sma_bench.nodes.start import run
from sma_bench.parameters.node_tables import NODE_TABLES


@pytest.fixture
def given(tmp_path):
    """Arguments with a parameter file."""

    def given(text, *more):
        path = tmp_path / "rig.yaml"
        path.write_text(f"/**:\n  ros__parameters:\n    {text}\n")
        return ["--ros-args", "--params-file", str(path), *more]

    return given


BAD = {
    "wire.resistence: 2.0": "unknown parameter wire.resistence, did you mean wire.resistance?",
    "wire.resistance: 3": "wire.resistance is the integer 3, ROS expects 3.0",
    "wire.diameter: 0.3": "times 0.001 it would fit: wrong unit prefix?",
    "environment.ambient_temperature: 23.0": "degrees Celsius?",
    "wire.resistance: .nan": "expected a finite number",
    "bench.channels: [a, b]": "bench.channel_sides has 1 entries, expected 2",
    "seed: 1.5": "seed is 1.5, expected a whole number",
    "managed: true": "managed: nodes are no lifecycle nodes any more: they start active",
    "bench.channels: !!python/tuple [1]": "bench.channels",
    "speed: !!python/object/apply:os.getcwd []": "not YAML",
}


@pytest.mark.parametrize("text", BAD)
def test_a_slip_in_a_parameter_file_is_one_line_with_the_file(given, text):
    with pytest.raises(InputError) as error:
        check_arguments("simulator", given(text))
    line = str(error.value)
    assert BAD[text] in line and "rig.yaml" in line and "\n" not in line


def test_a_node_reads_its_own_section_and_later_sources_win(given, caplog):
    foreign = "wire.resistance: 2.0\n/**/experiment:\n  ros__parameters: {speeed: 1}"
    check_arguments("simulator", given(foreign))
    as_launch_writes = "feedback: !!python/tuple [power]"
    check_arguments("experiment", given(as_launch_writes))
    two = given("bench: {channels: [a, b], channel_sides: [front, back]}")
    check_arguments("simulator", [*two, "-p", "bench.channel_sides:=[back, front]"])
    of_others = "use_sim_time: true\n    protocol: ramp\n    gain: 2\n    wyre: 1"
    with caplog.at_level(logging.WARNING):
        check_arguments("simulator", given(of_others))
    warned = [record.getMessage() for record in caplog.records]
    assert len(warned) == 2 and "gain is not a parameter of this package" in warned[0]
    for arguments, said in (
        (given(foreign, "-p", "wire.resistance:=-1.0"), "wire.resistance is -1"),
        (["--ros-args", "-p", "bench.chanels:=[a]"], "unknown parameter bench.chanels"),
        # ROS would pass over these.
        (["--ros-args", "-r", "__ns:=/bench", "--", "x"], "unknown argument 'x'"),
        (["speed:=2.0"], "after --ros-args"),
        (["--ros-args", "--params-file", "none.yaml"], "none.yaml: cannot read"),
    ):
        with pytest.raises(InputError, match=said):
            check_arguments("simulator", arguments)


@pytest.mark.parametrize("node", sorted(NODE_TABLES))
def test_help_ends_at_once_and_lists_the_nodes_own_parameters(node, capsys):
    assert run(node, ["--help"]) == 0
    printed = capsys.readouterr().out
    assert printed.startswith(f"usage: {node} ")
    assert [p.name for p in NODE_TABLES[node] if f"  {p.name} " not in printed] == []
