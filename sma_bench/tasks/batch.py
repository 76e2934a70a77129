"""Batch work: many records, each identified or diagnosed on its own, in parallel."""

import asyncio
import logging
import os
import re
import tempfile
import time
from collections.abc import Generator, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import resource_tracker
from pathlib import Path
from typing import Any

import joblib
from joblib.externals.loky import get_reusable_executor
from joblib.externals.loky.process_executor import TerminatedWorkerError

from sma_bench.errors import InputError
from sma_bench.installation import VERSION
from sma_bench.lifeline import end_after, interrupts_held
from sma_bench.parameters import Parameters

IDENTIFY, DIAGNOSE = "identify", "diagnose"
_CONNECTING = 3.0  # s, timeout for a dask scheduler


@dataclass(frozen=True)
class Task:
    """Identify or diagnose (`kind`) one record; `path` must be valid on the worker."""

    kind: str
    path: str
    parameters: Parameters
    template: str | None = None  # parameter file whose comments are kept


@dataclass(frozen=True)
class Outcome:
    """Result of a task: the result and the text of its parameter file, or an error; time [s]."""

    path: str
    result: dict[str, Any] | None = None
    yaml: str = ""
    error: str = ""
    seconds: float = 0.0


def run_task(task: Task) -> Outcome:
    """Run one task. Raises nothing: an error becomes part of the outcome."""
    from sma_bench.tasks import work

    begin = time.perf_counter()
    try:
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "found.yaml"
            result: Any
            if task.kind == IDENTIFY:
                result = work.identify_files([task.path], task.parameters)
                work.write_identified(file, result, "sma-bench batch", [task.path], task.template)
            else:
                result = work.diagnose_files([task.path], [], task.parameters)
                work.write_improved(file, result, "sma-bench batch")
            text = file.read_text(encoding="utf-8")
        return Outcome(task.path, result.to_json(), text, "", time.perf_counter() - begin)
    except InputError as error:
        reason = str(error)
    except Exception as error:  # noqa: BLE001 (one record must not end the others)
        reason = f"{task.path}: failed: {type(error).__name__}: {error}"
    return Outcome(task.path, error=" ".join(reason.split()), seconds=time.perf_counter() - begin)


def do_tasks(tasks: Sequence[Task], jobs: int,
             cluster: str | None = None) -> Generator[tuple[int, Outcome], None, None]:
    """Yields (index of the task, outcome) as each is done, by `jobs` processes, which end with this
    one, or by the workers of the dask scheduler at `cluster`, which need this package and the same
    paths. InputError: the cluster cannot be reached, or is lost."""
    tied = {"initializer": end_after, "initargs": (os.getpid(),)}
    left = dict(enumerate(tasks))
    with _on_cluster(cluster) if cluster else joblib.parallel_config("loky", **tied):
        try:
            work = (joblib.delayed(_numbered)(k, task) for k, task in list(left.items()))
            resource_tracker.ensure_running()  # here, because starting it lets interrupts through
            with interrupts_held():  # interrupted while it starts, a process prints a traceback
                done = joblib.Parallel(jobs, return_as="generator_unordered", batch_size=1)(work)
            for k, outcome in done:
                del left[k]
                yield k, outcome
        except TerminatedWorkerError:  # one of the tasks, unknown which, took all memory, say
            for k, task in list(left.items()):
                # Each in a process of its own: the task whose process is killed again is the cause.
                try:
                    executor = get_reusable_executor(1, **tied)
                    with interrupts_held():
                        alone = executor.submit(run_task, task)
                    yield k, alone.result()
                except TerminatedWorkerError:
                    why = f"{task.path}: its process was killed (out of memory?)"
                    yield k, Outcome(task.path, error=why)


def _numbered(k: int, task: Task) -> tuple[int, Outcome]:
    return k, run_task(task)


@contextmanager
def _on_cluster(address: str) -> Iterator[None]:
    """Make joblib use the workers of a dask scheduler."""
    if not re.fullmatch(r"(tcp|tls|ws|wss)://[^/\s]+:\d+", address):
        raise InputError(f"--dask {address}: expected tcp://HOST:PORT (or tls, ws, wss)")
    try:
        import distributed
    except ImportError:
        missing = "dask.distributed, which is not installed: pip install distributed"
        raise InputError(f"a cluster needs {missing}") from None

    async def asked() -> Any:
        async with distributed.rpc(address) as scheduler:
            return await asyncio.wait_for(scheduler.identity(), _CONNECTING)

    logging.disable()  # an error is one line here; dask logs hundreds
    try:
        # Ask first: a dask client takes long to give up on something that is not a scheduler.
        if asyncio.run(asked()).get("type") != "Scheduler":
            raise InputError(f"dask {address}: answers, but is not a scheduler")
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
        reason = " ".join(f"{type(error).__name__}: {str(error) or 'no answer'}".split())
        raise InputError(f"dask scheduler {address}: {reason}") from None
    finally:
        logging.disable(logging.NOTSET)


def _version() -> str:
    return VERSION
