"""Is a bag of other people's read right, refused, and never silently wrong?

Bags of a bench are drawn at random (synthetic data), each read with `read_record`, and what comes
of it is compared with what was written.

    ./bench check bags --bags 500 --seed 9 --json result.json
"""

import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from examination.campaign.drawn_bags import HABITS, LOSS, OUTCOMES, RAISED, RIGHT, WRONG, try_bag
from examination.pieces import IN_PIECES, in_blocks, options_of, outcome_table

ROW = "{:44}{:>6}" + "{:>10}" * len(OUTCOMES)
_SHOWN_BAGS, _SHOWN = 20, 300  # wrong ones, and characters of each


def main(argv: Sequence[str] | None = None) -> int:
    """Draw, read, compare; 0 if nothing was silently wrong, 1 if something was."""
    own = {"bags": (200, "how many"), "seed": (1, "of all")}
    options = options_of("bags", __doc__, argv, **own, **IN_PIECES)
    found = in_blocks(try_bags, options, options.bags)
    wrong = [one for one in found if one["outcome"] in (WRONG, RAISED)]
    for one in wrong[:_SHOWN_BAGS]:
        print(f"{one['number']}: {one['why'][-_SHOWN:]}\n    {one['odd']}")
    print(table(found))
    return 1 if wrong else 0


def try_bags(seed: int, first: int, stop: int) -> list[dict[str, Any]]:
    """Bags `first` to `stop` of a seed."""
    with tempfile.TemporaryDirectory() as folder:
        return [try_bag(seed, number, Path(folder)) for number in range(first, stop)]


def table(found: list[dict[str, Any]]) -> str:
    lines = outcome_table(found, OUTCOMES, HABITS, ROW, "bags with", "bags")
    if telling := [one["outcome"] for one in found if one["tells"]]:
        read = sum(end in (RIGHT, LOSS) for end in telling)
        lines.append(f"of those that tell, read {read / len(telling):.1%}")
    return "\n".join(lines)
