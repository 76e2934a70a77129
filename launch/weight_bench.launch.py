"""Weight rig (one wire under a constant force), simulated, in one namespace.

ros2 launch sma_bench weight_bench.launch.py speed:=10.0
"""

from launch import LaunchDescription

from sma_bench.nodes.bench_plan import WEIGHT, bench_launch


def generate_launch_description() -> LaunchDescription:
    """The nodes, each with the rig's parameters."""
    return bench_launch(WEIGHT)
