"""Antagonist rig (two wires on one slider), simulated, in one namespace.

ros2 launch sma_bench antagonist_bench.launch.py speed:=10.0
"""

from launch import LaunchDescription

from sma_bench.nodes.bench_plan import ANTAGONIST, bench_launch


def generate_launch_description() -> LaunchDescription:
    """The nodes, each with the rig's parameters."""
    return bench_launch(ANTAGONIST)
