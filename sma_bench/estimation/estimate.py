"""A number with its error: the one type of estimates in the whole package."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any


@dataclass(frozen=True)
class Estimate:
    """A number with one standard deviation, both in `unit`."""

    value: float
    std: float
    unit: str = ""
    method: str = ""
    n: int = 0  # measured points behind it
    systematic: float = 0.0  # part of `std` that more of the same records would not lower
    informed: float = 1.0  # share of its information that came from the records, NaN: unknown
    # Systematic errors in `unit` by their cause, which may act on other numbers, too.
    shares: Mapping[str, float] = field(default_factory=dict)
    stated: "Estimate | None" = None  # the same number in the parameter file
    warnings: tuple[str, ...] = ()  # about this number

    def with_shares(self, shares: Mapping[str, float]) -> "Estimate":
        """The same with these systematic errors, one standard deviation each, and no others."""
        systematic = math.hypot(*shares.values())
        std = math.hypot(self.statistical, systematic) if systematic else self.statistical
        return replace(self, std=std, systematic=systematic, shares=dict(shares))

    def capped(self, std: float) -> "Estimate":
        """The same with a standard deviation of at most `std`."""
        if self.std <= std:
            return self
        statistical = min(self.statistical, std)
        systematic = _other_part(statistical, std)
        ratio = systematic / self.systematic if self.systematic else 0.0
        shares = {name: ratio * share for name, share in self.shares.items()}
        return replace(self, std=std, systematic=systematic, shares=shares)

    @property
    def statistical(self) -> float:
        """Standard deviation without the systematic part."""
        if not self.systematic:
            return self.std
        return _other_part(self.systematic, self.std)

    @property
    def relative_std(self) -> float:
        return self.std / abs(self.value) if self.value else math.inf

    @property
    def deviations(self) -> float:
        """Distance from the stated value in standard deviations of both; 0 without one."""
        if self.stated is None:
            return 0.0
        both = max(math.hypot(self.std, self.stated.std), 1e-300)
        off = (self.value - self.stated.value) / both
        return off if math.isfinite(off) else 0.0

    def to_json(self) -> dict[str, Any]:
        """The entry of the result file (contract, section 5)."""
        stated = self.stated
        return {"value": float(self.value), "std": float(self.std),
                "statistical": float(self.statistical), "systematic": float(self.systematic),
                "informed": float(self.informed), "unit": self.unit, "method": self.method,
                "n": int(self.n),
                **({"stated": {"value": stated.value, "std": stated.std}} if stated else {})}


def _other_part(part: float, whole: float) -> float:
    """sqrt(whole^2 - part^2) without the squares, which overflow for absurd numbers of a file."""
    return math.sqrt(max(whole - part, 0.0)) * math.sqrt(whole + part)
