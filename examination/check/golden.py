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
from typing import Any

# Each process keeps to one core: linear algebra with threads of its own would only wait.
os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = "1"

from examination.check.golden_numbers.made import (
    BLIND,
    DAILY,
    DEVELOPMENT_SEED,
    REASONS,
    SECTIONS,
    Number,
    Result,
    Results,
    Task,
    exact,
    is_number,
    sma_bench_command,
    tasks,
)

KEPT = Path(__file__).resolve().parent / "golden_numbers"
UNKNOWN_SECONDS = 10.0  # of a result that was never timed
NO_TASK = "nothing makes this result any more"
SHOWN = 0.01  # of its tolerance that a number must have moved to be listed


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


def compare(kept: Mapping[str, Result], now: Mapping[str, Result]) -> list[Move]:
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


# --- the command --------------------------------------------------------------------------------


def main(argv: Sequence[str] | None = None) -> int:
    """0 if nothing is outside its tolerance."""
    options = _options(argv)
    kept = {section: read(options.kept / f"{section}.json") for section in options.sections}
    with tempfile.TemporaryDirectory(prefix="sma_bench_golden_") as folder:
        cases = options.cases or folder
        due = [
            task
            for section in options.sections
            for task in tasks(section, cases, options.jobs)
            if options.only in task.name
        ]
        if not due:
            _say(f"no result has {options.only!r} in its name")
            return 2
        for number in sorted({task.cases for task in due if task.cases}):
            make_cases(cases, number, options.jobs)
        now = _made(due, kept, options)
    failures = 0
    for section in options.sections:
        before = kept[section]
        made = {name: _settled(result, name in before) for name, result in now[section].items()}
        if not options.only:
            made |= {name: Result({}, failed=NO_TASK) for name in before if name not in made}
        moves = compare(before, made)
        failures += sum(move.outside for move in moves)
        for line in report(section, before, made, moves):
            print(line)
    print("FAILED" if failures else "PASSED")
    if options.write:
        print(f"written to {options.kept}")
    return 1 if failures and not options.write else 0


def _settled(result: Result, has_been_kept: bool) -> Result:
    """What never worked, a record that no version reads yet, is no failure."""
    if result.failed and not has_been_kept:
        return replace(result, skipped=result.failed)
    return result


def _options(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="./bench check golden", description=__doc__)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("sections", nargs="*", metavar="SECTION", help=f"of {', '.join(SECTIONS)}")
    parser.add_argument("--only", default="", metavar="NAME", help="results with this in the name")
    parser.add_argument("--write", action="store_true", help="keep the numbers as they are now")
    parser.add_argument("--kept", type=Path, default=KEPT, metavar="DIR", help="where they are")
    parser.add_argument(
        "--cases", metavar="DIR", help="keep the development cases there, for again"
    )
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="processes")
    options = parser.parse_args(argv)
    options.sections = list(dict.fromkeys(options.sections or DAILY))
    unknown = [section for section in options.sections if section not in SECTIONS]
    if unknown:
        parser.error(f"no section {unknown[0]!r}, expected some of {', '.join(SECTIONS)}")
    if options.jobs < 1:
        parser.error(f"--jobs is {options.jobs}, expected 1 or more")
    return options


def make_cases(folder: str, number: int, jobs: int) -> None:
    """The first `number` development cases below `folder`, unless they are there."""
    if Path(folder, str(number)).is_dir():
        return
    _say(f"making {number} development cases")
    what = ("--seed", str(DEVELOPMENT_SEED), "--n", str(number))
    where = ("--out", f"{folder}/{number}", "--jobs", str(jobs))
    sma_bench_command("make", *what, *where, module=BLIND)


def _made(
    due: Sequence[Task], kept: Mapping[str, Results], options: argparse.Namespace
) -> dict[str, Results]:
    """All results by section, the longest begun first; kept as they come if that is asked for."""

    def expected(task: Task) -> float:
        before = kept[task.section].get(task.name)
        return before.seconds if before and before.seconds else UNKNOWN_SECONDS

    made: dict[tuple[str, str], Result] = {}
    for task in due:
        if task.missing:
            made[task.section, task.name] = Result({}, 0.0, task.missing)
    waiting = sorted((task for task in due if not task.missing), key=expected, reverse=True)
    begin, total, done = time.monotonic(), sum(map(expected, waiting)), 0.0
    for count, (task, result) in enumerate(_in_processes(waiting, options.jobs), 1):
        made[task.section, task.name] = result
        if options.write and result.numbers:
            path = options.kept / f"{task.section}.json"
            order = [t.name for t in due if t.section == task.section]
            write(path, {**read(path), task.name: result}, order)
        done += expected(task)
        left = (time.monotonic() - begin) * (total / done - 1.0)
        _say(f"{count}/{len(waiting)}, {left:.0f} s left  ({task.section}: {task.name})")
    return {
        section: {t.name: made[section, t.name] for t in due if t.section == section}
        for section in kept
    }


