"""Whether the twin keeps pace: readings at 500 Hz in real time, and what it takes of a core."""

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray

from examination.perf.measuring import Figure
from examination.perf.running import NAMESPACE, RIGS, running
from sma_bench.parameters import read_parameters
from sma_bench.parameters.node_tables import NODE_TABLES
from sma_bench.twin import Twin, compile_model
from sma_bench.twin.twin import NANOSECONDS

RATE, CAMERA_EVERY = 500.0, 6  # Hz; a picture is there every 12 ms
STEP = 10  # readings between two steps of the twin: 20 ms


def measure(tiny: bool = False) -> Iterator[Figure]:
    """Share of a core of the twin alone and of its node, and the pace it keeps."""
    for name, rig in RIGS.items():
        seconds, case = 1.0 if tiny else 8.0, f"{name} at {RATE:g} Hz"
        yield Figure(case, "twin without ROS", _alone(rig, seconds), "cores", most=1.0)
        if not tiny or name == "one wire":
            yield from _node(case, rig, seconds)


def _alone(rig: Path, seconds: float) -> float:
    """No ROS: readings handed over as the node does."""
    parameters = read_parameters(rig)
    compile_model(parameters)
    settings = {p.name: p.default for p in NODE_TABLES["twin"]}
    twin = Twin(parameters, settings, lambda _: None, lambda _: None)
    begin = time.process_time()
    for k in range(round(seconds * RATE)):
        stamp, volt = round(k / RATE * NANOSECONDS), 3.0 + np.sin(k / RATE)
        for wire in range(len(parameters["bench.channels"])):
            twin.power(wire, stamp, volt, volt / 2.7)
            if k % CAMERA_EVERY == 0:
                twin.temperature(wire, stamp, 300.0)
        twin.mechanics(stamp, 0.0)
        if k % STEP == 0:
            twin.advance()
    return (time.process_time() - begin) / seconds


def _node(case: str, rig: Path, seconds: float) -> Iterator[Figure]:
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
        bench.spin(lambda: heard)
        _, shares = bench.shares(seconds)
        (first, start), (last, end) = heard[0], heard[-1]
    names = ("model_time", "restarts", "readings_late")
    model, restarts, late = (float(end[name]) - float(start[name]) for name in names)
    yield Figure(case, "model time a second", model / (last - first), "s/s", least=0.98)
    yield Figure(case, "twin began anew", restarts, "times", most=0.0)
    yield Figure(case, "readings too late", late, "readings", most=0.0)
    yield Figure(case, "twin node", shares["twin"], "cores", most=1.0)
    yield Figure(case, "simulator node", shares["simulator"], "cores")
