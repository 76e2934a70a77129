"""Nodes can only be reached from this machine, unless the user opens them to the network."""

import subprocess
import sys
from pathlib import Path

import pytest

from sma_bench.nodes.bench_plan import COMPOSITE, REPLAY, WIRE
from sma_bench.ros import processes
from sma_bench.ros.processes import PROFILE, RANGE, TRANSPORTS, choose_discovery

ROOT = Path(__file__).resolve().parents[2]
SAYS = f"""
import os, runpy, sys
import sma_bench.commands.nodes as command
from sma_bench.commands.options import run_command
from sma_bench.ros.processes import choose_discovery
runpy.run_module = lambda module, run_name: (
    choose_discovery(), print(os.environ.get("{RANGE}"), sys.argv[1:]))
run_command(command.run_run, "sma-bench run", sys.argv[1:])
"""


def chosen(user, **options):
    environment = dict(user)
    choose_discovery(environment=environment, **options)
    return environment


def test_nodes_are_bound_to_this_machine_and_none_waits_for_shared_memory():
    variables = processes.discovery_variables(False, {})
    assert variables[RANGE] == "SYSTEM_DEFAULT", "whatever the profile says"
    profile = Path(variables[PROFILE]).read_text()
    assert "<address>127.0.0.1</address>" in profile and "<type>SHM</type>" not in profile
    for network, user in ((True, {}), (False, {RANGE: "SUBNET"})):
        assert processes.discovery_variables(network, user)[TRANSPORTS] == "UDPv4"
        own = {TRANSPORTS: "DEFAULT", **user}
        assert TRANSPORTS not in processes.discovery_variables(network, own)


@pytest.mark.parametrize("user", [{}, {RANGE: ""}, {RANGE: "LOCALHOST"}, {RANGE: "OFF"},
                                  {RANGE: "SUBNETT"}, {"ROS_LOCALHOST_ONLY": "1"},
                                  {"ROS_STATIC_PEERS": "10.0.0.1"},
                                  {"ROS_LOCALHOST_ONLY": "1", RANGE: "SUBNET"}])  # fmt: skip
def test_only_a_word_that_asks_for_the_network_opens_it(user):
    environment = chosen(user)
    for found in (environment, chosen(environment)):  # and a child of it
        assert found[PROFILE].endswith("this_machine.xml")
        assert found[RANGE] == ("OFF" if user.get(RANGE) == "OFF" else "SYSTEM_DEFAULT")
        assert not found.get("ROS_LOCALHOST_ONLY"), "it would add what is not bound"
        assert found.items() >= {k: v for k, v in user.items() if "PEERS" in k}.items()


def test_a_word_or_a_switch_that_asks_for_the_network_opens_it_and_a_users_profile_stays():
    for user in (
        {RANGE: "SUBNET"}, {RANGE: "SYSTEM_DEFAULT"}, {"ROS_LOCALHOST_ONLY": "0"},
        {"ROS_DISCOVERY_SERVER": "10.0.0.1:11811"},
    ):  # fmt: skip
        assert chosen(user) == {**user, TRANSPORTS: "UDPv4"}
    opened = chosen(chosen({}), network=True)  # a child of a bound process
    assert chosen(opened) == {RANGE: "SUBNET", TRANSPORTS: "UDPv4"}
    for network in (False, True):
        assert PROFILE not in processes.discovery_variables(network, {PROFILE: "own.xml"})


def test_an_ignored_switch_is_reported_and_a_private_bench_drops_variables_that_would_open_it(
    capsys, monkeypatch
):
    chosen({"RMW_IMPLEMENTATION": "rmw_fastrtps_cpp"})
    assert capsys.readouterr().err == ""
    chosen({"ROS_STATIC_PEERS": "10.0.0.1", "RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp"})
    peers, middleware = capsys.readouterr().err.splitlines()
    assert "ROS_STATIC_PEERS" in peers and "rmw_cyclonedds_cpp" in middleware
    monkeypatch.setenv("ROS_DOMAIN_ID", "1")
    for name in processes.USERS_VARIABLES:
        monkeypatch.setenv(name, "0.0.0.0")
    processes.private_ros_environment()
    assert processes.discovery_variables(False)[PROFILE].endswith("this_machine.xml")


def test_launch_files_and_the_command_line_have_the_switch_and_it_is_off():
    for arguments in (WIRE.arguments, COMPOSITE.arguments, REPLAY):
        assert arguments["network"].default == "false"
    environment = {"PATH": "/usr/bin:/bin", "PYTHONPATH": str(ROOT)}
    for words, expected in (([], "SYSTEM_DEFAULT"), (["--network"], "SUBNET")):
        command = [sys.executable, "-c", SAYS, "simulator", *words, "--ros-args"]
        process = subprocess.run(command, env=environment, capture_output=True, text=True)
        assert process.stdout.splitlines()[-1] == f"{expected} ['simulator', '--ros-args']"


def test_every_place_that_starts_ros_asks_first():
    for path in (ROOT / "sma_bench").rglob("*.py"):
        lines = path.read_text().splitlines()
        for number, line in enumerate(lines):
            if "rclpy.init(" in line:
                before = "".join(lines[number - 2 : number])
                assert "choose_discovery()" in before, f"{path}: line {number + 1}"
