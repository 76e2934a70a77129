"""Isobaric tests: strain of a specimen under constant stress while its temperature cycles."""

import math
import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from sma_bench.drawn import Drawn
from sma_bench.errors import InputError
from sma_bench.findings import Finding, Severity
from sma_bench.records.record import FloatArray
from sma_bench.records.roles import Sheet
from sma_bench.records.tables import Account, read_lines, read_table_file
from sma_bench.records.units import number_with_unit, parse_unit

SMALLEST_RANGE = 5.0  # K
SMALLEST_SPIKE = 3.0  # K
TURN = 0.15
COMPLETE = 0.6
FEWEST_ROWS = 20
# NiTi single crystals recover some 10 %: a larger span of strain is written in percent, and one
# of less than a hundredth of that is no transformation.
LARGEST_SPAN = 0.12
# Cold-drawn NiTi wire breaks at 1.4 to 1.9 GPa.
STRONGEST = 1.5e9
CONSTANCY = 0.05
_WINDOW = 11
_FEWEST_SAMPLES = 8
_NOISY, _SMOOTH = 0.5, 0.2  # K
# Coldest point of a cycle in degC: above, the values are K or degF as well.
_COLDEST = (-150.0, 60.0)
_UNIT_LINE = re.compile(r"\s*+(stress|strain|temperature)\s*+[=:]\s*+(\S.*)", re.IGNORECASE)
_NOTES = ("source", "unit", "readme")
_UNTITLED = ("temperature", "strain", "stress")


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
    columns, load = sheet.table.columns, _load_beside(sheet)
    if sheet.titles:
        temperature = sheet.find("temperature")
        has_all = sheet.has("isobaric", ["stress"] if load else [])
        varies = temperature is not None and np.ptp(temperature[0].values) > SMALLEST_RANGE
        return bool(has_all and varies and not sheet.is_driven())
    if len(columns) != (3 if load is None else 2) or len(columns[0].values) < 2:
        return False
    first, last = columns[0].values, np.abs(columns[-1].values)
    steps, level = np.diff(first), float(np.median(last))
    held = load is not None or np.mean(np.abs(last - level) < 0.2 * level) > 0.5
    return bool(held and steps.max() > 0.0 > steps.min() and np.ptp(first) > SMALLEST_RANGE)


def _load_beside(sheet: Sheet) -> float | None:
    """A stress that is stated, in a line above the table or by the name of its sheet."""
    stated = sheet.noted("stress")
    return stated if stated is not None else number_with_unit(sheet.table.name, "stress")


