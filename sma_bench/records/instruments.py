"""Records of calorimeters, isobaric and tensile tests, and the thermal cycles of a test."""

import math
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from sma_bench.arrays import Array, Mask
from sma_bench.errors import InputError
from sma_bench.findings import Finding

if TYPE_CHECKING:
    from sma_bench.records.tables import Account

Phase = Literal["martensite", "austenite"]
PHASES: tuple[Phase, ...] = get_args(Phase)
Direction = Literal["heating", "cooling"]
FEWEST_ROWS, _FEWEST_SAMPLES = 20, 8  # rows of a mechanical test, of a branch
STRONGEST = 1.5e9  # Pa: cold-drawn NiTi wire breaks at 1.4 to 1.9 GPa
STEADY, SMALLEST_RANGE = 3.0, 5.0  # K, most change in a tensile test, least in a thermal cycle
_SMALLEST_SPIKE, _WINDOW = 3.0, 11  # K, rows around it
NOISY, _SMOOTH = 0.5, 0.2  # K, scatter that is smoothed, scatter that remains
_TURN, _COMPLETE = 0.15, 0.6  # of the range: change that makes a turn, span of a branch


@dataclass(frozen=True)
class Branch:
    """One heating or cooling: temperature K, strain, stress Pa, each (n,), ordered by time."""

    direction: Direction
    temperature: Array
    strain: Array
    stress: Array


@dataclass(frozen=True)
class Cycle:
    """One or two successive branches of opposite direction, `number` from 1."""

    number: int
    branches: tuple[Branch, ...]

    def get(self, direction: str) -> Branch | None:
        return next((b for b in self.branches if b.direction == direction), None)


@dataclass(frozen=True)
class DscSegment:
    """One step of a DSC run; the heat flow of the sample is heat_flow - baseline."""

    number: int  # in the file, from 1
    rate: float  # programmed, K/s, negative when cooling, 0 when isothermal
    time: Array  # (n,) s since the start of the run
    heat_flow: Array  # (n,) W, unsubtracted, with the file's sign
    baseline: Array  # (n,) W, zeros where the file has none
    temperature: Array  # (n,) K of the sample
    program_temperature: Array  # (n,) K

    @property
    def kind(self) -> Literal["heating", "cooling", "isothermal"]:
        return "heating" if self.rate > 0.0 else "cooling" if self.rate < 0.0 else "isothermal"


@dataclass(frozen=True, repr=False)
class DscRecord:
    """A differential scanning calorimetry run."""

    path: Path
    mass: float  # of the sample, kg
    header: dict[str, str]  # `key: value` lines before the data, as written
    segments: tuple[DscSegment, ...]  # in order
    findings: tuple[Finding, ...] = ()  # of the reader, for instance a file cut short
    instrument: str = "PerkinElmer Pyris DSC"
    exotherm: str = ""  # "up" or "down", if the file states it
    account: "Account | None" = None  # what became of the file's rows and columns

    def __repr__(self) -> str:
        return f"<DscRecord {self.path}: {len(self.segments)} segments>"

    @property
    def sample(self) -> str:
        names = ("Sample ID", "Sample", "Sample Name", "SAMPLE", "IDENTITY")
        return next((self.header[name] for name in names if name in self.header), "")

    def specific_heat_flow(self, segment: DscSegment) -> Array:
        """Heat flow less baseline per mass of sample, (n,) W/kg, with the file's sign."""
        return (segment.heat_flow - segment.baseline) / self.mass

    @property
    def endothermic_up(self) -> bool | None:
        """True if heat into the sample is positive: as stated, else if the heating scans are above
        the cooling scans; None if neither is known."""
        if self.exotherm:
            return self.exotherm == "down"
        means = [(s.kind, float(np.mean(s.heat_flow - s.baseline))) for s in self.segments]
        heating, cooling = ([m for k, m in means if k == kind] for kind in ("heating", "cooling"))
        return bool(np.mean(heating) > np.mean(cooling)) if heating and cooling else None


@dataclass(frozen=True, repr=False)
class IsobaricRecord:
    """One test at one stress. A "relative" strain is the extension divided by its range."""

    path: Path
    name: str  # folder, stem and sheet of the file
    stress: float  # median over the cycles, Pa
    strain_unit: str  # "1", or "relative" where the gauge length is unknown
    cycles: tuple[Cycle, ...]  # heating and cooling branches in order
    findings: tuple[Finding, ...] = ()  # of the reader, and what it assumed
    account: "Account | None" = None  # what became of the file's rows and columns

    def __repr__(self) -> str:
        shown = f"{self.stress / 1e6:.4g} MPa, {len(self.cycles)} cycles"
        return f"<IsobaricRecord {self.path}: {shown}>"


