"""Speed of whole tasks: reading bags, commands with and without compiled code, long records.

For a command, wall time and CPU time are measured; limits apply to CPU time, which equals wall time
on an idle machine.
"""

import os
import resource
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

import sma_bench
from examination.bags import in_sqlite3
from examination.blind.make import make
from examination.perf.measuring import CONFIG, ROOT, Figure, interleaved, ratio
from sma_bench.parameters import Parameters, read_parameters, write_parameters
from sma_bench.protocols import load_protocol
from sma_bench.records import read_record
from sma_bench.records.bag_writer import TYPES, write_record
from sma_bench.synthetic.bench_records import protocol_record

COMPOSITE = CONFIG / "composite_rig.yaml"
RATE = 100.0  # Hz
LINEAR = 1.15  # largest exponent that counts as linear growth
COMPILING = 22.0  # s, as measured before the diagnosis was made faster
TRIANGLES, STEPS = "composite_diagnosis_triangles", "composite_diagnosis_steps"
HIDDEN = {"effect.side_heat_coupling.conductance": 0.03}
LENGTHS = {"2 minutes": 120.0, "10 minutes": 600.0, "an hour": 3600.0}
LONG = {"10 minutes of triangles": 600.0, "an hour of triangles": 3600.0,
        "8 hours of triangles": 28_800.0}
# Development cases of all forms, with the loads of the frozen set.
SEED, DEALT = 3900, {"beam": 12, "antagonist": 5, "force": 4, "spring": 3}
DURATION, EACH_SECOND = 600.0, 200  # s; messages per second, of power and temperature
# V: 1 to 5.5 and back, then 0.
_LEVELS = np.array([1.0, 1.9, 2.8, 3.7, 4.6, 5.5, 5.5, 4.6, 3.7, 2.8, 1.9, 1.0, 0.0])


def staircase_bag(bag: Path, duration: float) -> Path:
    """A bag of a wire on a staircase of voltages up and down, 5 s each."""
    time = np.arange(int(duration * RATE)) / RATE
    voltage = _LEVELS[(time / 5.0).astype(int) % _LEVELS.size]
    record = sma_bench.measure(sma_bench.simulate((time, voltage), Parameters.defaults()))
    write_record(bag, list(record.signals.values()))
    return bag


def reading(tiny: bool = False) -> Iterator[Figure]:
    """Reading a bag, compared with the usual alternative, message by message."""
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
            bag = staircase_bag(Path(folder, storage), duration)
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


