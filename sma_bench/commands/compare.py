"""sma-bench compare: records and models over each other, their differences in numbers."""

import argparse

from sma_bench.commands.parser import FOLDER, add_output
from sma_bench.commands.terminal import (
    add_figure_options,
    add_json_option,
    column_of,
    output_console,
    print_table,
    progress,
    say,
    write_json,
)

_LEAST_SHIFT = 1e-3  # s, worth a line


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument(
        "records", nargs="+", metavar="RECORD",
        help="bags; the first is what the others are compared with",
    )
    parser.add_argument(
        "--model", metavar="FILE", dest="models", nargs="+", action="extend", default=[],
        help="parameter files: each model is simulated under the first record's voltages",
    )
    parser.add_argument(
        "--signals", metavar="SIGNAL", nargs="+", default=[],
        help="draw these signals or quantities (default: of each quantity what differs most)",
    )
    parser.add_argument("--namespace", help="where two benches are in one bag: the one to take")
    add_json_option(parser, "shifts and differences")
    add_output(parser, "--out", FOLDER, metavar="DIR", help="write a page with the figure")
    add_figure_options(parser)


def run(args: argparse.Namespace) -> int:
    """Lay them over each other, print what differs, write what was asked for."""
    from sma_bench.api import compare, load
    from sma_bench.records.overlay import HEADER

    column = column_of(args)
    with progress("compare") as report:
        report(0.1, "reading and simulating")
        found = compare([load(path, args.namespace) for path in args.records], args.models)
    if args.json:
        write_json(args.json, found.to_json())
    rows = [d.cells() for d in found.differences]
    print_table(output_console(), HEADER, rows, right=(2, 3, 4, 5))
    for name, shift in found.shifts.items():
        if abs(shift) >= _LEAST_SHIFT:
            say(f"{name}: its clock was shifted by {shift:+.3f} s")
    for remark in found.remarks:
        say(remark)
    if args.out:
        from sma_bench.report.page import Made, Section, Table, write_report
        from sma_bench.report.plots import overlay_picture

        made = Made(args.command_line, [*args.records, *args.models])
        table = Table(HEADER, rows, frozenset({2, 3, 4, 5}), "differences", "Largest first")
        sections = [
            Section("", found.remarks, pictures=[overlay_picture(found, "overlay", args.signals)]),
            Section("Differences from the first", tables=[table]),
            made.section(),
        ]
        *others, last = found.records
        title = f"{', '.join(others)} and {last}, compared" if others else f"{last}, compared"
        with progress("drawing the page") as report:
            page = write_report(args.out, title, made.head, sections, column=column, report=report)
        say(f"report {page}")
    return 0
