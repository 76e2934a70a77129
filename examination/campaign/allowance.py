"""How much memory and time a piece of work may take: more ends in an exception."""

import resource
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

_PATIENCE = 30.0
_TIMERS = {signal.ITIMER_PROF: signal.SIGPROF, signal.ITIMER_REAL: signal.SIGALRM}


class TooLong(Exception):
    """The work went on beyond its time."""


@contextmanager
def allowance(memory: int, seconds: float) -> Iterator[None]:
    """MemoryError beyond `memory` bytes more than now, TooLong beyond `seconds` of CPU time, the
    system's for it included, or beyond _PATIENCE times as long on the wall.

    Of the main thread only, for the signals; CPU time, for a busy machine is no fault; the wall's
    too, for what waits on a pipe takes none.
    """

    def too_long(number: int, _: object) -> None:
        on_the_wall = number == signal.SIGALRM
        raise TooLong(f"waits for {_PATIENCE * seconds:g} s" if on_the_wall
                      else f"more than {seconds:g} s")  # fmt: skip

    before, hard = resource.getrlimit(resource.RLIMIT_AS)
    handlers = {number: signal.signal(number, too_long) for number in _TIMERS.values()}
    resource.setrlimit(resource.RLIMIT_AS, (address_space() + memory, hard))
    for timer, patience in ((signal.ITIMER_PROF, 1.0), (signal.ITIMER_REAL, _PATIENCE)):
        signal.setitimer(timer, patience * seconds)
    try:
        yield
    finally:
        for timer in _TIMERS:
            signal.setitimer(timer, 0.0)
        resource.setrlimit(resource.RLIMIT_AS, (before, hard))
        for number, handler in handlers.items():
            signal.signal(number, handler)


def address_space() -> int:
    """Bytes that this process has mapped."""
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    return pages * resource.getpagesize()


def own_memory(pid: int | str = "self") -> int:
    """Bytes of memory that a process holds and cannot give back: its files' pages are not, as the
    system drops those and reads them again as it likes."""
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    fields = dict(line.split(":", 1) for line in lines)
    return sum(1024 * int(fields[name].split()[0]) for name in ("RssAnon", "RssShmem"))
