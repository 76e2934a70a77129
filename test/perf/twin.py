"""Whether the twin keeps pace: readings at 500 Hz in real time, and what it takes of a core."""

import os
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

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


def measure(seconds: float = 8.0) -> dict[str, float]:
    """Share of a core of the twin alone and of its node, and the pace it keeps; printed as well."""
    numbers: dict[str, float] = {}
    for name, rig in RIGS.items():
        numbers |= _alone(name, CONFIG / rig, seconds)
    for name, rig in RIGS.items():
        numbers |= _node(name, CONFIG / rig, seconds)
    for key, value in numbers.items():
        print(f"  {key:66s} {value:9.3g}")
    return numbers


def _alone(name: str, rig: Path, seconds: float) -> dict[str, float]:
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
    return {f"{name} at {RATE:g} Hz: twin without ROS, share of a core": used}


def _node(name: str, rig: Path, seconds: float) -> dict[str, float]:
    try:
        import rclpy
        from diagnostic_msgs.msg import DiagnosticArray
    except ImportError:
        print("  (no ROS 2: the node is not measured)")
        return {}
    from sma_bench.nodes.processes import NodeProcesses, private_ros_environment

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
            before, begin = {k: _cpu(pid) for k, pid in pids.items()}, time.monotonic()
            told.clear()
            spin(begin + seconds)
            elapsed = time.monotonic() - begin
            used = {k: (_cpu(pid) - before[k]) / elapsed for k, pid in pids.items()}
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
    label = f"{name} at {RATE:g} Hz"
    if len(told) < 2:
        return {f"{label}: twin, share of a core": used["twin"]}
    (first, start), (last, end) = told[0], told[-1]
    wires = len(read_parameters(rig)["bench.channels"])
    rates = [float(values["voltage_readings_rate"]) for _, values in told[1:]]
    return {
        f"{label}: model seconds a second": (float(end["model_time"]) - float(start["model_time"]))
        / (last - first),
        f"{label}: voltages taken of each wire [1/s]": float(np.mean(rates)) / wires,
        f"{label}: twin began anew": float(end["restarts"]) - float(start["restarts"]),
        f"{label}: readings too late": float(end["readings_late"]) - float(start["readings_late"]),
        **{f"{label}: {k}, share of a core": share for k, share in used.items()},
    }


def _cpu(pid: int) -> float:
    """CPU time of a process so far [s]."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


if __name__ == "__main__":
    measure()
