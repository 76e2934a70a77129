"""sma-bench parameters: the table of every parameter, or a parameter file to start from."""

import argparse

from sma_bench.commands.parameter_options import add_parameter_options, parameters_from_options
from sma_bench.parameters import write_parameters
from sma_bench.parameters.documentation import parameter_page
from sma_bench.parameters.node_tables import NODE_TABLES
from sma_bench.parameters.table import TABLE

DESCRIPTION = "show every parameter with unit, default, range and source, or write a file of them"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    add_parameter_options(parser)
    parser.add_argument("--markdown", action="store_true", help="print the documentation page")
    parser.add_argument("--out", metavar="P.yaml", help="write a ROS 2 parameter file")


def run(args: argparse.Namespace) -> int:
    """Print the table, the page, or write the file."""
    if args.markdown:
        print(parameter_page(NODE_TABLES), end="")
        return 0
    parameters = parameters_from_options(args)
    if args.out:
        comment = "Parameters of an SMA bench in SI units.\nLoad with: --ros-args --params-file"
        write_parameters(args.out, parameters, comment)
        print(args.out)
        return 0
    for parameter in TABLE:
        value = parameters[parameter.name]
        shown = f"{value:.6g}" if isinstance(value, float) else str(value)
        print(f"{parameter.name:45} {shown:>12} {parameter.unit:10} {parameter.provenance}")
    return 0
