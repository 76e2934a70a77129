"""What can be proposed: the family of drives that is searched, and the tests of the paper."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from sma_bench.border import read_yaml
from sma_bench.parameters import Parameters

_SHARES = {"full": (1.0,), "growing": (0.7, 0.8, 0.9, 1.0), "partial": (0.85, 0.8)}
_ORDERS = ("in turn", "one side", "the other side", "both sides", "the other side warmed before")
_SECONDS, _RESTS = (5.0, 60.0), (5.0, 90.0)
_FIRST_REST = 5.0
_SHORT, _BUDGET = 4.0, 15.0  # minutes


@dataclass(frozen=True)
class Drive:
    """Equal pulses until `minutes` are over; `seconds` of a pulse's rise, or of its level."""

    order: str
    shape: str
    heights: str
    seconds: float
    rest: float
    minutes: float

    def document(self, level: float, sides: Sequence[str]) -> dict[str, Any]:
        """As a protocol file holds it."""
        one, other = sides[0], sides[-1]
        targets = {
            "one side": (one,), "the other side": (other,), "both sides": ("all",),
        }.get(self.order, (one, other) if one != other else (one,))
        warmed, triangle = "warmed" in self.order, self.shape == "triangle"
        pulse = self.seconds * (2.0 if triangle else 1.0) + self.rest
        pulse += 2.0 * self.seconds if warmed else 0.0
        steps: list[dict[str, Any]] = [{"kind": "rest", "duration": _FIRST_REST}]
        left, k = 60.0 * self.minutes - _FIRST_REST, 0
        shares = _SHARES[self.heights]
        while k == 0 or left >= pulse:
            target = targets[k % len(targets)]
            volts = round(shares[(k // len(targets)) % len(shares)] * level, 3)
            if warmed:
                passive = next((s for s in sides if s != target), target)
                steps.append({"kind": "step", "drive": passive, "level": round(0.5 * volts, 3),
                              "duration": 2.0 * self.seconds})
            if triangle:
                steps.append({"kind": "triangle", "drive": target, "peak": volts,
                              "rise": self.seconds, "fall": self.seconds})
            else:
                steps.append({"kind": "step", "drive": target, "level": volts,
                              "duration": self.seconds})
            steps.append({"kind": "rest", "duration": self.rest})
            left, k = left - pulse, k + 1
        what = "triangles" if triangle else "steps"
        order = [self.order]
        if len(set(sides)) == 1:
            order = ["warmed before"] if warmed else []
        return {
            "name": "_".join([self.heights, what, *order]).replace(" ", "_"),
            "description": ", ".join([
                f"{self.heights} {what} of {self.seconds:g} s", *order,
                f"with rests of {self.rest:g} s",
            ]),
            "steps": steps,
        }


_TABLE = read_yaml(Path(__file__).with_suffix(".yaml"), aliases=True)
KNOWN = tuple(Drive(*numbers) for numbers in _TABLE["drives"])
FIRST = Drive(*_TABLE["first"])  # of a bench without a record


def drawn(random: np.random.Generator) -> Drive:
    """Any drive of the family."""

    def between(ends: tuple[float, float]) -> float:
        return float(f"{np.exp(random.uniform(*np.log(ends))):.2g}")

    return Drive(
        str(random.choice(_ORDERS)), str(random.choice(("triangle", "step"))),
        str(random.choice(list(_SHARES))), between(_SECONDS), between(_RESTS),
        float(random.choice((2.0, _SHORT))),
    )


def changed(drive: Drive, random: np.random.Generator) -> Drive:
    """One or two of its numbers drawn anew, or its time doubled."""
    if random.uniform() < 0.3:
        return replace(drive, minutes=min(2.0 * drive.minutes, _BUDGET))
    names = random.choice(("order", "shape", "heights", "seconds", "rest"), 2, replace=False)
    other = drawn(random)
    return replace(drive, **{str(name): getattr(other, str(name)) for name in names})


class Test(NamedTuple):
    """A test of the paper: minutes, and the standard deviations that it leaves, of temperatures in
    K, of all others as a share. An effect that its `readings_hold` is read as the parameter's own.
    """

    minutes: float
    title: str
    leaves: Mapping[str, float]
    readings_hold: str = ""

    def stds(self, parameters: Parameters) -> dict[str, float]:
        """What it leaves, in the parameters' units."""
        return {
            name: std if name.endswith("_temperature") else std * abs(parameters[name])
            for name, std in self.leaves.items()
        }


TESTS = {name: Test(**row) for name, row in _TABLE["tests"].items()}
_ROUNDING = 1.1  # of deviations in a file, and of values that have changed since


def least_stds(parameters: Parameters) -> dict[str, float]:
    """The smallest deviation that any test of the paper leaves, of each parameter."""
    least: dict[str, float] = {}
    for test in TESTS.values():
        for name, std in test.stds(parameters).items():
            least[name] = min(std, least.get(name, np.inf))
    return least


def measured(parameters: Parameters) -> frozenset[str]:
    """Parameters stated as well as the best test of the paper leaves them: they were measured."""
    stated = parameters.given_uncertainty
    return frozenset(
        name for name, std in least_stds(parameters).items()
        if stated.get(name, np.inf) <= _ROUNDING * std
    )
