"""Options that every command taking parameters shares."""

import argparse
from typing import Any

from sma_bench.border import load_yaml
from sma_bench.errors import InputError
from sma_bench.parameters import Parameters, read_parameters
from sma_bench.parameters.node_tables import node_groups
from sma_bench.parameters.yaml_file import split_names


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
