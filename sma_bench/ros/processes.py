"""Nodes as processes of a script: started with a log each, ended in reverse order."""

import os
import signal
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Self

from sma_bench.errors import InputError
from sma_bench.lifeline import tied_to_this_process
from sma_bench.ros.discovery import RANGE, THIS_MACHINE, USERS_VARIABLES

_PATIENCE = 8.0
_PRIVATE_DOMAINS = range(120, 220)


def private_ros_environment() -> None:
    """Keep this process and its nodes away from any other bench: own domain, this machine only."""
    for name in USERS_VARIABLES:
        os.environ.pop(name, None)
    os.environ[RANGE] = THIS_MACHINE
    os.environ["ROS_DOMAIN_ID"] = str(_PRIVATE_DOMAINS[os.getpid() % len(_PRIVATE_DOMAINS)])


class NodeProcesses:
    """Nodes of this package in one namespace; leaving the context ends them all.

    They end as well where this process is killed and cannot leave the context.
    """

    def __init__(self, namespace: str, logs: Path) -> None:
        self._namespace = namespace
        self._logs = logs
        self._running: dict[str, subprocess.Popen[bytes]] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        for name in reversed(list(self._running)):
            self.end(name)

    def start(
        self,
        name: str,
        parameters: Mapping[str, Any],
        files: tuple[str | Path, ...] = (),
        remappings: Mapping[str, str] | None = None,
    ) -> None:
        """Start a node with parameter files and, over them, single parameters."""
        command = [sys.executable, "-m", "sma_bench.nodes.start", name, "--ros-args"]
        for old, new in {"__ns": self._namespace, **(remappings or {})}.items():
            command += ["-r", f"{old}:={new}"]
        for file in files:
            command += ["--params-file", str(file)]
        for key, value in parameters.items():
            command += ["-p", f"{key}:={_yaml(value)}"]
        with open(self._logs / f"{name}.log", "ab") as log:
            self._running[name] = subprocess.Popen(
                command, stdout=log, stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL,
                env=tied_to_this_process(),
            )

    def check(self) -> None:
        """Raise InputError when a node has ended by itself; the line quotes its last words."""
        for name, process in self._running.items():
            if process.poll() is not None:
                raise InputError(f"node {name} ended: {self._last_words(name)}")

    def pid(self, name: str) -> int:
        """Process of a running node."""
        return self._running[name].pid

    def end(self, name: str) -> None:
        """End a node as Ctrl-C would; insist after a while."""
        process = self._running.pop(name)
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGKILL):
            if process.poll() is None:
                process.send_signal(number)
                try:
                    process.wait(_PATIENCE)
                except subprocess.TimeoutExpired:
                    continue
            return

    def _last_words(self, name: str) -> str:
        lines = (self._logs / f"{name}.log").read_text(errors="replace").strip().splitlines()
        return lines[-1] if lines else "without a word"


def _yaml(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(_yaml(item) for item in value) + "]"
    if isinstance(value, str):
        return "'" + value.replace("'", "''") + "'"
    return repr(value)
