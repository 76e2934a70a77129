"""sma-bench parameters: every parameter, or a file to start from; options of all that take them."""

import argparse
from typing import Any

from sma_bench.border import load_yaml
from sma_bench.commands.parser import FILE, add_output
from sma_bench.commands.terminal import add_json_option, output_console, print_table, write_json
from sma_bench.errors import InputError
from sma_bench.parameters import Parameters, read_parameters, write_parameters
from sma_bench.parameters.documentation import parameter_page
from sma_bench.parameters.node_tables import NODE_TABLES, node_groups
from sma_bench.parameters.parameter import Parameter
from sma_bench.parameters.table import TABLE
from sma_bench.parameters.yaml_file import split_names

# --- Options that every command taking parameters shares.


def add_parameter_options(parser: argparse.ArgumentParser) -> None:
    """Add --params and --set."""
    parser.add_argument(
        "--params", metavar="P.yaml", help="ROS 2 parameter file (default: the paper's Table I)"
    )
    parser.add_argument(
        "--set", metavar="NAME=VALUE", action="append", default=[], dest="overrides",
        help="override one parameter, e.g. --set wire.resistance=2.8 (repeatable)",
    )


def parameters_from_options(args: argparse.Namespace) -> Parameters:
    """Parameters of --params with the --set overrides applied.

    Raises:
        InputError: bad file, unknown name, wrong type or value, in one line.
    """
    parameters = Parameters.defaults()
    if args.params:
        parameters = read_parameters(args.params, ignore=node_groups())
    values, uncertainty = split_names(dict(named_value(text) for text in args.overrides))
    return parameters.replace(values, uncertainty, "--set")


def named_value(text: str) -> tuple[str, Any]:
    """NAME=VALUE, the value as YAML has it.

    Raises:
        InputError: it is not that.
    """
    name, equals, value = text.partition("=")
    if not equals or not name:
        raise InputError(f"--set {text}: expected NAME=VALUE")
    try:
        return name.strip(), load_yaml(value)
    except InputError:
        raise InputError(f"--set {text}: {value!r} is not a value") from None


# --- The command.

def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    add_parameter_options(parser)
    parser.add_argument("--markdown", action="store_true", help="print the documentation page")
    add_output(parser, "--out", FILE, metavar="P.yaml", help="write a ROS 2 parameter file")
    add_json_option(parser, "the table")


def run(args: argparse.Namespace) -> int:
    """Print the table, the page, or write the file."""
    parameters = parameters_from_options(args)
    if args.json:
        write_json(args.json, {"parameters": [_entry(p, parameters) for p in TABLE]})
    if args.markdown:
        print(parameter_page(NODE_TABLES), end="")
        return 0
    if args.out:
        comment = "Parameters of an SMA bench in SI units.\nLoad with: --ros-args --params-file"
        write_parameters(
            args.out, parameters, comment, template=args.params or args.out, explain=True
        )
        print(args.out)
        return 0
    rows = [(p.name, _shown(parameters[p.name]), p.unit, p.provenance) for p in TABLE]
    print_table(output_console(), ("parameter", "value", "unit", "source"), rows)
    return 0


def _shown(value: object) -> str:
    if isinstance(value, tuple):
        return ", ".join(map(str, value))
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _entry(parameter: Parameter, parameters: Parameters) -> dict[str, object]:
    value = parameters[parameter.name]
    return {
        "name": parameter.name,
        "unit": parameter.unit,
        "value": list(value) if isinstance(value, tuple) else value,
        "std": parameters.std(parameter.name) if parameter.uncertainty is not None else None,
        "low": parameter.low,
        "high": parameter.high,
        "description": parameter.description,
        "source": parameter.provenance,
    }
