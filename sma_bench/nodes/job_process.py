"""Work that takes its time, as a process of its own, so that it cannot block a node. No ROS."""

import json
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Protocol

from sma_bench.errors import InputError

_BAD_INPUT = 2


class Job(Protocol):
    """A dataclass of plain values that travel as JSON to its module, run as a program."""

    __dataclass_fields__: Any

    def run(self) -> str:
        """The result as JSON."""


class JobProcess:
    """Runs one job at a time in a Python process; `kill` may come from any thread."""

    def __init__(self, work: str) -> None:
        """`work` is what the jobs are called in messages."""
        self._work = work
        self._running: subprocess.Popen[str] | None = None
        self._killed = False

    def run(self, job: Job) -> str:
        """The job's result, waited for without using the processor.

        Raises:
            InputError: what the job raised, or that it was ended.
        """
        self._running = subprocess.Popen(
            [sys.executable, "-m", type(job).__module__],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
            # Ctrl-C in a terminal is for the node, which then ends this process.
            start_new_session=True,
        )
        if self._killed:
            self._running.kill()
        output, errors = self._running.communicate(json.dumps(asdict(job)))
        status = self._running.returncode
        self._running = None
        if status == 0:
            return output
        if status == _BAD_INPUT:
            raise InputError(output.strip())
        if self._killed:
            raise InputError(f"{self._work}: ended with its node")
        last = errors.strip().splitlines()[-1:] or [f"status {status}"]
        raise InputError(f"{self._work}: failed: {last[0]}")

    def kill(self) -> None:
        """End the running job, and every later one."""
        self._killed = True
        running = self._running
        if running is not None:
            running.kill()


def run_job(kind: Callable[..., Job]) -> int:
    """The program: a job as JSON on standard input, its result on standard output."""
    try:
        print(kind(**json.load(sys.stdin)).run(), end="")
    except InputError as error:
        print(error)
        return _BAD_INPUT
    return 0


def records_inside(root: str, records: list[str], parameter: str = "record") -> list[str]:
    """Paths of `records`, relative ones below `root`; with a root, none may lie outside.

    Raises:
        InputError: no records, or one outside the root, `..` and links followed.
    """
    if not records:
        raise InputError(f"{parameter}: is empty, expected the path of one record or more")
    paths = [Path(root) / record for record in records]
    for path in paths:
        if root and not path.resolve().is_relative_to(Path(root).resolve()):
            raise InputError(f"{parameter}: {path} lies outside record_root {root}")
    return [str(path) for path in paths]


def given(names: Sequence[str]) -> list[str]:
    """Names of a list parameter; ROS cannot type an empty array: [""] stands for none."""
    return [name for name in names if name]


def made_folder(path: str) -> Path:
    """The folder, made if it does not exist.

    Raises:
        InputError: it cannot be made.
    """
    folder = Path(path)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot be made: {error.strerror}") from None
    return folder
