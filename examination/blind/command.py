"""./bench blind: the withheld-effect check."""

import argparse
import os
import shlex
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from rich.console import Console
from rich.markup import escape

from examination.blind.parser import (
    FILE,
    FOLDER,
    NEW,
    CommandParser,
    add_dask_option,
    add_json_option,
    add_output,
    one_of,
    results_apart,
    terminated_as_interrupted,
)
from sma_bench.border import printable
from sma_bench.commands.terminal import (
    output_console,
    print_table,
    progress,
    write_json,
)
from sma_bench.errors import InputError, did_you_mean
from sma_bench.lifeline import end_with_parent
from sma_bench.parameters import read_parameters, write_parameters
from sma_bench.progress import counted, in_turn

if TYPE_CHECKING:
    from examination.blind.case_files import CaseSet
    from examination.blind.examination import Examinee
    from examination.blind.score import Labels, Paper, Score


_EXAMPLES = {
    "make": ("make --seed 1 --n 20 --out cases --jobs 2",),
    "run": ("run cases --limit 5", "run cases --rival bic"),
    "score": ("score cases --json score.json --page score",),
    "figures": ("figures --out symptoms",),
    "rival": ("rival bic my_bag --params lab.yaml --json answer.json",),
}


def main(argv: Sequence[str] | None = None) -> int:
    """Run one sub-command; 0 on success, 2 on bad input with one line on standard error."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(variable, "1")
    end_with_parent(inherited=True)
    try:
        return _dispatch(arguments)
    except InputError as error:
        print(f"bench blind: {printable(str(error))}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("bench blind: interrupted", file=sys.stderr)
        return 130


def _dispatch(arguments: list[str]) -> int:
    width = max(map(len, SHOWN))
    lines = "\n".join(f"  {name:{width}}  {command.text}" for name, command in SHOWN.items())
    if not arguments or arguments[0] in ("-h", "--help"):
        print(f"usage: ./bench blind COMMAND [options]\n\ncommands:\n{lines}\n\n"
              "./bench blind COMMAND --help shows the options of a command.")  # fmt: skip
        return 0
    name, *rest = arguments
    if name not in COMMANDS:
        raise InputError(f"no command {name!r}{did_you_mean(name, SHOWN)}, expected one of "
                         f"{', '.join(SHOWN)}")  # fmt: skip
    args = parser_of(name).parse_args(rest)
    with results_apart(getattr(args, "json", None)), terminated_as_interrupted():
        return COMMANDS[name].run(args)


def parser_of(name: str) -> CommandParser:
    """The parser of a sub-command, examples in its help."""
    command = COMMANDS[name]
    parser = CommandParser(
        prog=f"./bench blind {name}", description=command.text or None,
        epilog="\n".join(["examples:", *(f"  ./bench blind {line}" for line in _EXAMPLES[name])]),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    command.add_arguments(parser)
    return parser


# --- make: bags with effects that only a sealed file names.

def make_cases_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of `blind make`."""
    parser.add_argument(
        "--seed", type=int, required=True, metavar="S",
        help="1000 to 1999: development, 2000 to 2999: frozen test, others: open",
    )
    parser.add_argument("--n", type=int, default=200, metavar="N", help="cases (default 200)")
    add_output(parser, "--out", NEW, required=True, metavar="DIR", help="new folder")
    parser.add_argument(
        "--load", default="beam", type=one_of(loads), metavar="KIND",
        help="what the wires pull against: beam (default), force, spring, antagonist",
    )
    parser.add_argument(
        "--jobs", type=int, default=os.cpu_count() or 1, metavar="J",
        help="processes (default: one a core); the result does not depend on it",
    )
    add_json_option(parser, "the manifest of the set")


def make_cases(args: argparse.Namespace) -> int:
    """Make the set; all of it appears, or nothing."""
    from examination.blind.make import make

    started = time.monotonic()
    with progress("blind make") as report:
        cases = counted(report, args.n, "case")
        manifest = make(args.out, args.seed, args.n, args.jobs, cases, args.load)
    if args.json:
        write_json(args.json, {"set": args.out, **manifest})
    print(
        f"{args.out}: {args.n} cases of seed {args.seed} ({manifest['split']}) "
        f"in {time.monotonic() - started:.0f} s"
    )
    print(f"labels sealed, sha256 {manifest['sha256']}")
    return 0


def loads() -> tuple[str, ...]:
    """Kinds of load that a set can have."""
    from examination.blind.cases import LOADS

    return LOADS


# --- run: put every case to the diagnosis, or to a naive rival.

DIAGNOSIS = "diagnosis"
DIAGNOSE = (sys.executable, "-m", "sma_bench.cli", "diagnose")


def examine_arguments(parser: argparse.ArgumentParser) -> None:
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
    add_dask_option(parser, "the folder")
    parser.add_argument("--limit", type=int, metavar="N", help="stop after N more cases")
    parser.add_argument(
        "--time-limit", type=float, default=120.0, metavar="S",
        help="a case fails that takes longer (default 120; half as long more a further record)",
    )
    parser.add_argument(
        "--again", action="store_true", help="ask failed cases again; answers are always kept"
    )
    add_json_option(parser, "how far the set is")


