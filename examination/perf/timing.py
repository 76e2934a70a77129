"""Times side by side: every call in turn, round after round, so that a busy machine slows all.

What runs in this thread alone is timed by the processor's time it took, which other programs on the
machine hardly touch; what runs on several threads or processes by the clock on the wall.
"""

import gc
import os
import resource
import time
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

Array = np.ndarray


def processor() -> float:
    """Seconds of the processor that this process and those that it has waited for have had."""
    had = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(one.ru_utime + one.ru_stime for one in had)


def processor_of(pid: int) -> float:
    """Seconds of the processor that another process has had."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def interleaved(
    calls: Mapping[str, Callable[[], object]], rounds: int, budget: float = np.inf,
    clock: Callable[[], float] = time.process_time,
) -> dict[str, Array]:
    """Seconds of every call, (r,) each: `rounds` rounds, fewer (two at least) beyond `budget` s.

    A first round is not counted: it compiles, fills caches, touches memory.
    """
    for call in calls.values():
        call()
    seconds: dict[str, list[float]] = {name: [] for name in calls}
    begin = time.perf_counter()
    gc.freeze()  # what was there before is no garbage, and takes longer to look through than a call
    try:
        for k in range(rounds):
            if k >= 2 and time.perf_counter() - begin > budget:
                break
            for name, call in calls.items():
                gc.collect()
                start = clock()
                call()
                seconds[name].append(clock() - start)
    finally:
        gc.unfreeze()
    return {name: np.array(values) for name, values in seconds.items()}


def ratio(slower: Array, faster: Array) -> float:
    """Median of the rounds' own ratios: what slowed a whole round down drops out."""
    return float(np.median(slower / faster))


def exponent(sizes: Array, seconds: Array) -> float:
    """Slope of log time over log size: 1 is linear growth."""
    return float(np.polyfit(np.log(sizes), np.log(seconds), 1)[0])
