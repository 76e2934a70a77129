"""The command line `sma-bench`."""

import argparse
import importlib
import os
import shlex
import shutil
import signal
import sys
import textwrap
import warnings
from collections.abc import Sequence

from sma_bench.commands.parser import (
    COMMANDS,
    RETIRED,
    CommandParser,
    command_parser,
    terminated_as_interrupted,
)
from sma_bench.errors import InputError, did_you_mean
from sma_bench.installation import VERSION
from sma_bench.lifeline import end_with_parent

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
        status = _dispatch(arguments)
        sys.stdout.flush()  # a reader that has left is noticed here, not when Python ends
        return status
    except InputError as error:
        from sma_bench.border import printable  # --help does without YAML

        line = printable(str(error))
        end = "" if len(line) <= LONGEST_LINE else "..."
        print(_folded(f"sma-bench: {line[:LONGEST_LINE]}{end}"), file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("sma-bench: interrupted", file=sys.stderr)
        return 130
    except BrokenPipeError:  # the reader of a pipe (head, less) has left
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0


def script() -> None:
    """What the executable of colcon's installation runs, which ends in silence until here."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    sys.exit(main())


def _folded(line: str) -> str:
    """A line as it is, on a terminal folded between its words."""
    if not sys.stderr.isatty():
        return line
    width = shutil.get_terminal_size().columns
    return textwrap.fill(line, width, subsequent_indent="  ", break_on_hyphens=False)


def _show_warning(
    message: Warning | str, category: object, filename: str, lineno: int, *_: object, **__: object
) -> None:
    from sma_bench.border import printable

    print(_folded(f"sma-bench: note: {printable(str(message))}"), file=sys.stderr)


def _dispatch(arguments: list[str]) -> int:
    if not arguments or arguments[0].startswith("-"):
        _top_parser().parse_args(arguments)
        return 0
    name, *rest = arguments
    if name in RETIRED:
        raise InputError(f"{name} {RETIRED[name]}")
    if name not in COMMANDS:
        hint = did_you_mean(name, COMMANDS) or ", sma-bench --help lists them"
        raise InputError(f"no command {name!r}{hint}")
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
    parser.add_argument("--version", action="version", version=f"sma-bench {VERSION}")
    parser.add_argument("command", choices=list(COMMANDS), metavar="COMMAND")
    return parser


if __name__ == "__main__":
    sys.exit(main())
