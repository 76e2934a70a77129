"""Identification of a whole bench (E10), and diagnosis: over the record's length, and of cases."""

import resource
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from examination.blind.make import make
from examination.perf.commands import run
from examination.perf.measuring import LINEAR, Figure, exponent, processor
from examination.perf.records import COMPOSITE, STEPS, TRIANGLES, long_record
from sma_bench.diagnose import diagnose
from sma_bench.identify import identify
from sma_bench.parameters import read_parameters

LENGTHS = {"2 minutes": 120.0, "10 minutes": 600.0, "an hour": 3600.0}
CASES = 24
LONG = {
    "10 minutes of triangles": 600.0,
    "an hour of triangles": 3600.0,
    "8 hours of triangles": 28_800.0,
}
WORK = {
    "identification": lambda record, lab: identify([record], lab, experiments=["E10"]),
    "diagnosis": lambda record, lab: diagnose([record], lab),
}


def identification(tiny: bool = False) -> Iterator[Figure]:
    yield from over_lengths("identification", {"a minute": 60.0} if tiny else LENGTHS, TRIANGLES)


def diagnosis(tiny: bool = False) -> Iterator[Figure]:
    """Of cases of the examination's development split, and of synthetic records in memory."""
    if tiny:
        yield from over_lengths("diagnosis", {"a minute of triangles": 60.0}, TRIANGLES)
        return
    seconds = []
    with TemporaryDirectory() as name:
        made = Path(name) / "cases"
        make(made, 1000, CASES)
        for case in sorted((made / "cases").iterdir()):
            words = [case / "record", "--params", case / "nominal.yaml"]
            words += ["--hold-out", case / "hold_out"]
            seconds.append(run(["diagnose", *map(str, words)])[0])
    case, last = f"{CASES} development cases", float(np.quantile(seconds, 0.9))
    yield Figure(case, "median command, on the wall", float(np.median(seconds)), "s", most=5.0)
    yield Figure(case, "90th percentile", last, "s", most=10.0)
    yield from over_lengths("diagnosis", LONG, TRIANGLES)
    yield from over_lengths("diagnosis", {"10 minutes of steps": 600.0}, STEPS)


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


if __name__ == "__main__":
    work_, protocol_, length_ = sys.argv[1:]
    record_, lab_ = long_record(protocol_, float(length_)), read_parameters(COMPOSITE)
    begin_, before_ = time.perf_counter(), processor()
    WORK[work_](record_, lab_)
    memory_ = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    print(time.perf_counter() - begin_, processor() - before_, memory_)
