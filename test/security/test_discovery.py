"""Nodes are found on this machine only, unless the user opens them to the network."""

import subprocess
import sys
from pathlib import Path

import pytest

from sma_bench.nodes.bench_plan import COMPOSITE, WIRE
from sma_bench.nodes.discovery import RANGE, choose_discovery, discovery_range
from sma_bench.nodes.replay_plan import ARGUMENTS

ROOT = Path(__file__).resolve().parents[2]
SAYS = f"""
import os, sys
import sma_bench.commands.run as command
from types import SimpleNamespace
def module(name):
    def main(rest):
        from sma_bench.nodes.discovery import choose_discovery
        choose_discovery()
        print(os.environ.get("{RANGE}"), rest)
    return SimpleNamespace(main=main)
command.importlib = SimpleNamespace(import_module=module)
command.run(sys.argv[1:])
"""


def test_without_a_word_of_the_user_only_this_machine_is_asked() -> None:
    assert discovery_range(False, {}) == {RANGE: "LOCALHOST"}
    assert discovery_range(True, {}) == {RANGE: "SUBNET"}
    assert discovery_range(True, {RANGE: "OFF"}) == {RANGE: "SUBNET"}


@pytest.mark.parametrize("name", [RANGE, "ROS_LOCALHOST_ONLY", "ROS_DISCOVERY_SERVER"])
def test_what_the_user_set_stays(name: str) -> None:
    environment = {name: "x"}
    choose_discovery(environment=environment)
    assert environment == {name: "x"}
    environment = {name: ""}
    choose_discovery(environment=environment)
    assert environment[RANGE] == "LOCALHOST"


def test_every_launch_file_has_the_switch_and_it_is_off() -> None:
    for arguments in (WIRE.arguments, COMPOSITE.arguments, ARGUMENTS):
        assert arguments["network"].default == "false"


def test_the_command_line_has_the_switch() -> None:
    environment = {"PATH": "/usr/bin:/bin", "PYTHONPATH": str(ROOT)}
    for words, expected in (
        (["simulator", "--ros-args"], "LOCALHOST ['--ros-args']"),
        (["simulator", "--network", "--ros-args"], "SUBNET ['--ros-args']"),
    ):
        process = subprocess.run(
            [sys.executable, "-c", SAYS, *words], env=environment, capture_output=True, text=True,
            check=True,
        )
        assert process.stdout.strip() == expected


def test_every_place_that_starts_ros_asks_first() -> None:
    for path in (ROOT / "sma_bench").rglob("*.py"):
        lines = path.read_text().splitlines()
        for number, line in enumerate(lines):
            if "rclpy.init(" in line:
                assert "choose_discovery()" in lines[number - 1], f"{path}: line {number + 1}"
