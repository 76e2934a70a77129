"""sma-bench blind run: put every case of a set to the diagnosis, or to a naive rival."""

import argparse
import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.markup import escape

from sma_bench.commands.parser import one_of
from sma_bench.commands.terminal import add_json_option, progress, write_json
from sma_bench.errors import InputError
from sma_bench.progress import counted

if TYPE_CHECKING:
    from sma_bench.blind.case_files import CaseSet
    from sma_bench.blind.examination import Examinee

DIAGNOSIS = "diagnosis"
_SMA_BENCH = (sys.executable, "-m", "sma_bench.cli")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("set", metavar="DIR", help="folder that blind make has written")
    who = parser.add_mutually_exclusive_group()
    who.add_argument(
        "--rival", type=one_of(rivals), metavar="NAME",
        help="a naive method instead of the diagnosis: rmse, score or bic",
    )
    who.add_argument(
        "--program", metavar="COMMAND",
        help="any other command line that takes the arguments of sma-bench diagnose",
    )
    parser.add_argument(
        "--answers", metavar="DIR", help="folder for the answers (default: DIR/answers/<who>)"
    )
    parser.add_argument("--jobs", type=int, default=2, metavar="N", help="cases at a time")
    parser.add_argument("--limit", type=int, metavar="N", help="stop after N more cases")
    parser.add_argument(
        "--time-limit", type=float, default=120.0, metavar="S",
        help="a case fails that takes longer (default 120)",
    )
    parser.add_argument(
        "--again", action="store_true", help="ask failed cases again; answers are always kept"
    )
    add_json_option(parser, "how far the set is")


def run(args: argparse.Namespace) -> int:
    """Ask what has no answer yet; 0 whatever the answers are."""
    from sma_bench.blind.case_files import Examination, read_case_set, write_examination
    from sma_bench.blind.examination import Examinee, open_cases

    for option, value in (("jobs", args.jobs), ("limit", args.limit)):
        if value is not None and value < 1:
            raise InputError(f"--{option} is {value}, expected 1 or more")
    if not args.time_limit > 0.0:
        raise InputError(f"--time-limit is {args.time_limit:g} s, expected more than 0")
    cases = read_case_set(args.set)
    name, program = _who(args)
    answers = Path(args.answers) if args.answers else cases.answers / name
    write_examination(answers, Examination(name, program, args.time_limit, cases.sealed_sha256))
    waiting = open_cases(cases.names, answers, args.again)[: args.limit]
    failed = _ask(cases, Examinee(program, args.time_limit), waiting, answers, args.jobs)
    left = len(open_cases(cases.names, answers))
    if args.json:
        write_json(args.json, {
            "answers": str(answers), "cases": len(cases.names), "asked": len(waiting),
            "failed": failed, "open": left,
        })  # fmt: skip
    print(
        f"{answers}: {len(waiting)} of {len(cases.names)} cases asked, {failed} failed, "
        f"{left} still open"
    )
    return 0


def rivals() -> tuple[str, ...]:
    """Names of the naive methods."""
    from sma_bench.blind.rivals import RIVALS

    return tuple(RIVALS)


def _who(args: argparse.Namespace) -> tuple[str, tuple[str, ...]]:
    """Name and command line of the examinee."""
    if args.rival:
        return args.rival, (*_SMA_BENCH, "blind", "rival", args.rival)
    if args.program:
        words = tuple(shlex.split(args.program))
        if not words:
            raise InputError("--program is empty, expected a command line")
        return Path(words[0]).name, words
    return DIAGNOSIS, (*_SMA_BENCH, "diagnose")


def _ask(
    cases: "CaseSet", examinee: "Examinee", waiting: list[str], answers: Path, jobs: int
) -> int:
    """Examine under a progress bar; the number of failed cases."""
    from sma_bench.blind.examination import examine

    failures = []
    with progress(f"blind run, {answers.name}") as report:
        told = counted(report, len(waiting), "case")

        def after(done: int, line: str) -> None:
            if line:
                failures.append(line)
                print_failure(line)
            told(done)

        examine(examinee, waiting, cases.folder, answers, jobs, after)
    return len(failures)


def print_failure(line: str) -> None:
    """One line on standard error; above a bar where there is one."""
    console = Console(highlight=False, stderr=True)
    console.print(f"[yellow]failed[/] {escape(line)}", soft_wrap=True)
