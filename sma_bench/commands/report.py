"""sma-bench report: records and result files as one page that opens from disk and prints."""

import argparse

from sma_bench.commands.parameters import add_parameter_options, parameters_from_options
from sma_bench.commands.parser import FOLDER, add_output
from sma_bench.commands.terminal import (
    add_figure_options,
    add_json_option,
    column_of,
    progress,
    say,
    write_json,
)
from sma_bench.progress import in_turn, part

_READING = 0.3  # of the time, about


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument(
        "inputs", nargs="+", metavar="RECORD|RESULT",
        help="bag, instrument file, or a result of identify or diagnose (.json)",
    )
    add_output(
        parser, "--out", FOLDER, metavar="DIR", required=True,
        help="folder for index.html, and its figures (PNG, SVG, PDF) and tables (CSV) for papers",
    )
    add_figure_options(parser, "double")
    parser.add_argument("--title", default="SMA bench report", help="head of the page")
    parser.add_argument("--namespace", help="where two benches are in one bag: the one to show")
    add_json_option(parser, "summary and provenance")
    add_parameter_options(parser)


def run(args: argparse.Namespace) -> int:
    """Read everything, then write everything; 0 whatever the inputs say."""
    from sma_bench.report.collected_report import (
        answers,
        counted,
        document,
        parameter_section,
        shown_input,
        summary_section,
    )
    from sma_bench.report.page import Made, write_report

    parameters, column = parameters_from_options(args), column_of(args)
    with progress("report") as report:
        reading = in_turn(args.inputs, part(report, 0.0, _READING), lambda path: f"reading {path}")
        shown = [shown_input(path, k, args.namespace) for k, path in enumerate(reading, 1)]
        made = Made(args.command_line, [*args.inputs, *filter(None, [args.params])])
        own = [one.section for one in shown]
        sections = [*answers(shown), summary_section(shown), *own]
        if parameters.given:
            given = " and ".join([*([args.params] if args.params else []), *args.overrides])
            sections.append(parameter_section(parameters, given))
        sections.append(made.section())
        page = write_report(
            args.out, args.title, f"{counted(shown)}. {made.head}", sections,
            column=column, report=part(report, _READING, 1.0),
        )
    if args.json:
        write_json(args.json, document(shown, args.command_line, page))
    for one in shown:
        say(f"{one.path}: {one.said}")
    warnings = sum(len(one.warnings) for one in shown)
    size = page.stat().st_size / 1e6
    say(f"warnings {warnings}\nreport   {page}, {size:.1f} MB")
    return 0