def commands(tiny: bool = False) -> Iterator[Figure]:
    """Help, identification of a short and of a 30-minute bag, diagnosis, a cold start."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        short = staircase_bag(folder / "short", 30.0 if tiny else 60.0)
        words = {"--help": (["--help"], 1.0), "identify --help": (["identify", "--help"], 1.0),
                 "identify a minute's bag": (["identify", str(short)], 2.0)}
        if not tiny:
            long, paper = staircase_bag(folder / "long", 1800.0), read_parameters(COMPOSITE)
            words["identify a 30-minute bag"] = ["identify", str(long)], np.inf
            gap = protocol_record(STEPS, paper.replace(HIDDEN))
            write_record(folder / "gap", list(gap.signals.values()))
            write_parameters(folder / "paper.yaml", paper)
            diagnosis = ["diagnose", str(folder / "gap"), "--params", str(folder / "paper.yaml")]
            words["diagnose a composite bag"] = diagnosis, np.inf
        for case, (command, most) in words.items():
            wall, warm = np.median([run(command) for _ in range(1 if tiny else 4)][-3:], axis=0)
            yield Figure(case, "warm: processor", warm, "s", most=most)
            yield Figure(case, "warm: on the wall", wall, "s")
        if not tiny:  # in a copy of the package without any compiled code
            copy, ignored = folder / "cold", shutil.ignore_patterns("__pycache__")
            shutil.copytree(ROOT / "sma_bench", copy / "sma_bench", ignore=ignored)
            for shared in ("package.xml", "config"):
                (copy / shared).symlink_to(ROOT / shared)
            cache = str(copy / "cache")
            _, cold = run(diagnosis, {"PYTHONPATH": str(copy), "XDG_CACHE_HOME": cache})
            yield Figure(case, "compiling: processor", cold - warm, "s", most=COMPILING)


def run(words: Sequence[str], environment: Mapping[str, str] | None = None) -> tuple[float, float]:
    """Wall and CPU time [s] of `sma-bench words`. RuntimeError: it failed."""
    command, variables = [sys.executable, "-P", "-m", "sma_bench.cli", *words], dict(os.environ)
    variables |= environment or {}
    begin, before = time.perf_counter(), os.times()
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=variables)
    if done.returncode:
        raise RuntimeError(f"{' '.join(words)}: {done.stderr.strip()}")
    return time.perf_counter() - begin, sum(os.times()[2:4]) - sum(before[2:4])


def diagnosis(tiny: bool = False) -> Iterator[Figure]:
    """Diagnoses of development cases of the examination, and of synthetic records in memory."""
    if tiny:
        yield from over_lengths("diagnosis", {"a minute of triangles": 60.0}, TRIANGLES)
        return
    seconds = []
    with TemporaryDirectory() as name:
        for load, n in DEALT.items():
            make(Path(name) / load, SEED, n, load=load)
            for case in sorted((Path(name) / load / "cases").iterdir()):
                record, lab, unseen = case / "record", case / "nominal.yaml", case / "hold_out"
                words = ["diagnose", record, "--params", lab, "--hold-out", unseen]
                seconds.append(run([str(word) for word in words])[0])
    case, last = f"{len(seconds)} development cases", float(np.quantile(seconds, 0.9))
    yield Figure(case, "median command, on the wall", float(np.median(seconds)), "s", most=6.0)
    yield Figure(case, "90th percentile", last, "s", most=10.0)
    yield from over_lengths("diagnosis", LONG, TRIANGLES)
    yield from over_lengths("diagnosis", {"10 minutes of steps": 600.0}, STEPS)


def identification(tiny: bool = False) -> Iterator[Figure]:
    yield from over_lengths("identification", {"a minute": 60.0} if tiny else LENGTHS, TRIANGLES)


def over_lengths(work: str, lengths: Mapping[str, float], protocol: str) -> Iterator[Figure]:
    """Each length (s) in a process of its own, to measure its memory."""
    found = {}
    for name, length in lengths.items():
        with get_context("spawn").Pool(1) as pool:
            wall, cpu, memory = pool.apply(one_length, (work, protocol, length))
        most = 6.0 if (work, length) == ("diagnosis", 600.0) else np.inf
        yield Figure(f"{name} at 100 Hz", f"{work}: on the wall", wall, "s", most=most)
        yield Figure(f"{name} at 100 Hz", f"{work}: processor", cpu, "s")
        yield Figure(f"{name} at 100 Hz", "largest memory", memory, "MB")
        if length >= 600.0:
            found[length] = cpu, memory
    if len(found) > 1:
        slopes = np.polyfit(np.log(list(found)), np.log(list(found.values())), 1)[0]
        for name, slope in zip(("processor", "memory"), slopes, strict=True):
            span = f"{name}: exponent from {min(found):g} to {max(found):g} s"
            yield Figure(f"{work} over the length", span, slope, most=LINEAR)


def one_length(work: str, protocol: str, length: float) -> tuple[float, float, float]:
    """Wall and CPU time [s] and memory [MB] for a protocol repeated to this length."""
    lab = read_parameters(COMPOSITE)
    once = load_protocol(protocol, lab).sample(1.0 / RATE)[1]
    clock = np.arange(int(length * RATE)) / RATE
    volts = np.take(once, np.arange(clock.size), axis=0, mode="wrap")
    record = sma_bench.measure(sma_bench.simulate((clock, volts), lab.replace(HIDDEN)))
    begin, before = time.perf_counter(), sum(os.times()[:4])
    if work == "diagnosis":
        sma_bench.diagnose([record], lab)
    else:
        sma_bench.identify([record], lab, ["E10"])
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    return time.perf_counter() - begin, sum(os.times()[:4]) - before, memory
