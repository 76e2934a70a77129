"""Many records, each by itself: tasks, and who does them.

Processes of this machine, or the workers of a dask cluster; both yield (index of the task, outcome)
as soon as each is done, and end what still runs when the caller is interrupted, is killed or stops
asking."""

import time
from collections import deque
from collections.abc import Generator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from typing import Any

from sma_bench.errors import InputError
from sma_bench.parameters import Parameters
from sma_bench.worker_pool import WorkerPool

# --- One record of a batch: what is to be done with it, and what came of it.

IDENTIFY, DIAGNOSE = "identify", "diagnose"


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


# --- Who does the tasks: processes of this machine, or the workers of a dask cluster.
#
# Both yield (index of the task, outcome) as soon as each is done, and end what still runs when the
# caller is interrupted, is killed or stops asking.

MOST_JOBS = 1024
_CONNECTING = "10s"
_KILLED = "its process was killed (out of memory?)"


def on_processes(tasks: Sequence[Task], jobs: int) -> Generator[tuple[int, Outcome], None, None]:
    """Do the tasks on `jobs` processes of this machine, one record at a time each.

    Where a process is killed from outside, nobody can tell which record it was doing: all that
    were under way are done again, one by one, and only the one that is killed again has failed.

    Raises:
        InputError: jobs out of range.
    """
    if not 1 <= jobs <= MOST_JOBS:
        raise InputError(f"jobs {jobs}: expected 1 to {MOST_JOBS}")
    waiting = deque(enumerate(tasks))
    while waiting:
        broken = yield from _in_one_pool(waiting, min(jobs, len(waiting)))
        for k in broken:
            # Alone with a process of its own: if that is killed too, it is this record's doing.
            again = yield from _in_one_pool(deque([(k, tasks[k])]), 1)
            for lost in again:
                yield lost, Outcome(tasks[lost].path, error=f"{tasks[lost].path}: {_KILLED}")


def _in_one_pool(
    waiting: deque[tuple[int, Task]], jobs: int
) -> Generator[tuple[int, Outcome], None, list[int]]:
    """Work the queue off until it is empty or a process is killed; returns what is left undone."""
    running: dict[Future[Outcome], int] = {}
    try:
        with WorkerPool(jobs) as pool:
            while waiting or running:
                while waiting and len(running) < jobs:
                    k, task = waiting[0]
                    running[pool.submit(run_task, task)] = k
                    waiting.popleft()
                for done in wait(running, return_when=FIRST_COMPLETED).done:
                    outcome = done.result()
                    yield running.pop(done), outcome
    except BrokenProcessPool:
        return sorted(running.values())
    return []


def on_cluster(tasks: Sequence[Task], address: str) -> Generator[tuple[int, Outcome], None, None]:
    """Do the tasks on the workers of the dask scheduler at `address`.

    The workers have this package installed and see the records under the same paths.

    Raises:
        InputError: dask.distributed is not installed, or no scheduler answers.
    """
    distributed = _distributed()
    try:
        client = distributed.Client(address, timeout=_CONNECTING, set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(f"dask scheduler {address}: cannot be reached: {reason}") from None
    with client:
        # Not pure: what a path holds may have changed since the last batch.
        futures = {client.submit(run_task, task, pure=False): k for k, task in enumerate(tasks)}
        try:
            for future in distributed.as_completed(futures, loop=client.loop):
                k = futures[future]
                yield k, _outcome(tasks[k], future)
                future.release()
        finally:
            client.cancel(list(futures))


def _outcome(task: Task, future: Any) -> Outcome:
    if future.status == "finished":
        return future.result()
    reason = _KILLED if type(future.exception()).__name__ == "KilledWorker" else future.exception()
    return Outcome(task.path, error=" ".join(f"{task.path}: {reason}".split()))


def _distributed() -> Any:
    try:
        import distributed
    except ImportError:
        raise InputError(
            "a cluster needs dask.distributed, which is not installed: pip install distributed"
        ) from None
    return distributed
