"""Do the numbers still come out as they did? Compared with those kept in golden_numbers/.

Everything that has numbers, in sections: identification of foreign, real and simulated records,
simulations, diagnoses, the paper's tables. Each kept number has a tolerance and its reason, so that
a rebuilt engine may differ in its last digits and no further. Only the public interface is used:
`import sma_bench` and the command line.

    ./bench check golden [identify simulate diagnose paper] [--only NAME] [--write]
    ./bench check golden blind60      # measures of 60 development cases, six minutes on one core

Exits with 1 if a number is outside its tolerance or gone. What needs the measured data beside the
checkout is skipped where they are not, and named.
"""

import argparse
import json
import math
import os
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path

# Each process keeps to one core: linear algebra with threads of its own would only wait.
os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = "1"

from examination.check.golden_numbers import made as making
from examination.check.golden_numbers.made import REASONS, SECTIONS, Number, Result, Task, tasks

KEPT = Path(__file__).resolve().parent / "golden_numbers"
UNKNOWN_SECONDS = 10.0  # of a result that was never timed
NO_TASK = "nothing makes this result any more"
SHOWN = 0.01  # of its tolerance that a number must have moved to be listed

Results = Mapping[str, Result]


@dataclass(frozen=True)
class Move:
    """A number that is not what is kept. `now` is None when it is gone, `kept` when it is new."""

    result: str
    name: str
    kept: Number | None
    now: Number | None

    @property
    def outside(self) -> bool:
        """Whether this is a failure."""
        if self.kept is None:
            return False
        return self.now is None or self.kept.is_outside(self.now)


def compare(kept: Results, now: Results) -> list[Move]:
    """Everything that moved, is gone or is new, of the results that were made now."""
    moves = []
    for result, made in now.items():
        if made.skipped:
            continue
        old = kept[result].numbers if result in kept else {}
        for name in [*old, *(name for name in made.numbers if name not in old)]:
            before, after = old.get(name), made.numbers.get(name)
            if before is None or after is None or abs(before.moved(after)) > SHOWN:
                moves.append(Move(result, name, before, after))
    return moves


def main(argv: Sequence[str] | None = None) -> int:
    """0 if nothing is outside its tolerance."""
    parser = argparse.ArgumentParser(prog="./bench check golden", description=__doc__)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    add = parser.add_argument
    add("sections", nargs="*", metavar="SECTION", help=f"of {', '.join(SECTIONS)}")
    add("--only", default="", metavar="NAME", help="results with this in the name")
    add("--write", action="store_true", help="keep the numbers as they are now")
    add("--kept", type=Path, default=KEPT, metavar="DIR", help="where they are")
    add("--cases", metavar="DIR", help="keep the development cases there, for again")
    add("--jobs", type=int, default=os.cpu_count() or 1, help="processes")
    options = parser.parse_args(argv)
    sections = list(dict.fromkeys(options.sections or making.DAILY))
    if unknown := [section for section in sections if section not in SECTIONS]:
        parser.error(f"no section {unknown[0]!r}, expected some of {', '.join(SECTIONS)}")
    if options.jobs < 1:
        parser.error(f"--jobs is {options.jobs}, expected 1 or more")

    kept = {section: read(options.kept / f"{section}.json") for section in sections}
    with tempfile.TemporaryDirectory(prefix="sma_bench_golden_") as folder:
        cases = options.cases or folder
        due = [task for section in sections for task in tasks(section, cases, options.jobs)
               if options.only in task.name]  # fmt: skip
        if not due:
            _say(f"no result has {options.only!r} in its name")
            return 2
        for number in sorted({task.cases for task in due if task.cases}):
            if not Path(cases, str(number)).is_dir():
                _say(f"making {number} development cases")
                making.make_cases(f"{cases}/{number}", number, options.jobs)
        now = _made(due, kept, options)
    failures = 0
    for section, before in kept.items():
        made = {task.name: now[task] for task in due if task.section == section}
        # What never worked, a record that no version reads yet, is no failure.
        made |= {name: replace(result, skipped=result.failed) for name, result in made.items()
                 if result.failed and name not in before}  # fmt: skip
        if not options.only:
            made |= {name: Result({}, failed=NO_TASK) for name in before if name not in made}
        moves = compare(before, made)
        failures += sum(move.outside for move in moves)
        print(*report(section, before, made, moves), sep="\n")
    print("FAILED" if failures else "PASSED")
    if options.write:
        print(f"written to {options.kept}")
    return 1 if failures and not options.write else 0


