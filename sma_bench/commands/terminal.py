"""What commands say: tables that fit, progress with the time left, findings, results as JSON."""

import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from os import environ
from typing import TYPE_CHECKING, Any

from sma_bench.border import printable
from sma_bench.commands.options import STANDARD_OUTPUT, results
from sma_bench.findings import Finding
from sma_bench.progress import Report, silent
from sma_bench.results import json_text, write_result

if TYPE_CHECKING:
    from rich.console import Console

    from sma_bench.report.tables import Table

# A table is no wider than the terminal, or this in a file; below the other all columns are folded.
_FOR_FILES, _ROOM = 100, 80  # cells
_NAME_WHOLE = 36  # cells of the first column, by which one looks things up, that are not folded
_SEVERITIES = {"info": "green", "warning": "yellow", "error": "red"}


def say(text: str) -> None:
    """Print lines in which names from outside may stand."""
    print(printable(text, "\n"))


def write_json(path: str | None, document: dict[str, Any]) -> None:
    """Write a result to `path`, "-" standard output, None nowhere. InputError: it cannot be."""
    if path == STANDARD_OUTPUT:
        print(json_text(document), end="", flush=True, file=results[-1] if results else None)
    elif path:
        write_result(path, document)


def output_console() -> "Console":
    """Standard output; a reader of a pipe who leaves early is a BrokenPipeError."""
    from rich.console import Console

    def leave() -> None:
        raise BrokenPipeError

    console = Console(highlight=False)
    console.on_broken_pipe = leave  # type: ignore[method-assign]
    if not console.is_terminal and "COLUMNS" not in environ:
        console.width = _FOR_FILES
    return console


def print_table(table: "Table") -> None:
    """Print a table; numeric columns and names keep their width where the terminal has it, what
    else does not fit is folded, not cut."""
    from rich.cells import cell_len
    from rich.table import Table as Shown
    from rich.text import Text

    console = output_console()
    if table.title:
        console.print(Text(table.title, style="bold"))
    rows = [[printable(cell, "\n") for cell in row] for row in table.rows]
    named = min(max(cell_len(row[0]) for row in (table.header, *rows)), _NAME_WHOLE)
    shown, has_room = Shown(box=None, pad_edge=False), console.width >= _ROOM
    for k, heading in enumerate(table.header):
        is_number = k in table.numeric
        shown.add_column(Text(heading), justify="right" if is_number else "left", overflow="fold",
                         width=None if k or not has_room else named,
                         no_wrap=is_number and has_room)
    for row in rows:
        shown.add_row(*map(Text, row))
    console.print(shown)


def print_findings(findings: Iterable[Finding]) -> None:
    """One paragraph a finding, folded to the right of its severity, coloured on a terminal."""
    from rich.table import Column
    from rich.table import Table as Shown
    from rich.text import Text

    console = output_console()
    for finding in findings:
        row = Shown.grid(Column(width=max(map(len, _SEVERITIES)) + 1), Column(overflow="fold"))
        text = printable(f"{finding.subject}: {finding.text}", "\n").replace(" +- ", " ± ")
        row.add_row(Text(finding.severity, style=_SEVERITIES[finding.severity]), Text(text))
        console.print(row)


@contextmanager
def progress(title: str) -> Iterator[Report]:
    """Show on a terminal how far the work inside is, which calls what is yielded, and the time
    left. Print nothing on standard output meanwhile: it would run into the line."""
    if not sys.stderr.isatty():
        yield silent
        return
    from rich.console import Console
    from rich.progress import Progress, TextColumn, TimeRemainingColumn
    from rich.text import Text

    before, after = (TextColumn(form, markup=False) for form in (
        "sma-bench: {task.description}: {task.percentage:.0f}%", "left {task.fields[what]}"))
    with Progress(before, TimeRemainingColumn(), after, console=Console(stderr=True),
                  transient=True, redirect_stdout=False) as shown:
        task = shown.add_task(printable(title), total=1.0, what="")

        def report(share: float, what: str = "") -> None:
            """It never goes back; an empty `what` leaves the last one."""
            known = shown.tasks[0]
            text = Text(f"({printable(what)})" if what else known.fields["what"])
            text.truncate(max(shown.console.width - len(title) - 32, 0), overflow="ellipsis")
            done = max(min(share, 1.0), known.completed)
            shown.update(task, completed=done, what=text.plain)

        yield report
