"""What the benchmark measures: calls side by side, figures with their limits, tables of them.

What runs in this thread alone is timed by the processor's time it took, which other programs on the
machine hardly touch; what runs on several threads or processes by the clock on the wall.
"""

import gc
import os
import time
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

import sma_bench
from sma_bench.arrays import Array
from sma_bench.parameters import Parameters, read_parameters, write_parameters
from sma_bench.records.bag_writer import write_record
from sma_bench.synthetic.bench_records import protocol_record

LINEAR = 1.15  # exponent: what may be called linear growth


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


def processor_of(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


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


def exponent(sizes: Iterable[float], seconds: Iterable[float]) -> float:
    """Slope of log time over log size: 1 is linear growth."""
    return float(np.polyfit(np.log(list(sizes)), np.log(list(seconds)), 1)[0])


# --- Synthetic records that several sections measure with.
ROOT = Path(__file__).resolve().parents[2]
COMPOSITE = ROOT / "config" / "composite_rig.yaml"
RATE = 100.0  # Hz
TRIANGLES, STEPS = "composite_diagnosis_triangles", "composite_diagnosis_steps"
HIDDEN = {"effect.side_heat_coupling.conductance": 0.03}
# 1 to 5.5 V and back, then 0.
_LEVELS = np.array([1.0, 1.9, 2.8, 3.7, 4.6, 5.5, 5.5, 4.6, 3.7, 2.8, 1.9, 1.0, 0.0])


def staircase_bag(bag: Path, duration: float) -> Path:
    """A wire led up and down a staircase of voltages, 5 s each."""
    time = np.arange(int(duration * RATE)) / RATE
    voltage = _LEVELS[(time / 5.0).astype(int) % _LEVELS.size]
    record = sma_bench.measure(sma_bench.simulate((time, voltage), Parameters.defaults()))
    write_record(bag, list(record.signals.values()))
    return bag


def diagnosis_case(folder: Path) -> tuple[Path, Path]:
    """A composite bag with an effect that its parameter file does not know."""
    paper = read_parameters(COMPOSITE)
    record = protocol_record(STEPS, paper.replace(HIDDEN))
    bag, file = folder / "gap", folder / "paper.yaml"
    write_record(bag, list(record.signals.values()))
    write_parameters(file, paper)
    return bag, file
