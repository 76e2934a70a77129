"""Plans of the launch files as actions of ROS's `launch`. The only module that needs it."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from ament_index_python.packages import get_package_prefix
from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess, OpaqueFunction, Shutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from sma_bench.errors import InputError
from sma_bench.nodes import bench_plan
from sma_bench.nodes.bench_plan import (
    PACKAGE,
    Argument,
    LaunchedRig,
    PlannedNode,
    plan_bench,
    switch,
)
from sma_bench.ros.processes import discovery_variables


def bench_launch(rig: LaunchedRig) -> LaunchDescription:
    """Launch description of a rig."""

    def actions(values: dict[str, str]) -> list[Any]:
        return _nodes(plan_bench(values), values)

    return _description(rig.arguments, actions)


def replay_launch() -> LaunchDescription:
    """Launch description of a record that is played; it ends with the record."""

    def actions(values: dict[str, str]) -> list[Any]:
        command, nodes = bench_plan.plan_replay(values)
        player = ExecuteProcess(
            cmd=command, name="player", output="screen", additional_env=_discovery(values),
            on_exit=Shutdown(reason="the record is over"),
        )
        return [*_nodes(nodes, values), player]

    return _description(bench_plan.ARGUMENTS, actions)


def _description(
    arguments: Mapping[str, Argument], actions: Callable[[dict[str, str]], list[Any]]
) -> LaunchDescription:
    def start(context: LaunchContext) -> list[Any]:
        return actions({name: LaunchConfiguration(name).perform(context) for name in arguments})

    declared = [_declared(name, argument) for name, argument in arguments.items()]
    return LaunchDescription([*declared, OpaqueFunction(function=start)])


def _declared(name: str, argument: Argument) -> DeclareLaunchArgument:
    # No empty list of choices: launch would refuse every value.
    choices = {"choices": list(argument.choices)} if argument.choices else {}
    return DeclareLaunchArgument(
        name, default_value=argument.default, description=argument.description, **choices
    )


def _discovery(values: Mapping[str, str]) -> dict[str, str]:
    return discovery_variables(switch(values, "network"))


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
    return [_node(node, values) for node in planned]


def _node(planned: PlannedNode, values: Mapping[str, str]) -> Node:
    own = {name: _parameter(value) for name, value in planned.parameters.items()}
    files = [planned.file] if planned.file else []
    end = Shutdown(reason=f"{planned.executable} has ended") if planned.vital else None
    return Node(
        package=planned.package, executable=planned.executable, name=planned.executable,
        namespace=values["namespace"], parameters=[*files, *([own] if own else [])],
        remappings=list(planned.remappings.items()), output="screen", on_exit=end,
        additional_env=_discovery(values),
    )


def _parameter(value: Any) -> Any:
    """A text stays one: launch_ros would read '10' as a number and '' as nothing."""
    return ParameterValue(value, value_type=str) if isinstance(value, str) else value
