"""Nodes on a fresh install, from a copy in which nothing is compiled: the first word and topic.

Seconds are the processor's, of the node alone; another process of its compiles beside it.
"""

import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import sma_bench
from examination.perf.figures import Figure, Outcome, Skipped, at_most

ROOT = Path(__file__).resolve().parents[2]
_NAMESPACE = "/perf"
_PATIENCE = 400.0
_TICKS = os.sysconf("SC_CLK_TCK")
# Node: what it publishes once it works. The twin needs a bench, so the simulator goes on.
_FIRST = {
    "simulator": "front_1/power",
    "twin": "twin/front_1/power",
    "temperature_controller": "temperature_controller/state",
    "deflection_controller": "deflection_controller/state",
}


def measure(tiny: bool = False) -> list[Outcome]:
    """First word and first topic of every node that computes; tiny: the simulator alone."""
    try:
        import rclpy
    except ImportError:
        return [Skipped("first start of nodes", "rclpy is not installed")]
    from sma_bench.ros.processes import private_ros_environment

    private_ros_environment()
    rclpy.init(args=[])
    with TemporaryDirectory() as name:
        folder = Path(name)
        shutil.copytree(
            Path(sma_bench.__file__).parent, folder / "sma_bench",
            ignore=shutil.ignore_patterns("__pycache__"),
        )
        for shared in ("package.xml", "config"):
            (folder / shared).symlink_to(ROOT / shared)
        started: list[subprocess.Popen[bytes]] = []
        try:
            outcomes = [
                figure
                for node in list(_FIRST)[: 1 if tiny else None]
                for figure in _first(node, folder, started)
            ]
            return outcomes if tiny else [*outcomes, _compiled(folder)]
        finally:
            for process in started:
                process.send_signal(signal.SIGINT)
            for process in started:
                process.wait(_PATIENCE)
            rclpy.try_shutdown()


def _first(node: str, folder: Path, started: list[subprocess.Popen[bytes]]) -> list[Outcome]:
    import rclpy
    from rclpy.qos import QoSProfile, ReliabilityPolicy

    from sma_bench.ros.node import LATCHED

    listener = rclpy.create_node(f"listener_{node}", namespace=_NAMESPACE)
    heard: list[Any] = []
    kind = _type(_FIRST[node])
    newest = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
    qos = LATCHED if _FIRST[node].endswith("/state") else newest
    listener.create_subscription(kind, _FIRST[node], heard.append, qos)
    log = folder / f"{node}.log"
    with log.open("wb") as stream:
        process = subprocess.Popen(
            [sys.executable, "-P", "-m", "sma_bench.nodes.start", node, "--ros-args",
             "-r", f"__ns:={_NAMESPACE}", "--params-file", str(_rig())],
            stdout=stream, stderr=subprocess.STDOUT,
            env={**os.environ, "PYTHONPATH": str(folder), "XDG_CACHE_HOME": str(folder / "cache")},
        )
    started.append(process)
    begin, word = time.monotonic(), 0.0
    while not heard:
        rclpy.spin_once(listener, timeout_sec=0.01)
        word = word or (_used(process.pid) if log.stat().st_size else 0.0)
        if process.poll() is not None or time.monotonic() - begin > _PATIENCE:
            raise RuntimeError(f"{node}: {log.read_text(errors='replace').strip()[-300:]}")
    topic = _used(process.pid)
    word = word or topic
    listener.destroy_node()
    return [
        Figure(node, "fresh install: first word", word, "s", at_most(1.0)),
        Figure(node, f"fresh install: first {_FIRST[node]}", topic, "s", at_most(10.0)),
        Figure(node, "the same on the wall", time.monotonic() - begin, "s"),
    ]


def _compiled(folder: Path) -> Figure:
    """When the simulator, started first, had its machine code."""
    begin, log = time.monotonic(), folder / "simulator.log"
    while "compiled" not in log.read_text(errors="replace").splitlines()[-1]:
        time.sleep(0.1)
        if time.monotonic() - begin > _PATIENCE:
            raise RuntimeError("simulator: not compiled")
    return Figure("simulator", "compiled, on the wall", time.time() - _begun(log), "s")


def _begun(log: Path) -> float:
    """Time of the log's first line with one: `[INFO] [1790000000.123456789] ...`."""
    stamped = next(line for line in log.read_text().splitlines() if "] [" in line)
    return float(stamped.split("] [")[1].split("]")[0])


def _type(topic: str) -> type:
    from sensor_msgs.msg import BatteryState
    from std_msgs.msg import String

    return String if topic.endswith("/state") else BatteryState


def _rig() -> Path:
    return ROOT / "config" / "composite_rig.yaml"


def _used(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / _TICKS
