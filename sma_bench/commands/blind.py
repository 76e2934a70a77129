"""sma-bench blind: the withheld-effect check; every sub-command has a file of its own."""

import argparse
import importlib

from sma_bench.commands.output import results_apart
from sma_bench.commands.parser import command_parser

COMMANDS = {
    "make": "bags with effects that only a sealed file names",
    "run": "put every case to the diagnosis, or to a naive rival",
    "score": "open the labels and print every measure",
    "figures": "for every effect: the record with it and without it",
}
# What a sub-command starts as a process of its own.
HIDDEN = ("rival",)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command: a sub-command and what is its own."""
    width = max(map(len, COMMANDS))
    lines = "\n".join(f"  {name:{width}}  {text}" for name, text in COMMANDS.items())
    parser.usage = "sma-bench blind COMMAND [options]"
    parser.epilog = (
        f"commands:\n{lines}\n\n{parser.epilog or ''}\n\n"
        "sma-bench blind COMMAND --help shows the options of a command."
    )
    parser.add_argument("command", choices=[*COMMANDS, *HIDDEN], metavar="COMMAND")
    parser.add_argument(
        "rest", nargs=argparse.REMAINDER, metavar="[options]", help=argparse.SUPPRESS
    )


def run(args: argparse.Namespace) -> int:
    """Hand over to the sub-command."""
    module = importlib.import_module(f"sma_bench.commands.blind_{args.command}")
    parser = command_parser(f"blind {args.command}", COMMANDS.get(args.command))
    module.add_arguments(parser)
    own = parser.parse_args(args.rest)
    with results_apart(own):
        return int(module.run(own))
