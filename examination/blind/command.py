"""./bench blind: the withheld-effect check."""

import argparse
import os
import shlex
import signal
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NoReturn

from rich.console import Console
from rich.table import Table

from sma_bench.errors import InputError
from sma_bench.parameters import read_parameters, write_parameters
from sma_bench.results import write_result

# What --help does without is loaded where it is needed: the cases bring numba and scipy along.

HERE = "examination.blind.command"
DIAGNOSE = (sys.executable, "-m", "sma_bench.cli", "diagnose")
DIAGNOSIS, BIC = "diagnosis", "bic"


def main(argv: Sequence[str] | None = None) -> int:
    """Run one sub-command; 0 on success, 2 on bad input with one line on standard error."""
    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(variable, "1")
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # a polite kill tidies up, too
    try:
        args = parser().parse_args(argv)
        return int(args.run(args))
    except InputError as error:
        print(f"bench blind: {' '.join(str(error).split())}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("bench blind: interrupted", file=sys.stderr)
        return 130


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        raise InputError(f"{message}; see {self.prog} --help")


def parser() -> argparse.ArgumentParser:
    """Of all sub-commands."""
    top = _Parser(prog="./bench blind", description="cases with withheld effects")
    commands = top.add_subparsers(required=True, metavar="COMMAND", parser_class=_Parser)

    def command(name: str, run: Callable, text: str) -> argparse.ArgumentParser:
        found = commands.add_parser(name, help=text, description=text)
        found.set_defaults(run=run)
        found.add_argument("--json", metavar="FILE", help="write the result to FILE")
        found.add_argument("--force", action="store_true", help="replace outputs that exist")
        return found

    text = "bags with effects that only a sealed file names"
    add = command("make", make_cases, text).add_argument
    add("--seed", type=int, required=True, metavar="S",
        help="1000 to 1999: development, 2000 to 2999: frozen test, others: open")
    add("--n", type=int, default=200, metavar="N", help="cases (default 200)")
    add("--out", required=True, metavar="DIR", help="new folder")
    add("--load", default="beam", choices=("beam", "force", "spring", "antagonist"),
        help="what the wires pull against")
    add("--jobs", type=int, default=os.cpu_count() or 1, metavar="J",
        help="processes (default: one a core); the result does not depend on it")

    add = command("run", run_cases, "put every case to the diagnosis, or to a rival").add_argument
    add("set", metavar="DIR", help="folder that blind make has written")
    add("--rival", choices=(BIC,), help="a naive method instead of the diagnosis")
    add("--program", metavar="COMMAND",
        help="any other command line that takes the arguments of sma-bench diagnose")
    add("--answers", metavar="DIR", help="folder for the answers (default: DIR/answers/<who>)")
    add("--jobs", type=int, default=2, metavar="N", help="cases at a time")
    add("--limit", type=int, metavar="N", help="stop after N more cases")
    add("--time-limit", type=float, default=120.0, metavar="S",
        help="a case fails that takes longer (half as long more a further record)")
    add("--again", action="store_true", help="ask failed cases again; answers are always kept")

    add = command("score", score_cases, "open the labels and print every measure").add_argument
    add("set", metavar="DIR", help="folder that blind make has written")
    add("--answers", metavar="DIR", action="append", default=[],
        help="folder of answers (repeatable; default: all that lie in DIR/answers)")
    add("--jobs", type=int, default=2, metavar="N", help="follow-ups at a time")
    add("--no-follow-up", action="store_true",
        help="do not perform the experiments that answers ask for")
    add("--markdown", metavar="FILE", help="write the result page that a repository keeps")

    add = command("rival", answer_as_rival, "answer one case as a rival does").add_argument
    add("rival", choices=(BIC,))
    add("records", nargs="+", metavar="RECORD")
    add("--params", metavar="FILE", required=True)
    add("--hold-out", metavar="RECORD", nargs="+", default=[])
    add("--out", metavar="FILE", help="write the improved parameters")
    return top  # fmt: skip


def make_cases(args: argparse.Namespace) -> int:
    """Make the set; all of it appears, or nothing."""
    from examination.blind.make import make

    started = time.monotonic()
    manifest = make(args.out, args.seed, args.n, args.jobs, _counter("made", args.n), args.load)
    _write_json(args, {"set": args.out, **manifest})
    print(f"{args.out}: {args.n} cases of seed {args.seed} ({manifest['split']}) "
          f"in {time.monotonic() - started:.0f} s")  # fmt: skip
    print(f"labels sealed, sha256 {manifest['sha256']}")
    return 0


def run_cases(args: argparse.Namespace) -> int:
    """Ask what has no answer yet; 0 whatever the answers are."""
    from examination.blind.case_files import Examination, read_case_set, write_examination
    from examination.blind.examination import Examinee, examine, open_cases

    for option, value in (("jobs", args.jobs), ("limit", args.limit)):
        if value is not None and value < 1:
            raise InputError(f"--{option} is {value}, expected 1 or more")
    if not args.time_limit > 0.0:
        raise InputError(f"--time-limit is {args.time_limit:g} s, expected more than 0")
    name, program = DIAGNOSIS, DIAGNOSE
    if args.rival:
        name, program = args.rival, (sys.executable, "-m", HERE, "rival", args.rival)
    elif args.program is not None:
        program = tuple(shlex.split(args.program))
        if not program:
            raise InputError("--program is empty, expected a command line")
        name = Path(program[0]).name
    cases = read_case_set(args.set)
    answers = Path(args.answers) if args.answers else cases.answers / name
    write_examination(answers, Examination(name, program, args.time_limit, cases.sealed_sha256))
    waiting = open_cases(cases.names, answers, args.again)[: args.limit]
    failed = []
    count = _counter("asked", len(waiting))

    def after(done: int, line: str) -> None:
        if line:
            failed.append(line)
            print(f"failed: {line}", file=sys.stderr)
        count(done)

    examine(Examinee(program, args.time_limit), waiting, cases.folder, answers, args.jobs, after)
    left = len(open_cases(cases.names, answers))
    _write_json(args, {"answers": str(answers), "cases": len(cases.names), "asked": len(waiting),
                       "failed": len(failed), "open": left})  # fmt: skip
    print(f"{answers}: {len(waiting)} of {len(cases.names)} cases asked, {len(failed)} failed, "
          f"{left} still open")  # fmt: skip
    return 0


def score_cases(args: argparse.Namespace) -> int:
    """Judge all complete answers; the labels stay sealed while one is missing."""
    from examination.blind.case_files import read_case_set
    from examination.blind.examination import Examinee, follow_up
    from examination.blind.measures import TARGETS
    from examination.blind.page import side_by_side, summary, tables, write_markdown
    from examination.blind.score import followed_up, handed_in, open_labels, score

    _refuse_existing(args, args.markdown)
    cases = read_case_set(args.set)
    papers = handed_in(cases, [Path(folder) for folder in args.answers])
    labels = open_labels(cases)
    if not args.no_follow_up:
        for paper in papers:
            examinee = Examinee(paper.examination.program, paper.examination.time_limit)
            follow_up(cases, labels, examinee, paper.folder, args.jobs, _tell_failure)
        papers += followed_up(papers)
    scores = score(cases, papers, labels, _counter("judged", len(cases.names)))
    _write_json(args, {
        "set": {"seed": cases.seed, "split": cases.split, "n": len(cases.names),
                "sha256": cases.sealed_sha256},
        "scores": {one.name: one.to_json() for one in scores},
    })  # fmt: skip
    print(f"{len(cases.names)} cases, seed {cases.seed} ({cases.split})")
    for one in scores:
        for title, header, rows in tables(one):
            _print_table(f"{one.name}: {title}", header, rows)
    if len(scores) > 1:
        header = ("measure", *(one.name for one in scores))
        _print_table("side by side: value (95 % interval)", header, side_by_side(scores, TARGETS))
    for one in scores:
        print(summary(one))
    if args.markdown:
        print(f"result {write_markdown(args.markdown, cases, papers, scores)}")
    return 0


def answer_as_rival(args: argparse.Namespace) -> int:
    """Answer one case."""
    from examination.blind.bic import bic_answer
    from sma_bench.records import read_record

    nominal = read_parameters(args.params)
    records, hold_out = ([read_record(p) for p in paths] for paths in (args.records, args.hold_out))
    answer, improved = bic_answer(records, hold_out, nominal)
    if args.out:
        said = " ".join([answer["verdict"], *answer["cause"]])
        _refuse_existing(args, args.out)
        write_parameters(args.out, improved, f"The rival {args.rival}: {said}")
    _write_json(args, answer)
    print(answer["verdict"], *answer["cause"])
    return 0


# --- What is printed and written.


def _write_json(args: argparse.Namespace, document: dict[str, Any]) -> None:
    if args.json:
        _refuse_existing(args, args.json)
        write_result(args.json, document)


def _refuse_existing(args: argparse.Namespace, path: str | None) -> None:
    if path and Path(path).exists() and not args.force:
        raise InputError(f"{path}: exists already, expected a new path; --force replaces it")


def _counter(what: str, whole: int) -> Callable[[int], None]:
    """Says on standard error how far it is, on a terminal only."""

    def say(done: int) -> None:
        if sys.stderr.isatty():
            print(f"\r{done} of {whole} cases {what}", end="\n" * (done == whole), file=sys.stderr)

    return say


def _tell_failure(done: int, line: str) -> None:
    if line:
        print(f"failed: {line}", file=sys.stderr)


def _print_table(title: str, header: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """As wide as it is where no terminal sets a width."""
    console = Console() if sys.stdout.isatty() else Console(width=240)
    table = Table(title=title, title_justify="left", box=None, pad_edge=False)
    for k, name in enumerate(header):
        table.add_column(name, justify="right" if k else "left")
    for row in rows:
        table.add_row(*row)
    console.print()
    console.print(table)


if __name__ == "__main__":
    sys.exit(main())
