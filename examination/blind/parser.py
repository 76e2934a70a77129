"""The parsers of ./bench blind, on argparse still."""

import argparse
import re
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, NoReturn

from sma_bench.commands.options import (
    FILE,
    FOLDER,
    NEW,
    STANDARD_OUTPUT,
    keep_safe,
    paths_in,
    results_apart,
    terminated_as_interrupted,
)
from sma_bench.errors import InputError, did_you_mean

__all__ = ["FILE", "FOLDER", "NEW", "results_apart", "terminated_as_interrupted"]

PROGRAM = "sma-bench"
_INVALID_CHOICE = re.compile(r"invalid choice: '([^']*)' \(choose from (.*)\)")


class CommandParser(argparse.ArgumentParser):
    """Raises InputError instead of printing the usage and an error below it, and before any work
    where an output would replace what is there."""

    def parse_args(self, args: Any = None, namespace: Any = None) -> Any:
        """The arguments, once no output of theirs endangers a file."""
        self._require_known_options(args or [])
        found = super().parse_args(args, namespace)
        values = vars(found)
        targets = {
            "/".join(action.option_strings): (Path(values[action.dest]), action.kind)
            for action in self._actions
            if isinstance(action, Output) and values[action.dest] not in (None, STANDARD_OUTPUT)
        }
        outputs = {action.dest for action in self._actions if isinstance(action, Output)}
        inputs = paths_in(
            tuple(value) if isinstance(value, list) else value
            for name, value in values.items() if name not in outputs
        )
        keep_safe(targets, inputs, bool(values.get("force")))
        return found

    def _require_known_options(self, args: Sequence[str]) -> None:
        """A slip of the pen, before the parser complains of what it left unsaid."""
        known = set(self._option_string_actions)
        if any(a.nargs == argparse.REMAINDER and not a.option_strings for a in self._actions):
            return  # the rest has a parser of its own
        for argument in args:
            option = argument.partition("=")[0]
            if option in ("--", "--ros-args"):
                return
            if option.startswith("--") and not any(name.startswith(option) for name in known):
                self.error(f"unknown option {option}{did_you_mean(option, known)}")

    def error(self, message: str) -> NoReturn:
        """One line that says what was wrong and where help is."""
        where = self.prog.removeprefix(PROGRAM).strip()
        if choice := _INVALID_CHOICE.search(message):
            message += did_you_mean(choice[1], re.findall(r"[\w/.-]+", choice[2]))
        said = f"{where}: {message}" if where else message
        raise InputError(f"{said}; see {self.prog} --help")


class Output(argparse.Action):
    """An option that names what is written; `kind`: FILE, FOLDER (of files with names of their
    own), BAG, NEW (never replaced), or OWN (the command calls `keep_safe` when it knows the
    files)."""

    def __init__(self, *args: Any, kind: str = FILE, **options: Any) -> None:
        super().__init__(*args, **options)
        self.kind = kind

    def __call__(
        self, parser: argparse.ArgumentParser, namespace: argparse.Namespace, values: Any,
        option_string: str | None = None,
    ) -> None:
        """Keep the path."""
        setattr(namespace, self.dest, values)


def add_output(parser: argparse.ArgumentParser, option: str, kind: str, **rest: Any) -> None:
    """Add an option that names what is written, and --force once."""
    parser.add_argument(option, action=Output, kind=kind, **rest)
    if kind != NEW and "--force" not in parser._option_string_actions:
        parser.add_argument(
            "--force", action="store_true", help="replace outputs that exist (inputs never)"
        )


def add_dask_option(parser: argparse.ArgumentParser, shared: str) -> None:
    """Add the address of a cluster."""
    parser.add_argument(
        "--dask", metavar="ADDRESS",
        help="on the workers of this dask scheduler instead, tcp://host:8786 say; they see "
        f"{shared} under the same path",
    )


def one_of(words: Callable[[], Iterable[str]]) -> Callable[[str], str]:
    """Type of an option that takes one of some words, which are looked up when it is used: the help
    need not load what knows them."""

    def checked(word: str) -> str:
        known = tuple(words())
        if word not in known:
            choices = ", ".join(map(repr, known))
            raise argparse.ArgumentTypeError(f"invalid choice: {word!r} (choose from {choices})")
        return word

    return checked


def add_json_option(parser: argparse.ArgumentParser, what: str) -> None:
    """Add --json [FILE]; `what` it holds."""
    add_output(
        parser, "--json", FILE, metavar="FILE", nargs="?", const=STANDARD_OUTPUT,
        help=f"write {what} as JSON; without FILE, or to -, on standard output",
    )
