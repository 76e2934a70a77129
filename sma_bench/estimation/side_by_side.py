"""Work side by side in threads: the compiled core lets go of the interpreter's lock, and most of a
fit is the core's. One level of it: what a thread calls runs in that thread.
"""

import os
import sys
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from multiprocessing import parent_process
from typing import Any, TypeVar

T = TypeVar("T")

_THREADS = 2
_WORKER = threading.local()
# s, for which a thread may keep the interpreter from one that comes back from the core after some
# tenths of a millisecond; Python's own is 5 ms.
_SWITCH = 2e-4


def in_threads(function: Callable[..., T], arguments: Sequence[tuple[Any, ...]]) -> list[T]:
    """Results in the order of the arguments, the first error raised."""
    if not threads_to_spare() or len(arguments) < 2:
        return [function(*args) for args in arguments]

    def work(args: tuple[Any, ...]) -> T:
        _WORKER.busy = True
        return function(*args)

    before = sys.getswitchinterval()
    sys.setswitchinterval(_SWITCH)
    try:
        with ThreadPoolExecutor(_THREADS) as pool:
            return list(pool.map(work, arguments))
    finally:
        sys.setswitchinterval(before)


def threads_to_spare() -> int:
    """How many run side by side; none within such work, and in a process of a pool, which has the
    other cores busy."""
    busy = getattr(_WORKER, "busy", False) or parent_process() is not None
    return 0 if busy or os.environ.get("NUMBA_NUM_THREADS") == "1" else _THREADS
