"""A polite kill that tidies up as Ctrl-C does."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import NoReturn


class Terminated(KeyboardInterrupt):
    """A polite kill. Python would end by SIGINT, whatever the exit code, had a plain
    KeyboardInterrupt passed through code that a library compiles from text."""


@contextmanager
def terminated_as_interrupted() -> Iterator[None]:
    """A polite kill tidies up as Ctrl-C does."""

    def interrupt(number: int, frame: FrameType | None) -> NoReturn:
        raise Terminated

    before = signal.signal(signal.SIGTERM, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)