@dataclass(frozen=True, repr=False)
class TensileRecord:
    """One tensile test; length and section of the specimen may be unknown."""

    path: Path
    strain: Array  # (n,) ordered by time; m if `is_extension`
    stress: Array  # (n,) Pa; N if `is_force`
    temperature: float | None  # K; None if not stated
    findings: tuple[Finding, ...] = ()  # of the reader
    phase: Phase | None = None  # of the specimen
    is_extension: bool = False  # the gauge length is unknown
    is_force: bool = False  # the cross-section is unknown
    account: "Account | None" = None  # what became of the file's rows and columns

    def __repr__(self) -> str:
        return f"<TensileRecord {self.path}: {len(self.strain)} rows>"


def without_spikes(temperature: Array) -> tuple[Mask, Array]:
    """(n,) False for single readings of temperature (n,) K that jump away from their neighbours and
    back; and the heights of these spikes (K)."""
    half, steps = _WINDOW // 2, np.diff(temperature)
    around = sliding_window_view(np.pad(steps, (half, half + 1), mode="edge"), _WINDOW)
    slope = np.median(around, axis=1)[: len(temperature), None]
    windows = sliding_window_view(np.pad(temperature, half, mode="edge"), _WINDOW)
    away = temperature - np.median(windows - slope * np.arange(-half, half + 1), axis=1)
    bad = np.abs(away) > max(_SMALLEST_SPIKE, 6.0 * 1.4826 * float(np.median(np.abs(away))))
    # A spike differs from both neighbours; a corner or a step does not.
    before, after = np.pad(steps, (1, 0)), np.pad(steps, (0, 1))
    bad &= (before * after < 0.0) & (np.minimum(abs(before), abs(after)) > _SMALLEST_SPIKE)
    return ~bad, away[bad]


def without_noise(temperature: Array) -> tuple[Array, float, int]:
    """Temperature (n,) K, smoothed by parabolas if noisy; its scatter (K); and the number of rows
    of each parabola, 0 if it was not smoothed."""
    from scipy.signal import savgol_filter  # half a second to load
    noise = 0.0
    if len(temperature) >= _FEWEST_SAMPLES:
        noise = 1.4826 * float(np.median(np.abs(np.diff(temperature, 2)))) / math.sqrt(6.0)
    smooth, width, window = temperature, 0, 5
    # The middle of a parabola through w readings has 9/4 of the variance of their mean.
    while noise >= NOISY and noise * math.sqrt(2.25 / max(width, 2.25)) > _SMOOTH:
        level = 0.5 * (smooth.max() + smooth.min())
        away = smooth[np.abs(smooth - level) > 0.15 * np.ptp(smooth)] > level
        if window > len(temperature) / (1 + np.count_nonzero(np.diff(away))) / 6.0:
            break
        smooth = np.asarray(savgol_filter(temperature, window, 2))
        width, window = window, 2 * window - 1
    return smooth, noise, width if noise >= NOISY else 0


def find_cycles(temperature: Array, strain: Array, stress: Array,
                where: str) -> tuple[tuple[Cycle, ...], list[Finding]]:
    """Cycles of temperature (n,) K, with strain (n,) and stress (n,) Pa, and findings; `where`
    begins the messages. InputError: there is no branch."""
    span = float(np.ptp(temperature)) if len(temperature) else 0.0
    if span < SMALLEST_RANGE:
        raise InputError(f"{where}: temperature changes by {span:.3g} K, expected a cycle of "
                         f"{SMALLEST_RANGE:g} K or more")
    # Turns: extremes that are followed by a change of more than the threshold, and both ends.
    threshold = max(_TURN * span, 2.0)
    turns, extreme, direction = [0], 0, 0
    for i, t in enumerate(temperature):
        change = t - temperature[extreme]
        if direction and direction * change >= 0.0:
            extreme = i
        elif abs(change) > threshold:
            turns += [extreme] if direction else []
            direction, extreme = (1 if change > 0.0 else -1), i
    turns.append(extreme)
    cycles, partial = list[tuple[Branch, ...]](), 0
    for first, last in pairwise(turns):
        change = temperature[last] - temperature[first]
        if abs(change) < _COMPLETE * span or last - first < _FEWEST_SAMPLES:
            partial += 1
            continue
        way: Direction = "heating" if change > 0.0 else "cooling"
        branch = Branch(way, *(v[first : last + 1] for v in (temperature, strain, stress)))
        if cycles and len(cycles[-1]) == 1 and cycles[-1][0].direction != way:
            cycles[-1] = (cycles[-1][0], branch)
        else:
            cycles.append((branch,))
    if not cycles:
        short = f"no branch spans {_COMPLETE:.0%} of the {span:.1f} K range"
        raise InputError(f"{where}: {short}, expected a heating or cooling")
    text = (f"{where}: {partial} branches span less than {_COMPLETE:.0%} of the temperature range "
            "and are left out")
    findings = [Finding("info", "temperature", text, {"count": float(partial)})] * bool(partial)
    return tuple(Cycle(number, branches) for number, branches in enumerate(cycles, 1)), findings
