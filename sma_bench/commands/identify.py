"""sma-bench identify: parameters of Table I from bags and instrument files."""

import argparse

from rich.console import Console
from rich.table import Table

from sma_bench.commands.output import print_findings, write_json
from sma_bench.commands.parameter_options import add_parameter_options, parameters_from_options
from sma_bench.identify import EXPERIMENTS, Identification, identify
from sma_bench.parameters import write_parameters
from sma_bench.records import open_record


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument(
        "records", nargs="+", metavar="RECORD", help="bag (folder, .mcap, .db3) or instrument file"
    )
    add_parameter_options(parser)
    parser.add_argument(
        "--experiment", action="append", choices=EXPERIMENTS, dest="experiments",
        help="do this one only (repeatable; default: all that the records hold)",
    )
    parser.add_argument("--namespace", help="where two benches are in one bag: the one to take")
    parser.add_argument(
        "--out", metavar="identified.yaml", help="write a ROS 2 parameter file that nodes load"
    )
    parser.add_argument("--json", metavar="FILE", help="write the result as JSON")
    parser.add_argument("--report", metavar="DIR", help="write a page with figures")


def run(args: argparse.Namespace) -> int:
    """Identify, print a table, write the files that were asked for."""
    parameters = parameters_from_options(args)
    records = [open_record(path, args.namespace) for path in args.records]
    result = identify(records, parameters, args.experiments)
    if args.json:
        write_json(args.json, result.to_json())
    if args.out:
        comment = "Identified by sma-bench identify from " + ", ".join(args.records)
        write_parameters(args.out, result.parameters, comment.replace("\n", " "))
    print_result(result)
    if args.report:
        from sma_bench.report.identification_report import write_identification_report

        print(f"report {write_identification_report(args.report, result)}")
    return 0


def print_result(result: Identification) -> None:
    """A table of the numbers, and below it every remark on them."""
    table = Table(box=None, pad_edge=False)
    for heading in ("parameter", "value", "std", "unit", "n", "from"):
        right = heading in ("value", "std", "n")
        table.add_column(heading, justify="right" if right else "left", no_wrap=True)
    for name, e in result.estimates.items():
        number = f"{e.value:.6g}"
        table.add_row(name, number, f"{e.std:.2g}", e.unit, str(e.n), result.origin(name))
    Console(highlight=False).print(table)
    print_findings(result.notes)
    for experiment in result.experiments:
        print(f"\n{experiment.name} {experiment.title} ({experiment.source})")
        print_findings(experiment.findings)
