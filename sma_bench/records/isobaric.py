"""Isobaric tests: strain of a specimen under constant stress while its temperature cycles."""

import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from sma_bench.drawn import Drawn
from sma_bench.errors import InputError
from sma_bench.findings import Finding
from sma_bench.records.text_table import (
    FloatArray,
    TextTable,
    find_column,
    is_driven,
    plain_unit,
    read_lines,
    read_text_table,
    to_si,
)

SMALLEST_RANGE = 5.0  # K
SMALLEST_SPIKE = 3.0  # K
TURN = 0.15
COMPLETE = 0.6
_WINDOW = 11
_FEWEST_SAMPLES = 8
_NOISY, _SMOOTH = 0.5, 0.2  # K


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


def without_noise(temperature: FloatArray, where: str, findings: list[Finding]) -> FloatArray:
    """(n,) K without the scatter of a noisy thermometer, which would pass for a wider range of
    transformation: a parabola through the readings around, at most a sixth of a branch."""
    from scipy.signal import savgol_filter  # half a second to load

    if len(temperature) < _FEWEST_SAMPLES:
        return temperature
    noise = 1.4826 * float(np.median(np.abs(np.diff(temperature, 2)))) / math.sqrt(6.0)
    if noise < _NOISY:
        return temperature
    smooth, width, window = temperature, 0, 5
    # A parabola through w readings has 9/4 of the variance of their mean.
    while noise * math.sqrt(2.25 / max(width, 2.25)) > _SMOOTH:
        level = 0.5 * (smooth.max() + smooth.min())
        away = smooth[np.abs(smooth - level) > 0.15 * np.ptp(smooth)] > level
        if window > len(temperature) / (1 + np.count_nonzero(np.diff(away))) / 6.0:
            break
        smooth = savgol_filter(temperature, window, 2)
        width, window = window, 2 * window - 1
    text = (
        f"{where}: temperature scatters by {noise:.2g} K from row to row; read through {width} rows"
    )
    findings.append(Finding("info", "temperature", text, {"noise": noise, "rows": float(width)}))
    return np.asarray(smooth)


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


# --- reading the tables

FEWEST_ROWS = 20
# NiTi single crystals recover some 10 %: a larger span of strain is written in percent.
LARGEST_SPAN = 0.12
# Cold-drawn NiTi wire breaks at 1.4 to 1.9 GPa.
STRONGEST = 1.5e9
CONSTANCY = 0.05
RELATIVE: Literal["relative"] = "relative"
_UNIT_LINE = re.compile(r"\s*+(stress|strain|temperature)\s*+[=:]\s*+(\S.*)", re.IGNORECASE)
_TEMPERATURE = ("specimen temp", "temperature", "temp")
_STRAIN = ("strain", "extension", "elongation", "crosshead")
_NOTES = ("source", "unit", "readme")


@dataclass(frozen=True, repr=False)
class IsobaricRecord(Drawn):
    """One test at one stress.

    Attributes:
        path: the file.
        name: of the test, unique among files of different folders: folder and stem.
        stress: median stress over the cycles, Pa.
        strain_unit: "1", or "relative" where the gauge length is unknown: the extension over its
            own full range, so that strains can be compared within the test only.
        cycles: heating and cooling branches in order.
        findings: what the reader noticed or assumed.
    """

    path: Path
    name: str
    stress: float
    strain_unit: Literal["1", "relative"]
    cycles: tuple[Cycle, ...]
    findings: tuple[Finding, ...] = ()

    def __repr__(self) -> str:
        shown = f"{self.stress / 1e6:.4g} MPa, {len(self.cycles)} cycles"
        return f"<IsobaricRecord {self.path}: {shown}>"


def is_isobaric(path: Path) -> bool:
    """Whether a file is a table of temperature, strain and stress of which temperature changes."""
    try:
        table = read_text_table(path)
    except InputError:
        return False
    if not table.titles:
        temperature = table.values[:, 0]
        return table.values.shape[1] == 3 and float(np.ptp(temperature)) > SMALLEST_RANGE
    if is_driven(table):
        return False
    found = find_column(table, _TEMPERATURE, ("temperature",))
    others = (find_column(table, ("stress",), ("stress",)),
              find_column(table, _STRAIN, ("strain", "length")))
    return (
        found is not None
        and all(others)
        and float(np.ptp(table.values[:, found[0].index])) > SMALLEST_RANGE
    )


