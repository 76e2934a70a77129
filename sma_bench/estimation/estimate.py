"""A number with its error, whatever told it: the one type of the whole package."""

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
    informed: float = 1.0  # share of its information from the records, NaN where not known
    # Of the systematic part, in `unit`, by what is behind them, which other numbers may share.
    shares: Mapping[str, float] = field(default_factory=dict)
    stated: "Estimate | None" = None  # the same number in the parameter file
    warnings: tuple[str, ...] = ()  # that concern it

    def with_shares(self, shares: Mapping[str, float]) -> "Estimate":
        """The same with these systematic errors, one standard deviation each, and no others."""
        systematic = math.hypot(*shares.values())
        std = math.hypot(self.statistical, systematic) if systematic else self.statistical
        return replace(self, std=std, systematic=systematic, shares=dict(shares))

    def capped(self, std: float) -> "Estimate":
        """The same, no less sure than `std`."""
        if self.std <= std:
            return self
        statistical = min(self.statistical, std)
        systematic = _beside(statistical, std)
        ratio = systematic / self.systematic if self.systematic else 0.0
        shares = {name: ratio * share for name, share in self.shares.items()}
        return replace(self, std=std, systematic=systematic, shares=shares)

    @property
    def statistical(self) -> float:
        """Standard deviation without the systematic part."""
        if not self.systematic:
            return self.std
        return _beside(self.systematic, self.std)

    @property
    def relative_std(self) -> float:
        return self.std / abs(self.value) if self.value else math.inf

    @property
    def deviations(self) -> float:
        """From what is stated, in standard deviations of both; 0 where nothing is."""
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


def _beside(part: float, whole: float) -> float:
    """The other part of a standard deviation; what a hostile file holds overflows as a square."""
    return math.sqrt(max(whole - part, 0.0)) * math.sqrt(whole + part)
