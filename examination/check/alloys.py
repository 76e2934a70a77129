"""Do the stated intervals of E5 to E9 hold the truth, whatever the alloy and however noisy?

Alloys are drawn as NiTi wires of the field differ (examination/alloys/), near the paper's and far
from it, with tests of each whose noise goes from tiny to 10 K. What is identified without any
parameter file, but the diameter and A_s that E8 cannot do without, is compared with what was drawn.

    ./bench check alloys --draws 200 --seed 1 [--joint 20] [--json FILE]

Exits with 1 where the 90 % intervals hold less than 85 or more than 95 % of all numbers, or of
those far from the paper's.
"""

import math
import sys
import tempfile
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from examination.alloys import drawn
from examination.pieces import IN_PIECES, in_pieces, options_of
from sma_bench.errors import InputError
from sma_bench.identify import identify
from sma_bench.parameters import Parameters

Z90 = 1.6449
BAND = (0.85, 0.95)
FAR = 3.0  # of the table's deviations, from the paper's number
METHODS = ("E5", "E6", "E7", "E8", "E9")
SECTION = math.pi * 0.3e-3**2 / 4.0
LOADS = (50e6, 100e6, 150e6, 200e6, 250e6, 300e6)


def main(argv: Sequence[str] | None = None) -> int:
    """Print a row a method and number; 0 where the intervals hold, else 1."""
    options = options_of(
        "alloys", __doc__, argv, draws=(200, "alloys"), seed=(1, "of all"),
        joint=(20, "E9 of every N-th draw"), **IN_PIECES,
    )  # fmt: skip
    jobs = [(options.seed, draw, options.joint) for draw in range(options.draws)]
    found = [row for rows in in_pieces(_examine, jobs, options) for row in rows]
    print(f"{options.draws} alloys, seed {options.seed}: 90 % intervals that hold the truth")
    for method in METHODS:
        own = [f for f in found if f["method"] == method]
        for name in sorted({f["name"] for f in own}):
            _print_row(method, name, [f for f in own if f["name"] == name])
        _print_row(method, "all", own)
    whole = _print_row("all", "", found)
    far = _print_row("far", "", [f for f in found if f["far"] > FAR])
    return 0 if all(BAND[0] <= share <= BAND[1] for share in (whole, far)) else 1


def examine(seed: int, draw: int, joint: int = 0) -> list[dict[str, Any]]:
    """What each method finds of one alloy, a row a number: deviations from the truth, and how far
    it is from the paper's; E9, which takes longer, of every `joint`-th draw (0: of none)."""
    random = np.random.default_rng([seed, draw])
    alloy = drawn.draw_alloy(random)
    levels = np.sort(random.choice(LOADS, int(random.integers(1, 5)), replace=False))
    paper, start = Parameters.of_paper(), "wire.austenite_start_temperature"
    stated = {"wire.diameter": 0.3e-3, start: alloy.numbers[start]}
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as folder:
        isobaric = drawn.isobaric_tests(alloy, random, Path(folder), levels)
        records = {
            "E5": [drawn.calorimetry(alloy, random)], "E6": isobaric,
            "E7": drawn.tensile_tests(alloy, random),
            "E8": [drawn.clamped_staircase(alloy, random, SECTION)],
        }  # fmt: skip
        if joint and draw % joint == 0:
            records["E9"] = isobaric
        for method, of in records.items():
            given = stated if method == "E8" else {}
            try:
                result = identify(of, Parameters(given), [method])
            except InputError as error:
                print(f"{method}: {error}"[:160], file=sys.stderr)
                continue
            for name, e in result.estimates.items():
                if name in alloy.numbers and name not in given:
                    off, far = e.value - alloy.numbers[name], abs(alloy.numbers[name] - paper[name])
                    rows.append({"method": method, "name": name, "z": off / e.std, "error": off,
                                 "far": far / paper.std(name), "std": e.std})  # fmt: skip
    return rows


def _examine(job: tuple[int, int, int]) -> list[dict[str, Any]]:
    return examine(*job)


def coverage(found: Iterable[dict[str, Any]]) -> float:
    """Share of 90 % intervals that hold the truth."""
    return float(np.mean([abs(f["z"]) < Z90 for f in found]))


def _print_row(method: str, name: str, found: Sequence[dict[str, Any]]) -> float:
    if not found:
        return 0.9
    z, share = np.array([f["z"] for f in found]), coverage(found)
    print(
        f"{method:4s} {name:36s} {len(z):5d}  {share:6.1%}  bias {np.median(z):+5.2f}  rms z "
        f"{math.sqrt(float(np.mean(z**2))):5.2f}  std {np.median([f['std'] for f in found]):.3g}"
    )
    return share


if __name__ == "__main__":
    sys.exit(main())
