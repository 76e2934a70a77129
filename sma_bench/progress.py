"""How a long piece of work tells how far it is: plain callables, which commands turn into a bar."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import accumulate
from typing import TypeVar

T = TypeVar("T")
# Called with the share that is done (0 to 1), and what comes now ("": as before).
Report = Callable[[float, str], None]
# What comes where functions of the physics have no machine code yet: nothing moves for a while.
COMPILING = "compiling, once after an installation"


def silent(share: float, what: str = "") -> None:
    """For callers that do not ask."""


def part(report: Report, low: float, high: float, name: str = "") -> Report:
    """The reporter of a part of the work, from one share to another; `name` leads what it tells."""

    def reporter(share: float, what: str = "") -> None:
        report(low + (high - low) * min(share, 1.0), ": ".join(filter(None, (name, what))))

    return reporter


def in_turn(items: Sequence[T], report: Report, named: Callable[[T], str]) -> Iterator[T]:
    """The items one after the other, each reported when its turn has come."""
    for k, item in enumerate(items):
        report(k / len(items), named(item))
        yield item


def counted(report: Report, total: int, unit: str) -> Callable[[int], None]:
    """A reporter that is called with how many of `total` are done."""

    def reporter(done: int) -> None:
        report(done / total if total else 1.0, f"{unit} {min(done + 1, total)} of {total}")

    reporter(0)
    return reporter


def shares(plan: Mapping[str, float]) -> dict[str, tuple[float, float]]:
    """From which share of the whole to which steps go. `plan`: how long they take, in any unit."""
    ends = [0.0, *accumulate(plan.values())]
    return {step: (low / ends[-1], high / ends[-1])
            for step, low, high in zip(plan, ends, ends[1:], strict=False)}


def by_name(report: Report, plan: Mapping[str, float]) -> Callable[[str], None]:
    """A reporter that is called with the step of a plan (see `shares`) that comes now."""
    begins = {step: low for step, (low, _) in shares(plan).items()}
    return lambda step: report(begins.get(step, 0.0), step)