def _made(
    due: Sequence[Task], kept: Mapping[str, Results], options: argparse.Namespace
) -> dict[Task, Result]:
    """All results, the longest begun first; kept as they come if that is asked for."""

    def expected(task: Task) -> float:
        before = kept[task.section].get(task.name)
        return before.seconds if before and before.seconds else UNKNOWN_SECONDS

    def in_processes() -> Iterator[tuple[Task, Result]]:
        if options.jobs == 1:
            yield from ((task, task.make()) for task in waiting)
            return
        # A fresh interpreter each: forked ones would inherit the threads of numpy and numba.
        with ProcessPoolExecutor(options.jobs, get_context("spawn")) as pool:
            running: dict[Future[Result], Task] = {pool.submit(t.make): t for t in waiting}
            for future in as_completed(running):
                yield running[future], future.result()

    made = {task: Result({}, 0.0, task.missing) for task in due if task.missing}
    waiting = sorted((task for task in due if not task.missing), key=expected, reverse=True)
    begin, total, done = time.monotonic(), sum(map(expected, waiting)), 0.0
    for count, (task, result) in enumerate(in_processes(), 1):
        made[task] = result
        if options.write and result.numbers:
            path = options.kept / f"{task.section}.json"
            order = [t.name for t in due if t.section == task.section]
            write(path, {**read(path), task.name: result}, order)
        done += expected(task)
        left = (time.monotonic() - begin) * (total / done - 1.0)
        _say(f"{count}/{len(waiting)}, {left:.0f} s left  ({task.section}: {task.name})")
    return made


def report(section: str, kept: Results, now: Results, moves: Sequence[Move]) -> Iterator[str]:
    """Lines for people: the sum, what was skipped, and what moved, the failures first."""
    old = [kept[name] for name in now if name in kept]
    new = sum(move.kept is None for move in moves)
    yield (
        f"\n{section}: {len(now)} results, {sum(len(result.numbers) for result in old)} numbers "
        f"kept, {len(moves) - new} moved, {sum(move.outside for move in moves)} outside, {new} new;"
        f" {sum(result.seconds for result in now.values()):.0f} s of processor time, "
        f"{sum(result.seconds for result in old):.0f} s then"
    )
    for name, result in now.items():
        if result.skipped:
            yield f"  skipped  {name}: {result.skipped}"
        elif result.failed:
            yield f"  FAILED   {name}: {result.failed}"
    for move in sorted(moves, key=lambda move: not move.outside):
        before, after, where = move.kept, move.now, f"{move.result}: {move.name}"
        verdict = "OUTSIDE" if move.outside else "moved"
        if before is None:
            yield f"  new      {where}: {after}"
        elif after is None:
            yield f"  {verdict:8} {where}: gone, was {before}"
        else:
            far = before.moved(after)
            by = f"{far:+.2f} tolerances ({before.reason})"
            by = by if math.isfinite(far) else "not the same"
            yield f"  {verdict:8} {where}: {before} is now {after}, {by}"


def _say(text: str) -> None:
    print(f"golden: {text}", file=sys.stderr, flush=True)


def read(path: Path) -> dict[str, Result]:
    """Results as they were kept; none where there is no file."""
    results = {}
    for name, result in json.loads(path.read_text())["results"].items() if path.is_file() else ():
        numbers = {key: Number(*entry) if isinstance(entry, list) else making.exact(entry)
                   for key, entry in result["numbers"].items()}  # fmt: skip
        results[name] = Result(numbers, result["seconds"])
    return results


def write(path: Path, results: Results, order: Sequence[str]) -> None:
    """One number a line: its value alone if it is exact, else value, tolerance, reason, side."""
    names = [*(n for n in order if n in results), *(n for n in results if n not in order)]
    used = {n.reason for result in results.values() for n in result.numbers.values()}
    reasons = {reason: text for reason, text in REASONS.items() if reason in used}
    blocks = []
    for name in names:
        lines = []
        for key, n in results[name].numbers.items():
            entry = [n.value, n.tolerance, n.reason, *([n.side] if n.side else [])]
            text = json.dumps(n.value if n.reason == "exact" else entry)
            lines.append(f"    {json.dumps(key)}: {text}")
        seconds, text = results[name].seconds, ",\n".join(lines)
        head = f'  {json.dumps(name)}: {{"seconds": {seconds:.1f}, "numbers": {{'
        blocks.append(f"{head}\n{text}\n  }}}}")
    text, tolerances = ",\n".join(blocks), json.dumps(reasons, indent=1)
    path.parent.mkdir(exist_ok=True)
    path.write_text(f'{{"tolerances": {tolerances},\n"results": {{\n{text}\n}}}}\n')


if __name__ == "__main__":
    sys.exit(main())
