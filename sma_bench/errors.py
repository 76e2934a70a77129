"""The one exception a user can cause, what it may add, and the one that nobody should see."""

import difflib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager


class InputError(ValueError):
    """Bad input: one line that says what, where, which value and what was expected."""


class FitError(RuntimeError):
    """A fit has left the numbers of a bench: a fault of this package, whatever the records hold."""


@contextmanager
def errors_in(where: str) -> Iterator[None]:
    """Error lines begin with where they were found; what the system refuses is one, too."""
    try:
        yield
    except (InputError, OSError) as error:
        why = error.strerror if isinstance(error, OSError) else error
        raise InputError(f"{where}: {why}") from None


def did_you_mean(word: object, known: Iterable[str]) -> str:
    """Say ", did you mean X?" where a known word is near, else nothing."""
    close = difflib.get_close_matches(str(word), list(known), n=1)
    return f", did you mean {close[0]}?" if close else ""
