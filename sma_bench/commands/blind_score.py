"""sma-bench blind score: open the labels and print how good the answers were."""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from sma_bench.commands.blind_run import print_failure
from sma_bench.commands.terminal import add_json_option, progress, write_json
from sma_bench.progress import counted

if TYPE_CHECKING:
    from sma_bench.blind.case_files import CaseSet
    from sma_bench.blind.score import Labels, Paper, Score


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
    from sma_bench.blind.case_files import read_case_set
    from sma_bench.blind.score import handed_in, open_labels, score
    from sma_bench.commands.blind_score_tables import print_scores, result_document

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
    args: argparse.Namespace, cases: "CaseSet", papers: "Sequence[Paper]",
    scores: "Sequence[Score]",
) -> None:
    if not args.page and not args.markdown:
        return
    from sma_bench.blind.page import write_markdown, write_page

    if args.page:
        print(f"page {write_page(args.page, cases, papers, scores)}")
    if args.markdown:
        print(f"result {write_markdown(args.markdown, cases, papers, scores)}")


def _follow_up(cases: "CaseSet", labels: "Labels", paper: "Paper", jobs: int) -> None:
    from sma_bench.blind.examination import Examinee, asks_for_more, follow_up

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
