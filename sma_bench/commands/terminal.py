"""What commands say: tables that fit, progress with the time left, findings, results as JSON."""

import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from os import environ
from shutil import get_terminal_size
from typing import TYPE_CHECKING, Any

from sma_bench.border import printable
from sma_bench.commands.options import STANDARD_OUTPUT, results
from sma_bench.findings import Finding
from sma_bench.progress import Report
from sma_bench.results import json_text, write_result

if TYPE_CHECKING:
    from rich.console import Console

    from sma_bench.report.tables import Table

# A table is no wider than the terminal, or this in a file; what does not fit is folded, not cut.
_FOR_FILES = 100  # cells
_NAME_WHOLE = 36  # cells of the first column, by which one looks things up, that are not folded
_LEAST, _BETWEEN = 10, 2  # cells of a column that is folded, and between columns
_SEVERITIES = {"info": "green", "warning": "yellow", "error": "red"}
# How far a command is stands on standard error: on a terminal in one line that is written anew,
# elsewhere in a line now and then; nothing at all where it is over in a moment.
FIRST_SHOWN, FIRST_LINE, NEXT_LINE, _REFRESH = 1.0, 5.0, 15.0, 0.1  # s
_LEAST_SHARE = 0.02  # less says nothing of the rest


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
    """Print a table; its numeric columns stand flush right and are folded last."""
    from rich.cells import cell_len
    from rich.table import Table as Shown
    from rich.text import Text

    console = output_console()
    if table.title:
        console.print(Text(table.title, style="bold"))
    rows = [[printable(cell, "\n") for cell in row] for row in table.rows]
    columns = [*zip(table.header, *rows, strict=True)]
    full = [max(cell_len(line) for cell in own for line in cell.split("\n")) for own in columns]
    # Where not all fits, numbers and names keep their width if something is left for the others.
    space, kept = console.width - _BETWEEN * (len(full) - 1), dict[int, int]()
    if sum(full) > space:
        kept = {k: w for k, w in enumerate(full) if k in table.numeric}
        kept.setdefault(0, min(full[0], _NAME_WHOLE))
        if sum(kept.values()) + _LEAST * (len(full) - len(kept)) > space:
            kept = {}
    shown = Shown(box=None, pad_edge=False)
    for k, heading in enumerate(table.header):
        shown.add_column(Text(heading), justify="right" if k in table.numeric else "left",
                         overflow="fold", width=kept.get(k))
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


class WorkState:
    """How a piece of work goes: the share done, what is being done, and the time left."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:  # s
        self.share, self.what = 0.0, ""
        self._clock, self._begin = clock, clock()
        self._heard = self._begin

    def report(self, share: float, what: str = "") -> None:
        """It never goes back; an empty `what` leaves the last one."""
        if share > self.share:
            self.share, self._heard = min(share, 1.0), self._clock()
        self.what = printable(what) or self.what

    @property
    def left(self) -> float | None:
        """Time left [s] at the speed so far; None while that is not known."""
        if self.share < _LEAST_SHARE:
            return None
        foreseen = (self._heard - self._begin) * (1.0 / self.share - 1.0)
        foreseen -= self._clock() - self._heard
        return foreseen if foreseen > 0.0 else None

    @property
    def words(self) -> str:
        """Share and time left; the time gone where that is all that is known."""
        left = self.left
        seconds = self._clock() - self._begin if left is None else left
        minutes, rest = divmod(round(seconds), 60)
        hours, minutes = divmod(minutes, 60)
        span = f"{minutes} min {rest} s" if minutes else f"{rest} s"
        span = f"{hours} h {minutes} min" if hours else span
        share = f"{self.share:.0%}, " if self.share else ""
        return f"{share}{span} {'gone' if left is None else 'left'}"


@contextmanager
def progress(title: str, state: WorkState | None = None) -> Iterator[Report]:
    """Show how far the work inside is, which calls what is yielded. Print nothing on standard
    output meanwhile: it would run into the line. `state`: of work that has begun already."""
    state, over = state or WorkState(), threading.Event()

    def show() -> None:
        stays = sys.stderr.isatty() and environ.get("TERM") not in ("dumb", "unknown")
        wait, begin, end = (FIRST_SHOWN, "\r\x1b[2K", "") if stays else (FIRST_LINE, "", "\n")
        shown = False
        while not over.wait(wait):
            what = f" ({state.what})" if state.what else ""
            line = f"sma-bench: {title}: {state.words}{what}"
            if stays:
                from rich.text import Text

                text = Text(line)
                text.truncate(get_terminal_size().columns, overflow="ellipsis")
                line = text.plain
            print(f"{begin}{line}", end=end, file=sys.stderr, flush=True)
            wait, shown = _REFRESH if stays else NEXT_LINE, True
        if stays and shown:
            print(begin, end="", file=sys.stderr, flush=True)

    display = threading.Thread(target=show, daemon=True)
    display.start()
    try:
        yield state.report
    finally:
        over.set()
        display.join()
