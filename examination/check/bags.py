"""Is a bag of other people's read right, refused, and never silently wrong?

Bags of a bench are drawn at random (storage, split files, metadata, compression, damaged ends,
foreign topics, clocks, stamps; synthetic data), each read with `read_record`, and what comes of it
is compared with what was written.

    ./bench check bags --bags 500 --seed 9 --json result.json

A piece is `--bags 100 --first 200`: bag k is the same whatever it is drawn beside.
"""

import sys
import tempfile
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from examination.campaign.drawn_bags import HABITS, LOSS, OUTCOMES, RAISED, RIGHT, WRONG, try_bag
from examination.pieces import IN_PIECES, in_pieces, options_of

BLOCK = 20  # bags of one piece at most
_SHOWN_BAGS, _SHOWN = 20, 300  # wrong ones, and characters of each


def main(argv: Sequence[str] | None = None) -> int:
    """Draw, read, compare; 0 if nothing was silently wrong, 1 if something was."""
    options = options_of(
        "bags", __doc__, argv, bags=(200, "how many"), first=(0, "number of the first"),
        seed=(1, "of all of them"), **IN_PIECES,
    )  # fmt: skip
    numbers = range(options.first, options.first + options.bags)
    jobs = [(options.seed, k, min(k + BLOCK, numbers.stop)) for k in numbers[::BLOCK]]
    found = [one for block in in_pieces(try_bags, jobs, options) for one in block]
    wrong = [one for one in found if one["outcome"] in (WRONG, RAISED)]
    for one in wrong[:_SHOWN_BAGS]:
        print(f"{one['number']}: {one['why'][-_SHOWN:]}\n    {one['odd']}")
    print(table(found))
    return 1 if wrong else 0


def try_bags(job: tuple[int, int, int]) -> list[dict[str, Any]]:
    """Bags `first` to `stop` of a seed; a job is (seed, first, stop)."""
    seed, first, stop = job
    with tempfile.TemporaryDirectory() as folder:
        return [try_bag(seed, number, Path(folder)) for number in range(first, stop)]


def table(found: Sequence[dict[str, Any]]) -> str:
    """Outcomes by habit, of all, and the shares that are asked for."""
    lines = [f"{'bags with':44}{'bags':>6}" + "".join(f"{end:>10}" for end in OUTCOMES)]

    def row(name: str, some: Sequence[dict[str, Any]]) -> None:
        count = Counter(one["outcome"] for one in some)
        if some:
            lines.append(f"{name:44}{len(some):6}" + "".join(f"{count[e]:10}" for e in OUTCOMES))

    for kind, habits in HABITS.items():
        for habit in habits[1:]:
            row(f"{kind}: {habit}", [one for one in found if one["odd"].get(kind) == habit])
    telling = [one for one in found if one["tells"]]
    row("all", found)
    row("that tell what they mean", telling)
    row("that do not", [one for one in found if not one["tells"]])
    wrong = sum(one["outcome"] in (WRONG, RAISED) for one in found)
    lines.append(f"silently wrong {wrong} of {len(found)} ({wrong / len(found):.1%})")
    if telling:
        read = sum(one["outcome"] in (RIGHT, LOSS) for one in telling)
        lines.append(f"of those that tell, read {read / len(telling):.1%}")
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())
