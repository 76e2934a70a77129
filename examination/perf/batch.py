"""A batch over the cores of this machine; what a thousand cost."""

import os
import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

from examination.perf.measuring import LINEAR, Figure, exponent
from examination.perf.records import diagnosis_case, staircase_bag
from sma_bench.parameters import Parameters, read_parameters
from sma_bench.tasks.batch import DIAGNOSE, IDENTIFY, Outcome, Task, do_tasks

BAGS, DIAGNOSES = 200, 4
_DURATION = 300.0  # s, of each
_GAIN = 0.95  # of the cores


def batch(tiny: bool = False) -> Iterator[Figure]:
    """Identifications and diagnoses, on one process and on one a core."""
    with TemporaryDirectory() as name:
        bag = staircase_bag(Path(name, "bag"), _DURATION)
        tasks = [Task(IDENTIFY, str(bag), Parameters.of_paper())] * (1 if tiny else BAGS)
        case = f"bags of {_DURATION:g} s identified"
        if tiny:
            yield Figure(case, "one process", 1.0 / _spent(do_tasks(tasks, 1))[0], "bags/s")
            return
        yield from _growing(case, tasks)
        gap, paper = diagnosis_case(Path(name))
        tasks = [Task(DIAGNOSE, str(gap), read_parameters(paper))] * DIAGNOSES
        yield from _growing("composite bags diagnosed", tasks)


def _growing(case: str, tasks: list[Task]) -> Iterator[Figure]:
    """More and more on one process, then all on as many as there are cores."""
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
