"""Heating and cooling branches of a temperature that cycles."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from sma_bench.errors import InputError
from sma_bench.findings import Finding
from sma_bench.records.text_table import FloatArray

SMALLEST_RANGE = 5.0  # K
SMALLEST_SPIKE = 3.0  # K
TURN = 0.15
COMPLETE = 0.6
_WINDOW = 11
_FEWEST_SAMPLES = 8


@dataclass(frozen=True)
class Branch:
    """One heating or cooling: temperature K, strain, stress Pa, each (n,), in order of time."""

    direction: Literal["heating", "cooling"]
    temperature: FloatArray
    strain: FloatArray
    stress: FloatArray


@dataclass(frozen=True)
class Cycle:
    """One or two successive branches of opposite direction, `number` from 1."""

    number: int
    branches: tuple[Branch, ...]

    def get(self, direction: str) -> Branch | None:
        """The branch of that direction, or None."""
        return next((b for b in self.branches if b.direction == direction), None)


def without_spikes(temperature: FloatArray) -> tuple[NDArray[np.bool_], FloatArray]:
    """Find single readings that jump away from the local line and back.

    Args:
        temperature: (n,) K in order of time, evenly enough spaced.

    Returns:
        (n,) True for good readings, and the heights (K) of the others.
    """
    half = _WINDOW // 2
    steps = np.pad(np.diff(temperature), (half, half + 1), mode="edge")
    slope = np.median(sliding_window_view(steps, _WINDOW), axis=1)[: len(temperature)]
    windows = sliding_window_view(np.pad(temperature, half, mode="edge"), _WINDOW)
    offsets = np.arange(-half, half + 1)
    level = np.median(windows - slope[:, None] * offsets, axis=1)
    away = temperature - level
    scatter = 1.4826 * float(np.median(np.abs(away)))
    bad = np.abs(away) > max(SMALLEST_SPIKE, 6.0 * scatter)
    bad &= _is_peak(temperature)
    return ~bad, away[bad]


def find_cycles(
    temperature: FloatArray, strain: FloatArray, stress: FloatArray, where: str
) -> tuple[tuple[Cycle, ...], list[Finding]]:
    """Split a test at the reversals of temperature.

    Args:
        temperature: (n,) K; strain: (n,); stress: (n,) Pa; in order of time.
        where: leads the messages.

    Raises:
        InputError: temperature does not change enough for a branch.
    """
    span = float(np.ptp(temperature)) if len(temperature) else 0.0
    if span < SMALLEST_RANGE:
        raise InputError(
            f"{where}: temperature changes by {span:.3g} K, expected a cycle of "
            f"{SMALLEST_RANGE:g} K or more"
        )
    turns = _turning_points(temperature, max(TURN * span, 2.0))
    branches: list[Branch] = []
    partial = 0
    for first, last in zip(turns[:-1], turns[1:], strict=True):
        change = temperature[last] - temperature[first]
        if abs(change) < COMPLETE * span or last - first < _FEWEST_SAMPLES:
            partial += 1
            continue
        part = slice(first, last + 1)
        branches.append(
            Branch(
                "heating" if change > 0.0 else "cooling",
                temperature[part],
                strain[part],
                stress[part],
            )
        )
    if not branches:
        raise InputError(f"{where}: no branch spans {COMPLETE:.0%} of the {span:.1f} K range")
    findings = []
    if partial:
        text = (
            f"{where}: {partial} turns of temperature span less than {COMPLETE:.0%} of the range "
            "and are left out"
        )
        findings.append(Finding("info", "temperature", text, {"count": float(partial)}))
    return _paired(branches), findings


def _is_peak(temperature: FloatArray) -> NDArray[np.bool_]:
    """Whether a reading stands out from both its neighbours: a corner or a step does not."""
    before = np.diff(temperature, prepend=temperature[0])
    after = np.diff(temperature, append=temperature[-1])
    return (before * after < 0.0) & (np.minimum(abs(before), abs(after)) > SMALLEST_SPIKE)


def _turning_points(temperature: FloatArray, threshold: float) -> list[int]:
    """Indices of the extremes that a change of more than `threshold` follows, and both ends."""
    turns = [0]
    extreme, direction = 0, 0
    for i in range(1, len(temperature)):
        change = temperature[i] - temperature[extreme]
        if direction == 0:
            if abs(change) > threshold:
                direction, extreme = (1 if change > 0.0 else -1), i
        elif direction * change >= 0.0:
            extreme = i
        elif abs(change) > threshold:
            turns.append(extreme)
            direction, extreme = -direction, i
    turns.append(extreme)
    return turns


def _paired(branches: list[Branch]) -> tuple[Cycle, ...]:
    cycles: list[Cycle] = []
    pending: list[Branch] = []
    for branch in branches:
        if pending and (len(pending) == 2 or pending[-1].direction == branch.direction):
            cycles.append(Cycle(len(cycles) + 1, tuple(pending)))
            pending = []
        pending.append(branch)
    cycles.append(Cycle(len(cycles) + 1, tuple(pending)))
    return tuple(cycles)
