"""Isobaric tests: strain of a specimen under constant stress while its temperature cycles."""

import math
import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from sma_bench.border import read_bytes
from sma_bench.drawn import Drawn
from sma_bench.errors import InputError
from sma_bench.findings import Finding
from sma_bench.records.record import FloatArray
from sma_bench.records.roles import Sheet
from sma_bench.records.sheets import decoded_lines
from sma_bench.records.tables import Account
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
_NOTES, _LARGEST_NOTE = ("source", "unit", "readme"), 100_000  # bytes


Direction = Literal["heating", "cooling"]


@dataclass(frozen=True)
class Branch:
    """One heating or cooling: temperature K, strain, stress Pa, each (n,), in order of time."""

    direction: Direction
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
    """(n,) True for the readings of temperature (n,) K but single ones that jump away from the line
    through those around and back, and the heights (K) of these."""
    half, steps = _WINDOW // 2, np.diff(temperature)
    around = sliding_window_view(np.pad(steps, (half, half + 1), mode="edge"), _WINDOW)
    slope = np.median(around, axis=1)[: len(temperature), None]
    windows = sliding_window_view(np.pad(temperature, half, mode="edge"), _WINDOW)
    away = temperature - np.median(windows - slope * np.arange(-half, half + 1), axis=1)
    scatter = 1.4826 * float(np.median(np.abs(away)))
    bad = np.abs(away) > max(SMALLEST_SPIKE, 6.0 * scatter)
    # It stands out from both its neighbours: a corner or a step does not.
    before, after = np.pad(steps, (1, 0)), np.pad(steps, (0, 1))
    bad &= (before * after < 0.0) & (np.minimum(abs(before), abs(after)) > SMALLEST_SPIKE)
    return ~bad, away[bad]


def without_noise(temperature: FloatArray) -> tuple[FloatArray, float, int]:
    """(n,) K without the scatter of a noisy thermometer, which would pass for a wider range of
    transformation, that scatter, and through how many rows: a parabola, at most a sixth of a
    branch; 0 where nothing was done."""
    from scipy.signal import savgol_filter  # half a second to load

    noise = 0.0
    if len(temperature) >= _FEWEST_SAMPLES:
        noise = 1.4826 * float(np.median(np.abs(np.diff(temperature, 2)))) / math.sqrt(6.0)
    smooth, width, window = temperature, 0, 5
    # A parabola through w readings has 9/4 of the variance of their mean.
    while noise >= _NOISY and noise * math.sqrt(2.25 / max(width, 2.25)) > _SMOOTH:
        level = 0.5 * (smooth.max() + smooth.min())
        away = smooth[np.abs(smooth - level) > 0.15 * np.ptp(smooth)] > level
        if window > len(temperature) / (1 + np.count_nonzero(np.diff(away))) / 6.0:
            break
        smooth = np.asarray(savgol_filter(temperature, window, 2))
        width, window = window, 2 * window - 1
    return smooth, noise, width if noise >= _NOISY else 0


def find_cycles(
    temperature: FloatArray, strain: FloatArray, stress: FloatArray, where: str
) -> tuple[tuple[Cycle, ...], list[Finding]]:
    """Split a test at the reversals of temperature (n,) K, with strain (n,) and stress (n,) Pa in
    order of time; `where` leads the messages. Raises InputError where there is no branch."""
    span = float(np.ptp(temperature)) if len(temperature) else 0.0
    if span < SMALLEST_RANGE:
        said = f"{where}: temperature changes by {span:.3g} K"
        raise InputError(f"{said}, expected a cycle of {SMALLEST_RANGE:g} K or more")
    turns = _turning_points(temperature, max(TURN * span, 2.0))
    cycles: list[tuple[Branch, ...]] = []
    partial = 0
    for first, last in zip(turns[:-1], turns[1:], strict=True):
        change = temperature[last] - temperature[first]
        if abs(change) < COMPLETE * span or last - first < _FEWEST_SAMPLES:
            partial += 1
            continue
        way: Direction = "heating" if change > 0.0 else "cooling"
        branch = Branch(way, *(v[first : last + 1] for v in (temperature, strain, stress)))
        if cycles and len(cycles[-1]) == 1 and cycles[-1][0].direction != way:
            cycles[-1] = (cycles[-1][0], branch)
        else:
            cycles.append((branch,))
    if not cycles:
        raise InputError(f"{where}: no branch spans {COMPLETE:.0%} of the {span:.1f} K range")
    text = f"{where}: {partial} turns of temperature span less than {COMPLETE:.0%} of the range"
    numbers = {"count": float(partial)}
    left_out = Finding("info", "temperature", f"{text} and are left out", numbers)
    found = tuple(Cycle(number, branches) for number, branches in enumerate(cycles, 1))
    return found, [left_out] if partial else []


