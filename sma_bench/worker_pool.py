"""Tasks over processes of this machine, or over the workers of a dask cluster.

Both yield (index of the task, what came of it) as soon as each is done, and end what still runs
when the caller is interrupted, is killed or stops asking.
"""

import logging
import multiprocessing
import signal
import threading
import time
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import (
    FIRST_COMPLETED,
    CancelledError,
    Future,
    ProcessPoolExecutor,
    ThreadPoolExecutor,
    wait,
)
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, ParamSpec, TypeVar

from sma_bench.errors import InputError
from sma_bench.installation import VERSION
from sma_bench.lifeline import end_after

P = ParamSpec("P")
T = TypeVar("T")
R = TypeVar("R")

MOST_JOBS = 1024
_KILLED = "its process was killed (out of memory?)"


@dataclass(frozen=True)
class Lost:
    """Instead of a result: whoever did the task is gone, each time that it was tried."""

    why: str


Done = Generator[tuple[int, R | Lost], None, None]


def over_processes(work: Callable[[T], R], tasks: Sequence[T], jobs: int) -> Done[R]:
    """Do the tasks on `jobs` processes of this machine, one at a time each.

    Where a process is killed from outside, nobody can tell which task it was doing: all that
    were under way are done again, one by one, and only the one that is killed again is lost.

    Raises:
        InputError: jobs out of range.
    """
    if not 1 <= jobs <= MOST_JOBS:
        raise InputError(f"jobs {jobs}: expected 1 to {MOST_JOBS}")
    waiting = deque(enumerate(tasks))
    while waiting:
        broken = yield from _in_one_pool(work, waiting, min(jobs, len(waiting)))
        for k in broken:
            # Alone with a process of its own: if that is killed too, it is this task's doing.
            again = yield from _in_one_pool(work, deque([(k, tasks[k])]), 1)
            for lost in again:
                yield lost, Lost(_KILLED)


def _in_one_pool(
    work: Callable[[T], R], waiting: deque[tuple[int, T]], jobs: int
) -> Generator[tuple[int, R], None, list[int]]:
    """Work the queue off until it is empty or a process is killed; returns what is left undone."""
    running: dict[Future[R], int] = {}
    try:
        with WorkerPool(jobs) as pool:
            for k, done in _each_done(lambda task: pool.submit(work, task), waiting, jobs, running):
                yield k, done.result()
    except BrokenProcessPool:
        return sorted(running.values())
    return []


def over_threads(
    work: Callable[[T], R], tasks: Sequence[T], jobs: int, stop: Callable[[], None]
) -> Generator[tuple[int, R], None, None]:
    """Do tasks that run programs of their own; `stop` ends those when the work ends early."""
    with ThreadPoolExecutor(jobs) as pool:
        try:
            queue = deque(enumerate(tasks))
            for k, done in _each_done(lambda task: pool.submit(work, task), queue, jobs, {}):
                yield k, done.result()
        except BaseException:
            stop()
            raise


def _each_done(
    submit: Callable[[T], Future[R]], waiting: deque[tuple[int, T]], most: int,
    running: dict[Future[R], int], look: Callable[[], None] = lambda: None,
) -> Iterator[tuple[int, Future[R]]]:
    """Work the queue off, at most `most` at a time, and `look` now and then meanwhile."""
    while waiting or running:
        while waiting and len(running) < most:
            k, task = waiting[0]
            running[submit(task)] = k
            waiting.popleft()
        for done in wait(running, _LOOK, FIRST_COMPLETED).done:
            yield running[done], done
            del running[done]
        look()


# --- The workers of a dask cluster.

_CONNECTING = "10s"
_LOOK = 2.0  # s


def over_cluster(
    work: Callable[[T], R], tasks: Sequence[T], address: str, patience: float = 60.0
) -> Done[R]:
    """Do the tasks on the workers of the dask scheduler at `address`.

    The workers have this package installed and see files under the same paths. What a lost worker
    was doing is done again by another one.

    Args:
        work: of a module, so that the workers find it.
        patience: s without any worker after which it gives up.

    Raises:
        InputError: dask.distributed is not installed, no scheduler answers or is lost, there are no
            workers, they have another version of this package, or `work` has raised anything.
    """
    with _client(address) as client:
        cluster = _Cluster(client, f"dask scheduler {address}", patience)
        cluster.check_versions()
        executor = client.get_executor(pure=False)  # what a path holds may have changed
        try:
            queue, most = deque(enumerate(tasks)), max(len(tasks), 1)
            for k, done in _each_done(
                lambda task: executor.submit(work, task), queue, most, {}, cluster.look
            ):
                yield k, cluster.result(done)
        finally:
            executor.shutdown(wait=False)  # cancels what has not begun