def examine_cases(args: argparse.Namespace) -> int:
    """Ask what has no answer yet; 0 whatever the answers are."""
    from examination.blind.case_files import Examination, read_case_set, write_examination
    from examination.blind.examination import Examinee, open_cases

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
    failed = _ask(cases, Examinee(program, args.time_limit), waiting, answers, args)
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
    from examination.blind.rivals import RIVALS

    return tuple(RIVALS)


def _who(args: argparse.Namespace) -> tuple[str, tuple[str, ...]]:
    """Name and command line of the examinee."""
    if args.rival:
        return args.rival, (sys.executable, "-m", "examination.blind.command", "rival", args.rival)
    if args.program:
        words = tuple(shlex.split(args.program))
        if not words:
            raise InputError("--program is empty, expected a command line")
        return Path(words[0]).name, words
    return DIAGNOSIS, DIAGNOSE


def _ask(
    cases: "CaseSet", examinee: "Examinee", waiting: list[str], answers: Path,
    args: argparse.Namespace,
) -> int:
    """Examine under a progress bar; the number of failed cases."""
    from examination.blind.examination import examine

    failures = []
    with progress(f"blind run, {answers.name}") as report:
        count = counted(report, len(waiting), "case")

        def after(done: int, line: str) -> None:
            if line:
                failures.append(line)
                print_failure(line)
            count(done)

        examine(examinee, waiting, cases.folder, answers, args.jobs, after, args.dask)
    return len(failures)


def print_failure(line: str) -> None:
    """One line on standard error; above a bar where there is one."""
    console = Console(highlight=False, stderr=True)
    console.print(f"[yellow]failed[/] {escape(line)}", soft_wrap=True)


# --- score: open the labels and print how good the answers were.

def score_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("set", metavar="DIR", help="folder that blind make has written")
    parser.add_argument(
        "--answers", metavar="DIR", action="append", default=[],
        help="folder of answers (repeatable; default: all that lie in DIR/answers)",
    )
    parser.add_argument("--jobs", type=int, default=2, metavar="N", help="follow-ups at a time")
    add_dask_option(parser, "the folder")
    parser.add_argument(
        "--no-follow-up", action="store_true",
        help="do not perform the experiments that ambiguous answers ask for",
    )
    add_json_option(parser, "the result")
    add_output(parser, "--page", FOLDER, metavar="DIR", help="write an HTML page with figures")
    add_output(
        parser, "--markdown", FILE, metavar="FILE",
        help="write the result page that a repository keeps"
    )


def score_cases(args: argparse.Namespace) -> int:
    """Judge all complete answers; the labels stay sealed while one is missing."""
    from examination.blind.case_files import read_case_set
    from examination.blind.score import followed_up, handed_in, open_labels
    from examination.blind.score import score as judge

    cases = read_case_set(args.set)
    papers = handed_in(cases, [Path(folder) for folder in args.answers])
    labels = open_labels(cases)
    if not args.no_follow_up:
        for paper in papers:
            _follow_up(cases, labels, paper, args)
        papers += followed_up(papers)
    with progress("blind score") as report:
        scores = judge(cases, papers, labels, counted(report, len(cases.names), "case"))
    if args.json:
        write_json(args.json, {
            "set": {"seed": cases.seed, "split": cases.split, "n": len(cases.names),
                    "sha256": cases.sealed_sha256},
            "scores": {score.name: score.to_json() for score in scores},
        })  # fmt: skip
    _print_scores(cases, scores)
    _write_pages(args, cases, papers, scores)
    return 0


def _write_pages(
    args: argparse.Namespace, cases: "CaseSet", papers: "Sequence[Paper]",
    scores: "Sequence[Score]",
) -> None:
    if not args.page and not args.markdown:
        return
    from examination.blind.pages import write_markdown, write_page

    if args.page:
        print(f"page {write_page(args.page, cases, papers, scores)}")
    if args.markdown:
        print(f"result {write_markdown(args.markdown, cases, papers, scores)}")


def _follow_up(
    cases: "CaseSet", labels: "Labels", paper: "Paper", args: argparse.Namespace
) -> None:
    from examination.blind.examination import Examinee, asks_for_more, follow_up

    if not any(asks_for_more(kept) for kept in paper.kept):
        return
    examinee = Examinee(paper.examination.program, paper.examination.time_limit)
    with progress(f"following up {paper.name}") as report:

        def after(done: int, line: str) -> None:
            if line:
                print_failure(line)
            report(0.0, f"{done} of this round done")

        follow_up(cases, labels, examinee, paper.folder, args.jobs, after, args.dask)


_MET_STYLE = {"aim": "green", "floor": "yellow", "missed": "red", "": ""}


def _print_scores(cases: "CaseSet", scores: "Sequence[Score]") -> None:
    """All tables, as wide as they are where no terminal sets a width."""
    from examination.blind.measures import TARGETS
    from examination.blind.score import side_by_side, summary

    console = output_console()
    console.print(f"{len(cases.names)} cases, seed {cases.seed} ({cases.split})")
    for one in scores:
        _print_score(console, one)
    if len(scores) > 1:
        header = ("measure", *(one.name for one in scores))
        rows = side_by_side(scores, TARGETS)
        _print_table(console, "side by side: value (95 % interval)", header, rows)
    for one in scores:
        console.print(escape(summary(one)), soft_wrap=True)


