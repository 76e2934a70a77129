"""Exceptions for wrong input and for faults of this package; helpers for their messages."""

import difflib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager


class InputError(ValueError):
    """Wrong input: a message of one line with what, where, which value and what was expected."""


class FitError(RuntimeError):
    """A fit left the range of a bench's numbers: always a fault of this package."""


@contextmanager
def errors_in(where: str) -> Iterator[None]:
    """Put `where` in front of the message of an InputError; make an OSError an InputError."""
    try:
        yield
    except (InputError, OSError) as error:
        why = error.strerror if isinstance(error, OSError) else error
        raise InputError(f"{where}: {why}") from None


def did_you_mean(word: object, known: Iterable[str]) -> str:
    """", did you mean X?" if a known word is similar, else ""."""
    close = difflib.get_close_matches(str(word), list(known), n=1)
    return f", did you mean {close[0]}?" if close else ""
