"""Output of commands: tables that fit, progress with the time left, findings, JSON."""

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
from sma_bench.results import Invocation, card_text, json_text, write_result

if TYPE_CHECKING:
    from rich.console import Console

    from sma_bench.report.tables import Table

# Widths in characters. A table that does not fit is folded, not cut.
_FOR_FILES = 100  # of a table that does not go to a terminal
_LEAST, _NAME_WHOLE = 12, 40  # of a folded text at least; of a text that stays whole, at most
_BETWEEN = 2  # of the space between columns
_SEVERITIES = {"info": "green", "warning": "yellow", "error": "red"}
# Progress goes to standard error: on a terminal one line, shown after FIRST_SHOWN s and rewritten
# every _REFRESH s; elsewhere a line after FIRST_LINE s and every NEXT_LINE s.
FIRST_SHOWN, FIRST_LINE, NEXT_LINE, _REFRESH = 1.0, 5.0, 15.0, 0.1
_LEAST_SHARE = 0.02  # of the work: before it is done, the time left cannot be estimated


def say(text: str) -> None:
    """Print lines; unprintable characters, e.g. in names of files, are escaped."""
    print(printable(text, "\n"))


def write_json(path: str | None, document: dict[str, Any]) -> None:
    """Write a result to `path` ("-": standard output, None: nowhere). InputError: it cannot."""
    if path == STANDARD_OUTPUT:
        print(json_text(document), end="", flush=True, file=results[-1] if results else None)
    elif path:
        write_result(path, document)


def output_console() -> "Console":
    """A console on standard output. BrokenPipeError: the reader of the pipe has closed it."""
    from rich.console import Console

    def leave() -> None:
        raise BrokenPipeError

    console = Console(highlight=False)
    console.on_broken_pipe = leave  # type: ignore[method-assign]
    if not console.is_terminal and "COLUMNS" not in environ:
        console.width = _FOR_FILES
    return console


def print_card(result: Any, asked: Invocation | None = None) -> None:
    """Print the card of a result; `asked`: for its advice on what to do next."""
    say(f"{card_text(result, output_console().width, asked)}\n")


def print_table(table: "Table") -> None:
    """Print a table. Where it is too wide, texts are folded at spaces and items of lists get lines
    of their own; columns that still do not fit follow in a further part, after the first column."""
    from rich.cells import cell_len
    from rich.table import Table as Shown
    from rich.text import Text

    console = output_console()
    if table.title:
        console.print(Text(table.title, style="bold"))
    rows = [[printable(cell.replace("; ", "\n"), "\n") for cell in row] for row in table.rows]
    columns = [*zip(table.header, *rows, strict=True)]
    full = [max(cell_len(line) for cell in own for line in cell.split("\n")) for own in columns]
    words = [max((cell_len(word) for cell in own for word in cell.split()), default=0)
             for own in columns]
    least = [word if k in table.numeric else whole if whole <= _NAME_WHOLE else
             min(max(word, _LEAST), _NAME_WHOLE)
             for k, (word, whole) in enumerate(zip(words, full, strict=True))]
    parts = [[0]]
    for k in range(1, len(full)):
        width = sum(least[j] + _BETWEEN for j in [*parts[-1], k]) - _BETWEEN
        if width > console.width and len(parts[-1]) > 1:
            parts.append([0])
        parts[-1].append(k)
    for part in parts:
        # The columns that need the least space to be shown unfolded get theirs first.
        space = console.width - sum(least[k] + _BETWEEN for k in part) + _BETWEEN
        shown, widths = Shown(box=None, pad_edge=False), dict[int, int]()
        for k in sorted(part, key=lambda k: full[k] - least[k]):
            widths[k] = least[k] + max(min(full[k] - least[k], space), 0)
            space -= widths[k] - least[k]
        for k in part:
            shown.add_column(Text(table.header[k]), width=widths[k], overflow="fold",
                             justify="right" if k in table.numeric else "left")
        for row in rows:
            if len(parts) == 1 or any(row[k] for k in part[1:]):
                shown.add_row(*(Text(row[k]) for k in part))
        console.print(shown, *([] if part is parts[-1] else [""]), sep="\n")


def print_findings(findings: Iterable[Finding]) -> None:
    """One paragraph per finding, folded to the right of its severity, coloured on a terminal."""
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
    """Progress of a piece of work: the share done, the current step, and the time left."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:  # s
        self.share, self.what = 0.0, ""
        self._clock, self._begin = clock, clock()
        self._heard = self._begin

    def report(self, share: float, what: str = "") -> None:
        """Update; the share never decreases, an empty `what` keeps the last one."""
        if share > self.share:
            self.share, self._heard = min(share, 1.0), self._clock()
        self.what = printable(what) or self.what

    @property
    def left(self) -> float | None:
        """Time left [s] at the speed so far; None while it cannot be estimated."""
        if self.share < _LEAST_SHARE:
            return None
        foreseen = (self._heard - self._begin) * (1.0 / self.share - 1.0)
        foreseen -= self._clock() - self._heard
        return foreseen if foreseen > 0.0 else None

    @property
    def words(self) -> str:
        """Share and time left, or the time elapsed if the time left is unknown."""
        left = self.left
        seconds = self._clock() - self._begin if left is None else left
        minutes, rest = divmod(round(seconds), 60)
        hours, minutes = divmod(minutes, 60)
        span = f"{minutes} min {rest} s" if minutes else f"{rest} s"
        span = f"{hours} h {minutes} min" if hours else span
        share = f"{self.share:.0%}, " if self.share else ""
        return f"{share}{span} {'elapsed' if left is None else 'left'}"


@contextmanager
def progress(title: str, state: WorkState | None = None) -> Iterator[Report]:
    """Show the progress that the work inside reports by the yielded function. Print nothing
    meanwhile: it would run into the line. `state`: of work that has begun already."""
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