def _print_score(console: Console, one: "Score") -> None:
    from examination.blind.score import reliability, tables

    for title, header, rows in tables(one):
        styles = () if title else [_MET_STYLE[row[-1]] for row in rows]
        _print_table(console, f"{one.name}: {title or 'measures'}", header, rows, styles)
    bins = [
        (f"{b.low:.1f} to {b.high:.1f}", str(b.n), f"{b.stated:.2f}",
         f"{b.right:.2f} ({b.right_low:.2f} to {b.right_high:.2f})")
        for b in reliability(one.cases)
    ]  # fmt: skip
    header = ("probability of the first choice", "cases", "stated", "right")
    _print_table(console, f"{one.name}: reliability", header, bins)
    _print_confusion(console, one)


def _print_confusion(console: Console, one: "Score") -> None:
    """Truth down, first choice across, by number; columns that nobody chose are left out."""
    from examination.blind.score import COLUMNS, confusion

    matrix = confusion(one.cases)
    used = [c for c in COLUMNS if any(row[c] for row in matrix.values())]
    header = ("truth", *(str(k) for k in range(1, len(used) + 1)))
    rows = [(name, *(str(row[c] or "·") for c in used)) for name, row in matrix.items()]
    _print_table(console, f"{one.name}: truth against first choice", header, rows)
    console.print("  " + ", ".join(f"{k} {name}" for k, name in enumerate(used, 1)))


def _print_table(
    console: Console,
    title: str,
    header: Sequence[str],
    rows: Sequence[Sequence[str]],
    styles: Sequence[str] = (),
) -> None:
    console.print()
    print_table(console, header, rows, range(1, len(header)), title=title, styles=styles)


# --- figures: for every effect the record with it and without it.

def draw_figures_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of `blind figures`."""
    add_output(parser, "--out", NEW, required=True, metavar="DIR", help="new folder")
    parser.add_argument(
        "--seed", type=int, default=1, metavar="S", help="of the rig and its drive (default 1)"
    )
    add_json_option(parser, "what was drawn")


def draw_figures(args: argparse.Namespace) -> int:
    """Draw all effects; all of them appear, or nothing."""
    from examination.blind.make import new_folder
    from examination.blind.pages import NAMES, write_symptom, write_symptoms_index

    with new_folder(args.out) as folder, progress("blind figures") as report:
        seen = [
            write_symptom(folder, name, args.seed)
            for name in in_turn(NAMES, report, lambda name: name)
        ]
        write_symptoms_index(folder, seen, args.seed)
    if args.json:
        write_json(args.json, {"folder": args.out, "seed": args.seed, "effects": list(NAMES)})
    print(f"{args.out}: {len(seen)} figures and README.md")
    return 0


# --- rival: a naive method in the place of the diagnosis.

def answer_as_rival_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of `blind rival`: those of sma-bench diagnose after the rival's name."""
    parser.add_argument("rival", type=one_of(rivals))
    parser.add_argument("records", nargs="+", metavar="RECORD")
    parser.add_argument("--params", metavar="FILE", required=True)
    parser.add_argument("--hold-out", metavar="RECORD", nargs="+", default=[])
    add_json_option(parser, "the answer to the contract")
    add_output(parser, "--out", FILE, metavar="FILE", help="write the improved parameters")


def answer_as_rival(args: argparse.Namespace) -> int:
    """Answer one case."""
    from examination.blind.rivals import rival_answer
    from sma_bench.records import read_record

    nominal = read_parameters(args.params)
    records = [read_record(path) for path in args.records]
    hold_out = [read_record(path) for path in args.hold_out]
    answer, improved = rival_answer(args.rival, records, hold_out, nominal)
    if args.out:
        comment = f"The rival {args.rival}: {answer['verdict']} {' '.join(answer['cause'])}"
        write_parameters(args.out, improved, comment.rstrip())
    if args.json:
        write_json(args.json, answer)
    print(answer["verdict"], *answer["cause"])
    return 0


class Command(NamedTuple):
    """A sub-command; one without a text is started by others, as a process of its own."""

    text: str
    add_arguments: Callable[[argparse.ArgumentParser], None]
    run: Callable[[argparse.Namespace], int]


COMMANDS = {
    "make": Command(
        "bags with effects that only a sealed file names", make_cases_arguments, make_cases
    ),
    "run": Command(
        "put every case to the diagnosis, or to a naive rival",
        examine_arguments, examine_cases,
    ),
    "score": Command("open the labels and print every measure", score_arguments, score_cases),
    "figures": Command(
        "for every effect: the record with it and without it", draw_figures_arguments, draw_figures
    ),
    "rival": Command("", answer_as_rival_arguments, answer_as_rival),
}  # fmt: skip
# For people; the others are started by these.
SHOWN = {name: command for name, command in COMMANDS.items() if command.text}


if __name__ == "__main__":
    sys.exit(main())
