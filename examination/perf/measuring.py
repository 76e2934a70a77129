"""Figures with their limits; timing of calls in alternation.

Work in this thread alone is timed by its CPU time, which other programs hardly affect; work in
several threads or processes by wall time.
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
    """One number: the case, what was measured, and its lower or upper limit."""

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
    """Seconds of every call, (r,) each, in `rounds` rounds; fewer (at least two) beyond `budget` s.
    An extra first round is not counted: it compiles and fills caches."""
    for call in calls.values():
        call()
    seconds: dict[str, list[float]] = {name: [] for name in calls}
    begin = time.perf_counter()
    gc.freeze()  # collecting the existing objects would take longer than a call
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
    """Median of the ratios of the rounds: a disturbance that slows a whole round cancels."""
    return float(np.median(slower / faster))
