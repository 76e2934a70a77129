"""What commands say: tables that fit, progress with the time left, findings, results as JSON."""

import argparse
import sys
import threading
import time
from collections.abc import Callable, Container, Iterable, Iterator, Sequence
from contextlib import contextmanager, redirect_stdout
from os import environ
from typing import TYPE_CHECKING, Any, TextIO

from rich.cells import cell_len
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, ProgressColumn, Task, TextColumn
from rich.table import Column, Table
from rich.text import Text

from sma_bench.border import printable
from sma_bench.commands.parser import FILE, STANDARD_OUTPUT, add_output
from sma_bench.errors import InputError
from sma_bench.findings import Finding
from sma_bench.progress import Report
from sma_bench.results import json_text, write_result

if TYPE_CHECKING:
    from sma_bench.report.drawing import PaperColumn

# --- Tables that fit: no wider than a terminal, or 100 cells in a file or a pipe.
#
# What does not fit is folded, never cut, since a name that is cut cannot be looked up; where
# folding does not do either, every row becomes a block of lines.

_NARROWEST, _NARROWEST_NAME = 20, 30  # cells of a column that is folded; of the first one
_NEVER_BROKEN = 10
_BETWEEN = 2
_FOR_FILES = 100  # cells of a line in a file or a pipe
_SAYS_NOTHING = ("", "·")


class PipedConsole(Console):
    """A console whose reader may leave early: `main` ends the command then."""

    def on_broken_pipe(self) -> None:
        raise BrokenPipeError


def output_console() -> Console:
    """Standard output; in a file or a pipe tables are as wide as a page."""
    console = PipedConsole(highlight=False)
    if not console.is_terminal and "COLUMNS" not in environ:
        console.width = _FOR_FILES
    return console


def print_table(
    console: Console,
    headings: Sequence[str],
    rows: Sequence[Sequence[str]],
    right: Container[int] = (),
    *,
    title: str = "",
    styles: Sequence[str] = (),
) -> None:
    """Print a table.

    Args:
        headings, rows: text, not markup, a cell a column.
        right: columns of numbers, flush right and never folded.
        styles: of the rows, none when empty.
    """
    rows = [[printable(cell, "\n") for cell in row] for row in rows]
    columns = list(zip(headings, *rows, strict=True))
    widths = _widths(columns, right, console.width - _BETWEEN * (len(columns) - 1))
    if not widths:
        _print_blocks(console, headings, rows, title, styles)
        return
    if title:
        console.print(f"[bold]{escape(title)}[/]")
    table = Table(box=None, pad_edge=False)
    for k, heading in enumerate(headings):
        if k in right:
            table.add_column(Text(heading), justify="right", no_wrap=True, width=widths[k])
        else:
            table.add_column(Text(heading), overflow="fold", width=widths[k])
    for k, row in enumerate(rows):
        table.add_row(*map(Text, row), style=styles[k] if styles else None)
    console.print(table)


def _widths(columns: Sequence[Sequence[str]], right: Container[int], space: int) -> list[int]:
    """Widths of the columns: text wrapped between words, or else within them, as little as may be
    in the first column, by which one looks things up; none where that needs more space."""
    lines = [[line for cell in column for line in cell.split("\n")] for column in columns]
    full = [max(map(cell_len, own)) for own in lines]
    whole, least = [], []
    for k, own in enumerate(lines):
        if k in right or full[k] <= _NEVER_BROKEN:
            word = shortest = full[k]
        else:
            word = max((cell_len(word) for line in own for word in line.split()), default=0)
            shortest = min(full[k], _NARROWEST) if full[k] > _NARROWEST else word
        whole.append(max(word, shortest))
        least.append(shortest)
    widths = whole
    if sum(whole) > space:
        widths = [min(whole[0], space - sum(least[1:])), *least[1:]]
    if widths[0] < min(whole[0], _NARROWEST_NAME):
        return []
    for k, wanted in enumerate(full):
        widths[k] += min(wanted - widths[k], space - sum(widths))
    return widths


def _print_blocks(
    console: Console, headings: Sequence[str], rows: Sequence[Sequence[str]], title: str,
    styles: Sequence[str],
) -> None:
    """The first cell of a row on a line of its own, below it the others with their headings."""
    if title:
        console.print(f"[bold]{escape(title)}[/]")
    for k, (name, *cells) in enumerate(rows):
        style = styles[k] if styles else ""
        console.print(Text(name, style=style or "bold", overflow="fold"))
        for heading, cell in zip(headings[1:], cells, strict=True):
            if cell not in _SAYS_NOTHING:
                line = f"  {heading}: {cell}" if heading else f"  {cell}"
                console.print(Text(line, style=style, overflow="fold"))


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
    show = _bar if is_live() else _lines
    display = threading.Thread(target=show, args=(title, state, over), daemon=True)
    display.start()
    try:
        yield state.report
    finally:
        over.set()
        display.join()


