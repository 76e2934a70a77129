"""The command line `sma-bench`."""

import argparse
import difflib
import importlib
import os
import shlex
import sys
import warnings
from collections.abc import Sequence

from sma_bench import __version__
from sma_bench.commands.parser import CommandParser, command_parser, terminated_as_interrupted
from sma_bench.errors import InputError
from sma_bench.lifeline import end_with_parent

COMMANDS = {
    "info": "what a record holds and whether it can be trusted",
    "import": "tables of other loggers (CSV, Excel, MATLAB, HDF5, Parquet) to bags",
    "identify": "parameters of Table I from bags and instrument files",
    "diagnose": "where simulation and bench disagree, which effect causes it, how far it shrinks",
    "batch": "many records, each identified or diagnosed by itself, on all cores or a cluster",
    "report": "records and results as one page, with figures, tables and provenance",
    "audit": "do a lab's own numbers fit each other, and physics?",
    "parameters": "every parameter with unit, default, range and source",
    "effects": "what the paper's model leaves out: stage, size, how it shows",
    "simulate": "the paper's model on a protocol or on the voltages of a bag",
    "blind": "cases with withheld effects: make, examine, score",
    "paper": "the paper's figures, tables and errata redrawn from data",
    "calibrate": "gain and offset of a sensor of the Uno from known loads",
    "dashboard": "a bench live in the browser, with a stop that works",
    "call": "call a service of a running node: sma-bench call experiment/start",
    "run": "run a node: sma-bench run NODE [--ros-args ...]",
    "demo": "simulated benches, bags, identification, diagnosis, in one go",
    "completion": "a script that completes commands and options in bash or zsh",
}

# The fits' matrices are small: BLAS threads that wait for each other only slow them down.
_BLAS_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")

LONGEST_LINE = 2000  # characters of an error: names in a file may be of any length

_EXAMPLES = """examples:
  sma-bench info my_bag
  sma-bench identify my_bag --params lab.yaml --out identified.yaml
  sma-bench diagnose my_bag --params lab.yaml --hold-out other_bag --report gap
  sma-bench audit lab.yaml
  sma-bench run simulator --ros-args -r __ns:=/bench --params-file config/wire_rig.yaml
"""


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; 0 on success, 2 on bad input with one line on standard error."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    for variable in _BLAS_THREADS:
        os.environ.setdefault(variable, "1")
    warnings.showwarning = _show_warning
    end_with_parent(inherited=True)
    try:
        return _dispatch(arguments)
    except InputError as error:
        from sma_bench.border import printable  # --help does without YAML

        line = printable(str(error))
        end = "" if len(line) <= LONGEST_LINE else "..."
        print(f"sma-bench: {line[:LONGEST_LINE]}{end}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("sma-bench: interrupted", file=sys.stderr)
        return 130
    except BrokenPipeError:  # the reader of a pipe (head, less) has left
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0


def _show_warning(
    message: Warning | str, category: object, filename: str, lineno: int, *_: object, **__: object
) -> None:
    from sma_bench.border import printable

    print(f"sma-bench: note: {printable(str(message))}", file=sys.stderr)


def _dispatch(arguments: list[str]) -> int:
    if not arguments or arguments[0].startswith("-"):
        _top_parser().parse_args(arguments)
        return 0
    name, *rest = arguments
    if name not in COMMANDS:
        close = difflib.get_close_matches(name, COMMANDS, n=1)
        hint = f"did you mean {close[0]}?" if close else "sma-bench --help lists them"
        raise InputError(f"no command {name!r}, {hint}")
    module = importlib.import_module(f"sma_bench.commands.{name}")
    parser = command_parser(name, COMMANDS[name])
    if name == "run":
        return module.run(rest)
    module.add_arguments(parser)
    parser.set_defaults(command_line=shlex.join(["sma-bench", *arguments]))
    args = parser.parse_args(rest)
    from sma_bench.commands.terminal import (
        results_apart,  # --help does without what it brings along
    )

    with results_apart(args), terminated_as_interrupted():
        return module.run(args)


def _top_parser() -> CommandParser:
    width = max(map(len, COMMANDS))
    lines = "\n".join(f"  {name:{width}}  {text}" for name, text in COMMANDS.items())
    parser = CommandParser(
        prog="sma-bench",
        usage="sma-bench COMMAND [options]",
        description=f"Test bench for shape-memory-alloy actuators.\n\ncommands:\n{lines}",
        epilog=_EXAMPLES + "\nsma-bench COMMAND --help shows the options of a command.",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"sma-bench {__version__}")
    parser.add_argument("command", choices=list(COMMANDS), metavar="COMMAND")
    return parser


if __name__ == "__main__":
    sys.exit(main())
