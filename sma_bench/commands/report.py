"""sma-bench report: records and result files as one page that opens from disk and prints."""

import argparse
from datetime import UTC, datetime
from pathlib import Path

from sma_bench.commands.parameters import add_parameter_options, parameters_from_options
from sma_bench.commands.parser import FOLDER, add_output
from sma_bench.commands.terminal import add_json_option, progress, say, write_json
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
        help="folder for index.html, and its figures (PNG, SVG) and tables (CSV) for papers",
    )
    parser.add_argument("--title", default="SMA bench report", help="head of the page")
    parser.add_argument("--namespace", help="where two benches are in one bag: the one to show")
    add_json_option(parser, "summary and provenance")
    add_parameter_options(parser)


def run(args: argparse.Namespace) -> int:
    """Read everything, then write everything; 0 whatever the inputs say."""
    from sma_bench.report.collected_report import (
        counted,
        digest,
        document,
        parameter_section,
        provenance_section,
        shown_input,
        summary_section,
    )
    from sma_bench.report.page import write_report

    parameters = parameters_from_options(args)
    with progress("report") as report:
        reading = in_turn(args.inputs, part(report, 0.0, _READING), lambda path: f"reading {path}")
        shown = [shown_input(path, k, args.namespace) for k, path in enumerate(reading, 1)]
        digests = [(one.path, one.sha256, one.size) for one in shown]
        if args.params:
            digests.append((args.params, *digest(Path(args.params))))
        sections = [summary_section(shown), *(one.section for one in shown)]
        if parameters.given:
            given = " and ".join([*([args.params] if args.params else []), *args.overrides])
            sections.append(parameter_section(parameters, given))
        made = datetime.now(UTC)
        sections.append(provenance_section(digests, args.command_line, made))
        page = write_report(
            args.out, args.title, f"{counted(shown)}, {made:%Y-%m-%d}.", sections,
            for_papers=True, report=part(report, _READING, 1.0),
        )
    if args.json:
        write_json(args.json, document(shown, args.command_line, page))
    for one in shown:
        say(f"{one.path}: {one.said}")
    warnings = sum(len(one.warnings) for one in shown)
    size = page.stat().st_size / 1e6
    say(f"warnings {warnings}\nreport   {page}, {size:.1f} MB")
    return 0