def _in_processes(waiting: Sequence[Task], jobs: int) -> Iterator[tuple[Task, Result]]:
    """Every task with its result as it comes; one job needs no process."""
    if jobs == 1:
        for task in waiting:
            yield task, task.make()
        return
    # A fresh interpreter each: forked ones would inherit the threads of numpy and numba.
    with ProcessPoolExecutor(jobs, get_context("spawn")) as pool:
        running: dict[Future[Result], Task] = {pool.submit(t.make): t for t in waiting}
        for future in as_completed(running):
            yield running[future], future.result()


def report(
    section: str, kept: Mapping[str, Result], now: Mapping[str, Result], moves: Sequence[Move]
) -> Iterator[str]:
    """Lines for people: what moved, what was skipped, and the sum."""
    compared = sum(len(kept[name].numbers) for name in now if name in kept)
    seconds = sum(result.seconds for result in now.values())
    then = sum(kept[name].seconds for name in now if name in kept)
    outside = sum(move.outside for move in moves)
    new = sum(move.kept is None for move in moves)
    yield (
        f"\n{section}: {len(now)} results, {compared} numbers kept, {len(moves) - new} moved, "
        f"{outside} outside, {new} new; {seconds:.0f} s of processor time, {then:.0f} s then"
    )
    for name, result in now.items():
        if result.skipped:
            yield f"  skipped  {name}: {result.skipped}"
        elif result.failed:
            yield f"  FAILED   {name}: {result.failed}"
    for move in sorted(moves, key=lambda move: not move.outside):
        yield "  " + _line(move)


def _line(move: Move) -> str:
    where = f"{move.result}: {move.name}"
    if move.kept is None:
        return f"new      {where}: {_text(move.now)}"
    verdict = "OUTSIDE" if move.outside else "moved"
    if move.now is None:
        return f"{verdict:8} {where}: gone, was {_text(move.kept)}"
    far = move.kept.moved(move.now)
    by = f"{far:+.2f} tolerances ({move.kept.reason})" if math.isfinite(far) else "not the same"
    return f"{verdict:8} {where}: {_text(move.kept)} is now {_text(move.now)}, {by}"


def _text(number: Number | None) -> str:
    if number is None or not is_number(number.value):
        return "nothing" if number is None else str(number.value)
    return f"{number.value:.7g}"


def _say(text: str) -> None:
    print(f"golden: {text}", file=sys.stderr, flush=True)


# --- the kept numbers ---------------------------------------------------------------------------


def read(path: Path) -> Results:
    """Results as they were kept; none where there is no file."""
    if not path.is_file():
        return {}
    return {
        name: Result(
            {key: _number(entry) for key, entry in result["numbers"].items()}, result["seconds"]
        )
        for name, result in json.loads(path.read_text())["results"].items()
    }


def _number(entry: Any) -> Number:
    return Number(*entry) if isinstance(entry, list) else exact(entry)


def write(path: Path, results: Mapping[str, Result], order: Sequence[str]) -> None:
    """One number a line: its value alone if it is exact, else value, tolerance, reason, side."""
    names = [*(n for n in order if n in results), *(n for n in results if n not in order)]
    used = {n.reason for result in results.values() for n in result.numbers.values()}
    reasons = {reason: text for reason, text in REASONS.items() if reason in used}
    blocks = []
    for name, result in ((name, results[name]) for name in names):
        lines = ",\n".join(
            f"    {json.dumps(key)}: {json.dumps(_entry(n))}" for key, n in result.numbers.items()
        )
        head = f'  {json.dumps(name)}: {{"seconds": {result.seconds:.1f}, "numbers": {{'
        blocks.append(f"{head}\n{lines}\n  }}}}")
    text = ",\n".join(blocks)
    tolerances = json.dumps(reasons, indent=1)
    path.parent.mkdir(exist_ok=True)
    path.write_text(f'{{"tolerances": {tolerances},\n"results": {{\n{text}\n}}}}\n')


def _entry(number: Number) -> Any:
    if number.reason == "exact":
        return number.value
    side = [number.side] if number.side else []
    return [number.value, number.tolerance, number.reason, *side]


if __name__ == "__main__":
    sys.exit(main())
