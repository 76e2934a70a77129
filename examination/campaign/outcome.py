"""What one part of the campaign found: a line of the table."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Outcome:
    """A line of the table: how often something was tried, what came of it, what was allowed."""

    section: str
    what: str
    tried: int
    found: str
    limit: str
    met: bool


@dataclass(frozen=True)
class Campaign:
    """A section of the table.

    `run(size, seed, folder)` does it `size` times (`unit` says what), writing below `folder`.
    """

    name: str
    about: str
    size: int
    unit: str
    run: Callable[[int, int, Path], list[Outcome]]