def read_isobaric(
    path: Path | str, *, strain_unit: str | None = None, gauge_length: float | None = None
) -> IsobaricRecord:
    """Read an isobaric test.

    Two forms are known: three columns without header (temperature in degC, strain, stress in MPa;
    units from a note such as "Data Source.txt" beside the file), and a load frame's table with
    titles and units (extension or strain, stress, chamber temperature).

    Args:
        path: the file.
        strain_unit: "mm/mm" or "%"; None: from the note beside the file, else inferred.
        gauge_length: of the extension, m; None: strain is the extension over its own range.

    Raises:
        InputError: no such file, not such a table, a malformed line (named), or no thermal cycle.
    """
    path = Path(path)
    if gauge_length is not None and not 0.0 < gauge_length < np.inf:
        raise InputError(f"gauge length is {gauge_length} m, expected > 0")
    table = read_text_table(path)
    if len(table.values) < FEWEST_ROWS:
        raise InputError(
            f"{path}: {len(table.values)} rows of numbers, expected {FEWEST_ROWS} or more"
        )
    findings: list[Finding] = []
    if table.titles:
        temperature, strain, stress, is_relative = _titled(table, gauge_length, findings)
    else:
        temperature, strain, stress = _untitled(table, strain_unit, findings)
        is_relative = False
    _check_temperature(table, temperature)
    held = _held(path, stress, findings)
    temperature, strain, stress = temperature[held], strain[held], stress[held]
    if is_relative:
        strain = (strain - strain.min()) / np.ptp(strain)
    good, spikes = without_spikes(temperature)
    findings.extend(_about_spikes(path, spikes, temperature))
    settled = without_noise(temperature[good], str(path), findings)
    cycles, remarks = find_cycles(settled, strain[good], stress[good], str(path))
    findings.extend(remarks)
    level = float(np.median(stress))
    if level > STRONGEST:
        findings.append(_too_strong(path, level))
    return IsobaricRecord(
        path=path,
        name=f"{path.parent.name}/{path.stem}",
        stress=level,
        strain_unit=RELATIVE if is_relative else "1",
        cycles=cycles,
        findings=tuple(findings),
    )


