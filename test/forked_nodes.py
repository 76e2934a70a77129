"""Nodes forked from a process that has read the package's libraries: each runs as from its command
line, without the second of processor time that reading them takes.

rclpy itself is read after the fork, as it starts threads.
"""

import ast
import atexit
import contextlib
import gc
import importlib
import json
import os
import random
import select
import signal
import socket
import subprocess
import sys
import traceback
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
_AFTER_THE_FORK = ("rclpy", "launch", "launch_ros", "ament_index_python", "sma_bench.nodes")
_LONGEST_REQUEST = 1 << 20


class ForkedNode:
    """What the tests use of a subprocess.Popen."""

    def __init__(self, name, arguments, log):
        ours, theirs = socket.socketpair()
        request = {"node": name, "arguments": arguments, "environment": dict(os.environ)}
        socket.send_fds(_server(), [json.dumps(request).encode()], [log, theirs.fileno()])
        theirs.close()
        self._answers = ours.makefile("r")
        self.pid = int(self._answers.readline())
        self.returncode = None

    def wait(self, timeout=None):
        """Exit status; TimeoutExpired where it has none within `timeout` s."""
        if self.returncode is None:
            if not select.select([self._answers], [], [], timeout)[0]:
                raise subprocess.TimeoutExpired(str(self.pid), timeout or 0.0)
            self.returncode = int(self._answers.readline() or -signal.SIGKILL)
        return self.returncode

    def poll(self):
        """Exit status, None while it runs."""
        try:
            return self.wait(0.0)
        except subprocess.TimeoutExpired:
            return None

    def send_signal(self, number):
        """Nothing where it has ended, be it this moment."""
        if self.poll() is None:
            with contextlib.suppress(ProcessLookupError):
                os.kill(self.pid, number)

    def kill(self):
        """End it at once."""
        self.send_signal(signal.SIGKILL)


@cache
def _server():
    """The process that forks, started at the first node of this worker and ended with it."""
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    process = subprocess.Popen(
        [sys.executable, __file__, str(theirs.fileno())], pass_fds=[theirs.fileno()], cwd=ROOT
    )
    theirs.close()
    atexit.register(process.wait)
    atexit.register(ours.close)  # first: it ends without its socket
    return ours


def serve(requests):
    """Fork for each request, and answer with the node's process and, at its end, its status."""
    waking, wakes = os.pipe()
    os.set_blocking(wakes, False)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGCHLD, lambda *_: None)
    signal.set_wakeup_fd(wakes)
    running = {}
    while True:
        ready = select.select([requests, waking], [], [])[0]
        if waking in ready:
            os.read(waking, 4096)
            _report_ended(running)
        if requests in ready:
            data, handles, *_ = socket.recv_fds(requests, _LONGEST_REQUEST, 2)
            if not data:
                return
            log, answers = handles
            pid = os.fork()
            if pid == 0:
                signal.set_wakeup_fd(-1)
                _become_node(json.loads(data), log)
            os.close(log)
            running[pid] = socket.socket(fileno=answers)
            running[pid].send(f"{pid}\n".encode())


def _report_ended(running):
    while running:
        pid, status = os.waitpid(-1, os.WNOHANG)
        if pid == 0:
            return
        # Nobody may ask for it any more.
        with running.pop(pid) as answers, contextlib.suppress(OSError):
            answers.send(f"{os.waitstatus_to_exitcode(status)}\n".encode())


def _become_node(request, log):
    for number in (signal.SIGINT, signal.SIGCHLD):
        signal.signal(number, signal.SIG_DFL)
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    os.dup2(log, 1)
    os.dup2(log, 2)
    os.closerange(3, 256)
    os.environ.clear()
    os.environ.update(request["environment"])
    random.seed()
    sys.argv = ["start.py", request["node"], *request["arguments"]]
    try:
        importlib.import_module("sma_bench.nodes.start")._run(request["node"], sys.argv[2:])
    except BaseException as error:  # noqa: BLE001 (as the interpreter itself would)
        traceback.print_exc()
        sys.stderr.flush()
        os._exit(error.code if isinstance(error, SystemExit) else 1)


def read_libraries():
    """Import whatever the nodes import, but for ROS itself."""
    for path in sorted((ROOT / "sma_bench" / "nodes").glob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom) and not node.module.startswith(_AFTER_THE_FORK):
                importlib.import_module(node.module)
    gc.collect()
    gc.freeze()


if __name__ == "__main__":
    sys.path[0] = str(ROOT)
    read_libraries()
    serve(socket.socket(fileno=int(sys.argv[1])))
