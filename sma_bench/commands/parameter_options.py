"""Options that every command taking parameters shares."""

import argparse
from typing import Any

import yaml

from sma_bench.errors import InputError
from sma_bench.parameters import Parameters, read_parameters
from sma_bench.parameters.node_tables import NODE_TABLES
from sma_bench.parameters.parameters import UNCERTAINTY_PREFIX
from sma_bench.parameters.table import BY_NAME
from sma_bench.parameters.yaml_file import load_yaml, split_names


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
        parameters = read_parameters(args.params, ignore=_node_groups())
    values, uncertainty = split_names(dict(_override(text) for text in args.overrides))
    return parameters.replace(values, uncertainty, "--set")


def _node_groups() -> set[str]:
    """Groups that only nodes declare: the same file may hold them beside the contract's."""
    contract = {name.split(".")[0] for name in BY_NAME} | {UNCERTAINTY_PREFIX.rstrip(".")}
    nodes = {p.name.split(".")[0] for table in NODE_TABLES.values() for p in table}
    return nodes - contract


def _override(text: str) -> tuple[str, Any]:
    name, equals, value = text.partition("=")
    if not equals or not name:
        raise InputError(f"--set {text}: expected NAME=VALUE")
    try:
        return name.strip(), load_yaml(value)
    except yaml.YAMLError:
        raise InputError(f"--set {text}: {value!r} is not a value") from None
