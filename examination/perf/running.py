"""Nodes in processes of their own, what they take of a core, and a node here that listens."""

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import rclpy

from examination.perf.measuring import processor_of
from examination.perf.records import COMPOSITE
from sma_bench.ros.processes import NodeProcesses, private_ros_environment

RIGS = {"one wire": COMPOSITE.with_name("wire_rig.yaml"), "four wires": COMPOSITE}
NAMESPACE = "/perf"
_STARTING = 120.0  # s


@dataclass(frozen=True)
class Running:
    """Nodes that run, and `node`, which hears them while `spin` does its work."""

    node: Any
    processes: NodeProcesses
    pids: Mapping[str, int]

    def spin(self, until: Callable[[], Any], meanwhile: Callable[[], Any] = int) -> None:
        """Listen until the condition holds.

        Raises:
            RuntimeError: it does not within _STARTING s.
            InputError: a node has ended.
        """
        end = time.monotonic() + _STARTING
        while not until():
            if time.monotonic() > end:
                raise RuntimeError(f"nothing heard within {_STARTING:g} s")
            meanwhile()
            rclpy.spin_once(self.node, timeout_sec=0.01)
            self.processes.check()

    def shares(
        self, seconds: float, meanwhile: Callable[[], Any] = int
    ) -> tuple[float, dict[str, float]]:
        """Listen for a while: seconds it took, and the share of a core of every node."""
        before, begin = {k: processor_of(pid) for k, pid in self.pids.items()}, time.monotonic()
        self.spin(lambda: time.monotonic() - begin > seconds, meanwhile)
        elapsed = time.monotonic() - begin
        had = {k: processor_of(pid) - before[k] for k, pid in self.pids.items()}
        return elapsed, {k: used / elapsed for k, used in had.items()}


@contextmanager
def running(
    nodes: Mapping[str, Mapping[str, Any]], rig: Path = RIGS["one wire"]
) -> Iterator[Running]:
    """Start nodes with these settings, away from every other bench."""
    private_ros_environment()
    rclpy.init(args=[])
    node = rclpy.create_node("perf", namespace=NAMESPACE)
    try:
        with TemporaryDirectory() as folder, NodeProcesses(NAMESPACE, Path(folder)) as processes:
            for name, settings in nodes.items():
                processes.start(name, dict(settings), (rig,))
            yield Running(node, processes, {name: processes.pid(name) for name in nodes})
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
