"""How much memory and time a piece of work may take: more ends in an exception."""

import resource
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


class TooLong(Exception):
    """The work went on beyond its time."""


@contextmanager
def allowance(memory: int, seconds: float) -> Iterator[None]:
    """MemoryError beyond `memory` bytes more than now, TooLong beyond `seconds` of CPU time.

    Of the main thread only, for the signal; CPU time, for a busy machine is no fault.
    """

    def too_long(*_: object) -> None:
        raise TooLong(f"more than {seconds:g} s")

    before, hard = resource.getrlimit(resource.RLIMIT_AS)
    handler = signal.signal(signal.SIGVTALRM, too_long)
    resource.setrlimit(resource.RLIMIT_AS, (address_space() + memory, hard))
    signal.setitimer(signal.ITIMER_VIRTUAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0.0)
        resource.setrlimit(resource.RLIMIT_AS, (before, hard))
        signal.signal(signal.SIGVTALRM, handler)


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
