"""One case put to one program: a process of its own that sees the records and nothing else."""

import json
import os
import shutil
import signal
import subprocess
import tempfile
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sma_bench.blind.answers import checked_answer
from sma_bench.errors import InputError
from sma_bench.lifeline import tied_to_this_process
from sma_bench.parameters import read_parameters

PACKAGE_ROOT = Path(__file__).resolve().parents[2]
RECORD, HOLD_OUT, NOMINAL, EXPERIMENT = "record", "hold_out", "nominal.yaml", "experiment"
_RESULT, _IMPROVED = "result.json", "improved.yaml"
_ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
_NEEDS_IMPROVED = ("effect", "recalibration")
_LONGEST_LINE = 300


@dataclass(frozen=True)
class Given:
    """What came back: the plain result (None: failed, `line` says why), and the text of the
    improved parameter file."""

    result: Any
    line: str
    seconds: float
    improved: str | None = None


class Examinee:
    """A program that takes the arguments of `sma-bench diagnose`."""

    def __init__(self, program: Sequence[str], time_limit: float) -> None:
        """
        Args:
            program: start of the command line.
            time_limit: s after which a case counts as failed.
        """
        self._program = tuple(program)
        self._limit = time_limit
        self._running: set[subprocess.Popen[str]] = set()
        self._lock = threading.Lock()
        self._stopped = False

    def stop(self) -> None:
        """End what runs, and start nothing more."""
        with self._lock:
            self._stopped = True
            for process in self._running:
                if process.poll() is None:
                    _kill(process)

    def ask(self, case: Path, experiment: Path | None = None) -> Given:
        """Put a case to the program.

        Args:
            case: folder with record, hold_out and nominal.yaml.
            experiment: one more record, of the experiment that the first answer asked for.

        Raises:
            InputError: the case cannot be read or the program not be started. Whatever the
                program does is a failed answer.
        """
        with tempfile.TemporaryDirectory(prefix="bench_") as folder:
            desk = Path(folder)
            for name in (RECORD, HOLD_OUT, NOMINAL):
                _copy(case / name, desk / name)
            records = [RECORD]
            if experiment is not None:
                _copy(experiment, desk / EXPERIMENT)
                records.append(EXPERIMENT)
            begin = time.monotonic()
            line = self._run(desk, records)
            seconds = time.monotonic() - begin
            if line:
                return Given(None, line, seconds)
            try:
                result, improved = _collected(desk)
            except InputError as error:
                return Given(None, str(error).replace(f"{desk}/", ""), seconds)
            return Given(result, "", seconds, improved)

    def _run(self, desk: Path, records: Sequence[str]) -> str:
        """Run the program in its folder; "" or the line that says why there is no answer."""
        command = [
            *self._program, *records, "--params", NOMINAL, "--hold-out", HOLD_OUT,
            "--json", _RESULT, "--out", _IMPROVED,
        ]  # fmt: skip
        with tempfile.TemporaryFile("w+", encoding="utf-8", errors="replace") as errors:
            process = self._start(command, desk, errors)
            try:
                code = process.wait(timeout=self._limit)
            except subprocess.TimeoutExpired:
                _kill(process)
                process.wait()
                return f"no answer within {self._limit:g} s"
            finally:
                with self._lock:
                    self._running.discard(process)
            errors.seek(0)
            said = [text.strip() for text in errors if text.strip()]
        if code == 0:
            return ""
        return f"exit code {code}: {said[-1] if said else 'nothing said'}"[:_LONGEST_LINE]

    def _start(self, command: list[str], desk: Path, errors: Any) -> subprocess.Popen[str]:
        with self._lock:
            if self._stopped:
                raise InputError("the examination was stopped")
            try:
                process = subprocess.Popen(
                    command, cwd=desk, env=_environment(desk), text=True, start_new_session=True,
                    stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=errors,
                )  # fmt: skip
            except OSError as error:
                raise InputError(f"{command[0]}: cannot be started: {error.strerror}") from None
            self._running.add(process)
            return process


def _environment(desk: Path) -> dict[str, str]:
    """The caller's, with one thread a process and without a trace of the caller's folder."""
    environment = {k: v for k, v in os.environ.items() if k not in ("PWD", "OLDPWD", "_")}
    paths = [str(PACKAGE_ROOT), *filter(None, [environment.get("PYTHONPATH")])]
    one_thread = dict.fromkeys(_ONE_THREAD, "1")
    return tied_to_this_process(
        {**environment, **one_thread, "PWD": str(desk), "PYTHONPATH": os.pathsep.join(paths)}
    )


def _copy(source: Path, target: Path) -> None:
    """Contents only: links and times of files would tell where the case lies and when it was made.

    Raises:
        InputError: there is no such file or folder.
    """
    try:
        if source.is_dir():
            shutil.copytree(source, target, copy_function=shutil.copyfile)
            os.utime(target)
        else:
            shutil.copyfile(source, target)
    except (OSError, shutil.Error) as error:
        reason = getattr(error, "strerror", None) or "damaged"
        raise InputError(f"{source}: cannot be read: {reason}") from None


def _collected(desk: Path) -> tuple[Any, str | None]:
    """Checked result and text of the improved parameters.

    Raises:
        InputError: there is none, or it is against the contract.
    """
    try:
        result = json.loads((desk / _RESULT).read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError("no result was written") from None
    except (ValueError, RecursionError) as error:
        raise InputError(f"result is not JSON: {str(error).splitlines()[0]}") from None
    answer = checked_answer(result, "result")
    improved = desk / _IMPROVED
    if improved.is_file():
        read_parameters(improved)
        return result, improved.read_text(encoding="utf-8")
    if answer.verdict in _NEEDS_IMPROVED:
        raise InputError(f"verdict {answer.verdict} without improved parameters")
    return result, None


def _kill(process: subprocess.Popen[str]) -> None:
    """End a process and all that it started: it leads a session of its own."""
    try:
        os.killpg(process.pid, signal.SIGKILL)
    except ProcessLookupError:
        return
