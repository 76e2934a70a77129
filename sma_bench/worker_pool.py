"""A pool of processes that leaves none behind, however the work ends."""

import multiprocessing
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from contextlib import contextmanager
from typing import ParamSpec, TypeVar

from sma_bench.lifeline import end_after

P = ParamSpec("P")
T = TypeVar("T")


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
        with _interrupts_held():  # a process that just begins would answer with a traceback
            return self._pool.submit(work, *args, **kwargs)


@contextmanager
def _interrupts_held() -> Iterator[None]:
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
