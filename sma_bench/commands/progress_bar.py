"""How far a command is and what time is left, on standard error.

A bar on a terminal, elsewhere a line now and then; nothing at all where it is over in a moment.
The rooms below the commands take plain callables and know nothing of this.
"""

import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from os import environ

from rich.console import Console
from rich.progress import BarColumn, Progress, ProgressColumn, Task, TextColumn
from rich.table import Column
from rich.text import Text

from sma_bench.border import printable
from sma_bench.progress import Report

FIRST_BAR, FIRST_LINE, NEXT_LINE = 1.0, 5.0, 15.0  # s
_REFRESH = 0.1
_NAME = (8, 44)  # cells of what is being done, at least and at most
_REST = 32  # cells for the bar and the time left
_LEAST_SHARE = 0.02  # less says nothing of the rest


class Course:
    """How a piece of work goes: the share done, what is being done, and the time left."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        """`clock` gives s."""
        self.share, self.what = 0.0, ""
        self._clock, self._begin = clock, clock()
        self._told = self._begin

    def report(self, share: float, what: str = "") -> None:
        """It never goes back; an empty `what` leaves the last one."""
        if share > self.share:
            self.share, self._told = min(share, 1.0), self._clock()
        self.what = printable(what) or self.what

    @property
    def gone(self) -> float:
        """Time gone [s]."""
        return self._clock() - self._begin

    @property
    def left(self) -> float | None:
        """Time left [s] at the speed so far; None while that is not known."""
        if self.share < _LEAST_SHARE:
            return None
        now = self._clock()
        foreseen = (self._told - self._begin) * (1.0 / self.share - 1.0) - (now - self._told)
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
def progress(title: str, course: Course | None = None) -> Iterator[Report]:
    """Show how far the work inside is; it tells the yielded callable.

    Print nothing on standard output meanwhile: it would run into the bar.

    Args:
        title: leads the lines outside a terminal.
        course: one that has begun already, to go on with.
    """
    course, over = course or Course(), threading.Event()
    show = _bar if is_live() else _lines
    display = threading.Thread(target=show, args=(title, course, over), daemon=True)
    display.start()
    try:
        yield course.report
    finally:
        over.set()
        display.join()


def is_live() -> bool:
    """Whether standard error can show a bar that moves."""
    return sys.stderr.isatty() and environ.get("TERM") not in ("dumb", "unknown")


def _bar(title: str, course: Course, over: threading.Event) -> None:
    if over.wait(FIRST_BAR):
        return
    name = TextColumn("{task.description}", markup=False, table_column=Column(no_wrap=True))
    bar = BarColumn(None, table_column=Column(ratio=1))
    console = Console(stderr=True, highlight=False)
    # Only what goes to standard error may be drawn above the bar: results are not for it.
    with Progress(
        name, bar, _Words(course), console=console, transient=True, redirect_stdout=False,
        expand=True,
    ) as shown:
        task = shown.add_task(title, total=1.0)
        while not over.wait(_REFRESH):
            total = 1.0 if course.share else None
            what = Text(course.what or title)
            what.truncate(max(_NAME[0], min(_NAME[1], console.width - _REST)), overflow="ellipsis")
            shown.update(task, completed=course.share, total=total, description=what.plain)


class _Words(ProgressColumn):
    def __init__(self, course: Course) -> None:
        super().__init__(Column(no_wrap=True))
        self._course = course

    def render(self, task: Task) -> Text:
        return Text(self._course.words)


def _lines(title: str, course: Course, over: threading.Event) -> None:
    wait = FIRST_LINE
    while not over.wait(wait):
        what = f" ({course.what})" if course.what else ""
        print(f"sma-bench: {title}: {course.words}{what}", file=sys.stderr, flush=True)
        wait = NEXT_LINE
