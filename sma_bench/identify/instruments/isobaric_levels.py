"""Readings of isobaric tests, grouped by stress."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from sma_bench.errors import InputError
from sma_bench.findings import Finding
from sma_bench.identify.instruments.strain_tangents import StrainTangents, strain_tangents
from sma_bench.records.isobaric import IsobaricRecord
from sma_bench.records.thermal_cycles import Branch

PHASES = {
    # direction: (start, finish, C) with their parameters
    "heating": (
        ("A_s", "wire.austenite_start_temperature"),
        ("A_f", "wire.austenite_finish_temperature"),
        ("C_A", "wire.stress_influence_austenite"),
    ),
    "cooling": (
        ("M_s", "wire.martensite_start_temperature"),
        ("M_f", "wire.martensite_finish_temperature"),
        ("C_M", "wire.stress_influence_martensite"),
    ),
}
_SAME_STRESS = 0.03
Convention = Literal["tangent", "cosine"]


@dataclass(frozen=True)
class Reading:
    """The tangents of one branch."""

    record: IsobaricRecord
    cycle: int
    branch: Branch
    tangents: StrainTangents

    def ends(self, convention: Convention) -> tuple[tuple[float, float], tuple[float, float]]:
        """Start and finish, (value, std) each in K."""
        if convention == "cosine":
            return self.tangents.cosine_ends()
        return self.tangents.start, self.tangents.finish


@dataclass(frozen=True)
class Level:
    """All readings at one stress (Pa)."""

    stress: float
    readings: tuple[Reading, ...]

    def along(self, direction: str) -> tuple[Reading, ...]:
        """Those of one direction."""
        return tuple(r for r in self.readings if r.branch.direction == direction)


def read_tangents(records: Sequence[IsobaricRecord], findings: list[Finding]) -> list[Reading]:
    """Tangents of every branch; a branch without a transformation becomes a finding.

    Raises:
        InputError: no branch has one.
    """
    readings = []
    for record in records:
        for cycle in record.cycles:
            for branch in cycle.branches:
                other = cycle.get("cooling" if branch.direction == "heating" else "heating")
                try:
                    tangents = strain_tangents(branch, other)
                except InputError as error:
                    text = f"{record.name}, cycle {cycle.number}: {error}"
                    findings.append(Finding("warning", "tangents", text))
                else:
                    readings.append(Reading(record, cycle.number, branch, tangents))
    if not readings:
        raise InputError(f"{records[0].path}: no branch shows a transformation")
    return readings


def group_levels(readings: Sequence[Reading]) -> list[Level]:
    """Readings at the same stress together, in order of stress."""
    groups: list[list[Reading]] = []
    for reading in sorted(readings, key=lambda r: r.record.stress):
        stress = reading.record.stress
        if groups and abs(stress - groups[-1][0].record.stress) <= max(_SAME_STRESS * stress, 1e6):
            groups[-1].append(reading)
        else:
            groups.append([reading])
    return [Level(float(np.mean([r.record.stress for r in g])), tuple(g)) for g in groups]


def mean_and_deviation(values: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """Mean of repeats and their deviation (as the paper gives them), not below the reading error.

    Args:
        values: (value, std of the single reading) of each repeat.
    """
    value = np.array([v for v, _ in values])
    reading = math.sqrt(float(np.mean([s**2 for _, s in values])) / len(values))
    deviation = float(np.std(value, ddof=1)) if len(value) > 1 else 0.0
    return float(value.mean()), max(deviation, reading)
