"""What a launch file builds, with ROS's `launch` where it is installed.

Where it is not, a stand-in of its few classes takes its place. It keeps what it is given; it starts
nothing.
"""

import importlib.util
import sys
from types import ModuleType, SimpleNamespace

# Told by launch_ros alone: the folder launch/ of a checkout passes for a package of that name.
INSTALLED = importlib.util.find_spec("launch_ros") is not None


class Recorded:
    """An action with the arguments that it was made with."""

    def __init__(self, *args, **kwargs):
        self.args, self.given = args, SimpleNamespace(**kwargs)


class Node(Recorded): ...


class ExecuteProcess(Recorded): ...


class Shutdown(Recorded): ...


class Text(Recorded):
    """launch_ros.parameter_descriptions.ParameterValue"""


class Context:
    """launch.LaunchContext"""

    def __init__(self):
        self.launch_configurations = {}


class DeclareLaunchArgument:
    """launch.actions.DeclareLaunchArgument"""

    def __init__(self, name, *, default_value, description):
        self.name, self.default = name, default_value

    def visit(self, context):
        context.launch_configurations.setdefault(self.name, self.default)


class OpaqueFunction:
    """launch.actions.OpaqueFunction"""

    def __init__(self, *, function):
        self._function = function

    def visit(self, context):
        return self._function(context)


class LaunchDescription:
    """launch.LaunchDescription"""

    def __init__(self, entities):
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


def built(path, monkeypatch, **arguments):
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
    found = []
    for entity in load(path).generate_launch_description().entities:
        found += entity.visit(context) or []
    return found


def load(path):
    """The launch file as a module."""
    spec = importlib.util.spec_from_file_location("launch_file", path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
