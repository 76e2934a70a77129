"""What a launch file builds, with ROS's `launch` where it is installed.

Where it is not, a stand-in of its few classes takes its place. It keeps what it is given; it starts
nothing.
"""

import importlib.util
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

# Told by launch_ros alone: the folder launch/ of a checkout passes for a package of that name.
INSTALLED = importlib.util.find_spec("launch_ros") is not None


class Recorded:
    """An action with the arguments that it was made with."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        self.args, self.given = args, SimpleNamespace(**kwargs)


class Node(Recorded):
    """launch_ros.actions.Node"""


class ExecuteProcess(Recorded):
    """launch.actions.ExecuteProcess"""


class Shutdown(Recorded):
    """launch.actions.Shutdown"""


class Text(Recorded):
    """launch_ros.parameter_descriptions.ParameterValue"""


class Context:
    """launch.LaunchContext"""

    def __init__(self) -> None:
        self.launch_configurations: dict[str, str] = {}


class DeclareLaunchArgument:
    """launch.actions.DeclareLaunchArgument"""

    def __init__(self, name: str, *, default_value: str, description: str) -> None:
        self.name, self.default = name, default_value

    def visit(self, context: Context) -> None:
        context.launch_configurations.setdefault(self.name, self.default)


class OpaqueFunction:
    """launch.actions.OpaqueFunction"""

    def __init__(self, *, function: Any) -> None:
        self._function = function

    def visit(self, context: Context) -> list[Any]:
        return self._function(context)


class LaunchDescription:
    """launch.LaunchDescription"""

    def __init__(self, entities: list[Any]) -> None:
        self.entities = entities


_STAND_IN = {
    "launch": {"LaunchDescription": LaunchDescription, "LaunchContext": Context},
    "launch.actions": {
        "DeclareLaunchArgument": DeclareLaunchArgument, "OpaqueFunction": OpaqueFunction,
        "ExecuteProcess": ExecuteProcess, "Shutdown": Shutdown,
    },
    "launch_ros": {},
    "launch_ros.actions": {"Node": Node},
    "launch_ros.parameter_descriptions": {"ParameterValue": Text},
}


def built(path: Path, monkeypatch: pytest.MonkeyPatch, **arguments: str) -> list[Any]:
    """Nodes and processes that a launch file would start with these arguments."""
    if not INSTALLED:
        for name, members in _STAND_IN.items():
            module = ModuleType(name)
            vars(module).update(members)
            monkeypatch.setitem(sys.modules, name, module)
    monkeypatch.delitem(sys.modules, "sma_bench.nodes.bench_launch", raising=False)
    actions = importlib.import_module("sma_bench.nodes.bench_launch")
    monkeypatch.setitem(sys.modules, "sma_bench.nodes.bench_launch", actions)
    # What a Node was given cannot be read back from the real ones.
    for kind in (Node, ExecuteProcess, Shutdown):
        monkeypatch.setattr(actions, kind.__name__, kind)
    monkeypatch.setattr(actions, "ParameterValue", Text)
    context = importlib.import_module("launch").LaunchContext()
    context.launch_configurations.update(arguments)
    found: list[Any] = []
    for entity in load(path).generate_launch_description().entities:
        found += entity.visit(context) or []
    return found


def load(path: Path) -> ModuleType:
    """The launch file as a module."""
    spec = importlib.util.spec_from_file_location("launch_file", path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
