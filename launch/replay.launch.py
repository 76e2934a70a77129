"""Replay of a record, with further nodes; its commands drive nothing.

ros2 launch sma_bench replay.launch.py bag:=my_record rate:=2.0
ros2 launch sma_bench replay.launch.py bag:=my_record namespace:=bench description:=true
"""

from launch import LaunchDescription

from sma_bench.nodes.bench_plan import replay_launch


def generate_launch_description() -> LaunchDescription:
    """`ros2 bag play` and the requested nodes."""
    return replay_launch()
