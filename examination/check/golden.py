"""Do the numbers still come out as they did? Compared with those kept in golden_numbers/.

Each kept number has a tolerance and its reason: a rebuilt engine may differ in its last digits and
no further. Only the public interface is used: `import sma_bench` and the command line.

    ./bench check golden [identify simulate diagnose paper] [--only NAME] [--write]
    ./bench check golden blind60      # measures of 60 development cases, six minutes on one core

Exits with 1 if a number is outside its tolerance or gone. What needs the measured data beside the
checkout is skipped where they are not, and named.
"""

import argparse
import json
import os
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import joblib

from examination.check.golden_numbers import made as making
from examination.check.golden_numbers.made import REASONS, SECTIONS, Number, Result, Task, tasks

KEPT = Path(__file__).resolve().parent / "golden_numbers"
UNKNOWN_SECONDS = 10.0  # of a result that was never timed
SHOWN = 0.01  # of its tolerance that a number must have moved to be listed
Results = Mapping[str, Result]


def compare(kept: Results, now: Results) -> Iterator[tuple[bool, str]]:
    """All that moved, is gone or is new: whether it is outside its tolerance, and a line."""
    for result, made in now.items():
        old = kept[result].numbers if result in kept else {}
        for name in dict.fromkeys([*old, *made.numbers]) if not made.skipped else ():
            where, before, after = f"{result}: {name}", old.get(name), made.numbers.get(name)
            if before is None:
                yield False, f"new      {where}: {after}"
            elif after is None:
                yield True, f"OUTSIDE  {where}: gone, was {before}"
            elif abs(far := before.moved(after)) > SHOWN:
                outside = before.is_outside(after)
                by = f"{before} is now {after}, {far:+.2f} tolerances ({before.reason})"
                yield outside, f"{'OUTSIDE' if outside else 'moved':8} {where}: {by}"


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="./bench check golden", description=__doc__)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    add = parser.add_argument
    add("sections", nargs="*", metavar="SECTION", help=f"of {', '.join(SECTIONS)}")
    add("--only", default="", metavar="NAME", help="results with this in the name")
    add("--write", action="store_true", help="keep the numbers as they are now")
    add("--kept", type=Path, default=KEPT, metavar="DIR", help="where they are")
    add("--jobs", type=int, default=os.cpu_count() or 1, help="processes")
    options = parser.parse_args(argv)
    sections = list(dict.fromkeys(options.sections or making.DAILY))
    if unknown := [section for section in sections if section not in SECTIONS]:
        parser.error(f"no section {unknown[0]!r}, expected some of {', '.join(SECTIONS)}")
    if options.jobs < 1:
        parser.error(f"--jobs is {options.jobs}, expected 1 or more")

    kept = {section: read(options.kept / f"{section}.json") for section in sections}
    with tempfile.TemporaryDirectory(prefix="sma_bench_golden_") as cases:
        due = [task for section in sections for task in tasks(section, cases, options.jobs)
               if options.only in task.name]  # fmt: skip
        if not due:
            _say(f"no result has {options.only!r} in its name")
            return 2
        for number in sorted({task.cases for task in due if task.cases}):
            _say(f"making {number} development cases")
            making.make_cases(f"{cases}/{number}", number, options.jobs)
        now = _made(due, kept, options.jobs)
    failures = 0
    for section, before in kept.items():
        made = {task.name: now[task] for task in due if task.section == section}
        if not options.only:
            gone = Result({}, failed="nothing makes this result any more")
            made |= {name: gone for name in before if name not in made}
        moves = sorted(compare(before, made), key=lambda move: not move[0])
        outside, old = sum(out for out, _ in moves), [before[n] for n in made if n in before]
        failures += outside
        print(f"\n{section}: {len(made)} results, {sum(len(r.numbers) for r in old)} numbers kept, "
              f"{len(moves)} moved, gone or new, {outside} outside; "
              f"{sum(r.seconds for r in made.values()):.0f} s of processor time, "
              f"{sum(r.seconds for r in old):.0f} s then")  # fmt: skip
        for name, result in made.items():
            if result.skipped or result.failed:
                word = "skipped" if result.skipped else "FAILED"
                print(f"  {word:8} {name}: {result.skipped or result.failed}")
        print(*(f"  {line}\n" for _, line in moves), sep="", end="")
        if options.write:
            written = {name: result for name, result in made.items() if result.numbers}
            write(options.kept / f"{section}.json", {**before, **written}, list(made))
    print("FAILED" if failures else "PASSED")
    return 1 if failures and not options.write else 0


def _made(due: Sequence[Task], kept: Mapping[str, Results], jobs: int) -> dict[Task, Result]:
    """All results, the longest begun first."""

    def expected(task: Task) -> float:
        before = kept[task.section].get(task.name)
        return before.seconds if before and before.seconds else UNKNOWN_SECONDS

    made = {task: Result({}, 0.0, task.missing) for task in due if task.missing}
    waiting = sorted((task for task in due if not task.missing), key=expected, reverse=True)
    calls = (joblib.delayed(_numbered)(k, task) for k, task in enumerate(waiting))
    results = joblib.Parallel(jobs, return_as="generator_unordered")(calls)
    for count, (k, result) in enumerate(results, 1):
        made[task := waiting[k]] = result
        _say(f"{count}/{len(waiting)}  ({task.section}: {task.name})")
    return made


def _numbered(k: int, task: Task) -> tuple[int, Result]:
    return k, task.make()


def _say(text: str) -> None:
    print(f"golden: {text}", file=sys.stderr, flush=True)


def read(path: Path) -> dict[str, Result]:
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
