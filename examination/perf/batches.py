"""A batch over the cores of this machine and over a local dask cluster; what a thousand cost."""

import os
import time
from collections.abc import Iterable
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from examination.perf.figures import Figure, Outcome, Skipped, at_least, at_most
from examination.perf.timing import exponent
from examination.perf.whole_commands import diagnosis_case, staircase_signals
from sma_bench.parameters import Parameters, read_parameters
from sma_bench.records.bag_writer import write_record
from sma_bench.tasks.batch import DIAGNOSE, IDENTIFY, Task, do_tasks
from sma_bench.tasks.batch import Outcome as Done

BAGS, DIAGNOSES = 200, 4
_DURATION = 300.0  # s, of each
_GAIN = 0.95  # of the cores
_CLUSTERS = (16, 64)
_SPIN = 15_000_000


def measure(tiny: bool = False) -> list[Outcome]:
    """Identifications and diagnoses, on one worker and on one a core, here and on a cluster."""
    count, cores = (1 if tiny else BAGS), len(os.sched_getaffinity(0))
    with TemporaryDirectory() as name:
        folder = Path(name)
        bag = folder / "bag"
        write_record(bag, staircase_signals(_DURATION))
        tasks = [Task(IDENTIFY, str(bag), Parameters.of_paper())] * count
        case = f"bags of {_DURATION:g} s identified"
        if tiny:
            one = _spent(do_tasks(tasks, 1))[0]
            return [Figure(case, "one process", count / one, "bags/s")]
        outcomes = [_own_gain(cores), *_growing(case, tasks, cores, folder)]
        gap, paper = diagnosis_case(folder)
        tasks = [Task(DIAGNOSE, str(gap), read_parameters(paper))] * DIAGNOSES
        return outcomes + _growing("composite bags diagnosed", tasks, cores, folder)


def _own_gain(cores: int) -> Figure:
    """What the machine itself gives of several processes, at this hour: no batch has more."""
    context = get_context("spawn")
    with context.Pool(1) as one, context.Pool(cores) as many:
        gains = []
        for pool in (one, many) * 3:
            pool.map(_spin, [1000] * cores)  # has begun
            begin = time.perf_counter()
            pool.map(_spin, [_SPIN // cores] * (2 * cores), chunksize=1)
            gains.append(time.perf_counter() - begin)
    gain = float(np.median(np.array(gains[::2]) / np.array(gains[1::2])))
    return Figure("counting in Python", f"gain of {cores} processes over one", gain, "x")


def _spin(n: int) -> None:
    for _ in range(n):
        pass


def _growing(case: str, tasks: list[Task], cores: int, folder: Path) -> list[Outcome]:
    """More and more on one process, then all on as many as there are cores, then on clusters."""
    sizes = sorted({max(len(tasks) // part, 1) for part in (8, 4, 2, 1)})
    runs = [_spent(do_tasks(tasks[:n], 1)) for n in sizes]
    many = _spent(do_tasks(tasks, cores))
    walls, used = np.array(runs).T
    slope = (used[-1] - used[0]) / (sizes[-1] - sizes[0])
    outcomes: list[Outcome] = [
        Figure(case, f"one process: exponent from {sizes[0]} to {sizes[-1]}",
               exponent(np.array(sizes), used), "", at_most(1.15)),
        Figure(case, f"one process: {len(tasks)} on the wall", walls[-1], "s"),
        Figure(case, f"{cores} processes: {len(tasks)} on the wall", many[0], "s"),
        Figure(case, f"gain of {cores} processes over one", walls[-1] / many[0], "x",
               at_least(_GAIN * cores)),
        Figure(case, "one process: a thousand, processor", 1000.0 * slope, "s"),
        Figure(case, f"{cores} processes: their processor's time, of one's", many[1] / used[-1],
               "x"),
    ]
    return outcomes + _on_clusters(case, tasks, cores, folder, slope)


def _on_clusters(
    case: str, tasks: list[Task], cores: int, folder: Path, alone: float
) -> list[Outcome]:
    """Each worker's first task, which loads what it needs, is not counted."""
    try:
        from distributed import Client, LocalCluster
    except ImportError:
        return [Skipped(f"{case}: dask", "distributed is not installed")]
    outcomes: list[Outcome] = []
    for workers in (1, cores):
        with LocalCluster(
            n_workers=workers, threads_per_worker=1, dashboard_address=None, host="127.0.0.1",
            local_directory=str(folder),
        ) as cluster, Client(cluster.scheduler_address, set_as_default=False) as client:
            address = cluster.scheduler_address
            _spent(do_tasks(tasks[:1] * workers, 1, address))
            before = sum(client.run(time.process_time).values())
            wall = _spent(do_tasks(tasks, 1, address))[0]
            each = (sum(client.run(time.process_time).values()) - before) / len(tasks)
        name = f"dask, {workers} worker{'s' if workers > 1 else ''}"
        outcomes += [
            Figure(case, f"{name}: {len(tasks)} on the wall", wall, "s"),
            Figure(case, f"{name}: a thousand, processor", 1000.0 * each, "s"),
        ]
    outcomes.append(Figure(case, "dask: processor's time of that of a process", each / alone, "x"))
    return outcomes + [
        Figure(case, f"a cluster of {n} free cores: a thousand (extrapolated)",
               1000.0 * each / n / 60.0, "min")
        for n in _CLUSTERS
    ]


def _spent(batch: Iterable[tuple[int, Done]]) -> tuple[float, float]:
    """Seconds on the wall, and of the processors of the processes that it has begun."""
    begin, before = time.perf_counter(), os.times()
    failed = [outcome.error for _, outcome in batch if outcome.error]
    if failed:
        raise RuntimeError(failed[0])
    after = os.times()
    used = after.children_user + after.children_system
    used -= before.children_user + before.children_system
    return time.perf_counter() - begin, used