def is_live() -> bool:
    """Whether standard error can show a bar that moves."""
    return sys.stderr.isatty() and environ.get("TERM") not in ("dumb", "unknown")


def _bar(title: str, state: WorkState, over: threading.Event) -> None:
    if over.wait(FIRST_BAR):
        return
    name = TextColumn("{task.description}", markup=False, table_column=Column(no_wrap=True))
    bar = BarColumn(None, table_column=Column(ratio=1))
    console = Console(stderr=True, highlight=False)
    # Only what goes to standard error may be drawn above the bar: results are not for it.
    with Progress(
        name, bar, _Words(state), console=console, transient=True, redirect_stdout=False,
        expand=True,
    ) as shown:
        task = shown.add_task(title, total=1.0)
        while not over.wait(_REFRESH):
            total = 1.0 if state.share else None
            what = Text(state.what or title)
            what.truncate(max(_NAME[0], min(_NAME[1], console.width - _REST)), overflow="ellipsis")
            shown.update(task, completed=state.share, total=total, description=what.plain)


class _Words(ProgressColumn):
    def __init__(self, state: WorkState) -> None:
        super().__init__(Column(no_wrap=True))
        self._state = state

    def render(self, task: Task) -> Text:
        return Text(self._state.words)


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
    console = output_console()
    for finding in findings:
        severity = Text(finding.severity, style=_STYLES[finding.severity])
        row = Table.grid(Column(width=_SEVERITY), Column(overflow="fold"))
        row.add_row(severity, Text(finding_line(finding)))
        console.print(row)


def say(text: str) -> None:
    """Print lines in which names from outside may stand."""
    print(printable(text, "\n"))


def finding_line(finding: Finding) -> str:
    """A finding as it may be printed, whatever names from outside it holds."""
    return printable(f"{finding.subject}: {finding.text}", "\n").replace(" +- ", " ± ")


def add_json_option(parser: argparse.ArgumentParser, what: str) -> None:
    """Add --json [FILE]; `what` it holds."""
    add_output(
        parser, "--json", FILE, metavar="FILE", nargs="?", const=STANDARD_OUTPUT,
        help=f"write {what} as JSON; without FILE, or to -, on standard output and nothing else "
        "there",
    )


def add_figure_options(parser: argparse.ArgumentParser, default: str | None = None) -> None:
    """Add --column and --font: figures for papers; `column_of` reads them."""
    unasked = f"default {default}" if default else "default: PNG only"
    parser.add_argument(
        "--column", metavar="single|double|MM", default=default, type=_column_word,
        help="write every figure as SVG and PDF in this width too (single is 89 mm, double 183 "
        f"mm), and as CSV what is drawn in it ({unasked})",
    )
    parser.add_argument(
        "--font", type=float, metavar="PT", help="size of the letters in such a figure"
    )


def _column_word(text: str) -> str:
    if text not in ("single", "double"):
        try:
            if not 30.0 <= float(text) <= 500.0:
                raise ValueError
        except ValueError:
            raise argparse.ArgumentTypeError(
                f"{text!r}, expected single, double or a width of 30 to 500 mm"
            ) from None
    return text


def column_of(args: argparse.Namespace) -> "PaperColumn | None":
    """The column for which figures are written.

    Raises:
        InputError: letters that nobody can read, or without a column.
    """
    if args.font is not None and (args.column is None or not 4.0 <= args.font <= 24.0):
        raise InputError(f"--font is {args.font:g} pt, expected 4 to 24 pt, and --column with it")
    if args.column is None:
        return None
    from sma_bench.report.drawing import COLUMNS  # matplotlib: half a second to load

    column = COLUMNS.get(args.column) or COLUMNS["double"]._replace(width=float(args.column))
    return column if args.font is None else column._replace(font=args.font)


def add_ros_option(parser: argparse.ArgumentParser) -> None:
    """Add --ros-args, which takes all that follows; `ros_arguments` reads it."""
    parser.add_argument(
        "--ros-args", metavar="ARGUMENT", nargs=argparse.REMAINDER, default=[],
        help="all that follows is for ROS, e.g. -p "
        "qos_overrides./diagnostics.subscription.reliability:=best_effort",
    )


def ros_arguments(args: argparse.Namespace) -> list[str]:
    """What rclpy.init takes."""
    return ["--ros-args", *args.ros_args] if args.ros_args else []


_results: list[TextIO] = []


@contextmanager
def results_apart(args: argparse.Namespace) -> Iterator[None]:
    """Where the result goes to standard output as JSON, what is for people goes to standard
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
