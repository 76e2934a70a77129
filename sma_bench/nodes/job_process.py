"""Work that takes its time, as a process of its own, so that it cannot block a node. No ROS."""

import json
import re
import subprocess
import sys
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any, Protocol

from sma_bench.border import is_inside, read_bytes
from sma_bench.errors import InputError
from sma_bench.lifeline import end_with_parent, tied_to_this_process
from sma_bench.progress import COMPILING, Report, silent

CANCELLED = "cancelled on request"
OWN_ROOT = "sma_bench_results"
_OWN_BEGINNINGS = (b"# Improved by ", b"# Identified by ", b'{\n  "parameters"')
_LARGEST_RESULT = 1 << 26
_BAD_INPUT = 2
_TOLD = re.compile(r"progress (?P<share>[01]\.\d+) (?P<what>.*)")  # as `tell` prints it
_BUSY = re.compile(r"busy: (?P<percent>\d+) %, (?P<what>.*)")


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
        self._killed = self._cancelled = False

    def run(self, job: Job, report: Report = silent) -> str:
        """The job's result, waited for without using the processor.

        Args:
            report: told what the job tells meanwhile.

        Raises:
            InputError: what the job raised, or that it was ended.
        """
        process = self._running = subprocess.Popen(
            [sys.executable, "-m", type(job).__module__],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
            # Ctrl-C in a terminal is for the node, which then ends this process.
            start_new_session=True, env=tied_to_this_process(),
        )
        if self._killed:
            process.kill()
        errors: list[str] = []
        assert process.stdin and process.stdout and process.stderr
        with ThreadPoolExecutor(1) as beside:  # a pipe that nobody reads would stop the process
            output = beside.submit(process.stdout.read)
            with suppress(BrokenPipeError), process.stdin:  # it has ended; its status says why
                process.stdin.write(json.dumps(asdict(job)))
            for line in process.stderr:
                if told := _TOLD.match(line):
                    report(float(told["share"]), told["what"])
                else:
                    errors.append(line)
        status = process.wait()
        self._running = None
        cancelled, self._cancelled = self._cancelled, False
        if status == 0:
            return output.result()
        if status == _BAD_INPUT:
            raise InputError(output.result().strip())
        if self._killed or cancelled:
            why = "ended with its node" if self._killed else CANCELLED
            raise InputError(f"{self._work}: {why}")
        last = [line.strip() for line in errors if line.strip()][-1:] or [f"status {status}"]
        raise InputError(f"{self._work}: failed: {last[0]}")

    def cancel(self) -> bool:
        """End the running job, and no later one; whether there was one."""
        running = self._running
        if running is None:
            return False
        self._cancelled = True
        running.kill()
        return True

    def kill(self) -> None:
        """End the running job, and every later one."""
        self._killed = True
        running = self._running
        if running is not None:
            running.kill()


def tell(share: float, what: str = "") -> None:
    """Said by a job to whoever waits for it: the share that is done, and what comes now."""
    print(f"progress {share:.3f} {what}", file=sys.stderr, flush=True)


def busy(share: float, what: str) -> str:
    """The state of a node whose job is so far."""
    return f"busy: {100.0 * share:.0f} %, {what}"


def told_share(state: str) -> tuple[float, str] | None:
    """What `busy` put into a state; None of another one."""
    found = _BUSY.match(state)
    return (int(found["percent"]) / 100.0, found["what"]) if found else None


def run_job(kind: Callable[..., Job]) -> int:
    """The program: a job as JSON on standard input, its result on standard output."""
    from sma_bench.compiled import when_compiling  # brings numba, which the node does without

    end_with_parent()
    when_compiling(lambda: tell(0.0, COMPILING))
    try:
        print(kind(**json.load(sys.stdin)).run(), end="")
    except InputError as error:
        print(error)
        return _BAD_INPUT
    return 0


def records_inside(root: str, records: list[str], parameter: str = "record") -> list[str]:
    """Paths of `records`, relative ones below `root`; none may lie outside.

    Raises:
        InputError: no records, or one outside the root, `..` and links followed, those in the
            folder of a bag too.
    """
    if not records:
        raise InputError(f"{parameter}: is empty, expected the path of one record or more")
    return [str(_inside(root, record, parameter, "record_root")) for record in records]


def output_inside(root: str, path: str, parameter: str, suffix: str = "") -> str:
    """The path of what is to be written, a relative one below `root`; "" stays "".

    Without a root results have a folder of their own, where nothing else can be replaced.

    Raises:
        InputError: it lies outside the root, `..` and links followed, has a hidden name in it, or
            not the suffix.
    """
    if not path:
        return ""
    hidden = [part for part in Path(path).parts if part.startswith(".") and part.strip(".")]
    if hidden:
        raise InputError(f"{parameter}: {path}: {hidden[0]} is hidden, expected plain names")
    if suffix and not path.endswith(suffix):
        raise InputError(f"{parameter}: {path}, expected a name that ends in {suffix}")
    found = _inside(root or OWN_ROOT, path, parameter, "output_root")
    if suffix:
        require_own(found, parameter=parameter)
    return str(found)


def require_own(*files: Path, parameter: str) -> None:
    """InputError where one of the files exists and is none of those that jobs write."""
    for file in files:
        if file.exists() and not read_bytes(file, _LARGEST_RESULT).startswith(_OWN_BEGINNINGS):
            raise InputError(f"{parameter}: {file} is not a file that sma-bench has written")


def _inside(root: str, path: str, parameter: str, root_parameter: str) -> Path:
    top = Path(root or ".")
    found = Path(root, path)
    try:
        # A bag from elsewhere may hold a link to any file of this computer.
        parts = [found, *(found.iterdir() if found.is_dir() else ())]
        outside = not all(is_inside(part, top) for part in parts)
    except (OSError, ValueError):  # no permission, a zero byte
        outside = True
    if outside:
        where = root or f"{top.resolve()} (where the node was started)"
        if root in ("", OWN_ROOT):
            where += f"; {root_parameter} names another"
        raise InputError(f"{parameter}: {found} lies outside {root_parameter} {where}")
    return found


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
