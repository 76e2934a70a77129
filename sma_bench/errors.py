"""The one exception a user can cause, and what it may add."""

import difflib
from collections.abc import Iterable


class InputError(ValueError):
    """Bad input: one line that says what, where, which value and what was expected."""


def did_you_mean(word: object, known: Iterable[str]) -> str:
    """", did you mean X?" where a known word is near, else ""."""
    close = difflib.get_close_matches(str(word), list(known), n=1)
    return f", did you mean {close[0]}?" if close else ""
