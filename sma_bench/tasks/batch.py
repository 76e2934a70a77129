"""Many records, each by itself: a task, and what came of it."""

import time
from collections.abc import Generator, Sequence
from contextlib import closing
from dataclasses import dataclass
from typing import Any

from sma_bench.errors import InputError
from sma_bench.parameters import Parameters
from sma_bench.worker_pool import Lost, over_cluster, over_processes

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



def do_tasks(
    tasks: Sequence[Task], jobs: int, cluster: str | None = None
) -> Generator[tuple[int, Outcome], None, None]:
    """(index of the task, outcome) as soon as each is done.

    Args:
        jobs: processes of this machine.
        cluster: address of the dask scheduler whose workers do them instead.
    """
    if cluster:
        done = over_cluster(run_task, tasks, cluster)
    else:
        done = over_processes(run_task, tasks, jobs)
    with closing(done):
        for k, found in done:
            if isinstance(found, Lost):
                found = Outcome(tasks[k].path, error=f"{tasks[k].path}: {found.why}")
            yield k, found
