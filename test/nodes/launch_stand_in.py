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

    def visit(self, context):
        """Of the two that do something: an argument's default, and a function's actions."""
        if hasattr(self.given, "function"):
            return self.given.function(context)
        context.launch_configurations.setdefault(self.args[0], self.given.default_value)
        return []


NAMES = {
    "launch": ("LaunchDescription", "LaunchContext"),
    "launch.actions": ("DeclareLaunchArgument", "OpaqueFunction", "ExecuteProcess", "Shutdown"),
    "launch_ros": (),
    "launch_ros.actions": ("Node",),
    "launch_ros.parameter_descriptions": ("ParameterValue",),
}
KINDS = {name: type(name, (Recorded,), {}) for names in NAMES.values() for name in names}
Node, ExecuteProcess, Shutdown = (KINDS[n] for n in ("Node", "ExecuteProcess", "Shutdown"))
Text = KINDS["ParameterValue"]
KINDS["LaunchDescription"] = lambda entities: SimpleNamespace(entities=entities)
KINDS["LaunchContext"] = lambda: SimpleNamespace(launch_configurations={})


def built(path, monkeypatch, **arguments):
    """Nodes and processes that a launch file would start with these arguments."""
    if not INSTALLED:
        for module, names in NAMES.items():
            made = ModuleType(module)
            vars(made).update({name: KINDS[name] for name in names})
            monkeypatch.setitem(sys.modules, module, made)
    monkeypatch.delitem(sys.modules, "sma_bench.nodes.bench_launch", raising=False)
    actions = importlib.import_module("sma_bench.nodes.bench_launch")
    monkeypatch.setitem(sys.modules, "sma_bench.nodes.bench_launch", actions)
    # What a Node was given cannot be read back from the real ones.
    for kind in ("Node", "ExecuteProcess", "Shutdown", "ParameterValue"):
        monkeypatch.setattr(actions, kind, KINDS[kind])
    context = importlib.import_module("launch").LaunchContext()
    context.launch_configurations.update(arguments)
    spec = importlib.util.spec_from_file_location("launch_file", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    found = []
    for entity in module.generate_launch_description().entities:
        found += entity.visit(context) or []
    return found
