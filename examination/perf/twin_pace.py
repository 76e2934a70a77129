"""Whether the twin keeps pace: readings at 500 Hz in real time, and what it takes of a core."""

import time
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from examination.perf.figures import Figure, Outcome, Skipped, at_least, at_most
from examination.perf.running import NAMESPACE, RIGS, running
from sma_bench.parameters import read_parameters
from sma_bench.parameters.node_tables import NODE_TABLES
from sma_bench.twin import Twin, compile_model
from sma_bench.twin.twin import NANOSECONDS

RATE, CAMERA = 500.0, 80.0
_STEP = 0.02


def measure(tiny: bool = False) -> list[Outcome]:
    """Share of a core of the twin alone and of its node, and the pace it keeps."""
    seconds = 1.0 if tiny else 8.0
    outcomes: list[Outcome] = [_alone(name, rig, seconds) for name, rig in RIGS.items()]
    for name, rig in list(RIGS.items())[: 1 if tiny else None]:
        outcomes += _node(f"{name} at {RATE:g} Hz", rig, seconds)
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
    if find_spec("rclpy") is None:
        return [Skipped(f"twin node, {case}", "no ROS 2 (rclpy) here")]
    from diagnostic_msgs.msg import DiagnosticArray

    heard: list[tuple[float, dict[str, str]]] = []

    def listen(message: Any) -> None:
        for status in message.status:
            if status.name == f"{NAMESPACE}/twin: gap":
                heard.append((time.monotonic(), {v.key: v.value for v in status.values}))

    nodes = {"twin": {}, "simulator": {"rate.power": RATE, "rate.mechanics": RATE}}
    with running(nodes, rig) as bench:
        bench.node.create_subscription(DiagnosticArray, "/diagnostics", listen, 10)
        bench.spin(lambda: heard and float(heard[-1][1]["model_time"]))
        heard.clear()
        _, used = bench.shares(seconds)
    shares: list[Outcome] = [
        Figure(case, f"{name} node", used[name], "cores", at_most(1.0) if name == "twin" else None)
        for name in nodes
    ]
    if len(heard) < 2:
        return [*shares, Skipped(f"twin node's pace, {case}", "heard nothing twice")]
    (first, start), (last, end) = heard[0], heard[-1]
    grown = {name: float(end[name]) - float(start[name])
             for name in ("model_time", "restarts", "readings_late")}  # fmt: skip
    pace = grown["model_time"] / (last - first)
    return [
        Figure(case, "model time a second", pace, "s/s", at_least(0.98)),
        Figure(case, "twin began anew", grown["restarts"], "times", at_most(0.0)),
        Figure(case, "readings too late", grown["readings_late"], "readings", at_most(0.0)),
        *shares,
    ]
