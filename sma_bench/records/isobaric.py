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
from sma_bench.records.record import FloatArray
from sma_bench.records.roles import Sheet
from sma_bench.records.tables import Account, read_lines, read_table_file
from sma_bench.records.units import in_si, number_with_unit, parse_unit

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
_NOTES = ("source", "unit", "readme")


@dataclass(frozen=True, repr=False)
class IsobaricRecord(Drawn):
    """One test at one stress.

    Attributes:
        path: the file.
        name: of the test, unique among files of different folders: folder and stem, and its sheet.
        stress: median stress over the cycles, Pa.
        strain_unit: "1", or "relative" where the gauge length is unknown: the extension over its
            own full range, so that strains can be compared within the test only.
        cycles: heating and cooling branches in order.
        findings: what the reader noticed or assumed.
        account: what became of the file's rows and columns.
    """

    path: Path
    name: str
    stress: float
    strain_unit: Literal["1", "relative"]
    cycles: tuple[Cycle, ...]
    findings: tuple[Finding, ...] = ()
    account: Account | None = None

    def __repr__(self) -> str:
        shown = f"{self.stress / 1e6:.4g} MPa, {len(self.cycles)} cycles"
        return f"<IsobaricRecord {self.path}: {shown}>"


def is_isobaric(sheet: Sheet) -> bool:
    """Whether a table has a temperature that changes, strain or extension, and a load; or without
    titles a first column that goes up and down, a second one, and a third that is held."""
    columns = sheet.table.columns
    if not any(column.title for column in columns):
        if len(columns) != 3 and not (len(columns) == 2 and _load_beside(sheet) is not None):
            return False
        first, last = columns[0].values, columns[-1].values
        turns = bool(np.any(np.diff(first) > 0.0) and np.any(np.diff(first) < 0.0))
        level = abs(float(np.median(last)))
        held = len(columns) == 2 or np.mean(np.abs(np.abs(last) - level) < 0.2 * level) > 0.5
        return turns and bool(held) and float(np.ptp(first)) > SMALLEST_RANGE
    temperature = sheet.find("temperature")
    return (
        temperature is not None and not sheet.is_driven()
        and sheet.find("strain", "length") is not None
        and (sheet.find("stress") is not None or _load_beside(sheet) is not None)
        and float(np.ptp(temperature[0].values)) > SMALLEST_RANGE
    )


def _load_beside(sheet: Sheet) -> float | None:
    """A stress that is stated, in a line above the table or by the name of its sheet."""
    stated = sheet.noted("stress")
    return stated if stated is not None else number_with_unit(sheet.table.name, "stress")


def read_isobaric(
    path: Path | str, *, strain_unit: str | None = None, gauge_length: float | None = None
) -> IsobaricRecord:
    """Read an isobaric test.

    Two forms are known: three columns without header (temperature in degC, strain, stress in MPa;
    units from a note such as "Data Source.txt" beside the file), and a table with titles and units
    (extension or strain, temperature, stress, or the stress stated above it).

    Args:
        path: the file.
        strain_unit: "mm/mm" or "%"; None: from the note beside the file, else inferred.
        gauge_length: of the extension, m; None: strain is the extension over its own range.

    Raises:
        InputError: no such file, not such a table, a malformed line (named), or no thermal cycle.
    """
    if gauge_length is not None and not 0.0 < gauge_length < np.inf:
        raise InputError(f"gauge length is {gauge_length} m, expected > 0")
    file = read_table_file(path)
    given = {} if gauge_length is None else {"gauge_length": gauge_length}
    return isobaric_of(Sheet(file, file.tables[0], given), strain_unit)


