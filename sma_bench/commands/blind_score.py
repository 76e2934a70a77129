"""sma-bench blind score: open the labels and print how good the answers were."""

import argparse
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.markup import escape

from sma_bench.blind.breakdown import COLUMNS, confusion, groups, reliability
from sma_bench.blind.case_set import CaseSet, read_case_set
from sma_bench.blind.examinee import Examinee
from sma_bench.blind.follow_up import asks_for_more, follow_up
from sma_bench.blind.measure_table import OTHERS, TARGETS
from sma_bench.blind.score import Labels, Paper, Score, handed_in, open_labels, score
from sma_bench.blind.statistics import Measured
from sma_bench.blind.wording import MEASURE_HEADER, measure_row, side_by_side, summary
from sma_bench.commands.blind_run import print_failure
from sma_bench.commands.output import add_json_option, write_json
from sma_bench.commands.progress_bar import progress
from sma_bench.commands.tables import output_console, print_table
from sma_bench.progress import counted

_MET_STYLE = {"aim": "green", "floor": "yellow", "missed": "red", "": ""}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("set", metavar="DIR", help="folder that blind make has written")
    parser.add_argument(
        "--answers", metavar="DIR", action="append", default=[],
        help="folder of answers (repeatable; default: all that lie in DIR/answers)",
    )
    parser.add_argument("--jobs", type=int, default=2, metavar="N", help="follow-ups at a time")
    parser.add_argument(
        "--no-follow-up", action="store_true",
        help="do not perform the experiments that ambiguous answers ask for",
    )
    add_json_option(parser, "the result")
    parser.add_argument("--page", metavar="DIR", help="write an HTML page with figures")
    parser.add_argument(
        "--markdown", metavar="FILE", help="write the result page that a repository keeps"
    )


def run(args: argparse.Namespace) -> int:
    """Judge all complete answers; the labels stay sealed while one is missing."""
    cases = read_case_set(args.set)
    papers = handed_in(cases, [Path(folder) for folder in args.answers])
    labels = open_labels(cases)
    if not args.no_follow_up:
        for paper in papers:
            _follow_up(cases, labels, paper, args.jobs)
    with progress("blind score") as report:
        scores = score(cases, papers, labels, counted(report, len(cases.names), "case"))
    if args.json:
        write_json(args.json, result_document(cases, scores))
    print_scores(cases, scores)
    _write_pages(args, cases, papers, scores)
    return 0


def _write_pages(
    args: argparse.Namespace, cases: CaseSet, papers: Sequence[Paper], scores: Sequence[Score]
) -> None:
    if not args.page and not args.markdown:
        return
    from sma_bench.blind.page import write_markdown, write_page

    if args.page:
        print(f"page {write_page(args.page, cases, papers, scores)}")
    if args.markdown:
        print(f"result {write_markdown(args.markdown, cases, papers, scores)}")


def _follow_up(cases: CaseSet, labels: Labels, paper: Paper, jobs: int) -> None:
    asking = sum(asks_for_more(kept) for kept in paper.kept)
    if not asking:
        return
    examinee = Examinee(paper.examination.program, paper.examination.time_limit)
    with progress(f"following up {paper.name}") as report:
        told = counted(report, asking, "experiment")

        def after(done: int, line: str) -> None:
            if line:
                print_failure(line)
            told(done)

        follow_up(cases, labels, paper.kept, examinee, paper.folder, jobs, after)


def result_document(cases: CaseSet, scores: Sequence[Score]) -> dict:
    """Everything as plain data."""
    return {
        "set": {"seed": cases.seed, "split": cases.split, "n": len(cases.names),
                "sha256": cases.sealed_sha256},
        "scores": {score.name: score.to_json() for score in scores},
    }  # fmt: skip


def print_scores(cases: CaseSet, scores: Sequence[Score]) -> None:
    """All tables, as wide as they are where no terminal sets a width."""
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


def _print_score(console: Console, one: Score) -> None:
    rows = [measure_row(m, one.measured[m.name]) for m in TARGETS]
    styles = [_MET_STYLE[row[-1]] for row in rows]
    _print_table(console, f"{one.name}: measures", MEASURE_HEADER, rows, styles)
    others = [measure_row(m, one.measured[m.name])[:4] for m in OTHERS]
    _print_table(console, f"{one.name}: besides", MEASURE_HEADER[:4], others)
    for title, by_group in groups(one.cases).items():
        names = list(next(iter(by_group.values()), {}))
        lines = [
            (group, str(row[names[0]].n), *(_short(row[name]) for name in names))
            for group, row in by_group.items()
        ]
        _print_table(console, f"{one.name}: {title}", ("", "cases", *names), lines)
    bins = [
        (f"{b.low:.1f} to {b.high:.1f}", str(b.n), f"{b.stated:.2f}",
         f"{b.right:.2f} ({b.right_low:.2f} to {b.right_high:.2f})")
        for b in reliability(one.cases)
    ]  # fmt: skip
    header = ("probability of the first choice", "cases", "stated", "right")
    _print_table(console, f"{one.name}: reliability", header, bins)
    _print_confusion(console, one)


def _short(measured: Measured) -> str:
    return f"{measured.value:.2f} ({measured.low:.2f} to {measured.high:.2f})"


def _print_confusion(console: Console, one: Score) -> None:
    """Truth down, first choice across, by number; columns that nobody chose are left out."""
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
