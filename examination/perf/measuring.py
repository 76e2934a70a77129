"""Figures with their limits, calls timed side by side.

What runs in this thread alone is timed by the processor's time it took, which other programs on the
machine hardly touch; what runs on several threads or processes by the clock on the wall.
"""

import gc
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from sma_bench.arrays import Array

ROOT = Path(__file__).resolve().parents[2]
CONFIG = ROOT / "config"


class Figure(NamedTuple):
    """One number: of which case, what was measured, and what it is to be at least or at most."""

    case: str
    measure: str
    value: float
    unit: str = ""
    least: float = -np.inf
    most: float = np.inf

    @property
    def aim(self) -> str:
        if self.least > -np.inf:
            return f"at least {self.least:g}"
        return f"at most {self.most:g}" if self.most < np.inf else ""

    @property
    def verdict(self) -> str:
        return ("met" if self.least <= self.value <= self.most else "missed") if self.aim else ""


def interleaved(calls: Mapping[str, Callable[[], object]], rounds: int,
                budget: float = np.inf) -> dict[str, Array]:
    """Seconds of every call, (r,) each: `rounds` rounds, fewer (two at least) beyond `budget` s. A
    first round is not counted: it compiles, fills caches, touches memory."""
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
                start = time.process_time()
                call()
                seconds[name].append(time.process_time() - start)
    finally:
        gc.unfreeze()
    return {name: np.array(values) for name, values in seconds.items()}


def ratio(slower: Array, faster: Array) -> float:
    """Median of the rounds' own ratios: what slowed a whole round down drops out."""
    return float(np.median(slower / faster))
