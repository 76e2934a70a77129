"""Whether the twin keeps pace: readings at 500 Hz in real time, and what it takes of a core."""

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray

from examination.perf.measuring import Figure
from examination.perf.running import NAMESPACE, RIGS, running

RATE = 500.0  # Hz


def measure(tiny: bool = False) -> Iterator[Figure]:
    """The pace that the node keeps, and its share of a core."""
    for name, rig in list(RIGS.items())[: 1 if tiny else None]:
        yield from _node(f"{name} at {RATE:g} Hz", rig, 1.0 if tiny else 8.0)


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
