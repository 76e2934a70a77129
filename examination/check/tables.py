"""Is a table of other people's read right, asked about, or refused, and never silently wrong?

Forty true tables (bench runs, DSC, isobaric and tensile tests; synthetic data) are written in
dialects drawn at random, each imported as its user would, and what comes of it is compared with
the truth.

    ./bench check tables --imports 4000 --seed 2 --json result.json

A piece is `--imports 400 --first 800`: import k is the same whatever it is drawn beside. With
`--package DIR` the package of another checkout is judged.
"""

import sys
import tempfile
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from examination.pieces import IN_PIECES, in_pieces, options_of
from examination.tables.dialects import HABITS, draw_habits, write
from examination.tables.outcome import ASKED, OUTCOMES, RAISED, REFUSED, RIGHT, WRONG, outcome
from examination.tables.truths import TABLES, true_table

BLOCK = 20  # imports of one piece at most


def main(argv: Sequence[str] | None = None) -> int:
    """Write, import, compare; 0 if nothing was silently wrong, 1 if something was."""
    options = options_of(
        "tables", __doc__, argv, imports=(200, "how many"), first=(0, "number of the first"),
        seed=(1, "of all of them"), package=(Path, "another checkout, whose package is judged"),
        faults=(0, "show so many wrong ones"), keep=(Path, "keep files that are read wrong"),
        **IN_PIECES,
    )  # fmt: skip
    if options.package:  # at least two pieces: one alone would run in this process
        options.imports = max(options.imports, 2)
    step = min(BLOCK, max(options.imports // 2, 1))
    numbers = range(options.first, options.first + options.imports)
    jobs = [(options.seed, k, min(k + step, numbers.stop), str(options.keep or ""))
            for k in numbers[::step]]  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        if options.package:  # found first by every process of the pool
            options.processes = max(options.processes, 2)
            (Path(folder) / "sma_bench").symlink_to((options.package / "sma_bench").resolve())
            sys.path.insert(0, folder)
        found = [one for block in in_pieces(import_block, jobs, options) for one in block]
    shown = [one for one in found if one["outcome"] in (WRONG, RAISED)]
    for one in shown[: options.faults]:
        print(f"{one['number']} {one['kind']}: {one['why']}\n    {one['odd']}")
    print(table(found))
    return 1 if shown else 0


def import_block(job: tuple[int, int, int, str]) -> list[dict[str, Any]]:
    """Imports `first` to `stop` of a seed; a job is (seed, first, stop, folder to keep faults)."""
    seed, first, stop, keep = job
    return [import_one(seed, number, keep) for number in range(first, stop)]


def import_one(seed: int, number: int, keep: str = "") -> dict[str, Any]:
    """One table in one dialect: the habits that are not plain, what came of it and why."""
    truth = true_table(number % TABLES, seed)
    rng = np.random.default_rng([41, seed, number])
    habits = draw_habits(truth, rng)
    with tempfile.TemporaryDirectory() as folder:
        sample = write(truth, habits, Path(folder), rng)
        end, why = outcome(truth, sample)
        if keep and end in (WRONG, RAISED):
            kept = Path(keep) / f"{number:04d}_{sample.path.name}"
            kept.parent.mkdir(parents=True, exist_ok=True)
            kept.write_bytes(sample.path.read_bytes())
        why = why.replace(folder, "")
    odd = {f: h for f, h in habits.items() if h != HABITS[f][0]}
    return {"number": number, "kind": truth.kind, "odd": odd, "tells": sample.tells,
            "outcome": end, "why": why}  # fmt: skip


def table(found: Sequence[dict[str, Any]]) -> str:
    """Outcomes by habit, of all, and the shares that are asked for."""
    lines = [f"{'written with':32}{'files':>7}" + "".join(f"{end:>9}" for end in OUTCOMES)]

    def row(name: str, some: Sequence[dict[str, Any]]) -> None:
        count = Counter(one["outcome"] for one in some)
        if some:
            lines.append(f"{name:32}{len(some):7}" + "".join(f"{count[e]:9}" for e in OUTCOMES))

    for feature, habits in HABITS.items():
        for habit in habits[1:]:
            row(f"{feature}: {habit}", [o for o in found if o["odd"].get(feature) == habit])
    for kind in sorted({one["kind"] for one in found}):
        row(f"a table of: {kind}", [one for one in found if one["kind"] == kind])
    row("all", found)
    telling = [one for one in found if one["tells"]]
    others = [one for one in found if not one["tells"]]
    row("that tell what they mean", telling)
    row("that do not", others)
    wrong = sum(one["outcome"] in (WRONG, RAISED) for one in found)
    read = sum(one["outcome"] == RIGHT for one in telling)
    stopped = sum(one["outcome"] in (ASKED, REFUSED) for one in others)
    guessed = sum(one["outcome"] == RIGHT for one in others)
    lines.append(f"silently wrong {wrong} of {len(found)} ({wrong / len(found):.1%})")
    if telling:
        lines.append(f"of those that tell, read without a question {read / len(telling):.1%}")
    if others:
        lines.append(
            f"of those that do not, asked or refused {stopped / len(others):.1%}, guessed right "
            f"{guessed / len(others):.1%}"
        )
    return "\n".join(lines)


if __name__ == "__main__":
    raise SystemExit(main())
