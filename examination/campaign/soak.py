"""Hours of a bench in virtual time: memory stays flat, as a slope in MB for an hour of the bench.

The nodes themselves, in step with one another and faster than life: simulator, experiment and
recorder on a protocol that lasts, the recorder writing all that is published. What grows with the
computer's time and not with the bench's shows less here than in life: of that there is the index of
the recorder's chunks, 0.7 to 0.9 kB for each of two chunks a second.
"""

import shutil
import time
from collections import deque
from pathlib import Path

import numpy as np
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from scipy import stats
from std_msgs.msg import String
from std_srvs.srv import Trigger

from examination.campaign.allowance import own_memory
from examination.campaign.bench_nodes import PATIENCE, GaveUp, bench_nodes
from examination.campaign.outcome import Outcome

NODES = ("simulator", "experiment", "recorder")
LIMIT = 8.0
"""MB/h: a day adds 0.2 GB and a week 1.3 GB, which a small computer of 2 GB bears beside the bench.
The index of a bag, which has to grow, takes 5 to 7 of it."""
_SPEED = 1000.0
_SHORTEST = 60
"""Minutes: half of it to warm up, and as much to see a slope"""
_WARM_UP = 0.5
"""Hours. Memory follows the most that ever waited between two nodes: middleware and allocator keep
what a busy moment took. Such moments come again, but rarely a worse one."""
_PARTS, _FEWEST_PARTS = 10, 5
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
    """`size` minutes of the bench's time, an hour at least."""
    protocol = folder / "soak.yaml"
    protocol.write_text(_PROTOCOL)
    seconds, hours = 60.0 * max(size, _SHORTEST), []
    held: dict[str, list[float]] = {node: [] for node in NODES}
    clock: deque[float] = deque([0.0], maxlen=1)  # the newest; /clock ticks with every command
    with bench_nodes(folder / "logs") as talker:
        talker.node.create_subscription(
            Clock, "/clock", lambda tick: clock.append(tick.clock.sec + tick.clock.nanosec / 1e9),
            QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT),
        )  # fmt: skip
        states = talker.heard("experiment/state", String, latched=True)
        for node, settings in zip(NODES, (
            {"speed": _SPEED}, {"protocol": str(protocol), "use_sim_time": True},
            {"output": str(folder / "bag"), "use_sim_time": True},
        ), strict=True):  # fmt: skip
            talker.nodes.start(node, settings)
        talker.until("the simulator's clock, an idle experiment", lambda: clock[-1] and states)
        answer = talker.call(Trigger, "experiment/start")
        if not answer.success:
            raise RuntimeError(answer.message)
        begin = moved = clock[-1]
        due = still = time.monotonic()
        while (now := clock[-1]) - begin < seconds:
            talker.listen(0.05)
            talker.nodes.check()
            if now > moved:
                moved, still = now, time.monotonic()
            if time.monotonic() - still > PATIENCE:
                raise GaveUp(f"the bench's time stands still after {now - begin:.0f} s")
            if time.monotonic() >= due:
                due += _LOOK_EVERY
                hours.append((now - begin) / 3600.0)
                for node in NODES:
                    held[node].append(own_memory(talker.nodes.pid(node)) / 1e6)
            del states[:-5]
    shutil.rmtree(folder / "bag", ignore_errors=True)
    judged = {node: judge(np.array(hours), np.array(held[node])) for node in NODES}
    limit = f"{LIMIT:g} MB/h"
    return [
        Outcome("soak", f"memory of {node}", len(hours), found, limit, met)
        for node, (found, met) in judged.items()
    ]


def slope(hours: np.ndarray, megabytes: np.ndarray) -> tuple[float, float]:
    """MB an hour after the warm-up, and half of its interval of 95 %; NaN where that is unknown.

    The line goes through the means of parts of equal time: memory is a staircase, in which a look
    says what the one before it said, and the looks are not evenly spread over the bench's time.
    """
    edges = np.linspace(min(_WARM_UP, 0.5 * hours[-1]), hours[-1], _PARTS + 1)
    part = np.minimum(np.searchsorted(edges, hours, side="right") - 1, _PARTS - 1)
    means = np.array([
        [hours[part == k].mean(), megabytes[part == k].mean()] for k in range(_PARTS) if k in part
    ])  # fmt: skip
    if len(means) < _FEWEST_PARTS:
        return np.nan, np.nan
    fit = stats.linregress(*means.T)
    return float(fit.slope), float(stats.t.ppf(0.975, len(means) - 2) * fit.stderr)


def judge(hours: np.ndarray, megabytes: np.ndarray) -> tuple[str, bool]:
    """What was found, and whether it shows that the slope is below the limit."""
    fitted, doubt = slope(hours, megabytes)
    found = (
        f"{megabytes[-1]:.0f} MB after {hours[-1]:.2f} h, slope {fitted:+.2f} +- {doubt:.2f} MB/h"
    )
    return found, bool(fitted + doubt < LIMIT)
