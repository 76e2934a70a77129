"""A batch of bags over the cores of this machine, and over a local dask cluster."""

import os
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from figures import Figure, Outcome, Skipped, at_most
from timing import exponent
from whole_commands import staircase_signals

from sma_bench.parameters import Parameters
from sma_bench.records.write import write_record
from sma_bench.tasks.batch import IDENTIFY, Task, do_tasks

BAGS = 200
_DURATION = 300.0  # s, of each


def measure(tiny: bool = False) -> list[Outcome]:
    """Bags a second on one process, on one a core, and on as many workers of a cluster."""
    count, cores = (2 if tiny else BAGS), len(os.sched_getaffinity(0))
    case = f"{count} bags of {_DURATION:g} s identified"
    with TemporaryDirectory() as folder:
        bag = Path(folder, "bag")
        write_record(bag, staircase_signals(_DURATION))
        tasks = [Task(IDENTIFY, str(bag), Parameters.defaults())] * count
        one = _seconds(lambda: do_tasks(tasks, 1))
        outcomes: list[Outcome] = [Figure(case, "one process", count / one, "bags/s")]
        if tiny:
            return outcomes
        sizes = np.array([count // 8, count // 4, count // 2, count])
        fewer = [_seconds(lambda n=n: do_tasks(tasks[:n], 1)) for n in sizes[:-1].tolist()]
        growth = exponent(sizes, np.array([*fewer, one]))
        what = f"one process: exponent from {sizes[0]} to {count} bags"
        outcomes.append(Figure(case, what, growth, "", at_most(1.15)))
        many = _seconds(lambda: do_tasks(tasks, cores))
        outcomes += [
            Figure(case, f"{cores} processes", count / many, "bags/s"),
            Figure(case, f"gain of {cores} processes over one", one / many, "x",
                   ("least", 0.85 * cores)),
        ]
        return outcomes + _on_dask(case, tasks, cores, many, folder)


def _on_dask(
    case: str, tasks: list[Task], cores: int, processes: float, folder: str
) -> list[Outcome]:
    try:
        from distributed import LocalCluster
    except ImportError:
        return [Skipped("dask", "distributed is not installed")]
    with LocalCluster(
        n_workers=cores, threads_per_worker=1, dashboard_address=None, host="127.0.0.1",
        local_directory=folder,
    ) as cluster:
        address = cluster.scheduler_address
        spread = _seconds(lambda: do_tasks(tasks, 1, address))
    return [
        Figure(case, f"dask, {cores} local workers", len(tasks) / spread, "bags/s"),
        Figure(case, "dask: times the time of processes", spread / processes, "x"),
    ]


def _seconds(batch: Callable[[], Iterable]) -> float:
    begin = time.perf_counter()
    failed = [outcome.error for _, outcome in batch() if outcome.error]
    if failed:
        raise RuntimeError(failed[0])
    return time.perf_counter() - begin
