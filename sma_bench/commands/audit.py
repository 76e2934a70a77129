"""sma-bench audit: do the numbers of a lab fit each other, and physics?"""

import argparse

from sma_bench.commands.parameters import add_parameter_options, parameters_from_options
from sma_bench.commands.terminal import add_json_option, print_findings, write_json
from sma_bench.errors import InputError
from sma_bench.parameters import audit


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("file", nargs="?", metavar="P.yaml", help="ROS 2 parameter file")
    parser.add_argument(
        "--paper", action="store_true",
        help="findings on numbers that are all the paper's one by one too, not in one line "
        "(default without P.yaml and --set)",
    )
    add_parameter_options(parser)
    add_json_option(parser, "the findings")


def run(args: argparse.Namespace) -> int:
    """Print every finding; exit code 0 (a clash is a result, not an error)."""
    if args.file and args.params:
        raise InputError(f"audit: {args.file} and --params {args.params} given, expected one file")
    args.params = args.params or args.file
    parameters = parameters_from_options(args)
    findings = audit(parameters, papers_own=args.paper or not parameters.given)
    if args.json:
        write_json(args.json, {"findings": [finding.to_json() for finding in findings]})
    print_findings(findings)
    clashes = sum(finding.severity != "info" for finding in findings)
    print(f"{clashes} of {len(findings)} checks found a clash")
    return 0
