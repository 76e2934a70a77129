"""Work side by side: in threads, as the compiled core lets go of the interpreter's lock, or in a
forked copy of this process, where most of the work is Python's own.
"""

import gc
import os
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from multiprocessing import Pipe, parent_process
from multiprocessing.connection import Connection
from typing import Any, TypeVar

from sma_bench.lifeline import end_after

T = TypeVar("T")

_THREADS = 2
_WORKER = threading.local()
_MOST = 255  # places that a byte can name
_PATIENCE = 300.0  # s after this process is done with its own part


def _as_it_is(result: Any) -> Any:
    return result


def in_threads(function: Callable[..., T], arguments: Sequence[tuple[Any, ...]]) -> list[T]:
    """Results in the order of the arguments.

    What such a call calls in its turn runs in the one thread that it has, and so does all in the
    process of a pool, which has the other cores busy.
    """
    if _has_one_core():
        return [function(*args) for args in arguments]

    def work(args: tuple[Any, ...]) -> T:
        _WORKER.busy = True
        return function(*args)

    with ThreadPoolExecutor(_THREADS) as pool:
        return list(pool.map(work, arguments))


def in_processes(
    function: Callable[..., T], arguments: Sequence[tuple[Any, ...]],
    packed: Callable[[T], Any] = _as_it_is, unpacked: Callable[[Any], T] = _as_it_is,
) -> list[T]:
    """As `in_threads`, on two cores whatever share of the work is Python's.

    A forked copy of this process has everything already; only its results are handed over.
    Whatever it does not deliver is done here, so an error is raised where it can be read. Threads
    do it where a fork could be caught in another thread's lock.

    Args:
        packed: a result without what is large and here as well; unpacked: whole again.
    """
    if _has_one_core() or len(arguments) < 2:
        return [function(*args) for args in arguments]
    if len(arguments) > _MOST or not _may_fork():
        return in_threads(function, arguments)
    queue, fill = os.pipe()
    os.write(fill, bytes(range(len(arguments))))
    os.close(fill)

    def work() -> dict[int, T]:
        _WORKER.busy = True
        try:
            done = {}
            while place := os.read(queue, 1):
                done[place[0]] = function(*arguments[place[0]])
            return done
        finally:
            _WORKER.busy = False

    try:
        with _copy_doing(lambda: {k: packed(one) for k, one in work().items()}) as delivered:
            done = work()
            done |= {k: unpacked(one) for k, one in delivered().items()}
    finally:
        os.close(queue)
    return [
        done[place] if place in done else function(*args) for place, args in enumerate(arguments)
    ]


@contextmanager
def _copy_doing(work: Callable[[], dict[int, Any]]) -> Iterator[Callable[[], dict[int, Any]]]:
    """A forked copy of this process that does `work` meanwhile; what is yielded gets its results,
    none where it was killed, could not be made, or does not answer.

    No signal reaches the copy: what ends this process ends it too.
    """
    results, deliver = Pipe(duplex=False)
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM, signal.SIGHUP})
    own, copy = os.getpid(), 0

    def delivered() -> dict[int, Any]:
        with suppress(EOFError, OSError):  # killed before, or amid, its answer
            if results.poll(_PATIENCE):
                found: dict[int, Any] = results.recv()
                return found
        return {}

    try:
        with suppress(OSError):
            copy = _fork()
            if copy == 0:
                _deliver(work, deliver, own)
        deliver.close()
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        yield delivered
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        results.close()
        if copy:
            with suppress(OSError):
                os.kill(copy, signal.SIGKILL)
                os.waitpid(copy, 0)


def _has_one_core() -> bool:
    return getattr(_WORKER, "busy", False) or parent_process() is not None


def _may_fork() -> bool:
    """Whether this is the main thread and every other one is Python's own, such as draws a bar:
    none of those holds a lock that a simulation needs; of a middleware's threads nothing is
    known."""
    if threading.current_thread() is not threading.main_thread():
        return False
    try:
        return len(os.listdir("/proc/self/task")) == threading.active_count()
    except OSError:
        return False


def _fork() -> int:
    with warnings.catch_warnings():  # of threads: see `_may_fork`
        warnings.simplefilter("ignore", DeprecationWarning)
        return os.fork()


def _deliver(
    work: Callable[[], dict[int, Any]], deliver: Connection, parent: int
) -> None:
    """The forked copy: it works, hands its results over and is gone."""
    try:
        gc.disable()
        sys.stdout = sys.stderr = open(os.devnull, "w")  # noqa: SIM115, of which it has nothing
        end_after(parent, signal.SIGKILL)
        deliver.send(work())
    finally:
        os._exit(0)
