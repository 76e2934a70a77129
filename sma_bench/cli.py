"""The command line `sma-bench`.

Exit status: 0 done, 2 bad input (one line on standard error), 3 the model does not fit, 130
interrupted. Click completes commands, options and names in bash, zsh and fish:
`eval "$(_SMA_BENCH_COMPLETE=bash_source sma-bench)"`."""

import gc
import importlib
import os
import signal
import sys
import warnings
from collections.abc import Sequence
from typing import TYPE_CHECKING

from sma_bench.commands import COMMANDS, MODULES
from sma_bench.errors import InputError, did_you_mean
from sma_bench.installation import VERSION, one_blas_thread
from sma_bench.lifeline import end_with_parent

if TYPE_CHECKING:
    import click

# Allocations between two runs of the garbage collector, instead of Python's 700: importing numba
# and scipy creates many objects but no cycles, and collecting would take some 10 ms.
_GARBAGE = 100_000

LONGEST_LINE = 2000  # characters of an error message: names from a file may have any length
_COMPLETE = "_SMA_BENCH_COMPLETE"

_HELP = """usage: sma-bench COMMAND [options]

Test bench for shape-memory-alloy actuators.

commands:
{commands}

examples:
  sma-bench info my_bag
  sma-bench identify my_bag --params lab.yaml --out identified.yaml
  sma-bench diagnose my_bag --params lab.yaml --hold-out other_bag --report gap
  sma-bench audit lab.yaml
  sma-bench run simulator --ros-args -r __ns:=/bench --params-file config/wire_rig.yaml

sma-bench COMMAND --help shows the options of a command, sma-bench --version the version.
"""


def main(argv: Sequence[str] | None = None) -> int:
    arguments = list(sys.argv[1:] if argv is None else argv)
    one_blas_thread()
    gc.set_threshold(_GARBAGE)
    warnings.showwarning = _show_warning
    end_with_parent(inherited=True)
    try:
        status = _dispatch(arguments)
        sys.stdout.flush()  # raise BrokenPipeError here, not while Python exits
        return status
    except InputError as error:
        from sma_bench.border import printable  # imports YAML, which --help need not load

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


def script() -> None:
    """Entry point of colcon's executable, which until now exited silently on a signal."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    sys.exit(main())


def _dispatch(arguments: list[str]) -> int:
    if _COMPLETE in os.environ:
        _complete()
    if not arguments or arguments[0] in ("-h", "--help"):
        width = max(map(len, COMMANDS))
        lines = "\n".join(f"  {name:{width}}  {text}" for name, text in COMMANDS.items())
        print(_HELP.format(commands=lines), end="")
        return 0
    name, *rest = arguments
    if name == "--version":
        print(f"sma-bench {VERSION}")
        return 0
    if name not in COMMANDS:
        hint = did_you_mean(name, COMMANDS) or ", sma-bench --help lists them"
        raise InputError(f"no command {name!r}{hint}")
    from sma_bench.commands.options import run_command

    return run_command(load_command(name), f"sma-bench {name}", rest)


def load_command(name: str) -> "click.Command":
    """The command of this name; imports only its own module, so that the help loads quickly."""
    return getattr(importlib.import_module(f"sma_bench.commands.{MODULES[name]}"), f"run_{name}")


def _complete() -> None:
    """Answer a completion request of the shell, which is in _SMA_BENCH_COMPLETE, and exit."""
    import click

    class Commands(click.Group):
        def list_commands(self, ctx: click.Context) -> list[str]:
            return list(COMMANDS)

        def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
            return load_command(cmd_name) if cmd_name in COMMANDS else None

    Commands("sma-bench").main([], prog_name="sma-bench", complete_var=_COMPLETE)


def _show_warning(message: Warning | str, category: object, filename: str, lineno: int, *_: object,
                  **__: object) -> None:
    """Show warnings of this package in one line; ignore those of libraries."""
    if not filename.startswith(os.path.dirname(__file__)):
        return
    from sma_bench.border import printable

    print(f"sma-bench: note: {printable(str(message))}", file=sys.stderr)


if __name__ == "__main__":
    sys.exit(main())
