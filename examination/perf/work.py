"""Whole work: commands cold (nothing compiled) and warm, records of minutes to hours, batches.

A command has the time on the wall and the processor's; the limits are held against the second,
which is the first on a machine that does nothing else.
"""

import os
import resource
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

import sma_bench
from examination.bags import in_sqlite3
from examination.blind.make import make
from examination.perf import measuring
from examination.perf.measuring import LINEAR, Figure, exponent, interleaved, ratio
from sma_bench.diagnose import diagnose
from sma_bench.identify import identify
from sma_bench.parameters import Parameters, read_parameters
from sma_bench.protocols import load_protocol
from sma_bench.records import read_record
from sma_bench.records.bag_writer import TYPES
from sma_bench.tasks.batch import DIAGNOSE, IDENTIFY, Outcome, Task, do_tasks

COMPILING = 22.0  # s, what it took before the diagnosis was made faster
LENGTHS = {"2 minutes": 120.0, "10 minutes": 600.0, "an hour": 3600.0}
# Cases of all forms, loads as the frozen set has them; every third is run in other ways as well.
SEED, DEALT, FEW = 3900, {"beam": 12, "antagonist": 5, "force": 4, "spring": 3}, 3
LONG = {"10 minutes of triangles": 600.0, "an hour of triangles": 3600.0,
        "8 hours of triangles": 28_800.0}
WORK = {"identification": lambda record, lab: identify([record], lab, experiments=["E10"]),
        "diagnosis": lambda record, lab: diagnose([record], lab)}  # fmt: skip
BAGS, DIAGNOSES = 200, 4
_DURATION = 300.0  # s, of each
_GAIN = 0.95  # of the cores


