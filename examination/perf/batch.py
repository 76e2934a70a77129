"""A batch over the cores of this machine and over a local dask cluster; what a thousand cost."""

import os
import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

from distributed import Client, LocalCluster

from examination.perf.measuring import LINEAR, Figure, exponent
from examination.perf.records import diagnosis_case, staircase_bag
from sma_bench.parameters import Parameters, read_parameters
from sma_bench.tasks.batch import DIAGNOSE, IDENTIFY, Outcome, Task, do_tasks

BAGS, DIAGNOSES = 200, 4
_DURATION = 300.0  # s, of each
_GAIN = 0.95  # of the cores
_FREE_CORES = (16, 64)  # of a cluster


def batch(tiny: bool = False) -> Iterator[Figure]:
    """Identifications and diagnoses, on one worker and on one a core, here and on a cluster."""
    with TemporaryDirectory() as name:
        bag = staircase_bag(Path(name, "bag"), _DURATION)
        tasks = [Task(IDENTIFY, str(bag), Parameters.of_paper())] * (1 if tiny else BAGS)
        case = f"bags of {_DURATION:g} s identified"
        if tiny:
            yield Figure(case, "one process", 1.0 / _spent(do_tasks(tasks, 1))[0], "bags/s")
            return
        yield from _growing(case, tasks, Path(name))
        gap, paper = diagnosis_case(Path(name))
        tasks = [Task(DIAGNOSE, str(gap), read_parameters(paper))] * DIAGNOSES
        yield from _growing("composite bags diagnosed", tasks, Path(name))


def _growing(case: str, tasks: list[Task], folder: Path) -> Iterator[Figure]:
    """More and more on one process, then all on as many as there are cores, then on clusters."""
    cores, all_of = len(os.sched_getaffinity(0)), f"{len(tasks)} on the wall"
    sizes = sorted({max(len(tasks) // part, 1) for part in (8, 4, 2, 1)})
    walls, used = zip(*(_spent(do_tasks(tasks[:n], 1)) for n in sizes), strict=True)
    many, _ = _spent(do_tasks(tasks, cores))
    alone = (used[-1] - used[0]) / (sizes[-1] - sizes[0])
    growth, what = exponent(sizes, used), f"one process: exponent from {sizes[0]} to {sizes[-1]}"
    yield Figure(case, what, growth, most=LINEAR)
    yield Figure(case, f"one process: {all_of}", walls[-1], "s")
    yield Figure(case, f"{cores} processes: {all_of}", many, "s")
    gain, what = walls[-1] / many, f"gain of {cores} processes over one"
    yield Figure(case, what, gain, "x", least=_GAIN * cores)
    yield Figure(case, "one process: a thousand, processor", 1000.0 * alone, "s")

    options = {"threads_per_worker": 1, "dashboard_address": None, "host": "127.0.0.1"}
    for n in (1, cores):
        with (
            LocalCluster(n_workers=n, local_directory=str(folder), **options) as cluster,
            Client(cluster.scheduler_address, set_as_default=False) as client,
        ):
            address = cluster.scheduler_address
            # Each worker's first task, which loads what it needs, is not counted.
            _spent(do_tasks(tasks[:1] * n, 1, address))
            before = sum(client.run(time.process_time).values())
            wall = _spent(do_tasks(tasks, 1, address))[0]
            each = (sum(client.run(time.process_time).values()) - before) / len(tasks)
        name = f"dask, {n} worker{'s' if n > 1 else ''}"
        yield Figure(case, f"{name}: {all_of}", wall, "s")
        yield Figure(case, f"{name}: a thousand, processor", 1000.0 * each, "s")
    yield Figure(case, "dask: processor's time of that of a process", each / alone, "x")
    for n in _FREE_CORES:
        what = f"a cluster of {n} free cores: a thousand (extrapolated)"
        yield Figure(case, what, 1000.0 * each / n / 60.0, "min")


def _spent(batch: Iterable[tuple[int, Outcome]]) -> tuple[float, float]:
    """Seconds on the wall, and of the processors of the processes that it has begun."""
    begin, before = time.perf_counter(), os.times()
    failed = [outcome.error for _, outcome in batch if outcome.error]
    if failed:
        raise RuntimeError(failed[0])
    after = os.times()
    used = after.children_user + after.children_system
    used -= before.children_user + before.children_system
    return time.perf_counter() - begin, used
