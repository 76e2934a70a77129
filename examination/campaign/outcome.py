"""What a piece of a campaign may take, in memory and time, and what came of it."""

import resource
import signal
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

_PATIENCE, _SHOWN = 30.0, 5


class Outcome(NamedTuple):
    """A line of the table: how often something was tried, what came of it, what was allowed."""

    section: str
    what: str
    tried: int
    found: str
    limit: str
    met: bool

    @classmethod
    def of(cls, section: str, what: str, tried: int, wrong: Sequence[str],
           limit: str = "failed 0") -> "Outcome":
        """Of so many tries, of which each that went wrong has its text."""
        failures = [text for text in wrong if text]
        found = "; ".join([f"failed {len(failures)}", *dict.fromkeys(failures[:_SHOWN])])
        return cls(section, what, tried, found, limit, not failures)


class TooLong(Exception):
    """The work went on beyond its time."""


@contextmanager
def allowance(memory: int, seconds: float) -> Iterator[None]:
    """MemoryError beyond `memory` bytes more than now, TooLong beyond `seconds` of CPU time, the
    system's for it included, or beyond _PATIENCE times as long on the wall. Of the main thread
    only, for the signals; CPU time, for a busy machine is no fault; the wall's too, for what waits
    on a pipe takes none."""

    def too_long(number: int, _: object) -> None:
        waits = number == signal.SIGALRM
        raise TooLong(f"{'waits for' if waits else 'more than'} {seconds * (_PATIENCE**waits):g} s")

    mapped = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    before, hard = resource.getrlimit(resource.RLIMIT_AS)
    handlers = {n: signal.signal(n, too_long) for n in (signal.SIGPROF, signal.SIGALRM)}
    resource.setrlimit(resource.RLIMIT_AS, (mapped + memory, hard))
    signal.setitimer(signal.ITIMER_PROF, seconds)
    signal.setitimer(signal.ITIMER_REAL, _PATIENCE * seconds)
    try:
        yield
    finally:
        for timer in (signal.ITIMER_PROF, signal.ITIMER_REAL):
            signal.setitimer(timer, 0.0)
        resource.setrlimit(resource.RLIMIT_AS, (before, hard))
        for number, handler in handlers.items():
            signal.signal(number, handler)