def commands(tiny: bool = False) -> Iterator[Figure]:
    """Help, identification of a short and of a 30-minute bag, diagnosis, a cold start."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        short = measuring.staircase_bag(folder / "short", 30.0 if tiny else 60.0)
        commands = {"--help": ["--help"], "identify --help": ["identify", "--help"],
                    "identify a minute's bag": ["identify", str(short)]}  # fmt: skip
        most = dict(zip(commands, (1.0, 1.0, 2.0), strict=True))
        if not tiny:
            gap, paper = map(str, measuring.diagnosis_case(folder))
            long = measuring.staircase_bag(folder / "long", 1800.0)
            commands["identify a 30-minute bag"] = ["identify", str(long)]
            commands["diagnose a composite bag"] = ["diagnose", gap, "--params", paper]
        for case, words in commands.items():
            wall, warm = np.median([run(words) for _ in range(1 if tiny else 4)][-3:], axis=0)
            yield Figure(case, "warm: processor", warm, "s", most=most.get(case, np.inf))
            yield Figure(case, "warm: on the wall", wall, "s")
            if not tiny and "--help" not in words:
                wall, cold = _cold(folder / "cold", words)
                yield Figure(case, "cold: processor", cold, "s")
                yield Figure(case, "cold: on the wall", wall, "s")
        if not tiny:
            yield Figure(case, "compiling: processor", cold - warm, "s", most=COMPILING)


def run(words: Sequence[str], environment: Mapping[str, str] | None = None) -> tuple[float, float]:
    """s on the wall and of the processor for `sma-bench words`; raises RuntimeError if it fails."""
    command = [sys.executable, "-P", "-m", "sma_bench.cli", *words]
    variables = {**os.environ, **(environment or {})}

    def work() -> str:
        done = subprocess.run(command, capture_output=True, text=True, check=False, env=variables)
        return f"{' '.join(words)}: {done.stderr.strip()}" if done.returncode else ""

    return spent(work)


def spent(work: Callable[[], str]) -> tuple[float, float]:
    """s on the wall and of processes begun; RuntimeError with what `work` says went wrong."""
    begin, before = time.perf_counter(), os.times()
    if failed := work():
        raise RuntimeError(failed)
    used = sum(os.times()[2:4]) - sum(before[2:4])
    return time.perf_counter() - begin, used


def _cold(copy: Path, words: Sequence[str]) -> tuple[float, float]:
    """From a copy of the package in which nothing has been compiled yet."""
    shutil.rmtree(copy, ignore_errors=True)
    ignored = shutil.ignore_patterns("__pycache__")
    shutil.copytree(Path(sma_bench.__file__).parent, copy / "sma_bench", ignore=ignored)
    for shared in ("package.xml", "config"):
        (copy / shared).symlink_to(measuring.ROOT / shared)
    return run(words, {"PYTHONPATH": str(copy), "XDG_CACHE_HOME": str(copy / "cache")})


def identification(tiny: bool = False) -> Iterator[Figure]:
    yield from over_lengths("identification", {"a minute": 60.0} if tiny else LENGTHS,
                            measuring.TRIANGLES)


def diagnosis(tiny: bool = False) -> Iterator[Figure]:
    """Of cases of the examination's development split, and of synthetic records in memory."""
    if tiny:
        yield from over_lengths("diagnosis", {"a minute of triangles": 60.0}, measuring.TRIANGLES)
        return
    seconds, alone, later = [], [], []
    with TemporaryDirectory() as name:
        for load, n in DEALT.items():
            make(Path(name) / load, SEED, n, load=load)
        cases = [c for load in DEALT for c in sorted((Path(name) / load / "cases").iterdir())]
        for k, case in enumerate(cases):
            record, lab, unseen = (case / n for n in ("record", "nominal.yaml", "hold_out"))
            words = ["diagnose", *map(str, (record, "--params", lab, "--hold-out", unseen))]
            seconds.append(run(words)[0])
            if k % FEW == 0:
                alone.append(run(words, {"NUMBA_NUM_THREADS": "1"})[0] / seconds[-1])
                begun = time.perf_counter()
                diagnose([read_record(record)], read_parameters(lab), [read_record(unseen)])
                later.append(time.perf_counter() - begun)
    case, last = f"{len(cases)} development cases", float(np.quantile(seconds, 0.9))
    yield Figure(case, "median command, on the wall", float(np.median(seconds)), "s", most=6.0)
    yield Figure(case, "90th percentile", last, "s", most=10.0)
    beams = float(np.median(seconds[: DEALT["beam"]]))
    yield Figure(f"{DEALT['beam']} of them, beams", "median command, on the wall", beams, "s")
    case, wall = f"{len(alone)} of them", float(np.median(later[1:]))
    yield Figure(case, "second and later in one process", wall, "s", most=4.0)
    yield Figure(case, "one thread over two", float(np.median(alone)), "x")
    yield from over_lengths("diagnosis", LONG, measuring.TRIANGLES)
    yield from over_lengths("diagnosis", {"10 minutes of steps": 600.0}, measuring.STEPS)


def over_lengths(work: str, lengths: Mapping[str, float], protocol: str) -> Iterator[Figure]:
    """Each length (s) in a process of its own, whose memory is then its own."""
    found = {}
    for name, length in lengths.items():
        command = [sys.executable, __file__, work, protocol, str(length)]
        said = subprocess.run(command, capture_output=True, text=True, check=True).stdout
        wall, cpu, memory = map(float, said.split())
        most = 6.0 if (work, length) == ("diagnosis", 600.0) else np.inf
        yield Figure(f"{name} at 100 Hz", f"{work}: on the wall", wall, "s", most=most)
        yield Figure(f"{name} at 100 Hz", f"{work}: processor", cpu, "s")
        yield Figure(f"{name} at 100 Hz", "largest memory", memory, "MB")
        if length >= 600.0:
            found[length] = cpu, memory
    if len(found) > 1:
        (first, last), what = (min(found), max(found)), ("processor", "memory")
        for name, values in zip(what, zip(*found.values(), strict=True), strict=True):
            span = f"{name}: exponent from {first:g} to {last:g} s"
            yield Figure(f"{work} over the length", span, exponent(found, values), most=LINEAR)


def batch(tiny: bool = False) -> Iterator[Figure]:
    """Identifications and diagnoses, on one process and on one a core."""
    with TemporaryDirectory() as name:
        bag = measuring.staircase_bag(Path(name, "bag"), _DURATION)
        tasks = [Task(IDENTIFY, str(bag), Parameters.of_paper())] * (1 if tiny else BAGS)
        case = f"bags of {_DURATION:g} s identified"
        if tiny:
            yield Figure(case, "one process", 1.0 / _spent(do_tasks(tasks, 1))[0], "bags/s")
            return
        yield from _growing(case, tasks)
        gap, paper = measuring.diagnosis_case(Path(name))
        tasks = [Task(DIAGNOSE, str(gap), read_parameters(paper))] * DIAGNOSES
        yield from _growing("composite bags diagnosed", tasks)


