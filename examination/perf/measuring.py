"""What the benchmark measures: calls side by side, figures with their limits, tables of them.

What runs in this thread alone is timed by the processor's time it took, which other programs on the
machine hardly touch; what runs on several threads or processes by the clock on the wall.
"""

import gc
import os
import resource
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

Array = np.ndarray
_WIDE = 140
LINEAR = 1.15  # exponent: what may be called linear growth


@dataclass(frozen=True)
class Figure:
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
        reached = self.least <= self.value <= self.most
        return {True: "met", False: "missed"}[reached] if self.aim else ""


def print_section(name: str, figures: Iterable[Figure], seconds: float, missing: str) -> None:
    """The figures of a section as a table, and why it is not complete."""
    console = Console(highlight=False, width=max(_WIDE, Console().width))
    table = Table(title=f"{name} ({seconds:.0f} s)", title_justify="left", box=None, pad_edge=False)
    for heading in ("case", "measure", "value", "unit", "aim", ""):
        table.add_column(heading, justify="right" if heading == "value" else "left", no_wrap=True)
    for f in figures:
        table.add_row(f.case, f.measure, f"{f.value:.3g}", f.unit, f.aim, f.verdict)
    console.print(table)
    if missing:
        console.print(f"not measured: {missing}", soft_wrap=True)
    console.print()


def as_json(figures: Iterable[Figure], missing: str) -> dict[str, Any]:
    """A section; a value that is not finite is null."""
    rows = []
    for f in figures:
        value = float(f.value) if np.isfinite(f.value) else None
        numbers = {"value": value, "unit": f.unit, "aim": f.aim, "verdict": f.verdict}
        rows.append({"case": f.case, "measure": f.measure, **numbers})
    return {"figures": rows, "missing": missing}


def processor() -> float:
    """Seconds of the processor that this process and those that it has waited for have had."""
    had = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(one.ru_utime + one.ru_stime for one in had)


def processor_of(pid: int) -> float:
    """Seconds of the processor that another process has had."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def interleaved(
    calls: Mapping[str, Callable[[], object]],
    rounds: int,
    budget: float = np.inf,
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


def exponent(sizes: Iterable[float], seconds: Iterable[float]) -> float:
    """Slope of log time over log size: 1 is linear growth."""
    return float(np.polyfit(np.log(list(sizes)), np.log(list(seconds)), 1)[0])