def read_isobaric(
    path: Path | str, *, strain_unit: str | None = None, gauge_length: float | None = None
) -> IsobaricRecord:
    """The isobaric test in a file: a table with titles and units (extension or strain,
    temperature, stress, or the stress stated above it), or three columns without titles
    (temperature in degC, strain, stress in MPa; or in the units of a note beside the file, such as
    "Data Source.txt").

    Args:
        path: the file.
        strain_unit: "mm/mm" or "%"; None: from the note beside the file, else by its span.
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
    path, table, load = sheet.path, sheet.table, _load_beside(sheet)
    findings: list[Finding] = []

    def remark(severity: Severity, subject: str, text: str, **numbers: float) -> None:
        findings.append(Finding(severity, subject, f"{path}: {text}", numbers))

    if len(table.lines) < FEWEST_ROWS:
        raise InputError(f"{path}: {len(table.lines)} rows of numbers, expected {FEWEST_ROWS}")
    if not sheet.titles:
        sheet = _named(sheet, strain_unit, load is not None)
    columns = sheet.columns("isobaric", ["stress"] if load is not None else [])
    pulled = columns["strain"]
    if np.ptp(pulled[0].values) == 0.0:
        raise InputError(f"{path}: {pulled[0].name} is {pulled[0].values[0]:g} throughout")
    if pulled[1] == "strain" and not pulled[0].unit:
        # As mm/mm it is 0.12 to 12 %, or as % it is: no transformation gives more or less.
        span = float(np.ptp(pulled[0].values))
        unit = "%" if span > LARGEST_SPAN else "mm/mm"
        if 0.01 * LARGEST_SPAN < span < 100.0 * LARGEST_SPAN:
            text = f"no unit of strain is given; its span of {span:.4g} is taken as {unit}"
            remark("warning", "strain unit", text, span=span)
            columns["strain"] = pulled = replace(pulled[0], unit=unit), "strain"
    temperature, strain = sheet.values(columns["temperature"]), sheet.values(pulled)
    stress = np.full(len(strain), load)
    if "stress" in columns:
        stress = sheet.values(columns["stress"])
    span, gauge = float(np.ptp(strain)), sheet.noted("gauge_length")
    is_relative = pulled[1] == "length" and gauge is None
    if is_relative:
        text = f"{pulled[0].name} without a gauge length; strain is given relative to the largest "
        text += f"change, {span * 1e3:.4g} mm"
        remark("warning", "strain", text, extension_range=span)
    elif pulled[1] == "length" and gauge is not None:
        strain = strain / gauge
    elif span > LARGEST_SPAN:
        text = f"strain spans {span:.3g} in the unit {pulled[0].unit!r}, more than the "
        text += f"{LARGEST_SPAN:g} that NiTi recovers; is the unit percent?"
        remark("warning", "strain unit", text, span=span)
    wrong = np.flatnonzero((temperature <= 0.0) | (temperature > 1500.0))
    if len(wrong):
        found = f"line {table.lines[wrong[0]]}: temperature {temperature[wrong[0]]:.6g} K"
        raise InputError(f"{path}: {found}, expected 0 to 1500 K")

    # Rows between loading and unloading, where stress is at its level.
    level = float(np.median(stress))
    away = np.abs(stress - level) > max(CONSTANCY * abs(level), 1e6)
    inside = np.flatnonzero(~away)
    held = slice(int(inside[0]), int(inside[-1]) + 1)
    if left_out := len(stress) - (held.stop - held.start):
        remark(
            "info",
            "stress",
            f"{left_out} rows of loading or unloading are left out",
            rows=float(left_out),
        )
    share = float(np.mean(away[held]))
    if share > 0.02:
        text = (
            f"stress is more than {CONSTANCY:.0%} away from {level / 1e6:.4g} MPa in {share:.0%} "
        )
        remark("warning", "stress", f"{text}of the rows, so the test is not isobaric", share=share)
    temperature, strain, stress = temperature[held], strain[held], stress[held]
    if is_relative:
        strain = (strain - strain.min()) / np.ptp(strain)
    good, spikes = without_spikes(temperature)
    if len(spikes):
        text = f"{len(spikes)} of {len(temperature)} temperatures jump away by up to "
        text += f"{np.abs(spikes).max():.1f} K and back; left out"
        remark("info", "temperature", text, count=float(len(spikes)))
    settled = without_noise(temperature[good], str(path), findings)
    cycles, remarks = find_cycles(settled, strain[good], stress[good], str(path))
    findings.extend(remarks)
    median = float(np.median(stress))
    if median > STRONGEST:
        text = f"stress {median / 1e6:.0f} MPa is more than any NiTi endures "
        text += f"({STRONGEST / 1e6:.0f} MPa): the area or the unit of force behind it is wrong"
        remark("warning", "stress", text, stress=median)
    name = f"{path.parent.name}/{path.stem}"
    name += f"/{table.name}" if len(sheet.file.tables) > 1 else ""
    account = sheet.account({c.name: role for c, role in columns.values()}, int(np.sum(good)))
    return IsobaricRecord(
        path, name, median, "relative" if is_relative else "1", cycles, tuple(findings), account
    )


def _named(sheet: Sheet, strain_unit: str | None, is_loaded: bool) -> Sheet:
    """A table without titles under those of the known form, with the units of a note beside it."""
    path, columns = sheet.path, sheet.table.columns
    if len(columns) != 3 - is_loaded:
        raise InputError(
            f"{path}: {len(columns)} columns without titles, expected 3: temperature, strain, "
            "stress; of two the stress can be stated: stress=200 MPa, or a first line "
            "'Stress: 200 MPa'"
        )
    noted: dict[str, str] = {}  # lines such as "Strain = %"
    for note in (*sorted(path.parent.glob("*.txt")), *sorted(path.parent.glob("*.md"))):
        named = any(word in note.stem.lower() for word in _NOTES)
        if note != path and named and note.stat().st_size < 100_000:
            found = [match for line in read_lines(note) if (match := _UNIT_LINE.match(line))]
            noted = {m[1].lower(): m[2].strip() for m in reversed(found)} | noted
    coldest = float(np.nanquantile(columns[0].values, 0.05))
    if "temperature" not in noted and not _COLDEST[0] < coldest < _COLDEST[1]:
        said = f"the temperature begins at {coldest:.4g}: in degC or K? write titles with units"
        raise InputError(f"{path}: {said} above the columns")
    units = {"temperature": "degC", "stress": "MPa", "strain": ""} | noted
    units["strain"] = strain_unit or units["strain"]
    for what, quantity in zip(_UNTITLED, ("temperature", "ratio", "stress"), strict=True):
        known = parse_unit(units[what])
        if units[what] and (known is None or known.quantity != quantity):
            said = f"unit of {what} is {units[what]!r}, expected one of {quantity}"
            raise InputError(f"{path}: {said}")
    titled = tuple(
        replace(column, name=what, title=what, unit=units[what])
        for column, what in zip(columns, _UNTITLED, strict=False)
    )
    return replace(sheet, table=replace(sheet.table, columns=titled))
