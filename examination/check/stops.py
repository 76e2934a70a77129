"""Does every node end on Ctrl-C? Groups of six nodes, at random instants.

Real processes: while they start, from the interpreter's first line on, or while a simulated bench
is driven and recorded. After Ctrl-C, none may run for more than 3 s, stay in the ROS graph seen by
another program, or print a traceback. Ten seconds per group on two idle cores.

    ./bench check stops --groups 250 --json stops.json
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

GROUP, NAMESPACE = 6, "/stops"
LIMIT = 3.0  # s
_SLOWEST_START, _LONGEST_RUN, _PATIENCE, _FOR_EVER = 8.0, 3.0, 180.0, 30.0  # s
_DISCOVERY = 0.5  # s until another program may notice that a node has ended
_LOOK = 0.005  # s between checks
# As the executables of an installation begin (setup.py): a signal during the start of the
# interpreter is handled at its first line.
_HELD = ("/usr/bin/env", "--block-signal=INT")
_HEARD = """\
import os, signal, sys
signal.signal(signal.SIGINT, lambda *_: os._exit(0))
signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGINT])
from sma_bench.nodes import start
getattr(start, sys.argv.pop(1))()
"""
_SMALL = {"image_width": 64, "image_height": 64}
_OWN = {"experiment": {"protocol": "composite_triangle", "autostart": "true"},
        "recorder": {"output": "bag"},
        "ir_camera": {**_SMALL, "regions": list(regions_side_by_side(4, 64, 64))},
        "synthetic_camera": _SMALL}


def main(argv: Sequence[str] | None = None) -> int:
    """0 if all ended in time, left the ROS graph and printed no traceback."""
    options = options_of("stops", __doc__, argv, groups=(250, f"of {GROUP} nodes"),
                         seed=(1, "of all"), **IN_PIECES | {"processes": (1, "at once")})
    jobs = [(options.seed, number, GROUP) for number in range(options.groups)]
    stops = [one for group in in_pieces(stopped, jobs, options) for one in group]
    rows, wrong = [], [one for one in stops if one["wrong"]]
    for name in (*NODES, "all"):
        if found := [one for one in stops if name in (one["node"], "all")]:
            seconds, starting = [o["seconds"] for o in found], sum(not o["ready"] for o in found)
            times = f"{np.median(seconds):.2f}", f"{max(seconds):.2f}"
            rows.append((name, len(found), starting, *times, sum(one in wrong for one in found)))
    print_table(("node", ">stops", ">of a start", ">median s", ">longest s", ">wrong"), rows)
    for one in wrong:
        print(f"group {one['group']}: {one['node']}: {one['wrong']}")
    return 1 if wrong else 0


def stopped(seed: int, number: int, size: int) -> list[dict[str, Any]]:
    """Stop time and errors of each node of a group; every other group is stopped at its start."""
    rng, while_starting = random.Random(f"{seed}/{number}"), number % 2 == 0
    private_ros_environment()
    with (ros_node("watcher", "/elsewhere") as node,
          tempfile.TemporaryDirectory(prefix="sma_bench_stops_") as name):
        folder = Path(name)
        processes = {name: _started(name, folder)
                     for name in rng.sample(sorted(NODES), size)}

        def ready() -> dict[str, bool]:
            return {name: "ready" in (folder / f"{name}.log").read_text(errors="replace")
                    for name in processes}

        try:
            wait = rng.uniform(0.0, _SLOWEST_START) if while_starting else _PATIENCE
            until = time.monotonic() + wait
            while time.monotonic() < until and (while_starting or not all(ready().values())):
                time.sleep(_LOOK)
            time.sleep(0.0 if while_starting else rng.uniform(0.0, _LONGEST_RUN))
            were = ready()
            ended, ghosts = _interrupted(processes, node)
        finally:
            for process in processes.values():
                process.kill()
                process.wait()
        found = []
        for name, process in processes.items():
            text, status = (folder / f"{name}.log").read_text(errors="replace"), process.returncode
            seconds = round(ended.get(name, _FOR_EVER), 3)
            wrong = [f"there after {seconds:.1f} s" if seconds > LIMIT else "",
                     f"status {status}" if status and name in ended else "",
                     "still in the graph" if name in ghosts and name in ended else "",
                     "not ready" if not (while_starting or were[name]) else "",
                     "a traceback" if "Traceback" in text else ""]
            line = ", ".join(filter(None, wrong))
            found.append({"group": number, "node": name, "seconds": seconds, "ready": were[name],
                          "wrong": line + (f" ({text[-300:]})" if line else "")})
        return found


def _started(name: str, folder: Path) -> subprocess.Popen[bytes]:
    command = [*_HELD, sys.executable, "-c", _HEARD, name, "--ros-args", "-r", f"__ns:={NAMESPACE}",
               "--params-file", str(share_directory() / "config" / "composite_rig.yaml")]
    for key, value in _OWN.get(name, {}).items():
        command += ["-p", f"{key}:={value}"]
    with (folder / f"{name}.log").open("wb") as log:
        return subprocess.Popen(command, stdout=log, stderr=log, stdin=subprocess.DEVNULL,
                                cwd=folder, env=tied_to_this_process())


def _interrupted(processes: dict[str, subprocess.Popen[bytes]],
                 node: Any) -> tuple[dict[str, float], set[str]]:
    """By name, s from Ctrl-C to the end of the process; nodes that another program still sees."""
    ended, begin = dict[str, float](), time.monotonic()
    for process in processes.values():
        process.send_signal(signal.SIGINT)
    while len(ended) < len(processes) and time.monotonic() < begin + _FOR_EVER:
        for name, process in processes.items():
            if process.poll() is not None:
                ended.setdefault(name, time.monotonic() - begin)
        time.sleep(_LOOK)
    while ghosts := {n for n, where in node.get_node_names_and_namespaces() if where == NAMESPACE}:
        if time.monotonic() > begin + max(LIMIT, *ended.values(), 0.0) + _DISCOVERY:
            break
        time.sleep(_LOOK)
    return ended, ghosts
