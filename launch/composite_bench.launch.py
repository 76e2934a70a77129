"""Composite rig: bench, experiment, recorder and identification in one namespace.

ros2 launch sma_bench composite_bench.launch.py protocol:=composite_step speed:=10.0
ros2 launch sma_bench composite_bench.launch.py camera:=true description:=true
"""

from launch import LaunchDescription

from sma_bench.nodes.bench_plan import COMPOSITE, bench_launch


def generate_launch_description() -> LaunchDescription:
    """The nodes, each with the rig's parameters."""
    return bench_launch(COMPOSITE)
