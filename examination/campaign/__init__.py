"""The reliability campaign: what is done to the software, and what it must do then."""

from collections.abc import Sequence
from typing import NamedTuple


class Outcome(NamedTuple):
    """A line of the table: how often something was tried, what came of it, what was allowed."""

    what: str
    tried: int
    found: str
    limit: str
    met: bool


def counted(what: str, tried: int, wrong: Sequence[str], limit: str = "failed 0") -> Outcome:
    """Of so many tries, of which each that went wrong has its text."""
    failures = [text for text in wrong if text]
    found = "; ".join([f"failed {len(failures)}", *dict.fromkeys(failures[:5])])
    return Outcome(what, tried, found, limit, not failures)
