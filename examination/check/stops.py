"""Does every node end when it is asked to? Groups of eight, Ctrl-C at random instants.

Real processes: while they start, from the interpreter's first line on, or while a simulated bench
is driven and recorded. None may be there 3 s after Ctrl-C or stay in the graph that another program
sees, and none may say more than lines. Two at least of each group are bare nodes of rclpy, for
comparison: of these ghosts alone are counted. Ten seconds a group on two free cores.

    ./bench check stops --groups 250 [--only experiment serial_bridge] --json stops.json
"""

import random
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from examination.pieces import IN_PIECES, in_pieces, options_of, print_table, ros_node
from sma_bench.hardware.thermal_image import regions_side_by_side
from sma_bench.installation import share_directory
from sma_bench.lifeline import tied_to_this_process
from sma_bench.nodes.start import NODES
from sma_bench.ros.processes import private_ros_environment

GROUP, NAMESPACE = 8, "/stops"
LIMIT = 3.0  # s
_SLOWEST_START, _LONGEST_RUN, _PATIENCE, _FOR_EVER = 8.0, 3.0, 180.0, 30.0  # s
_DISCOVERY = 0.5  # s that another program may take to hear of an end
_LOOK = 0.005  # s
# As the executables of an installation begin (setup.py): what comes while the interpreter starts is
# heard at its first line.
_HELD = ("/usr/bin/env", "--block-signal=INT")
_HEARD = """\
import os, signal, sys
signal.signal(signal.SIGINT, lambda *_: os._exit(0))
signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGINT])
from sma_bench.nodes import start
getattr(start, sys.argv.pop(1))()
"""
_BARE = """\
import rclpy
from rclpy.executors import ExternalShutdownException
from std_msgs.msg import String
rclpy.init()
node = rclpy.create_node("node")
publisher = node.create_publisher(String, "chatter", 10)
node.create_timer(0.05, lambda: publisher.publish(String(data="hello")))
print("ready", flush=True)
try:
    rclpy.spin(node)
except (KeyboardInterrupt, ExternalShutdownException):
    pass
finally:
    node.destroy_node()
    rclpy.try_shutdown()
"""
BARE = tuple(f"bare_{k}" for k in range(GROUP))
_SMALL = {"image_width": 64, "image_height": 64}
_OWN = {"experiment": {"protocol": "composite_triangle", "autostart": "true"},
        "recorder": {"output": "bag"},
        "ir_camera": {**_SMALL, "regions": list(regions_side_by_side(4, 64, 64))},
        "synthetic_camera": _SMALL}  # fmt: skip


def main(argv: Sequence[str] | None = None) -> int:
    """0 when all of them ended in time, left no ghost and said no more than lines."""
    options = options_of("stops", __doc__, argv, groups=(250, f"of {GROUP} nodes"),
                         seed=(1, "of all"), only=(tuple(NODES), "of these nodes"),
                         **IN_PIECES | {"processes": (1, "at once")})
    jobs = [(options.seed, number, GROUP, tuple(options.only)) for number in range(options.groups)]
    stops = [one for group in in_pieces(stopped, jobs, options) for one in group]
    rows = []
    kinds = {name: (name,) for name in NODES} | {"all": tuple(NODES), "bare rclpy": BARE}
    for name, alike in kinds.items():
        if found := [one for one in stops if one["node"] in alike]:
            seconds, wrong = [one["seconds"] for one in found], [o for o in found if o["wrong"]]
            starting = sum(not one["ready"] for one in found)
            times = f"{np.median(seconds):.2f}", f"{max(seconds):.2f}"
            rows.append((name, len(found), starting, *times, len(wrong)))
    print_table(("node", ">stops", ">of a start", ">median s", ">longest s", ">wrong"), rows)
    for one in (one for one in stops if one["wrong"]):
        print(f"group {one['group']}: {one['node']}: {one['wrong']}")
    return 1 if any(one["wrong"] for one in stops if one["node"] in NODES) else 0


