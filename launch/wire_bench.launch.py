"""Wire rig: bench, experiment, recorder and identification in one namespace.

ros2 launch sma_bench wire_bench.launch.py protocol:=ramp speed:=10.0
ros2 launch sma_bench wire_bench.launch.py mode:=hardware params:=lab.yaml
"""

from launch import LaunchDescription

from sma_bench.nodes.bench_plan import WIRE, bench_launch


def generate_launch_description() -> LaunchDescription:
    """The nodes, each with the rig's parameters."""
    return bench_launch(WIRE)
