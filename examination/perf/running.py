"""Nodes in processes of their own, what they take of a core, and a node here that listens."""

import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from examination.perf.timing import processor_of

CONFIG = Path(__file__).resolve().parents[2] / "config"
RIGS = {"one wire": CONFIG / "wire_rig.yaml", "four wires": CONFIG / "composite_rig.yaml"}
NAMESPACE = "/perf"
_STARTING = 120.0  # s


class Running:
    """Nodes that run, and `node`, which hears them while `spin` does its work."""

    def __init__(self, node: Any, processes: Any, names: Iterable[str]) -> None:
        self.node, self.processes, self.names = node, processes, names

    def spin(
        self, until: Callable[[], Any], meanwhile: Callable[[], None] = lambda: None
    ) -> None:
        """Listen until the condition holds.

        Raises:
            RuntimeError: it does not within _STARTING s.
            InputError: a node has ended.
        """
        import rclpy

        end = time.monotonic() + _STARTING
        while not until():
            if time.monotonic() > end:
                raise RuntimeError(f"nothing heard within {_STARTING:g} s")
            meanwhile()
            rclpy.spin_once(self.node, timeout_sec=0.01)
            self.processes.check()

    def shares(
        self, seconds: float, meanwhile: Callable[[], None] = lambda: None
    ) -> tuple[float, dict[str, float]]:
        """Listen for a while: seconds it took, and the share of a core of every node."""
        pids = {name: self.processes.pid(name) for name in self.names}
        before, begin = {k: processor_of(pid) for k, pid in pids.items()}, time.monotonic()
        self.spin(lambda: time.monotonic() - begin > seconds, meanwhile)
        elapsed = time.monotonic() - begin
        return elapsed, {k: (processor_of(pid) - before[k]) / elapsed for k, pid in pids.items()}


@contextmanager
def running(
    nodes: Mapping[str, Mapping[str, Any]], rig: Path = RIGS["one wire"]
) -> Iterator[Running]:
    """Start nodes with these settings, away from every other bench."""
    import rclpy

    from sma_bench.ros.processes import NodeProcesses, private_ros_environment

    private_ros_environment()
    rclpy.init(args=[])
    node = rclpy.create_node("perf", namespace=NAMESPACE)
    try:
        with TemporaryDirectory() as folder, NodeProcesses(NAMESPACE, Path(folder)) as processes:
            for name, settings in nodes.items():
                processes.start(name, dict(settings), (rig,))
            yield Running(node, processes, nodes)
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


def percentile(values: list[float], percent: float) -> float:
    """NaN of none."""
    return float(np.percentile(values, percent)) if values else float("nan")
