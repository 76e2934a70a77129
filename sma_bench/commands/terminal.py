"""What commands say: tables that fit, progress with the time left, findings, results as JSON."""

import sys
import threading
import time
from collections.abc import Callable, Container, Iterable, Iterator, Sequence
from contextlib import contextmanager
from os import environ
from typing import TYPE_CHECKING, Any, Literal

from sma_bench.border import printable
from sma_bench.commands.options import STANDARD_OUTPUT, results
from sma_bench.findings import Finding
from sma_bench.progress import Report
from sma_bench.results import json_text, write_result

if TYPE_CHECKING:
    from rich.console import Console

# --- Tables: no wider than a terminal, or 100 cells in a file or a pipe. What does not fit is
# folded, never cut, since a name that is cut cannot be looked up.

_FOR_FILES = 100  # cells of a line in a file or a pipe
_NAME_WHOLE = 36  # cells of the first column, by which one looks things up, that are not folded
_LEAST, _BETWEEN = 10, 2  # cells of a column that is folded, and between columns


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


def print_table(
    console: "Console",
    headings: Sequence[str],
    rows: Sequence[Sequence[str]],
    right: Container[int] = (),
    *,
    title: str = "",
) -> None:
    """Print a table.

    Args:
        headings, rows: text, not markup, a cell a column.
        right: columns of numbers, flush right and folded last.
    """
    from rich.cells import cell_len
    from rich.table import Table
    from rich.text import Text

    if title:
        console.print(Text(title, style="bold"))
    texts = [[printable(cell, "\n") for cell in row] for row in rows]
    columns = [*zip(headings, *texts, strict=True)]
    full = [max(cell_len(line) for cell in own for line in cell.split("\n")) for own in columns]
    # Where not all fits, numbers and names keep their width if something is left for the others.
    space, kept = console.width - _BETWEEN * (len(full) - 1), dict[int, int]()
    if sum(full) > space:
        kept = {k: w for k, w in enumerate(full) if k in right}
        kept.setdefault(0, min(full[0], _NAME_WHOLE))
        if sum(kept.values()) + _LEAST * (len(full) - len(kept)) > space:
            kept = {}
    table = Table(box=None, pad_edge=False)
    for k, heading in enumerate(headings):
        justify: Literal["right", "left"] = "right" if k in right else "left"
        table.add_column(Text(heading), justify=justify, overflow="fold", width=kept.get(k))
    for row in texts:
        table.add_row(*map(Text, row))
    console.print(table)


# --- How far a command is and what time is left, on standard error.
#
# A bar on a terminal, elsewhere a line now and then; nothing at all where it is over in a moment.
# The rooms below the commands take plain callables and know nothing of this.

FIRST_BAR, FIRST_LINE, NEXT_LINE = 1.0, 5.0, 15.0  # s
_REFRESH = 0.1
_NAME = (8, 44)  # cells of what is being done, at least and at most
_REST = 32  # cells for the bar and the time left
_LEAST_SHARE = 0.02  # less says nothing of the rest
_PLAN_HOLDS = 2.0  # s, until which a plan counts for more than the pace


class WorkState:
    """How a piece of work goes: the share done, what is being done, and the time left."""

    def __init__(
        self, clock: Callable[[], float] = time.monotonic, expected: float | None = None
    ) -> None:
        """`clock` gives s; `expected` s are planned; this machine may need more or less."""
        self.share, self.what, self._expected = 0.0, "", expected
        self._clock, self._begin = clock, clock()
        self._heard = self._begin

    def report(self, share: float, what: str = "") -> None:
        """It never goes back; an empty `what` leaves the last one."""
        if share > self.share:
            self.share, self._heard = min(share, 1.0), self._clock()
        self.what = printable(what) or self.what

    @property
    def gone(self) -> float:
        """Time gone [s]."""
        return self._clock() - self._begin

    @property
    def left(self) -> float | None:
        """Time left [s] at the speed so far; None while that is not known."""
        gone, now = self._heard - self._begin, self._clock()
        if self._expected is not None:
            # The rest of the plan, as much slower as this machine has been so far.
            planned = self.share * self._expected
            whole = self._expected * (gone + _PLAN_HOLDS) / (planned + _PLAN_HOLDS)
        elif self.share >= _LEAST_SHARE:
            whole = gone / self.share
        else:
            return None
        foreseen = whole * (1.0 - self.share) - (now - self._heard)
        return foreseen if foreseen > 0.0 else None

    @property
    def words(self) -> str:
        """Share and time left; the time gone where that is all that is known."""
        left = self.left
        if left is None:
            gone = duration(self.gone)
            return f"{self.share:.0%}, {gone} gone" if self.share else gone
        return f"{self.share:.0%}, {duration(left)} left"


