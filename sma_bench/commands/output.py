"""How commands print findings and write results."""

import argparse
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, redirect_stdout
from typing import Any, TextIO

from rich.text import Text

from sma_bench.border import printable
from sma_bench.commands.tables import output_console
from sma_bench.findings import Finding
from sma_bench.results import json_text, write_result

STANDARD_OUTPUT = "-"
_STYLES = {"info": "green", "warning": "yellow", "error": "red"}


def print_findings(findings: Iterable[Finding]) -> None:
    """One paragraph a finding, coloured on a terminal."""
    console = output_console()
    for finding in findings:
        head = Text(f"{finding.severity:8}", style=_STYLES[finding.severity])
        console.print(head + Text(told(finding), style="default"))


def say(text: str) -> None:
    """Print lines in which names from outside may stand."""
    print(printable(text, "\n"))


def told(finding: Finding) -> str:
    """A finding as it may be printed, whatever names from outside it holds."""
    return printable(f"{finding.subject}: {finding.text}", "\n")


def add_json_option(parser: argparse.ArgumentParser, what: str) -> None:
    """Add --json [FILE]; `what` it holds."""
    parser.add_argument(
        "--json", metavar="FILE", nargs="?", const=STANDARD_OUTPUT,
        help=f"write {what} as JSON; without FILE, or to -, on standard output and nothing else "
        "there",
    )


_results: list[TextIO] = []


@contextmanager
def results_apart(args: argparse.Namespace) -> Iterator[None]:
    """Where the result goes to standard output as JSON, what is told people goes to standard
    error."""
    if getattr(args, "json", None) != STANDARD_OUTPUT:
        yield
        return
    _results.append(sys.stdout)
    try:
        with redirect_stdout(sys.stderr):
            yield
    finally:
        _results.pop()


def write_json(path: str, document: dict[str, Any]) -> None:
    """Write a result file, whole or not at all; "-" is standard output.

    Raises:
        InputError: the folder cannot be written.
    """
    if path == STANDARD_OUTPUT:
        print(json_text(document), end="", flush=True, file=_results[-1] if _results else None)
        return
    write_result(path, document)