def _untitled(
    table: TextTable, strain_unit: str | None, findings: list[Finding]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    if table.values.shape[1] != 3:
        raise InputError(
            f"{table.path}: {table.values.shape[1]} columns without titles, expected 3: "
            "temperature, strain, stress"
        )
    noted = _noted_units(table.path)
    unit = strain_unit or noted.get("strain") or _inferred_unit(table, findings)
    if np.ptp(table.values[:, 1]) == 0.0:
        raise InputError(f"{table.path}: strain is {table.values[0, 1]:g} throughout")
    try:
        temperature = to_si(table.values[:, 0], "temperature", noted.get("temperature", "C"))
        strain = to_si(table.values[:, 1], "strain", unit)
        stress = to_si(table.values[:, 2], "stress", noted.get("stress", "MPa"))
    except InputError as error:
        raise InputError(f"{table.path}: {error}") from None
    span = float(np.ptp(strain))
    if span > LARGEST_SPAN:
        text = (
            f"{table.path}: strain spans {span:.3g} in the unit {unit!r}, more than the "
            f"{LARGEST_SPAN:g} that NiTi recovers; is the unit percent?"
        )
        findings.append(Finding("warning", "strain unit", text, {"span": span}))
    return temperature, strain, stress


def _titled(
    table: TextTable, gauge_length: float | None, findings: list[Finding]
) -> tuple[FloatArray, FloatArray, FloatArray, bool]:
    temperature = find_column(table, _TEMPERATURE, ("temperature",))
    stress = find_column(table, ("stress",), ("stress",))
    strain = find_column(table, _STRAIN, ("strain", "length"))
    found = {"temperature": temperature, "stress": stress, "strain or extension": strain}
    for what, column in found.items():
        if column is None:
            raise InputError(
                f"{table.path}: no column of {what} with a known unit among "
                f"{', '.join(table.titles)}"
            )
    assert temperature and stress and strain
    for used in (temperature, stress, strain):
        findings += used[0].remark(table.path)
    kelvin, pascal, other = (
        to_si(table.values[:, column.index], kind, column.unit)
        for column, kind in (temperature, stress, strain)
    )
    if np.ptp(other) == 0.0:
        raise InputError(f"{table.path}: {strain[0].name} is constant throughout")
    if strain[1] == "strain":
        return kelvin, other, pascal, False
    if gauge_length is not None:
        return kelvin, other / gauge_length, pascal, False
    text = (
        f"{table.path}: {strain[0].name} without a gauge length; strain is given relative to the "
        f"largest change, {np.ptp(other) * 1e3:.4g} mm"
    )
    findings.append(Finding("warning", "strain", text, {"extension_range": float(np.ptp(other))}))
    return kelvin, other, pascal, True


def _noted_units(path: Path) -> dict[str, str]:
    """Units in a note beside the file: lines such as "Strain = %"."""
    units: dict[str, str] = {}
    for note in sorted(path.parent.glob("*.txt")) + sorted(path.parent.glob("*.md")):
        named = any(word in note.stem.lower() for word in _NOTES)
        if note == path or not named or note.stat().st_size > 100_000:
            continue
        for line in read_lines(note):
            match = _UNIT_LINE.match(line)
            if match:
                units.setdefault(match[1].lower(), plain_unit(match[2]))
    return units


def _inferred_unit(table: TextTable, findings: list[Finding]) -> str:
    span = float(np.ptp(table.values[:, 1]))
    unit = "%" if span > LARGEST_SPAN else "mm/mm"
    text = (
        f"{table.path}: no unit of strain is given; its span of {span:.4g} is taken as {unit} "
        f"because {span:.3g} mm/mm {'is more' if unit == '%' else 'is no more'} than NiTi recovers"
    )
    findings.append(Finding("warning", "strain unit", text, {"span": span}))
    return unit


def _check_temperature(table: TextTable, temperature: FloatArray) -> None:
    wrong = np.flatnonzero((temperature <= 0.0) | (temperature > 1500.0))
    if len(wrong):
        i = int(wrong[0])
        raise InputError(
            f"{table.path}: line {table.lines[i]}: temperature {temperature[i]:.6g} K, "
            "expected 0 to 1500 K"
        )


def _held(path: Path, stress: FloatArray, findings: list[Finding]) -> slice:
    """Rows between loading and unloading, where stress is at its level."""
    level = float(np.median(stress))
    away = np.abs(stress - level) > max(CONSTANCY * abs(level), 1e6)
    inside = np.flatnonzero(~away)
    held = slice(int(inside[0]), int(inside[-1]) + 1)
    left_out = len(stress) - (held.stop - held.start)
    if left_out:
        text = f"{path}: {left_out} rows of loading or unloading are left out"
        findings.append(Finding("info", "stress", text, {"rows": float(left_out)}))
    share = float(np.mean(away[held]))
    if share > 0.02:
        text = (
            f"{path}: stress is more than {CONSTANCY:.0%} away from {level / 1e6:.4g} MPa in "
            f"{share:.0%} of the rows, so the test is not isobaric"
        )
        findings.append(Finding("warning", "stress", text, {"share": share}))
    return held


def _about_spikes(path: Path, spikes: FloatArray, temperature: FloatArray) -> list[Finding]:
    if not len(spikes):
        return []
    text = (
        f"{path}: {len(spikes)} of {len(temperature)} temperatures jump away by up to "
        f"{np.abs(spikes).max():.1f} K and back; left out"
    )
    return [Finding("info", "temperature", text, {"count": float(len(spikes))})]


def _too_strong(path: Path, level: float) -> Finding:
    text = (
        f"{path}: stress {level / 1e6:.0f} MPa is more than any NiTi endures "
        f"({STRONGEST / 1e6:.0f} MPa): the area or the unit of force behind it is wrong"
    )
    return Finding("warning", "stress", text, {"stress": level})
