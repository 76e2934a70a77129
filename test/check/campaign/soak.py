"""Hours of a bench in virtual time: memory stays flat, as a slope in MB for an hour of the bench.

The nodes themselves, in step with one another and faster than life: simulator, experiment and
recorder on a protocol that lasts, the recorder writing all that is published.
"""

import shutil
import time
from pathlib import Path

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from std_msgs.msg import String
from std_srvs.srv import Trigger

from campaign.allowance import resident
from campaign.bench_nodes import PATIENCE, GaveUp, Talker, bench_nodes
from campaign.outcome import Outcome

NODES = ("simulator", "experiment", "recorder")
# MB/h: a day of it is a tenth of a small computer's memory. An mcap's index grows with its chunks.
LIMIT = 8.0
_SPEED = 1000.0
_WARM_UP = 0.5
"""Part of the time in which caches and queues fill"""
_LOOK_EVERY = 0.5
_PROTOCOL = """\
name: soak
description: triangles for ever
repeat: 5000
steps:
  - {kind: triangle, name: heat, peak: 6.0, rise: 20.0, fall: 20.0}
  - {kind: rest, duration: 20.0}
"""


def soak(size: int, _: int, folder: Path) -> list[Outcome]:
    """`size` minutes of the bench's time."""
    with bench_nodes(folder / "logs") as talker:
        hours, held = _run(talker, 60.0 * size, folder)
    shutil.rmtree(folder / "bag", ignore_errors=True)
    return [_outcome(node, hours, megabytes) for node, megabytes in held.items()]


def _run(
    talker: Talker, seconds: float, folder: Path
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Hours of the bench's time, and MB held by every node at each."""
    protocol = folder / "soak.yaml"
    protocol.write_text(_PROTOCOL)
    reports = talker.heard("/diagnostics", DiagnosticArray)
    states = talker.heard("experiment/state", String, latched=True)
    clock = {"use_sim_time": True}
    talker.nodes.start("simulator", {"speed": _SPEED})
    talker.nodes.start("experiment", {"protocol": str(protocol), **clock})
    talker.nodes.start("recorder", {"output": str(folder / "bag"), **clock})
    talker.until("the simulator reports", lambda: reports)
    talker.until("the experiment is idle", lambda: states)
    answer = talker.call(Trigger, "experiment/start")
    if not answer.success:
        raise RuntimeError(answer.message)
    begin = _simulated(reports)
    hours, held = [], {node: [] for node in NODES}
    due = time.monotonic()
    moved, still = begin, time.monotonic()
    while (now := _simulated(reports)) - begin < seconds:
        talker.listen(0.05)
        if now > moved:
            moved, still = now, time.monotonic()
        if time.monotonic() - still > PATIENCE:
            raise GaveUp(f"the bench's time stands still at {now:.0f} s")
        talker.nodes.check()
        if time.monotonic() >= due:
            due += _LOOK_EVERY
            hours.append((now - begin) / 3600.0)
            for node in NODES:
                held[node].append(resident(talker.nodes.pid(node)) / 1e6)
        del reports[:-5], states[:-5]
    return np.array(hours), {node: np.array(values) for node, values in held.items()}


def _simulated(reports: list[DiagnosticArray]) -> float:
    """s of the bench's time that its newest report states; 0 before the first."""
    for message in reversed(reports):
        for status in message.status:
            for item in status.values:
                if item.key == "simulated_seconds":
                    return float(item.value)
    return 0.0


def slope(hours: np.ndarray, megabytes: np.ndarray) -> tuple[float, float]:
    """MB an hour by least squares after the warm-up, and one standard error of it."""
    late = hours >= _WARM_UP * hours[-1]
    if np.count_nonzero(late) < 3:
        return np.nan, np.nan
    (fitted, _), covariance = np.polyfit(hours[late], megabytes[late], 1, cov="unscaled")
    rest = megabytes[late] - np.polyval(np.polyfit(hours[late], megabytes[late], 1), hours[late])
    return float(fitted), float(np.sqrt(covariance[0, 0]) * max(rest.std(), 1e-3))


def _outcome(node: str, hours: np.ndarray, megabytes: np.ndarray) -> Outcome:
    fitted, error = slope(hours, megabytes)
    found = (
        f"{megabytes[-1]:.0f} MB after {hours[-1]:.2f} h, slope {fitted:+.2f} +- {error:.2f} MB/h"
    )
    met = bool(fitted - 2.0 * error < LIMIT)
    return Outcome("soak", f"memory of {node}", len(hours), found, f"{LIMIT:g} MB/h", met)
