"""The replay of a record: its topics in a namespace of choice, its commands for nobody."""

from pathlib import Path

import numpy as np
import pytest
from launch_stand_in import ExecuteProcess, Node, Shutdown, built

from sma_bench.errors import InputError
from sma_bench.nodes.bench_plan import plan_replay
from sma_bench.records import Signal
from sma_bench.records.bag_writer import write_record

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def bag(tmp_path):
    time = np.arange(0.0, 2.0, 0.05)
    quantities = (("voltage", "V"), ("current", "A"), ("temperature", "K"))
    signals = [Signal(f"wire.{q}", u, time, np.full_like(time, 300.0)) for q, u in quantities]
    path = tmp_path / "bag"
    write_record(path, [*signals, Signal("voltage_command", "V", time, np.ones((len(time), 1)))])
    return path


def remapped(command):
    pairs = command[command.index("--remap") + 1 :]
    return dict(pair.split(":=") for pair in pairs)


def played(command):
    return command[command.index("--topics") + 1 : command.index("--remap")]


def test_topics_of_the_bench_are_played_below_the_namespace(bag):
    command, nodes = plan_replay({"bag": str(bag), "rate": "2"})
    assert command[:4] == ["ros2", "bag", "play", str(bag)]
    assert command[command.index("--rate") + 1] == "2"
    assert "--loop" not in command and nodes == []
    moved = remapped(command)
    assert set(played(command)) == set(moved)
    assert {"/replay/wire/power", "/replay/wire/temperature"} <= set(moved.values())


def test_recorded_commands_never_reach_a_bench(bag):
    command, _ = plan_replay({"bag": str(bag), "namespace": "bench"})
    moved = remapped(command)
    commands = [topic for topic in moved if topic.endswith("voltage_command")]
    assert len(commands) == 1
    assert moved[commands[0]] == "/bench/replayed/voltage_command"


def test_a_twin_listens_to_the_record_on_its_clock(bag):
    _, nodes = plan_replay({"bag": str(bag), "twin": "true", "params": "lab.yaml"})
    assert [node.executable for node in nodes] == ["twin"]
    assert nodes[0].parameters == {"use_sim_time": True} and nodes[0].file == "lab.yaml"
    assert not nodes[0].vital


def test_recorded_temperatures_step_aside_for_the_camera(bag):
    command, nodes = plan_replay({"bag": str(bag), "camera": "true", "loop": "true"})
    assert "/replay/replayed/wire/temperature" in remapped(command).values()
    assert "--loop" in command
    assert [n.executable for n in nodes] == ["ir_camera"]
    assert nodes[0].parameters["use_sim_time"] is True


def test_services_on_records_run_beside(bag):
    _, nodes = plan_replay({"bag": str(bag), "nodes": "diagnosis, identification"})
    assert [n.executable for n in nodes] == ["diagnosis", "identification"]
    with pytest.raises(InputError, match="'experiment', expected identification, diagnosis"):
        plan_replay({"bag": str(bag), "nodes": "experiment"})


def test_a_bare_storage_file_is_played_too(bag):
    storage = next(bag.glob("*.mcap"))
    assert sorted(played(plan_replay({"bag": str(storage)})[0])) == sorted(
        played(plan_replay({"bag": str(bag)})[0])
    )


def test_the_launch_file_ends_with_the_record(bag, monkeypatch):
    actions = built(
        ROOT / "launch" / "replay.launch.py", monkeypatch, bag=str(bag), twin="true"
    )
    nodes = [a.given.executable for a in actions if isinstance(a, Node)]
    player = [a.given for a in actions if isinstance(a, ExecuteProcess)]
    assert nodes == ["twin"] and len(player) == 1
    assert isinstance(player[0].on_exit, Shutdown)
    assert player[0].cmd[:3] == ["ros2", "bag", "play"]


@pytest.mark.parametrize(
    ("changed", "said"),
    [({"bag": ""}, "expected a record"), ({"bag": "nothing"}, "nothing"),
     ({"rate": "-1"}, "rate is '-1'")],
)
def test_what_cannot_be_played_is_one_line(changed, said, bag):
    with pytest.raises(InputError) as refused:
        plan_replay({"bag": str(bag), **changed})
    assert said in str(refused.value) and "\n" not in str(refused.value)


def test_a_damaged_list_of_topics_is_one_line(bag):
    (bag / "metadata.yaml").write_text("rosbag2_bagfile_information: {}\n")
    with pytest.raises(InputError, match="list of topics"):
        plan_replay({"bag": str(bag)})
