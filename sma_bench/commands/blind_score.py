"""sma-bench blind score: open the labels and print how good the answers were."""

import argparse
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from sma_bench.blind.breakdown import COLUMNS, confusion, groups, reliability
from sma_bench.blind.case_set import CaseSet, read_case_set
from sma_bench.blind.examinee import Examinee
from sma_bench.blind.follow_up import asks_for_more, follow_up
from sma_bench.blind.measure_table import OTHERS, TARGETS
from sma_bench.blind.score import Labels, Paper, Score, handed_in, open_labels, score
from sma_bench.blind.statistics import Measured
from sma_bench.blind.wording import MEASURE_HEADER, measure_row, side_by_side, summary
from sma_bench.commands.blind_run import progress_bar
from sma_bench.commands.output import write_json

_PAGE_WIDTH = 180
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
    parser.add_argument("--json", metavar="FILE", help="write the result as JSON")
    parser.add_argument("--page", metavar="DIR", help="write an HTML page with figures")
    parser.add_argument(
        "--markdown", metavar="FILE", help="write the result page that a repository keeps"
    )


def run(args: argparse.Namespace) -> int:
    """Judge all complete answers; the labels stay sealed while one is missing."""
    cases = read_case_set(args.set)
    papers = handed_in(cases, [Path(folder) for folder in args.answers])
    labels = open_labels(cases)
    console = Console(highlight=False, stderr=True)
    if not args.no_follow_up:
        for paper in papers:
            _follow_up(console, cases, labels, paper, args.jobs)
    with progress_bar(console) as progress:
        task = progress.add_task("judging", total=len(cases.names))
        scores = score(cases, papers, labels, lambda done: progress.update(task, completed=done))
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


def _follow_up(
    console: Console, cases: CaseSet, labels: Labels, paper: Paper, jobs: int
) -> None:
    asking = sum(asks_for_more(kept) for kept in paper.kept)
    if not asking:
        return
    examinee = Examinee(paper.examination.program, paper.examination.time_limit)
    with progress_bar(console) as progress:
        task = progress.add_task(f"follow {paper.name}", total=asking)

        def report(done: int, line: str) -> None:
            if line:
                console.print(f"[yellow]failed[/] {escape(line)}", soft_wrap=True)
            progress.update(task, completed=done)

        follow_up(cases, labels, paper.kept, examinee, paper.folder, jobs, report)


def result_document(cases: CaseSet, scores: Sequence[Score]) -> dict:
    """Everything as plain data."""
    return {
        "set": {"seed": cases.seed, "split": cases.split, "n": len(cases.names),
                "sha256": cases.sealed_sha256},
        "scores": {score.name: score.to_json() for score in scores},
    }  # fmt: skip


def print_scores(cases: CaseSet, scores: Sequence[Score]) -> None:
    """All tables, as wide as they are where no terminal sets a width."""
    console = Console(highlight=False)
    if not console.is_terminal:
        console = Console(highlight=False, width=_PAGE_WIDTH)
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
    table = Table(box=None, pad_edge=False)
    for k, head in enumerate(header):
        table.add_column(head, justify="right" if k else "left")
    for k, row in enumerate(rows):
        table.add_row(*(escape(cell) for cell in row), style=styles[k] if styles else None)
    console.print(f"\n[bold]{escape(title)}[/]", soft_wrap=True)
    console.print(table)
