"""What one part of the campaign found: a line of the table."""

from collections.abc import Sequence
from dataclasses import dataclass

_SHOWN = 5


@dataclass(frozen=True)
class Outcome:
    """A line of the table: how often something was tried, what came of it, what was allowed."""

    section: str
    what: str
    tried: int
    found: str
    limit: str
    met: bool

    @classmethod
    def of(
        cls, section: str, what: str, tried: int, wrong: Sequence[str], limit: str = "failed 0"
    ) -> "Outcome":
        """Of so many tries, of which each that went wrong has its text."""
        failures = [text for text in wrong if text]
        found = "; ".join([f"failed {len(failures)}", *dict.fromkeys(failures[:_SHOWN])])
        return cls(section, what, tried, found, limit, not failures)
