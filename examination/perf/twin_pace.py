"""Whether the twin keeps pace: readings at 500 Hz in real time, and what it takes of a core."""

import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from examination.perf.figures import Figure, Outcome, Skipped, at_least, at_most
from examination.perf.timing import processor_of
from sma_bench.parameters import read_parameters
from sma_bench.parameters.node_tables import NODE_TABLES
from sma_bench.twin import Twin, compile_model
from sma_bench.twin.twin import NANOSECONDS

CONFIG = Path(__file__).resolve().parents[2] / "config"
RIGS = {"one wire": "wire_rig.yaml", "four wires": "composite_rig.yaml"}
RATE, CAMERA = 500.0, 80.0
_NAMESPACE = "/perf"
_STEP = 0.02
_STARTING = 120.0


def measure(tiny: bool = False) -> list[Outcome]:
    """Share of a core of the twin alone and of its node, and the pace it keeps."""
    seconds = 1.0 if tiny else 8.0
    outcomes: list[Outcome] = [_alone(name, CONFIG / rig, seconds) for name, rig in RIGS.items()]
    for name, rig in list(RIGS.items())[: 1 if tiny else None]:
        outcomes += _node(f"{name} at {RATE:g} Hz", CONFIG / rig, seconds)
    return outcomes


def _alone(name: str, rig: Path, seconds: float) -> Figure:
    """No ROS: readings handed over as the node does, every 20 ms."""
    parameters = read_parameters(rig)
    compile_model(parameters)
    settings = {p.name: p.default for p in NODE_TABLES["twin"]}
    twin = Twin(parameters, settings, lambda _: None, lambda _: None)
    wires = len(parameters["bench.channels"])
    begin = time.process_time()
    for k in range(round(seconds * RATE)):
        at = k / RATE
        stamp, volt = round(at * NANOSECONDS), 3.0 + np.sin(at)
        for wire in range(wires):
            twin.power(wire, stamp, volt, volt / 2.7)
        if int(at * CAMERA) != int((at - 1.0 / RATE) * CAMERA) or k == 0:
            for wire in range(wires):
                twin.temperature(wire, stamp, 300.0)
        twin.mechanics(stamp, 0.0)
        if k % round(_STEP * RATE) == 0:
            twin.advance()
    used = (time.process_time() - begin) / seconds
    return Figure(f"{name} at {RATE:g} Hz", "twin without ROS", used, "cores", at_most(1.0))


def _node(case: str, rig: Path, seconds: float) -> list[Outcome]:
    try:
        import rclpy
        from diagnostic_msgs.msg import DiagnosticArray
    except ImportError:
        return [Skipped(f"twin node, {case}", "no ROS 2 (rclpy) here")]
    from sma_bench.ros.processes import NodeProcesses, private_ros_environment

    private_ros_environment()
    rclpy.init(args=[])
    node = rclpy.create_node("perf", namespace=_NAMESPACE)
    told: list[tuple[float, dict[str, str]]] = []

    def listen(message: Any) -> None:
        for status in message.status:
            if status.name == f"{_NAMESPACE}/twin: gap":
                told.append((time.monotonic(), {v.key: v.value for v in status.values}))

    node.create_subscription(DiagnosticArray, "/diagnostics", listen, 10)
    try:
        with TemporaryDirectory() as folder, NodeProcesses(_NAMESPACE, Path(folder)) as running:
            running.start("twin", {}, (rig,))
            running.start("simulator", {"rate.power": RATE, "rate.mechanics": RATE}, (rig,))

            def spin(until: float) -> None:
                while time.monotonic() < until:
                    rclpy.spin_once(node, timeout_sec=0.1)
                    running.check()

            limit = time.monotonic() + _STARTING
            while not (told and float(told[-1][1]["model_time"])) and time.monotonic() < limit:
                spin(time.monotonic() + 0.2)
            pids = {k: running.pid(k) for k in ("twin", "simulator")}
            before, begin = {k: processor_of(pid) for k, pid in pids.items()}, time.monotonic()
            told.clear()
            spin(begin + seconds)
            elapsed = time.monotonic() - begin
            used = {k: (processor_of(pid) - before[k]) / elapsed for k, pid in pids.items()}
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
    shares: list[Outcome] = [
        Figure(case, f"{name} node", used[name], "cores", at_most(1.0) if name == "twin" else None)
        for name in used
    ]
    if len(told) < 2:
        return [*shares, Skipped(f"twin node's pace, {case}", "it told nothing twice")]
    (first, start), (last, end) = told[0], told[-1]

    def grown(key: str) -> float:
        return float(end[key]) - float(start[key])

    return [
        Figure(case, "model time a second", grown("model_time") / (last - first), "s/s",
               at_least(0.98)),
        Figure(case, "twin began anew", grown("restarts"), "times", at_most(0.0)),
        Figure(case, "readings too late", grown("readings_late"), "readings", at_most(0.0)),
        *shares,
    ]  # fmt: skip

