"""The reliability campaign: faults, and what the software must do under them."""

from collections.abc import Sequence
from typing import NamedTuple


class Outcome(NamedTuple):
    """A line of the table: what was tried, how often, the result, and the limit."""

    what: str
    tried: int
    found: str
    limit: str
    met: bool


def counted(what: str, tried: int, wrong: Sequence[str], limit: str = "failed 0") -> Outcome:
    """The outcome of `tried` trials, with a text in `wrong` for each failure."""
    failures = [text for text in wrong if text]
    found = "; ".join([f"failed {len(failures)}", *dict.fromkeys(failures[:5])])
    return Outcome(what, tried, found, limit, not failures)
