"""sma-bench paper: the figures and tables of the paper redrawn from data, and its errata."""

import argparse
import time
from pathlib import Path

from sma_bench.commands.parameters import add_parameter_options, parameters_from_options
from sma_bench.commands.parser import FOLDER, add_output
from sma_bench.commands.terminal import (
    add_figure_options,
    add_json_option,
    column_of,
    print_findings,
    progress,
    write_json,
)
from sma_bench.parameters.yaml_file import write_text_atomically
from sma_bench.progress import in_turn, part

_TITLE = "Systems Actuated by Shape Memory Alloys: figures, tables and errata"
_SUMMARY = (
    "N. Keshtkar et al., Systems Actuated by Shape Memory Alloys: Identification and Modeling, "
    "redrawn by sma_bench. {origin}"
)
_OWN = (
    "All data on this page are synthetic: the paper's experiments on simulated benches and "
    "specimens of the parameters given ({given}), identified by the same code as real records; "
    "the paper's own numbers stand beside them."
)
_SYNTHETIC = (
    "All data on this page are synthetic: the paper's experiments on simulated benches and "
    "specimens, identified by the same code as real records."
)
# Shares of the time, about: all records read, all experiments compared.
_READ, _COMPARED = 0.05, 0.5
_MIXED = "From the records given ({given}) where they allow, else from synthetic data, as marked."


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument(
        "records", nargs="*", metavar="RECORD",
        help="bags and instrument files to draw from instead of synthetic data; --params without "
        "any draws the page of a simulated wire and composite of these parameters",
    )
    add_output(
        parser, "--out", FOLDER, metavar="DIR", required=True, help="folder to write to"
    )
    add_figure_options(parser)
    add_json_option(parser, "tables and errata")
    add_parameter_options(parser)


def run(args: argparse.Namespace) -> int:
    """Write index.html, one PNG a figure and one CSV a table."""
    from sma_bench.commands.paper_drawing import paper_page, to_json
    from sma_bench.records import open_record
    from sma_bench.report.page import Made, write_report
    from sma_bench.report.paper_page import csv_text

    started = time.monotonic()
    parameters, column = parameters_from_options(args), column_of(args)
    given = ", ".join(args.records)
    own = ", ".join([*([args.params] if args.params else []), *args.overrides])
    origin = _OWN.format(given=own) if own else _SYNTHETIC
    summary = _SUMMARY.format(origin=_MIXED.format(given=given) if given else origin)
    with progress("paper") as report:
        reading = in_turn(args.records, part(report, 0.0, _READ), lambda path: f"reading {path}")
        records = [open_record(path) for path in reading]
        page = paper_page(records, parameters, part(report, _READ, _COMPARED))
        drawing = part(report, _COMPARED, 1.0)
        made = Made(args.command_line, [*args.records, *filter(None, [args.params])])
        index = write_report(
            args.out, _TITLE, f"{summary} {made.head}", [*page.sections(), made.section()],
            column=column, report=drawing,
        )
    for name, rows in page.tables.items():
        write_text_atomically(Path(args.out) / f"{name}.csv", csv_text(rows))
    if args.json:
        write_json(args.json, to_json(page))
    print_findings(page.notes)
    synthetic = sum(outcome.synthetic for outcome in page.outcomes.values())
    measured = len(page.outcomes) - synthetic
    print(f"experiments: {measured} from the records given, {synthetic} synthetic")
    print(f"report   {index}\n{time.monotonic() - started:.0f} s")
    return 0
