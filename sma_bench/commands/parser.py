"""The parser that every command shares: examples below the options, errors in one line."""

import argparse
from collections.abc import Callable, Iterable, Sequence
from typing import NoReturn

from sma_bench.commands.examples import EXAMPLES
from sma_bench.errors import InputError

PROGRAM = "sma-bench"


class CommandParser(argparse.ArgumentParser):
    """Raises InputError instead of printing the usage and an error below it."""

    def error(self, message: str) -> NoReturn:
        """One line that says what was wrong and where help is."""
        where = self.prog.removeprefix(PROGRAM).strip()
        told = f"{where}: {message}" if where else message
        raise InputError(f"{told}; see {self.prog} --help")


def command_parser(name: str, description: str | None) -> CommandParser:
    """An empty parser of `sma-bench name`, with the command's examples in its help."""
    return CommandParser(
        prog=f"{PROGRAM} {name}", description=description,
        epilog=example_text(EXAMPLES.get(name, ())),
        formatter_class=argparse.RawDescriptionHelpFormatter,
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


def example_text(examples: Sequence[str]) -> str:
    """Examples as they stand in a help text; empty without any."""
    if not examples:
        return ""
    return "\n".join(["examples:", *(f"  {PROGRAM} {example}" for example in examples)])
