"""Composite rig, simulated: bench, experiment, recorder and identification in one namespace.

ros2 launch sma_bench composite_bench.launch.py protocol:=composite_step speed:=10.0
"""

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution, PythonExpression
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

RIG = "composite_rig.yaml"
ARGUMENTS = {
    "namespace": ("bench", "Namespace of all topics and nodes."),
    "params": (
        PathJoinSubstitution([get_package_share_directory("sma_bench"), "config", RIG]),
        "ROS parameter file: Table I, or what an identification wrote.",
    ),
    "protocol": ("composite_triangle", "Name in config/protocols, or the path of a .yaml file."),
    "autostart": ("false", "Start the protocol as soon as the bench answers."),
    "speed": ("1.0", "Simulated seconds per second; above 1 the nodes run on /clock."),
    "output": ("", "New folder for the bag; empty for record_<date>_<time>."),
}


def generate_launch_description() -> LaunchDescription:
    """The four nodes, each with the rig's parameters."""
    value = {name: LaunchConfiguration(name) for name in ARGUMENTS}
    simulated = PythonExpression(["float('", value["speed"], "') > 1.0"])
    use_sim_time = {"use_sim_time": ParameterValue(simulated, value_type=bool)}
    own_parameters = {
        "simulator": {"speed": ParameterValue(value["speed"], value_type=float)},
        "experiment": {
            "protocol": ParameterValue(value["protocol"], value_type=str),
            "autostart": ParameterValue(value["autostart"], value_type=bool),
            **use_sim_time,
        },
        "recorder": {"output": ParameterValue(value["output"], value_type=str), **use_sim_time},
        "identification": {},
    }
    arguments = [
        DeclareLaunchArgument(name, default_value=default, description=description)
        for name, (default, description) in ARGUMENTS.items()
    ]
    nodes = [
        Node(
            package="sma_bench", executable=name, name=name, namespace=value["namespace"],
            parameters=[value["params"], own], output="screen",
        )
        for name, own in own_parameters.items()
    ]
    return LaunchDescription([*arguments, *nodes])
