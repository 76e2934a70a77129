"""Is a table of other people's read right, asked about, or refused, and never silently wrong?

Forty true tables (synthetic data) are written in dialects drawn at random, each imported as its
user would, and what comes of it is compared with the truth.

    ./bench check tables --imports 4000 --seed 2 --json result.json
"""

import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from examination.pieces import IN_PIECES, in_blocks, options_of, outcome_table
from examination.tables.dialects import HABITS, draw_habits, write
from examination.tables.outcome import ASKED, OUTCOMES, RAISED, REFUSED, RIGHT, WRONG, outcome
from examination.tables.truths import TABLES, true_table

ROW = "{:32}{:>7}" + "{:>9}" * len(OUTCOMES)


def main(argv: Sequence[str] | None = None) -> int:
    """Write, import, compare; 0 if nothing was silently wrong, 1 if something was."""
    own = {"imports": (200, "how many"), "seed": (1, "of all")}
    own |= {"faults": (0, "show so many wrong ones")}
    options = options_of("tables", __doc__, argv, **own, **IN_PIECES)
    found = in_blocks(import_block, options, options.imports)
    shown = [one for one in found if one["outcome"] in (WRONG, RAISED)]
    for one in shown[: options.faults]:
        print(f"{one['number']} {one['kind']}: {one['why']}\n    {one['odd']}")
    print(table(found))
    return 1 if shown else 0


def import_block(seed: int, first: int, stop: int) -> list[dict[str, Any]]:
    """Imports `first` to `stop` of a seed."""
    return [import_one(seed, number) for number in range(first, stop)]


def import_one(seed: int, number: int) -> dict[str, Any]:
    """One table in one dialect: the habits that are not plain, what came of it and why."""
    truth = true_table(number % TABLES, seed)
    rng = np.random.default_rng([41, seed, number])
    habits = draw_habits(truth, rng)
    with tempfile.TemporaryDirectory() as folder:
        sample = write(truth, habits, Path(folder), rng)
        end, why = outcome(truth, sample)
        why = why.replace(folder, "")
    odd = {f: h for f, h in habits.items() if h != HABITS[f][0]}
    return {"number": number, "kind": truth.kind, "odd": odd, "tells": sample.tells,
            "outcome": end, "why": why}  # fmt: skip


def table(found: list[dict[str, Any]]) -> str:
    lines = outcome_table(found, OUTCOMES, HABITS, ROW, "written with", "files")
    telling, others = ([o["outcome"] for o in found if o["tells"] is t] for t in (True, False))
    if telling:
        read = telling.count(RIGHT) / len(telling)
        lines.append(f"of those that tell, read without a question {read:.1%}")
    if others:
        stopped = sum(end in (ASKED, REFUSED) for end in others) / len(others)
        guessed = others.count(RIGHT) / len(others)
        said = f"asked or refused {stopped:.1%}, guessed right {guessed:.1%}"
        lines.append(f"of those that do not, {said}")
    return "\n".join(lines)
