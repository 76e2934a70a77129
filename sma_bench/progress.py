"""Progress of long work: plain callables, which commands show as a line with the time left."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import accumulate
from typing import TypeVar

T = TypeVar("T")
# Called with the share done (0 to 1) and the name of the current step ("": as before).
Report = Callable[[float, str], None]
# Name of the step while functions of the physics are compiled.
COMPILING = "compiling, once after an installation"


def silent(share: float, what: str = "") -> None:
    """Reports nothing."""


def part(report: Report, low: float, high: float, name: str = "") -> Report:
    """A reporter for a part of the work, from share `low` to `high`; `name` is put before steps."""

    def reporter(share: float, what: str = "") -> None:
        report(low + (high - low) * min(share, 1.0), ": ".join(filter(None, (name, what))))

    return reporter


def in_turn(items: Sequence[T], report: Report, named: Callable[[T], str]) -> Iterator[T]:
    """Yield the items, reporting each one first."""
    for k, item in enumerate(items):
        report(k / len(items), named(item))
        yield item


def shares(plan: Mapping[str, float]) -> dict[str, tuple[float, float]]:
    """Shares at which each step begins and ends. `plan`: how long steps take, in any unit."""
    ends = [0.0, *accumulate(plan.values())]
    return {step: (low / ends[-1], high / ends[-1])
            for step, low, high in zip(plan, ends, ends[1:], strict=False)}


def by_name(report: Report, plan: Mapping[str, float]) -> Callable[[str], None]:
    """A reporter that is called with the name of the step that begins; `plan`: see `shares`."""
    begins = {step: low for step, (low, _) in shares(plan).items()}
    return lambda step: report(begins.get(step, 0.0), step)