def stopped(seed: int, number: int, size: int,
            only: Sequence[str] = tuple(NODES)) -> list[dict[str, Any]]:
    """How long each of a group took to stop and what was wrong; every other as it starts."""
    rng = random.Random(f"{seed}/{number}")
    names = rng.sample(sorted(only), min(size - 2, len(only)))
    names += BARE[: size - len(names)]
    private_ros_environment()
    with (ros_node("watcher", "/elsewhere") as node,
          tempfile.TemporaryDirectory(prefix="sma_bench_stops_") as folder):
        processes = {name: _started(name, Path(folder)) for name in names}
        try:
            found = _stopped(rng, number % 2 == 0, processes, Path(folder), node)
        finally:
            for process in processes.values():
                process.kill()
                process.wait()
    return [{"group": number, "node": name, **one} for name, one in found.items()]


def _started(name: str, folder: Path) -> subprocess.Popen[bytes]:
    given = ["--ros-args", "-r", f"__ns:={NAMESPACE}"]
    command = [sys.executable, "-c", _BARE, *given, "-r", f"__node:={name}"]
    if name in NODES:
        given += ["--params-file", str(share_directory() / "config" / "composite_rig.yaml")]
        for key, value in _OWN.get(name, {}).items():
            given += ["-p", f"{key}:={value}"]
        command = [*_HELD, sys.executable, "-c", _HEARD, name, *given]
    with (folder / f"{name}.log").open("wb") as log:
        return subprocess.Popen(command, stdout=log, stderr=log, stdin=subprocess.DEVNULL,
                                cwd=folder, env=tied_to_this_process())  # fmt: skip


def _stopped(rng: random.Random, while_starting: bool,
             processes: dict[str, subprocess.Popen[bytes]], folder: Path,
             node: Any) -> dict[str, dict[str, Any]]:
    """By node: s until it had ended, whether it was ready, and what was wrong, "" for nothing."""

    def said(name: str) -> str:
        return (folder / f"{name}.log").read_text(errors="replace")

    def ready() -> dict[str, bool]:
        return {name: "ready" in said(name) for name in processes}

    # The instant.
    until = time.monotonic() + (rng.uniform(0.0, _SLOWEST_START) if while_starting else _PATIENCE)
    while time.monotonic() < until and (while_starting or not all(ready().values())):
        time.sleep(_LOOK)
    time.sleep(0.0 if while_starting else rng.uniform(0.0, _LONGEST_RUN))
    # Ctrl-C, as a terminal sends it: to all of them.
    were, ended = ready(), dict[str, float]()
    begin = time.monotonic()
    for process in processes.values():
        process.send_signal(signal.SIGINT)
    while len(ended) < len(processes) and time.monotonic() < begin + _FOR_EVER:
        for name, process in processes.items():
            if process.poll() is not None:
                ended.setdefault(name, time.monotonic() - begin)
        time.sleep(_LOOK)
    # Whom another program still sees.
    while ghosts := {n for n, where in node.get_node_names_and_namespaces() if where == NAMESPACE}:
        if time.monotonic() > begin + max(LIMIT, *ended.values(), 0.0) + _DISCOVERY:
            break
        time.sleep(_LOOK)

    found, seconds = {}, {name: round(ended.get(name, _FOR_EVER), 3) for name in processes}
    for name, process in processes.items():
        text, status = said(name), process.poll()
        wrong = [f"there after {seconds[name]:.1f} s" if seconds[name] > LIMIT else "",
                 f"status {status}" if status else "",
                 "still in the graph" if name in ghosts and name in ended else "",
                 "not ready" if not (while_starting or were[name]) else "",
                 "a traceback" if "Traceback" in text else ""]  # fmt: skip
        wrong = wrong if name in NODES else wrong[2:3]
        line = ", ".join(filter(None, wrong))
        line += f" ({text[-300:]})" if line else ""
        found[name] = {"seconds": seconds[name], "ready": were[name], "wrong": line}
    return found
