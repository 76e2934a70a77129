"""What an instrument's table holds: its columns by role, and the numbers in the lines above it."""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sma_bench.errors import InputError
from sma_bench.findings import Finding
from sma_bench.records.cells import Column, Table
from sma_bench.records.tables import Account, TableFile
from sma_bench.records.units import (
    ROLES,
    STATED,
    FloatArray,
    in_si,
    number_with_unit,
    parse_unit,
    plain_title,
    title_meanings,
)

_LARGEST_STRAIN = 0.5  # as a ratio: NiTi breaks before


@dataclass(frozen=True)
class Sheet:
    """One table of an instrument's file, with what was stated beside it in SI units."""

    file: TableFile
    table: Table
    given: Mapping[str, float]

    @property
    def path(self) -> Path:
        """Of the file."""
        return self.file.path

    def find(self, *roles: str) -> "tuple[Column, str] | None":
        """The best column of the first of these roles that the table has, and its role."""
        for role in roles:
            quantities, better, worse = (ROLES[role][k] for k in ("units", "better", "worse"))
            found: list[tuple[int, Column]] = []
            for column in self.table.columns:
                unit, meant = parse_unit(column.unit), title_meanings(column.title)
                if "setpoint" in meant and role != "temperature":
                    continue
                named = role in meant
                if role == "temperature" and meant in (("setpoint",), ("ambient",)):
                    named = "temp" in plain_title(column.title)
                fits = unit is not None and unit.quantity in quantities
                if role == "heat flow":
                    named = fits and (named or not meant)
                if not named or (column.unit and not fits):
                    continue
                plain = plain_title(f"{column.title}")
                words = set(re.findall(r"[a-z]+", plain))
                score = sum(w in words or (len(w) > 3 and w in plain) for w in better)
                score -= 2 * sum(w in words or (len(w) > 3 and w in plain) for w in worse)
                found.append((score, column))
            if found:
                return max(found, key=lambda pair: pair[0])[1], role
        return None

    def values(self, found: "tuple[Column, str]", findings: list[Finding]) -> FloatArray:
        """(n,) in SI units; a unit that is not stated is guessed where the values leave no doubt,
        and said.

        Raises:
            InputError: a cell is missing, or no unit of a length, force or flow is stated.
        """
        column, role = found
        missing = np.flatnonzero(~np.isfinite(column.values))
        if len(missing):
            where = f"{self.path}: line {self.table.lines[missing[0]]}"
            raise InputError(f"{where} is without a finite number in {column.name}")
        unit = parse_unit(column.unit)
        if unit is None:
            largest = float(np.abs(column.values).max(initial=0.0))
            guess = {
                "temperature": "K" if float(column.values.min(initial=0.0)) > 180.0 else "degC",
                "stress": "Pa" if largest > 1e5 else "MPa",
                "strain": "%" if largest > _LARGEST_STRAIN else "mm/mm",
            }.get(role)
            if guess is None:
                raise InputError(
                    f"{self.path}: {column.name} has no unit; write it in the title, "
                    f"{column.title} (mm) for instance"
                )
            text = f"{self.path}: {column.name} has no unit; taken as {guess} because of its values"
            findings.append(Finding("warning", f"unit of {column.name}", text))
            unit = parse_unit(guess)
        assert unit is not None
        return in_si(column.values, unit)

    def noted(self, name: str) -> float | None:
        """A number of STATED in SI units: given, or in a line above the table."""
        if name in self.given:
            return self.given[name]
        quantity, words = STATED[name]["quantity"], STATED[name]["words"]
        for cells in self.table.above:
            text = " ".join(cells).lstrip("#% ")
            plain = plain_title(text)
            if not any(re.search(rf"(?<![a-z]){re.escape(word)}", plain) for word in words):
                continue
            value = number_with_unit(text, quantity)
            key, _, rest = text.partition(":") if ":" in text else text.partition("\t")
            if value is None and (number := re.search(r"\d+(?:[.,]\d+)?", rest)):
                for unit_text in re.findall(r"[/(\[]\s*([^\s)\]]+)", key):
                    unit = parse_unit(unit_text)
                    if unit is not None and unit.quantity == quantity:
                        value = float(number[0].replace(",", ".")) * unit.factor + unit.offset
            if value is not None:
                return value
        return None

    def account(self, used: Mapping[str, str], rows: int) -> Account:
        """What became of the table's rows and columns."""
        rest = {c.name: "not needed" for c in self.table.columns if c.name not in used}
        outside = (*self.table.unused_lines, *self.file.outside)
        return Account(self.table.rows, rows, dict(used), {**rest, **self.table.ignored}, (),
                       outside, self.table.name if len(self.file.tables) > 1 else "")  # fmt: skip

    def is_driven(self) -> bool:
        """Whether a title speaks of a duty, voltage or current: a bench's record."""
        for column in self.table.columns:
            unit, meant = parse_unit(column.unit), title_meanings(column.title)
            if unit is not None and unit.quantity in ("voltage", "current"):
                return bool(meant)
            if meant[:1] in (("duty",), ("current",)) or (meant == ("voltage",) and unit is None):
                return len(column.title) > 1
        return False


def parse_stated(texts: Iterable[str]) -> dict[str, float]:
    """`stress=200 MPa` and the like in SI units.

    Raises:
        InputError: none of STATED, or no number with its unit.
    """
    found: dict[str, float] = {}
    for text in texts:
        name, _, rest = text.partition("=")
        name = name.strip().replace("-", "_")
        if name not in STATED:
            raise InputError(f"{text!r}: expected one of {', '.join(STATED)}, e.g. mass=12 mg")
        value = number_with_unit(rest, STATED[name]["quantity"])
        if value is None or not 0.0 < value < np.inf:
            quantity = STATED[name]["quantity"]
            raise InputError(f"{text!r}: expected a number with a unit of {quantity}")
        found[name] = value
    return found