def duration(seconds: float) -> str:
    """In words: "8 s", "2 min 5 s", "1 h 3 min"."""
    minutes, rest = divmod(round(seconds), 60)
    if not minutes:
        return f"{rest} s"
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes} min" if hours else f"{minutes} min {rest} s"


@contextmanager
def progress(title: str, state: WorkState | None = None) -> Iterator[Report]:
    """Show how far the work inside is, which calls what is yielded.

    Print nothing on standard output meanwhile: it would run into the bar.

    Args:
        title: leads the lines outside a terminal.
        state: one that has begun already, to go on with.
    """
    state, over = state or WorkState(), threading.Event()
    moves = sys.stderr.isatty() and environ.get("TERM") not in ("dumb", "unknown")
    show = _bar if moves else _lines
    display = threading.Thread(target=show, args=(title, state, over), daemon=True)
    display.start()
    try:
        yield state.report
    finally:
        over.set()
        display.join()


def _bar(title: str, state: WorkState, over: threading.Event) -> None:
    if over.wait(FIRST_BAR):
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn
    from rich.table import Column
    from rich.text import Text

    name = TextColumn("{task.description}", markup=False, table_column=Column(no_wrap=True))
    bar = BarColumn(None, table_column=Column(ratio=1))
    words = TextColumn("{task.fields[words]}", style="", table_column=Column(no_wrap=True))
    console = Console(stderr=True, highlight=False)
    # Only what goes to standard error may be drawn above the bar: results are not for it.
    with Progress(
        name, bar, words, console=console, transient=True, redirect_stdout=False, expand=True
    ) as shown:
        task = shown.add_task(title, total=1.0, words="")
        while not over.wait(_REFRESH):
            total = 1.0 if state.share else None
            what = Text(state.what or title)
            what.truncate(max(_NAME[0], min(_NAME[1], console.width - _REST)), overflow="ellipsis")
            shown.update(
                task,
                completed=state.share,
                total=total,
                description=what.plain,
                words=state.words,
            )


def _lines(title: str, state: WorkState, over: threading.Event) -> None:
    wait = FIRST_LINE
    while not over.wait(wait):
        what = f" ({state.what})" if state.what else ""
        print(f"sma-bench: {title}: {state.words}{what}", file=sys.stderr, flush=True)
        wait = NEXT_LINE


# --- How commands print findings and write results.

_SEVERITY = 8  # cells
_STYLES = {"info": "green", "warning": "yellow", "error": "red"}


def print_findings(findings: Iterable[Finding]) -> None:
    """One paragraph a finding, folded beside its severity and coloured on a terminal."""
    from rich.table import Column, Table
    from rich.text import Text

    console = output_console()
    for finding in findings:
        severity = Text(finding.severity, style=_STYLES[finding.severity])
        row = Table.grid(Column(width=_SEVERITY), Column(overflow="fold"))
        text = printable(f"{finding.subject}: {finding.text}", "\n").replace(" +- ", " ± ")
        row.add_row(severity, Text(text))
        console.print(row)


def say(text: str) -> None:
    """Print lines in which names from outside may stand."""
    print(printable(text, "\n"))


def write_json(path: str, document: dict[str, Any]) -> None:
    """Write a result file, whole or not at all; "-" is standard output.

    Raises:
        InputError: the folder cannot be written.
    """
    if path == STANDARD_OUTPUT:
        print(json_text(document), end="", flush=True, file=results[-1] if results else None)
        return
    write_result(path, document)