def isobaric_of(sheet: Sheet, strain_unit: str | None = None) -> IsobaricRecord:
    """The test in a table; raises as `read_isobaric`."""
    path, table = sheet.path, sheet.table
    findings: list[Finding] = []
    if len(table.lines) < FEWEST_ROWS:
        raise InputError(
            f"{path}: {len(table.lines)} rows of numbers, expected {FEWEST_ROWS} or more"
        )
    gauge = sheet.noted("gauge_length")
    is_relative = False
    if any(column.title for column in table.columns):
        found = {"temperature": sheet.find("temperature"), "stress": sheet.find("stress"),
                 "strain or extension": sheet.find("strain", "length")}  # fmt: skip
        level = _load_beside(sheet)
        for what, column in found.items():
            if column is None and not (what == "stress" and level is not None):
                titles = ", ".join(c.name for c in table.columns)
                raise InputError(f"{path}: no column of {what} with a known unit among {titles}")
        temperature, strain = (sheet.values(found[k], findings)  # type: ignore[arg-type]
                               for k in ("temperature", "strain or extension"))  # fmt: skip
        stress = (sheet.values(found["stress"], findings) if found["stress"]
                  else np.full(len(strain), level))  # fmt: skip
        used = {pair[0].name: role for role, pair in found.items() if pair}
        name = found["strain or extension"][0].name  # type: ignore[index]
        if np.ptp(strain) == 0.0:
            raise InputError(f"{path}: {name} is constant throughout")
        if found["strain or extension"][1] == "length":  # type: ignore[index]
            is_relative = gauge is None
            if gauge is None:
                text = (
                    f"{path}: {name} without a gauge length; strain is given relative to the "
                    f"largest change, {np.ptp(strain) * 1e3:.4g} mm"
                )
                numbers = {"extension_range": float(np.ptp(strain))}
                findings.append(Finding("warning", "strain", text, numbers))
            else:
                strain = strain / gauge
    else:
        temperature, strain, stress = _untitled(sheet, strain_unit, findings)
        used = dict(zip((c.name for c in table.columns), ("temperature", "strain", "stress"),
                        strict=False))  # fmt: skip
    wrong = np.flatnonzero((temperature <= 0.0) | (temperature > 1500.0))
    if len(wrong):
        raise InputError(
            f"{path}: line {table.lines[wrong[0]]}: temperature {temperature[wrong[0]]:.6g} K, "
            "expected 0 to 1500 K"
        )
    held = _held(path, stress, findings)
    temperature, strain, stress = temperature[held], strain[held], stress[held]
    if is_relative:
        strain = (strain - strain.min()) / np.ptp(strain)
    good, spikes = without_spikes(temperature)
    if len(spikes):
        text = (
            f"{path}: {len(spikes)} of {len(temperature)} temperatures jump away by up to "
            f"{np.abs(spikes).max():.1f} K and back; left out"
        )
        findings.append(Finding("info", "temperature", text, {"count": float(len(spikes))}))
    settled = without_noise(temperature[good], str(path), findings)
    cycles, remarks = find_cycles(settled, strain[good], stress[good], str(path))
    findings.extend(remarks)
    median = float(np.median(stress))
    if median > STRONGEST:
        text = (
            f"{path}: stress {median / 1e6:.0f} MPa is more than any NiTi endures "
            f"({STRONGEST / 1e6:.0f} MPa): the area or the unit of force behind it is wrong"
        )
        findings.append(Finding("warning", "stress", text, {"stress": median}))
    several = len(sheet.file.tables) > 1
    return IsobaricRecord(
        path, f"{path.parent.name}/{path.stem}" + f"/{table.name}" * several, median,
        RELATIVE if is_relative else "1", cycles, tuple(findings),
        sheet.account(used, int(np.sum(good))),
    )


def _untitled(
    sheet: Sheet, strain_unit: str | None, findings: list[Finding]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    path, columns = sheet.path, sheet.table.columns
    stated = _load_beside(sheet)
    if len(columns) != 3 and not (len(columns) == 2 and stated is not None):
        raise InputError(
            f"{path}: {len(columns)} columns without titles, expected 3: temperature, strain, "
            "stress; of two the stress can be stated: stress=200 MPa, or a first line "
            "'Stress: 200 MPa'"
        )
    # Units in a note beside the file: lines such as "Strain = %".
    noted: dict[str, str] = {}
    for note in sorted(path.parent.glob("*.txt")) + sorted(path.parent.glob("*.md")):
        named = any(word in note.stem.lower() for word in _NOTES)
        if note == path or not named or note.stat().st_size > 100_000:
            continue
        for line in read_lines(note):
            if match := _UNIT_LINE.match(line):
                noted.setdefault(match[1].lower(), match[2].strip())
    values = []
    for column in columns:
        missing = np.flatnonzero(~np.isfinite(column.values))
        if len(missing):
            line = sheet.table.lines[missing[0]]
            raise InputError(f"{path}: line {line} is without a finite number in {column.name}")
        values.append(column.values)
    if np.ptp(values[1]) == 0.0:
        raise InputError(f"{path}: strain is {values[1][0]:g} throughout")
    span = float(np.ptp(values[1]))
    unit = strain_unit or noted.get("strain")
    if unit is None:
        unit = "%" if span > LARGEST_SPAN else "mm/mm"
        text = (
            f"{path}: no unit of strain is given; its span of {span:.4g} is taken as {unit}: as "
            f"mm/mm it {'is more' if unit == '%' else 'is no more'} than NiTi recovers"
        )
        findings.append(Finding("warning", "strain unit", text, {"span": span}))
    si = []
    units = (
        ("temperature", "temperature", noted.get("temperature", "degC")),
        ("strain", "ratio", unit), ("stress", "stress", noted.get("stress", "MPa")),
    )
    for (what, quantity, text), column_values in zip(units, values, strict=False):
        known = parse_unit(text)
        if known is None or known.quantity != quantity:
            raise InputError(f"{path}: unit of {what} is {text!r}, expected one of {quantity}")
        si.append(in_si(column_values, known))
    if len(si) == 2:
        si.append(np.full(len(si[0]), stated))
    span = float(np.ptp(si[1]))
    if span > LARGEST_SPAN:
        text = (
            f"{path}: strain spans {span:.3g} in the unit {unit!r}, more than the {LARGEST_SPAN:g} "
            "that NiTi recovers; is the unit percent?"
        )
        findings.append(Finding("warning", "strain unit", text, {"span": span}))
    return si[0], si[1], si[2]


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
