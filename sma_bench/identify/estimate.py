"""What an experiment yields: numbers with their errors, remarks, and curves to draw."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from sma_bench.errors import InputError
from sma_bench.findings import Finding

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]
Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Estimate:
    """A number with one standard deviation, both in `unit`; `n` measured points stand behind it."""

    value: float
    std: float
    unit: str
    method: str
    n: int

    @property
    def relative_std(self) -> float:
        """Standard deviation over the value's size."""
        return self.std / abs(self.value) if self.value else math.inf

    def to_json(self) -> dict[str, Any]:
        """The entry of the result file (contract, section 5)."""
        return {
            "value": float(self.value),
            "std": float(self.std),
            "unit": self.unit,
            "method": self.method,
            "n": int(self.n),
        }


@dataclass(frozen=True)
class Experiment:
    """One experiment of the paper as far as the records hold it.

    `estimates` maps parameter names of the contract to what goes into a parameter file;
    `details` holds further numbers (one direction, one heating rate, another method) under
    names of their own; `curves` holds the arrays of its figure, never written to JSON.
    """

    name: str
    title: str
    estimates: dict[str, Estimate]
    findings: tuple[Finding, ...] = ()
    curves: dict[str, Array] = field(default_factory=dict)
    source: str = ""
    details: dict[str, Estimate] = field(default_factory=dict)

    def to_json(self) -> dict[str, Any]:
        """Everything but the curves."""
        return {
            "name": self.name,
            "title": self.title,
            "source": self.source,
            "estimates": {name: e.to_json() for name, e in self.estimates.items()},
            "details": {name: e.to_json() for name, e in self.details.items()},
            "findings": [finding.to_json() for finding in self.findings],
        }


def combine(estimates: Sequence[Estimate]) -> Estimate:
    """Weighted mean of independent estimates of one number.

    Where they scatter by more than their errors explain, the error grows with the scatter
    (Birge ratio), so that disagreeing records never yield a smaller error than agreeing ones.

    Raises:
        InputError: nothing to combine.
    """
    if not estimates:
        raise InputError("no estimates to combine")
    if len(estimates) == 1:
        return estimates[0]
    values = np.array([e.value for e in estimates])
    weights = np.array([1.0 / e.std**2 for e in estimates])
    mean = float(np.sum(weights * values) / np.sum(weights))
    birge = math.sqrt(float(np.sum(weights * (values - mean) ** 2)) / (len(estimates) - 1))
    first = estimates[0]
    return Estimate(
        value=mean,
        std=max(1.0, birge) / math.sqrt(float(np.sum(weights))),
        unit=first.unit,
        method=f"{first.method}; weighted mean of {len(estimates)} records",
        n=sum(e.n for e in estimates),
    )
