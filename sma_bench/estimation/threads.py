"""Simulations side by side: the compiled core lets go of the interpreter's lock."""

import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

T = TypeVar("T")

_THREADS = 2
_WORKER = threading.local()


def in_threads(function: Callable[..., T], arguments: Sequence[tuple[Any, ...]]) -> list[T]:
    """Results in the order of the arguments.

    What such a call calls in its turn runs in the one thread that it has.
    """
    if getattr(_WORKER, "busy", False):
        return [function(*args) for args in arguments]

    def work(args: tuple[Any, ...]) -> T:
        _WORKER.busy = True
        return function(*args)

    with ThreadPoolExecutor(_THREADS) as pool:
        return list(pool.map(work, arguments))
