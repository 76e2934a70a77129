"""What a diagnosis costs: development cases and long records."""

from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from examination.blind.make import make
from examination.perf.commands import run
from examination.perf.identification import over_lengths
from examination.perf.measuring import Figure
from examination.perf.records import STEPS, TRIANGLES

CASES = 24
LENGTHS = {
    "10 minutes of triangles": 600.0,
    "an hour of triangles": 3600.0,
    "8 hours of triangles": 28_800.0,
}


def measure(tiny: bool = False) -> Iterator[Figure]:
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
    yield from over_lengths("diagnosis", LENGTHS, TRIANGLES)
    yield from over_lengths("diagnosis", {"10 minutes of steps": 600.0}, STEPS)
