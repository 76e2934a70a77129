"""What a diagnosis costs: its derivatives beside a plain simulation, cases, and long records."""

import sys
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from examination.blind.make import make
from examination.perf.commands import run
from examination.perf.identification import apart, spent
from examination.perf.measuring import LINEAR, Figure, exponent, interleaved, ratio
from examination.perf.records import COMPOSITE, STEPS, TRIANGLES, long_record
from sma_bench.diagnose import diagnose
from sma_bench.estimation.observation import observe
from sma_bench.estimation.residual import Problem
from sma_bench.estimation.unknowns import unknowns_of_records
from sma_bench.parameters import read_parameters

CASES = 24
LENGTHS = {
    "10 minutes of triangles": (TRIANGLES, 600.0),
    "an hour of triangles": (TRIANGLES, 3600.0),
    "8 hours of triangles": (TRIANGLES, 28_800.0),
    "10 minutes of steps": (STEPS, 600.0),
}


def measure(tiny: bool = False) -> Iterator[Figure]:
    """Of synthetic records in memory, and of cases of the examination's development split."""
    yield _derivatives(2 if tiny else 9)
    if not tiny:
        yield from _cases()
        yield from _lengths()


def _derivatives(rounds: int) -> Figure:
    lab = read_parameters(COMPOSITE)
    problem = Problem.of([observe(long_record(STEPS, 106.0), lab)])
    unknowns = unknowns_of_records(lab, problem.observations[0].quantities)
    x, which = unknowns.start(), range(unknowns.baseline)
    predicted = problem.predict(unknowns.parameters(x))
    ways = {
        "plain": lambda: problem.predict(unknowns.parameters(x)),
        "derivatives": lambda: problem.derivatives(unknowns, x, predicted, which),
    }
    seconds = interleaved(ways, rounds)
    times = ratio(seconds["derivatives"], seconds["plain"])
    case = f"a composite record, {unknowns.baseline} derivatives"
    return Figure(case, "plain simulations", times, most=15.0)


def _cases() -> Iterator[Figure]:
    """The command, as a user waits for it."""
    seconds = []
    with TemporaryDirectory() as name:
        made = Path(name) / "cases"
        make(made, 1000, CASES)
        for case in sorted((made / "cases").iterdir()):
            record, lab, rest = (
                str(case / part) for part in ("record", "nominal.yaml", "hold_out")
            )
            seconds.append(run(["diagnose", record, "--params", lab, "--hold-out", rest])[0])
    name = f"{CASES} development cases"
    yield Figure(name, "median command, on the wall", float(np.median(seconds)), "s", most=5.0)
    yield Figure(name, "90th percentile", float(np.quantile(seconds, 0.9)), "s", most=10.0)


def _lengths() -> Iterator[Figure]:
    found = {}
    for name, (protocol, length) in LENGTHS.items():
        case = f"{name} at 100 Hz"
        wall, found[name], memory = apart(__file__, protocol, length)
        most = 6.0 if length == 600.0 else None
        yield Figure(case, "diagnosis: on the wall", wall, "s", most=most)
        yield Figure(case, "diagnosis: processor", found[name], "s")
        yield Figure(case, "largest memory", memory, "MB")
    names = [name for name, (protocol, _) in LENGTHS.items() if protocol == TRIANGLES]
    growth = exponent((LENGTHS[name][1] for name in names), (found[name] for name in names))
    what = "exponent from 10 minutes to 8 hours"
    yield Figure("diagnosis over the length", what, growth, most=LINEAR)


if __name__ == "__main__":
    record_ = long_record(sys.argv[1], float(sys.argv[2]))
    print(*spent(lambda: diagnose([record_], read_parameters(COMPOSITE))))