@contextmanager
def _client(address: str) -> Iterator[Any]:
    try:
        import distributed
    except ImportError:
        raise InputError(
            "a cluster needs dask.distributed, which is not installed: pip install distributed"
        ) from None
    logging.disable()  # what goes wrong is said in one line; their own accounts of it have hundreds
    try:
        client = distributed.Client(address, timeout=_CONNECTING, set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(f"dask scheduler {address}: cannot be reached: {reason}") from None
    else:
        with client:
            yield client
    finally:
        logging.disable(logging.NOTSET)


class _Cluster:
    def __init__(self, client: Any, name: str, patience: float) -> None:
        self._client, self._name, self._patience = client, name, patience
        self._looked = self._seen = time.monotonic()

    def check_versions(self) -> None:
        """Raises InputError: a worker has another version, which might answer otherwise."""
        for worker, version in self._client.run(_version, on_error="return").items():
            if version != VERSION:
                found = " ".join(str(version).split())
                raise InputError(
                    f"dask worker {worker}: sma_bench {found}, expected {VERSION}"
                )

    def look(self) -> None:
        """Raises InputError: nobody is left to do the work."""
        now = time.monotonic()
        if now - self._looked < _LOOK:
            return
        self._looked = now
        try:
            workers = self._client.ncores()
        except OSError:
            raise InputError(f"{self._name}: lost") from None
        if workers:
            self._seen = now
        elif now - self._seen > self._patience:
            raise InputError(f"{self._name}: no workers for {self._patience:g} s")

    def result(self, done: Future[R]) -> R | Lost:
        """Raises InputError: the scheduler is lost, or the work has raised anything."""
        try:
            return done.result()
        except CancelledError:
            raise InputError(f"{self._name}: lost") from None
        except InputError:
            raise
        except Exception as error:
            if type(error).__name__ == "KilledWorker":
                return Lost(_KILLED)
            reason = " ".join(f"{type(error).__name__}: {error}".split())
            raise InputError(f"{self._name}: {reason}") from error


def _version() -> str:
    return VERSION


# --- Processes of this machine.


class WorkerPool:
    """Processes of this machine, as a context: left by an exception, it ends what still runs.

    Ctrl-C, a polite kill and a stop of the caller come as an exception; where the caller is killed
    outright, its processes notice.
    """

    def __init__(self, jobs: int) -> None:
        self._others = set(multiprocessing.active_children())
        context = multiprocessing.get_context("spawn")
        self._pool = ProcessPoolExecutor(jobs, mp_context=context, initializer=_begin_worker)

    def __enter__(self) -> "WorkerPool":
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is not None:
            for process in set(multiprocessing.active_children()) - self._others:
                process.terminate()
        self._pool.shutdown(wait=True, cancel_futures=True)

    def submit(self, work: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        """Have a process do it, as soon as one is free."""
        with interrupts_held():  # a process that just begins would answer with a traceback
            return self._pool.submit(work, *args, **kwargs)


@contextmanager
def interrupts_held() -> Iterator[None]:
    """Ctrl-C and a polite kill wait until the end, and a process that is started meanwhile never
    hears of Ctrl-C, which reaches the whole group and is for the parent to act upon."""
    arrived: list[int] = []
    handlers = {}
    if threading.current_thread() is threading.main_thread():  # no other is ever interrupted
        for number in (signal.SIGINT, signal.SIGTERM):
            handlers[number] = signal.signal(number, lambda number, _: arrived.append(number))
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        for number, handler in handlers.items():
            signal.signal(number, handler)
        for held in arrived:
            signal.raise_signal(held)


def _begin_worker() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None and parent.pid is not None:
        end_after(parent.pid)
