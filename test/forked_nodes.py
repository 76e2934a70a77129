"""Nodes forked from a process that has imported the libraries of the package. Each runs as from its
command line, without the second of CPU time for these imports.

rclpy itself is imported after the fork, because it starts threads.
"""

import ast
import contextlib
import gc
import importlib
import multiprocessing
import os
import signal
import subprocess
import sys
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
_AFTER_THE_FORK = ("rclpy", "launch", "launch_ros", "ament_index_python", "sma_bench.nodes")


class ForkedNode:
    """The part of subprocess.Popen that the tests use."""

    def __init__(self, name, arguments, log):
        given = name, arguments, str(log), dict(os.environ)
        self._process = _forks().Process(target=_become_node, args=given)
        self._process.start()
        self.pid = self._process.pid

    @property
    def returncode(self):
        return self._process.exitcode

    def wait(self, timeout=None):
        """Exit status. TimeoutExpired: it still runs after `timeout` s."""
        self._process.join(timeout)
        if self.returncode is None:
            raise subprocess.TimeoutExpired(str(self.pid), timeout or 0.0)
        return self.returncode

    def poll(self):
        """Exit status, None while it runs."""
        return self.returncode

    def send_signal(self, number):
        """Send a signal; does nothing if the process has ended."""
        if self.poll() is None:
            with contextlib.suppress(ProcessLookupError):
                os.kill(self.pid, number)

    def kill(self):
        """Kill it."""
        self.send_signal(signal.SIGKILL)


@cache
def _forks():
    """The forking process; it starts with the worker's first node and ends with the worker."""
    context = multiprocessing.get_context("forkserver")
    libraries = {
        node.module
        for path in (ROOT / "sma_bench" / "nodes").glob("*.py")
        for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.ImportFrom)
    }  # fmt: skip
    context.set_forkserver_preload(
        [name for name in sorted(libraries) if not name.startswith(_AFTER_THE_FORK)]
    )
    return context


def _become_node(name, arguments, log, environment):
    gc.freeze()
    os.dup2(os.open(log, os.O_WRONLY | os.O_APPEND | os.O_CREAT), 1)
    os.dup2(1, 2)
    os.chdir(ROOT)
    os.environ.clear()
    os.environ.update(environment)
    sys.argv = ["start.py", name, *arguments]
    importlib.import_module("sma_bench.nodes.start")._run(name, arguments)
