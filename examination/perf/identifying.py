"""Identification of a whole bench (E10) over the record's length, and the coverage check."""

import resource
import subprocess
import sys
from pathlib import Path

import numpy as np

from examination.check.identification import run_draw
from examination.perf.diagnosing import RATE, TRIANGLES, long_record
from examination.perf.figures import Figure, Outcome, at_most
from examination.perf.timing import exponent, processor
from examination.perf.whole_commands import ROOT
from sma_bench.identify import identify
from sma_bench.parameters import Parameters, read_parameters

LENGTHS = {"2 minutes": 120.0, "10 minutes": 600.0, "an hour": 3600.0}
LONGEST = ("8 hours", 28_800.0)
DRAWS = 50  # of the coverage check, as it is run


def measure(tiny: bool = False) -> list[Outcome]:
    """Each length in a process of its own, whose memory is then its own; tiny: a minute here."""
    if tiny:
        return _figures("a minute", *_one(60.0))
    found = []
    outcomes: list[Outcome] = []
    for name, length in LENGTHS.items():
        said = subprocess.run(
            [sys.executable, __file__, str(length)], capture_output=True, text=True, check=True
        ).stdout
        cpu, memory = map(float, said.split())
        found.append((length, cpu, memory))
        outcomes += _figures(name, cpu, memory)
    sizes, seconds, megabytes = np.array(found).T
    growth = exponent(sizes[1:], megabytes[1:])
    outcomes += [
        Figure("E10 over the length", "processor: exponent from 10 minutes to an hour",
               exponent(sizes[1:], seconds[1:]), "", at_most(1.15)),
        Figure("E10 over the length", "memory: exponent from 10 minutes to an hour", growth, "",
               at_most(1.15)),
    ]
    name, length = LONGEST
    needed = megabytes[-1] * (length / sizes[-1]) ** growth
    outcomes.append(
        Figure(f"E10: {name} at {RATE:g} Hz", "largest memory (extrapolated)", needed, "MB")
    )
    return outcomes + _coverage()


def _figures(name: str, cpu: float, memory: float) -> list[Outcome]:
    case = f"E10: {name} at {RATE:g} Hz"
    return [
        Figure(case, "identification: processor", cpu, "s"),
        Figure(case, "largest memory", memory, "MB"),
    ]


def _coverage() -> list[Outcome]:
    """One bench of the check: drawn, run, written, read and identified by every experiment."""
    run_draw(0)  # compiles
    begin = processor()
    run_draw(1)
    each = processor() - begin
    case = "coverage check"
    return [
        Figure(case, "a bench: processor", each, "s"),
        Figure(case, f"{DRAWS} benches: processor (extrapolated)", DRAWS * each, "s"),
    ]


def _one(length: float) -> tuple[float, float]:
    """Seconds of the processor; the most memory that this process has had, MB."""
    lab: Parameters = read_parameters(Path(ROOT, "config", "composite_rig.yaml"))
    record = long_record(lab, TRIANGLES, length)
    begin = processor()
    identify([record], lab, experiments=["E10"])
    spent = processor() - begin
    return spent, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


if __name__ == "__main__":
    print(*_one(float(sys.argv[1])))
