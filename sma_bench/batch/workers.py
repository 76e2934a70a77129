"""Who does the tasks: processes of this machine, or the workers of a dask cluster.

Both yield (index of the task, outcome) as soon as each is done, and end what still runs when the
caller is interrupted, is killed or stops asking.
"""

from collections import deque
from collections.abc import Generator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from concurrent.futures.process import BrokenProcessPool
from typing import Any

from sma_bench.batch.task import Outcome, Task, run_task
from sma_bench.errors import InputError
from sma_bench.worker_pool import WorkerPool

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
