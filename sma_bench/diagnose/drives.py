"""Drives that can be proposed."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sma_bench.border import read_yaml

_SHARES = {"full": (1.0,), "growing": (0.7, 0.8, 0.9, 1.0), "partial": (0.85, 0.8)}
_FIRST_REST = 5.0
LONGER = (8.0, 15.0)  # minutes of the best one


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
        orders = {"one side": (one,), "the other side": (other,), "both sides": ("all",)}
        targets = orders.get(self.order, (one, other) if one != other else (one,))
        warmed, triangle = "warmed" in self.order, self.shape == "triangle"
        pulse = self.seconds * (2.0 if triangle else 1.0) + self.rest
        pulse += 2.0 * self.seconds if warmed else 0.0
        steps: list[dict[str, Any]] = [{"kind": "rest", "duration": _FIRST_REST}]
        left, k, shares = 60.0 * self.minutes - _FIRST_REST, 0, _SHARES[self.heights]
        while k == 0 or left >= pulse:
            target = targets[k % len(targets)]
            volts = round(shares[(k // len(targets)) % len(shares)] * level, 3)
            if warmed:
                passive = next((s for s in sides if s != target), target)
                steps.append({"kind": "step", "drive": passive, "level": round(0.5 * volts, 3),
                              "duration": 2.0 * self.seconds})
            stroke: dict[str, Any] = {"kind": "step", "level": volts, "duration": self.seconds}
            if triangle:
                stroke = {"kind": "triangle", "peak": volts, "rise": self.seconds,
                          "fall": self.seconds}
            steps += [{**stroke, "drive": target}, {"kind": "rest", "duration": self.rest}]
            left, k = left - pulse, k + 1
        kind = [f"{self.heights} {'triangles' if triangle else 'steps'}"]
        order = [self.order] if one != other else ["warmed before"] if warmed else []
        rests = f"with rests of {self.rest:g} s"
        return {"name": "_".join([*kind, *order]).replace(" ", "_"),
                "description": ", ".join([f"{kind[0]} of {self.seconds:g} s", *order, rests]),
                "steps": steps}


_TABLE = read_yaml(Path(__file__).with_suffix(".yaml"), aliases=True)
KNOWN = tuple(Drive(*numbers) for numbers in _TABLE["drives"])
FIRST = Drive(*_TABLE["first"])  # of a bench without a record
