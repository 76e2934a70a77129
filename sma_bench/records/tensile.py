"""Tensile tests: stress against strain at constant temperature, from text tables with titles."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from sma_bench.drawn import Drawn
from sma_bench.errors import InputError
from sma_bench.findings import Finding
from sma_bench.records.contract import CELSIUS_ZERO
from sma_bench.records.text_table import (
    FloatArray,
    TextTable,
    TitledColumn,
    find_column,
    is_driven,
    read_text_table,
    to_si,
)

Phase = Literal["martensite", "austenite"]
PHASES: tuple[Phase, ...] = get_args(Phase)
FEWEST_ROWS = 20
LARGEST_STRAIN = 0.5
LARGEST_STRESS = 3e9
STEADY = 3.0  # K
_EXTENSION = ("extension", "elongation", "displacement", "crosshead", "position")
_FORCE = ("force", "load")
_TEMPERATURE = re.compile(
    r"temperature[^0-9+-]*+(?P<value>[+-]?\d++(?:\.\d++)?+)\s*+°?\s*+(?:deg)?\s*+(?P<unit>[CK])\b",
    re.IGNORECASE,
)
_PHASE = re.compile(r"\bphase\b[^a-z]{0,8}(?P<phase>martensite|austenite)\b", re.IGNORECASE)


@dataclass(frozen=True, repr=False)
class TensileRecord(Drawn):
    """One tensile test.

    Attributes:
        path: the file.
        strain: (n,) in order of time, m where `is_extension`; stress: (n,) Pa, N where `is_force`:
            what the specimen measures stands in no file.
        temperature: K; phase: of the specimen; None where the file does not say.
        findings: what the reader noticed.
    """

    path: Path
    strain: FloatArray
    stress: FloatArray
    temperature: float | None
    findings: tuple[Finding, ...] = ()
    phase: Phase | None = None
    is_extension: bool = False
    is_force: bool = False

    def __repr__(self) -> str:
        return f"<TensileRecord {self.path}: {len(self.strain)} rows>"


def is_tensile(path: Path) -> bool:
    """Whether a file is a table with titles of strain and stress, or of extension and force."""
    try:
        table = read_text_table(path)
    except InputError:
        return False
    if is_driven(table):
        return False
    pairs = (
        (("strain",), "strain", ("stress",), "stress"), (_EXTENSION, "length", _FORCE, "force")
    )
    return any(
        find_column(table, x, (x_kind,)) is not None
        and find_column(table, y, (y_kind,)) is not None
        for x, x_kind, y, y_kind in pairs
    )


def read_tensile(
    path: Path | str,
    *,
    gauge_length: float | None = None,
    area: float | None = None,
    temperature: float | None = None,
) -> TensileRecord:
    """Read a table whose titles name strain and stress, or extension and force, with their units.

    Args:
        path: the file.
        gauge_length: m, for a column of extension; None: it stays one.
        area: cross section in m2, for a column of force; None: it stays one.
        temperature: of the test in K; None: from a column or a line above the table, if any.

    Raises:
        InputError: no such file, no titles with known units, a malformed line (named), or values
            that no such test gives.
    """
    path = Path(path)
    numbers = {"gauge length": gauge_length, "area": area, "temperature": temperature}
    for what, given in numbers.items():
        if given is not None and not 0.0 < given < np.inf:
            raise InputError(f"{path}: {what} is {given}, expected > 0")
    table = read_text_table(path)
    if not table.titles:
        raise InputError(f"{path}: no titles above the numbers, expected Strain (%),Stress (MPa)")
    if len(table.values) < FEWEST_ROWS:
        raise InputError(f"{path}: {len(table.values)} rows, expected {FEWEST_ROWS} or more")
    findings: list[Finding] = []
    strain, is_extension = _either(
        table, ("strain",), "strain", _EXTENSION, "length", gauge_length, findings
    )
    stress, is_force = _either(table, ("stress",), "stress", _FORCE, "force", area, findings)
    _check(table, strain, "strain", LARGEST_STRAIN)
    _check(table, stress, "stress", LARGEST_STRESS)
    if temperature is None:
        temperature = _temperature(table, findings)
    said = next((m["phase"].lower() for m in map(_PHASE.search, table.preamble) if m), None)
    phase = next((phase for phase in PHASES if phase == said), None)
    return TensileRecord(
        path, strain, stress, temperature, tuple(findings), phase, is_extension, is_force
    )


def _either(
    table: TextTable,
    words: tuple[str, ...],
    kind: str,
    other_words: tuple[str, ...],
    other_kind: str,
    divisor: float | None,
    findings: list[Finding],
) -> tuple[FloatArray, bool]:
    """A column in its own right, or another one over what the specimen measures; whether that is
    still to be divided by."""
    found = find_column(table, words, (kind,))
    if found is not None and (kind == "strain" or found[0].unit):
        findings += found[0].remark(table.path)
        return _column_values(table, found), False
    other = find_column(table, other_words, (other_kind,))
    if other is None:
        raise InputError(
            f"{table.path}: no column of {kind} or {other_words[0]} with a known unit among "
            f"{', '.join(table.titles)}"
        )
    findings += other[0].remark(table.path)
    return _column_values(table, other) / (divisor or 1.0), divisor is None


def _column_values(table: TextTable, found: tuple[TitledColumn, str]) -> FloatArray:
    column, kind = found
    return to_si(table.values[:, column.index], kind, column.unit)


def _check(table: TextTable, values: FloatArray, what: str, largest: float) -> None:
    worst = int(np.argmax(np.abs(values)))
    if abs(values[worst]) > largest:
        raise InputError(
            f"{table.path}: line {table.lines[worst]}: {what} {values[worst]:.4g} in SI units, "
            f"expected no more than {largest:g}; is the unit in the title right?"
        )
    if np.ptp(values) == 0.0:
        raise InputError(f"{table.path}: {what} is constant throughout")


def _temperature(table: TextTable, findings: list[Finding]) -> float | None:
    found = find_column(table, ("temp",), ("temperature",))
    if found is not None:
        kelvin = _column_values(table, found)
        if np.ptp(kelvin) > STEADY:
            text = (
                f"{table.path}: temperature changes by {np.ptp(kelvin):.1f} K during the test, "
                f"expected no more than {STEADY:g} K"
            )
            findings.append(Finding("warning", "temperature", text))
        return float(np.median(kelvin))
    for line in table.preamble:
        match = _TEMPERATURE.search(line)
        if match:
            value = float(match["value"])
            return value if match["unit"].upper() == "K" else value + CELSIUS_ZERO
    return None
