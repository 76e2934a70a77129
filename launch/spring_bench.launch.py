"""Spring rig (one wire against a spring), simulated, in one namespace.

ros2 launch sma_bench spring_bench.launch.py speed:=10.0
"""

from launch import LaunchDescription

from sma_bench.nodes.bench_plan import SPRING, bench_launch


def generate_launch_description() -> LaunchDescription:
    """The nodes, each with the rig's parameters."""
    return bench_launch(SPRING)
