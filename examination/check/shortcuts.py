"""Does what makes a diagnosis fast change what it says?

    ./bench check shortcuts SET [--jobs N] [--limit N]

SET has been answered (`./bench blind run SET`). Every case is put once more to the diagnosis
without its shortcuts: each derivative a difference between two simulations instead of carried
along with one, each effect fitted to its end however little it promises, each drive that may be
proposed weighed with all that rivals may refit. Printed are the cases whose verdict or first choice
differs, and what both cost. Kept in SET/answers/unhurried; synthetic.
"""

import argparse
import statistics
import sys
from collections.abc import Sequence
from pathlib import Path

from examination.blind import command as blind
from examination.blind.case_files import ANSWERS, Answer, is_kept, read_case_set, read_kept
from sma_bench import cli

DIAGNOSE, DIAGNOSIS, UNHURRIED = "diagnose", "diagnosis", "unhurried"


def main(argv: Sequence[str] | None = None) -> int:
    words = list(sys.argv[1:] if argv is None else argv)
    if words[:1] == [DIAGNOSE]:
        return unhurried(words)
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("set", metavar="SET")
    parser.add_argument("--jobs", default="1", metavar="N", help="cases at a time")
    parser.add_argument("--limit", metavar="N", help="stop after N more cases")
    args = parser.parse_args(words)
    answers = Path(args.set) / ANSWERS
    if not any(is_kept(answers / DIAGNOSIS, name) for name in read_case_set(args.set).names):
        parser.error(f"{args.set}: no case is answered yet (./bench blind run {args.set})")
    program = f"{sys.executable} {Path(__file__).resolve()}"
    limit = ["--limit", args.limit] if args.limit else []
    code = blind.main([
        "run", args.set, "--program", f"{program} {DIAGNOSE}",
        "--answers", str(answers / UNHURRIED), "--jobs", args.jobs, "--time-limit", "600", *limit,
    ])  # fmt: skip
    return code or compared(args.set, answers)


def unhurried(words: Sequence[str]) -> int:
    """The diagnosis without its shortcuts."""
    from sma_bench.diagnose import next_experiment, search
    from sma_bench.estimation.unknowns import Unknowns

    Unknowns.is_carried = lambda self, i: False
    search._BEYOND = next_experiment._ADDED = float("inf")
    next_experiment._HOPE = -float("inf")
    return cli.main(list(words))


def said(answer: Answer | None) -> tuple[str, str]:
    """Verdict and first choice."""
    return ("failed", "") if answer is None else (answer.verdict, answer.candidates[0].name)


def compared(folder: str, answers: Path) -> int:
    """Print what differs; 1 where anything does."""
    both = [
        (read_kept(answers / DIAGNOSIS, name), read_kept(answers / UNHURRIED, name))
        for name in read_case_set(folder).names
        if is_kept(answers / DIAGNOSIS, name) and is_kept(answers / UNHURRIED, name)
    ]
    differing = [(a, b) for a, b in both if said(a.answer) != said(b.answer)]
    for a, b in differing:
        print(f"{a.case}: {' '.join(said(a.answer))}, without shortcuts {' '.join(said(b.answer))}")
    seconds = [statistics.median(kept.seconds for kept in who) for who in zip(*both, strict=True)]
    print(f"{len(differing)} of {len(both)} cases differ; median {seconds[0]:.1f} s a case, "
          f"without shortcuts {seconds[1]:.1f} s")  # fmt: skip
    return int(bool(differing))


if __name__ == "__main__":
    sys.exit(main())