def _turning_points(temperature: FloatArray, threshold: float) -> list[int]:
    """Indices of the extremes that a change of more than `threshold` follows, and both ends."""
    turns, extreme, direction = [0], 0, 0
    for i, change in ((i, t - temperature[extreme]) for i, t in enumerate(temperature)):
        if direction == 0 and abs(change) > threshold:
            direction, extreme = (1 if change > 0.0 else -1), i
        elif direction and direction * change >= 0.0:
            extreme = i
        elif direction and abs(change) > threshold:
            turns.append(extreme)
            direction, extreme = -direction, i
    return [*turns, extreme]


@dataclass(frozen=True, repr=False)
class IsobaricRecord(Drawn):
    """One test at one stress.

    Strain has the unit "1", or is "relative" where the gauge length is unknown: the extension over
    its own full range, so that strains can be compared within the test only.
    """

    path: Path
    name: str  # unique among files of different folders: folder and stem, and its sheet
    stress: float  # median over the cycles, Pa
    strain_unit: str
    cycles: tuple[Cycle, ...]  # heating and cooling branches in order
    findings: tuple[Finding, ...] = ()  # what the reader noticed or assumed
    account: Account | None = None  # what became of the file's rows and columns

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

    `strain_unit` is "mm/mm" or "%", None for that of the note or of the values' span;
    `gauge_length` (m) that of the extension. Raises InputError where it is not such a table, for a
    malformed line (named), and without a thermal cycle.
    """
    return isobaric_of(Sheet.first(path, gauge_length=gauge_length), strain_unit)


def isobaric_of(sheet: Sheet, strain_unit: str | None = None) -> IsobaricRecord:
    """The test in a table; raises as `read_isobaric`."""
    path, table, load = sheet.path, sheet.table, _load_beside(sheet)
    if len(table.lines) < FEWEST_ROWS:
        raise InputError(f"{path}: {len(table.lines)} rows of numbers, expected {FEWEST_ROWS}")
    if not sheet.titles:
        sheet = _named(sheet, strain_unit, load is not None)
    columns = sheet.columns("isobaric", ["stress"] if load is not None else [])
    pulled, role = columns["strain"]
    span = float(np.ptp(pulled.values))
    if span == 0.0:
        raise InputError(f"{path}: {pulled.name} is {pulled.values[0]:g} throughout")
    transforms = 0.01 * LARGEST_SPAN < span < 100.0 * LARGEST_SPAN
    if role == "strain" and not pulled.unit and transforms:
        unit = "%" if span > LARGEST_SPAN else "mm/mm"
        text = f"no unit of strain is given; its span of {span:.4g} is taken as {unit}"
        sheet.remark("warning", "strain unit", text, span=span)
        pulled = replace(pulled, unit=unit)
    temperature, strain = sheet.values(*columns["temperature"]), sheet.values(pulled, role)
    stress = np.full(len(strain), load)
    if "stress" in columns:
        stress = sheet.values(*columns["stress"])
    span, gauge = float(np.ptp(strain)), sheet.noted("gauge_length")
    is_relative = role == "length" and gauge is None
    if is_relative:
        text = f"{pulled.name} without a gauge length; strain is given relative to the largest "
        text += f"change, {span * 1e3:.4g} mm"
        sheet.remark("warning", "strain", text, extension_range=span)
    elif role == "length" and gauge is not None:
        strain = strain / gauge
    elif span > LARGEST_SPAN:
        text = f"strain spans {span:.3g} in the unit {pulled.unit!r}, more than the "
        text += f"{LARGEST_SPAN:g} that NiTi recovers; is the unit percent?"
        sheet.remark("warning", "strain unit", text, span=span)
    wrong = np.flatnonzero((temperature <= 0.0) | (temperature > 1500.0))
    if len(wrong):
        found = f"line {table.lines[wrong[0]]}: temperature {temperature[wrong[0]]:.6g} K"
        raise InputError(f"{path}: {found}, expected 0 to 1500 K")

    # Rows between loading and unloading, where stress is at its level.
    level = float(np.median(stress))
    away = np.abs(stress - level) > max(CONSTANCY * abs(level), 1e6)
    inside = np.flatnonzero(~away)
    held = slice(int(inside[0]), int(inside[-1]) + 1)
    if lost := len(stress) - (held.stop - held.start):
        text = f"{lost} rows of loading or unloading are left out"
        sheet.remark("info", "stress", text, rows=float(lost))
    share = float(np.mean(away[held]))
    if share > 0.02:
        text = f"stress is more than {CONSTANCY:.0%} away from {level / 1e6:.4g} MPa in "
        text += f"{share:.0%} of the rows, so the test is not isobaric"
        sheet.remark("warning", "stress", text, share=share)
    temperature, strain, stress = temperature[held], strain[held], stress[held]
    if is_relative:
        strain = (strain - strain.min()) / np.ptp(strain)
    good, spikes = without_spikes(temperature)
    if len(spikes):
        text = f"{len(spikes)} of {len(temperature)} temperatures jump away by up to "
        text += f"{np.abs(spikes).max():.1f} K and back; left out"
        sheet.remark("info", "temperature", text, count=float(len(spikes)))
    settled, noise, rows = without_noise(temperature[good])
    if noise >= _NOISY:
        text = f"temperature scatters by {noise:.2g} K from row to row; read through {rows} rows"
        sheet.remark("info", "temperature", text, noise=noise, rows=float(rows))
    cycles, remarks = find_cycles(settled, strain[good], stress[good], str(path))
    median = float(np.median(stress))
    if median > STRONGEST:
        text = f"stress {median / 1e6:.0f} MPa is more than any NiTi endures "
        text += f"({STRONGEST / 1e6:.0f} MPa): the area or the unit of force behind it is wrong"
        sheet.remark("warning", "stress", text, stress=median)
    name = f"{path.parent.name}/{path.stem}"
    name += f"/{table.name}" if len(sheet.file.tables) > 1 else ""
    account, unit = sheet.account(columns, int(np.sum(good))), "relative" if is_relative else "1"
    findings = (*sheet.findings, *remarks)
    return IsobaricRecord(path, name, median, unit, cycles, findings, account)


def _named(sheet: Sheet, strain_unit: str | None, is_loaded: bool) -> Sheet:
    """A table without titles under those of the known form, with the units of a note beside it."""
    path, columns = sheet.path, sheet.table.columns
    if len(columns) != 3 - is_loaded:
        raise InputError(
            f"{path}: {len(columns)} columns without titles, expected 3: temperature, strain, "
            "stress; of two state the stress: stress=200 MPa, or a first line 'Stress: 200 MPa'"
        )
    noted: dict[str, str] = {}  # lines such as "Strain = %"
    for note in sorted(n for n in path.parent.iterdir() if n.suffix in (".txt", ".md")):
        is_one = note != path and any(word in note.stem.lower() for word in _NOTES)
        if is_one and note.stat().st_size < _LARGEST_NOTE:
            lines = decoded_lines(read_bytes(note, _LARGEST_NOTE))
            found = [match for line in lines if (match := _UNIT_LINE.match(line))]
            noted = {m[1].lower(): m[2].strip() for m in reversed(found)} | noted
    coldest = float(np.nanquantile(columns[0].values, 0.05))
    level = 0.0 if is_loaded else 1e6 * float(np.nanmedian(columns[-1].values))
    is_cold = _COLDEST[0] < coldest < _COLDEST[1]
    for what, is_one, said in (
        ("temperature", is_cold, f"the temperature begins at {coldest:.4g}: in degC or K?"),
        ("stress", level < STRONGEST, f"the stress is {level / 1e6:.4g}: in MPa?"),
    ):
        if what not in noted and not is_one:
            raise InputError(f"{path}: {said} write titles with units above the columns")
    units = {"temperature": "degC", "strain": "", "stress": "MPa"} | noted
    units["strain"] = strain_unit or units["strain"]
    for what, quantity in (("temperature", "temperature"), ("strain", "ratio"), ("stress",) * 2):
        known = parse_unit(units[what])
        if units[what] and (known is None or known.quantity != quantity):
            said = f"unit of {what} is {units[what]!r}"
            raise InputError(f"{path}: {said}, expected one of {quantity}")
    names = [f"{what} [{unit}]" if unit else what for what, unit in units.items()]
    return sheet.titled(names[: len(columns)])