def _growing(case: str, tasks: list[Task]) -> Iterator[Figure]:
    """More and more on one process, then all on as many as there are cores."""
    cores, all_of = len(os.sched_getaffinity(0)), f"{len(tasks)} on the wall"
    sizes = sorted({max(len(tasks) // part, 1) for part in (8, 4, 2, 1)})
    walls, used = zip(*(_spent(do_tasks(tasks[:n], 1)) for n in sizes), strict=True)
    many, _ = _spent(do_tasks(tasks, cores))
    alone = (used[-1] - used[0]) / (sizes[-1] - sizes[0])
    yield Figure(case, f"one process: exponent from {sizes[0]} to {sizes[-1]}",
                 exponent(sizes, used), most=LINEAR)
    yield Figure(case, f"one process: {all_of}", walls[-1], "s")
    yield Figure(case, f"{cores} processes: {all_of}", many, "s")
    yield Figure(case, f"gain of {cores} processes over one", walls[-1] / many, "x",
                 least=_GAIN * cores)
    yield Figure(case, "one process: a thousand, processor", 1000.0 * alone, "s")


def _spent(batch: Iterable[tuple[int, Outcome]]) -> tuple[float, float]:
    return spent(lambda: max((outcome.error for _, outcome in batch), default=""))


# --- Reading a bag beside what one would pick instead, message by message.
DURATION, EACH_SECOND = 600.0, 200  # s; messages of power and temperature


def reading(tiny: bool = False) -> Iterator[Figure]:
    from mcap_ros2.reader import read_ros2_messages
    from rosbags.rosbag2 import Reader

    def rosbags(bag: Path) -> int:
        with Reader(bag) as reader:
            messages = reader.messages(reader.connections)
            decoded = (TYPES.deserialize_cdr(data, c.msgtype) for c, _, data in messages)
            return sum(message is not None for message in decoded)

    def mcap_ros2(path: Path) -> int:
        return sum(message.ros_msg is not None for message in read_ros2_messages(str(path)))

    duration = 20.0 if tiny else DURATION
    messages = round(EACH_SECOND * duration)
    for storage in ("mcap", "sqlite3"):
        with TemporaryDirectory() as folder:
            bag = measuring.staircase_bag(Path(folder, storage), duration)
            calls = {"ours": partial(read_record, bag), "rosbags": partial(rosbags, bag)}
            if storage == "sqlite3":
                in_sqlite3(bag)
            else:
                calls["mcap-ros2-support"] = partial(mcap_ros2, next(bag.glob("*.mcap")))
            seconds = interleaved(calls, 2 if tiny else 5, budget=30.0)
        case, ours = f"{storage}, {messages:,} messages", seconds.pop("ours")
        yield Figure(case, "messages a second", messages / float(np.median(ours)), "1/s")
        for name, taken in seconds.items():
            yield Figure(case, f"{name}: times slower", ratio(taken, ours), "x", least=1.5)


if __name__ == "__main__":
    work_, protocol_, length_ = sys.argv[1:]
    lab_ = read_parameters(measuring.COMPOSITE)
    # The protocol again and again, in memory.
    once_ = load_protocol(protocol_, lab_).sample(1.0 / measuring.RATE)[1]
    clock_ = np.arange(int(float(length_) * measuring.RATE)) / measuring.RATE
    volts_ = np.take(once_, np.arange(clock_.size), axis=0, mode="wrap")
    run_ = sma_bench.simulate((clock_, volts_), lab_.replace(measuring.HIDDEN))
    record_ = sma_bench.measure(run_)
    begin_, before_ = time.perf_counter(), sum(os.times()[:4])
    WORK[work_](record_, lab_)
    memory_ = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    print(time.perf_counter() - begin_, sum(os.times()[:4]) - before_, memory_)
