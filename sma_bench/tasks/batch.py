"""Many records, each by itself: a task, and what came of it."""

import logging
import os
import re
import time
from collections.abc import Generator, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from multiprocessing import resource_tracker
from typing import Any

import joblib
from joblib.externals.loky import get_reusable_executor
from joblib.externals.loky.process_executor import TerminatedWorkerError

from sma_bench.errors import InputError
from sma_bench.installation import VERSION
from sma_bench.lifeline import end_after, interrupts_held
from sma_bench.parameters import Parameters

IDENTIFY, DIAGNOSE = "identify", "diagnose"

_MOST_JOBS = 1024
_CONNECTING = "4s"


@dataclass(frozen=True)
class Task:
    """A record to identify or diagnose; travels to the process that does it.

    Attributes:
        kind: "identify" or "diagnose".
        path: the record, where the worker sees it.
        parameters: priors of the identification, or what the diagnosis holds against the record.
    """

    kind: str
    path: str
    parameters: Parameters


@dataclass(frozen=True)
class Outcome:
    """What came of one record.

    Attributes:
        result: the document that the command of this kind writes as JSON; None where it failed.
        parameters: identified or improved; None where it failed.
        error: why it failed, in one line; "" where it did not.
        seconds: how long it took.
    """

    path: str
    result: dict[str, Any] | None = None
    parameters: Parameters | None = None
    error: str = ""
    seconds: float = 0.0


def run_task(task: Task) -> Outcome:
    """Do one task; whatever goes wrong with its record stays with it."""
    begin = time.perf_counter()
    try:
        document, parameters = _WORK[task.kind](task)
    except InputError as error:
        reason = str(error)
    except Exception as error:  # noqa: BLE001 (one record must not end the others)
        reason = f"{task.path}: failed: {type(error).__name__}: {error}"
    else:
        return Outcome(task.path, document, parameters, "", time.perf_counter() - begin)
    return Outcome(task.path, error=" ".join(reason.split()), seconds=time.perf_counter() - begin)


def _identify(task: Task) -> tuple[dict[str, Any], Parameters]:
    from sma_bench.identify import identify
    from sma_bench.records import open_record

    result = identify([open_record(task.path)], task.parameters)
    return result.to_json(), result.parameters


def _diagnose(task: Task) -> tuple[dict[str, Any], Parameters]:
    from sma_bench.diagnose import diagnose
    from sma_bench.records import read_record

    result = diagnose([read_record(task.path)], task.parameters)
    return result.to_json(), result.improved


_WORK = {IDENTIFY: _identify, DIAGNOSE: _diagnose}


def do_tasks(
    tasks: Sequence[Task], jobs: int, cluster: str | None = None
) -> Generator[tuple[int, Outcome], None, None]:
    """(index of the task, outcome) as soon as each is done.

    Args:
        jobs: processes of this machine, which end with this one.
        cluster: address of the dask scheduler whose workers do them instead; they have this
            package installed and see files under the same paths.

    Raises:
        InputError: jobs out of range; no such cluster, or it is lost.
    """
    if not 1 <= jobs <= _MOST_JOBS:
        raise InputError(f"jobs {jobs}: expected 1 to {_MOST_JOBS}")
    where = _on_cluster(cluster) if cluster else _on_processes()
    left = dict(enumerate(tasks))
    with where:
        try:
            for k, outcome in _side_by_side(list(left.items()), jobs):
                del left[k]
                yield k, outcome
        except TerminatedWorkerError:  # by the one that hangs or takes all memory, whichever it is
            for k, task in list(left.items()):
                yield k, _alone(task)


def _side_by_side(
    tasks: Iterable[tuple[int, Task]], jobs: int
) -> Generator[tuple[int, Outcome], None, None]:
    work = (joblib.delayed(_numbered)(k, task) for k, task in tasks)
    resource_tracker.ensure_running()  # its own start would let interrupts through
    with interrupts_held():  # a process that just begins would answer with a traceback
        done = joblib.Parallel(jobs, return_as="generator_unordered", batch_size=1)(work)
    yield from done


def _numbered(k: int, task: Task) -> tuple[int, Outcome]:
    return k, run_task(task)


def _alone(task: Task) -> Outcome:
    """With a process of its own: if that is killed as well, it is this task's doing."""
    try:
        executor = get_reusable_executor(1, initializer=end_after, initargs=(os.getpid(),))
        with interrupts_held():
            done = executor.submit(run_task, task)
        return done.result()
    except TerminatedWorkerError:
        return Outcome(task.path, error=f"{task.path}: its process was killed (out of memory?)")


def _on_processes() -> AbstractContextManager[Any]:
    return joblib.parallel_config("loky", initializer=end_after, initargs=(os.getpid(),))


@contextmanager
def _on_cluster(address: str) -> Iterator[None]:
    """The workers of a dask scheduler, for joblib."""
    if not re.fullmatch(r"(tcp|tls|ws|wss)://[^/\s]+:\d+", address):
        raise InputError(f"--dask {address}: expected tcp://HOST:PORT (or tls, ws, wss)")
    try:
        import distributed
    except ImportError:
        raise InputError(
            "a cluster needs dask.distributed, which is not installed: pip install distributed"
        ) from None
    logging.disable()  # what goes wrong is said in one line; their own accounts of it have hundreds
    try:
        with distributed.Client(address, timeout=_CONNECTING, set_as_default=False) as client:
            for worker, version in client.run(_version, on_error="return").items():
                if version != VERSION:
                    raise InputError(f"dask worker {worker}: {version}, expected {VERSION}")
            if not client.nthreads():
                raise InputError(f"dask scheduler {address}: has no workers")
            with joblib.parallel_config("dask", client=client):
                yield
    except InputError:
        raise
    except Exception as error:
        reason = " ".join(f"{type(error).__name__}: {error}".split())
        raise InputError(f"dask scheduler {address}: {reason}") from None
    finally:
        logging.disable(logging.NOTSET)


def _version() -> str:
    return VERSION
