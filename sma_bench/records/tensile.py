"""Tensile tests: stress against strain at constant temperature, from tables with titles."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from sma_bench.drawn import Drawn
from sma_bench.errors import InputError
from sma_bench.findings import Finding
from sma_bench.records.record import FloatArray
from sma_bench.records.roles import Sheet
from sma_bench.records.tables import Account

Phase = Literal["martensite", "austenite"]
PHASES: tuple[Phase, ...] = get_args(Phase)
FEWEST_ROWS = 20
LARGEST_STRAIN = 0.5
LARGEST_STRESS = 3e9
STEADY = 3.0  # K
_PHASE = re.compile(r"\bphase\b[^a-z]{0,8}(?P<phase>martensite|austenite)\b", re.IGNORECASE)


@dataclass(frozen=True, repr=False)
class TensileRecord(Drawn):
    """One tensile test; the specimen's length and section may stand in no file."""

    path: Path
    strain: FloatArray  # (n,) in order of time, m where `is_extension`
    stress: FloatArray  # (n,) Pa, N where `is_force`
    temperature: float | None  # K; None where the file does not say
    findings: tuple[Finding, ...] = ()  # what the reader noticed
    phase: Phase | None = None  # of the specimen
    is_extension: bool = False
    is_force: bool = False
    account: Account | None = None  # what became of the file's rows and columns

    def __repr__(self) -> str:
        return f"<TensileRecord {self.path}: {len(self.strain)} rows>"


def is_tensile(sheet: Sheet) -> bool:
    """Whether a table has strain or extension, and stress or force, and no drive."""
    return sheet.has("tensile") and not sheet.is_driven()


def read_tensile(
    path: Path | str,
    *,
    gauge_length: float | None = None,
    area: float | None = None,
    temperature: float | None = None,
) -> TensileRecord:
    """The test in a table whose titles name strain and stress, or extension and force, with units.

    `gauge_length` (m) of an extension, `area` (m2) of a force and `temperature` (K) are taken from
    lines above the table where they are None. Raises InputError where there are no such titles, for
    a malformed line (named), or values that no such test gives.
    """
    given = {"gauge_length": gauge_length, "area": area, "temperature": temperature}
    return tensile_of(Sheet.first(path, **given))


def tensile_of(sheet: Sheet) -> TensileRecord:
    """The test in a table; raises as `read_tensile`."""
    path, table = sheet.path, sheet.table
    if not sheet.titles:
        raise InputError(f"{path}: no titles above the numbers, expected Strain (%),Stress (MPa)")
    if len(table.lines) < FEWEST_ROWS:
        raise InputError(f"{path}: {len(table.lines)} rows, expected {FEWEST_ROWS} or more")
    columns = sheet.columns("tensile")
    pulled, loaded = columns["strain"], columns["stress"]
    strain, stress = sheet.values(*pulled), sheet.values(*loaded)

    # Extension counts from the first row, over the gauge length; force over the section.
    length, section = sheet.noted("gauge_length"), sheet.noted("area")
    diameter = sheet.noted("diameter")
    if section is None and diameter is not None:
        section = 0.25 * np.pi * diameter**2
    is_extension, is_force = pulled[1] == "length", loaded[1] == "force"
    if is_extension:
        start = float(strain[0])
        if abs(start) > 0.01 * float(np.ptp(strain)):
            text = f"{pulled[0].name} begins at {start * 1e3:.6g} mm, which is taken as 0"
            sheet.remark("info", "extension", text, start=start)
        strain = strain - start
        if length is not None:
            strain, is_extension = strain / length, False
    if is_force and section is not None:
        stress, is_force = stress / section, False
    for values, what, largest in (
        (strain, "strain", LARGEST_STRAIN),
        (stress, "stress", LARGEST_STRESS),
    ):
        worst = int(np.argmax(np.abs(values)))
        if abs(values[worst]) > largest:
            said = f"line {table.lines[worst]}: {what} {values[worst]:.4g} in SI units"
            hint = "is the unit in the title right?"
            raise InputError(f"{path}: {said}, expected no more than {largest:g}; {hint}")
        if np.ptp(values) == 0.0:
            raise InputError(f"{path}: {what} is constant throughout")

    temperature, measured = sheet.noted("temperature"), sheet.find("temperature")
    if "temperature" not in sheet.given and measured is not None:
        kelvin = sheet.values(*measured)
        columns["temperature"] = measured
        if np.ptp(kelvin) > STEADY:
            text = f"temperature changes by {np.ptp(kelvin):.1f} K during the test, expected no "
            sheet.remark("warning", "temperature", f"{text}more than {STEADY:g} K")
        temperature = float(np.median(kelvin))
    noted = [m["phase"].lower() for c in table.above if (m := _PHASE.search(" ".join(c)))]
    phase = next((phase for phase in PHASES if phase in noted[:1]), None)
    account, findings = sheet.account(columns, len(strain)), tuple(sheet.findings)
    return TensileRecord(
        path, strain, stress, temperature, findings, phase, is_extension, is_force, account
    )
