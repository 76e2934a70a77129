"""Plans of the launch files as actions of ROS's `launch`. The only module that needs it."""

import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from ament_index_python.packages import get_package_prefix
from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess, OpaqueFunction, Shutdown
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from sma_bench.errors import InputError
from sma_bench.installation import share_directory
from sma_bench.nodes import bench_plan
from sma_bench.nodes.bench_plan import PACKAGE, Argument, LaunchedRig, PlannedNode
from sma_bench.ros.processes import discovery_variables


def bench_launch(rig: LaunchedRig) -> LaunchDescription:
    """Launch description of a rig."""
    return _description(
        rig.arguments, lambda given: _nodes(bench_plan.plan_bench(rig, given), given)
    )


def replay_launch() -> LaunchDescription:
    """Launch description of a record that is played; it ends with the record."""

    def actions(given: Mapping[str, str]) -> list[Any]:
        command, nodes = bench_plan.plan_replay(given)
        player = ExecuteProcess(
            cmd=command, name="player", output="screen", additional_env=_discovery(given),
            on_exit=Shutdown(reason="the record is over"),
        )
        return [*_nodes(nodes, given), player]

    return _description(bench_plan.ARGUMENTS, actions)


def _description(
    arguments: Mapping[str, Argument], actions: Callable[[Mapping[str, str]], list[Any]]
) -> LaunchDescription:
    def start(context: LaunchContext) -> list[Any]:
        given = dict(context.launch_configurations)
        # Those of a launch file that includes ours are among them, unless `ros2 launch` names ours.
        ours = {path.name for path in (share_directory() / "launch").iterdir()}
        if not any(Path(word).name in ours for word in sys.argv):
            given = {name: given[name] for name in arguments}
        return actions(given)

    declared = []
    for name, argument in arguments.items():
        # Not launch's own choices, whose refusal cannot say what replaces a word that is gone.
        choices = f" One of {', '.join(argument.choices)}." if argument.choices else ""
        declared.append(DeclareLaunchArgument(
            name, default_value=argument.default, description=argument.description + choices
        ))  # fmt: skip
    return LaunchDescription([*declared, OpaqueFunction(function=start)])


def _discovery(values: Mapping[str, str]) -> dict[str, str]:
    return discovery_variables(values["network"].lower() == "true")


def _nodes(planned: Sequence[PlannedNode], values: Mapping[str, str]) -> list[Node]:
    """All of them or none: launch would find out in the midst of starting them, and leave those
    that run."""
    for package in {node.package for node in planned} - {PACKAGE}:
        try:
            get_package_prefix(package)
        except (LookupError, OSError):
            raise InputError(
                f"the ROS package {package} is not installed: "
                f"apt install ros-jazzy-{package.replace('_', '-')}"
            ) from None
    nodes = []
    for node in planned:
        # A text stays one: launch_ros would read '10' as a number and '' as nothing.
        own = {
            name: ParameterValue(value, value_type=str) if isinstance(value, str) else value
            for name, value in node.parameters.items()
        }
        end = Shutdown(reason=f"{node.executable} has ended") if node.vital else None
        nodes.append(Node(
            package=node.package, executable=node.executable, name=node.executable,
            namespace=values["namespace"],
            parameters=[*([node.file] if node.file else []), *([own] if own else [])],
            remappings=list(node.remappings.items()), output="screen", on_exit=end,
            additional_env=_discovery(values),
        ))  # fmt: skip
    return nodes
