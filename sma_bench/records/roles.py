"""What an instrument's table holds: its columns by role, and the numbers in the lines above it."""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from sma_bench.errors import InputError
from sma_bench.findings import Finding, Severity
from sma_bench.records.structure import Column, Table
from sma_bench.records.tables import Account, TableFile, read_table_file
from sma_bench.records.units import (
    QUANTITIES,
    WORDS,
    FloatArray,
    in_si,
    meanings,
    number_with_unit,
    parse_unit,
    plain_title,
    split_title,
    title_meanings,
)

_STATED = WORDS["stated"]


@dataclass(frozen=True)
class Sheet:
    """One table of an instrument's file, with what was stated beside it in SI units."""

    file: TableFile
    table: Table
    given: Mapping[str, float]
    findings: list[Finding] = field(default_factory=list)

    @classmethod
    def first(cls, path: Path | str, **given: float | None) -> "Sheet":
        """The first of a file; raises InputError for a statement that is not > 0."""
        for what, value in given.items():
            if value is not None and not 0.0 < value < np.inf:
                raise InputError(f"{path}: {what.replace('_', ' ')} is {value}, expected > 0")
        file = read_table_file(path)
        return cls(file, file.tables[0], {k: v for k, v in given.items() if v is not None})

    @property
    def path(self) -> Path:
        """Of the file."""
        return self.file.path

    @property
    def titles(self) -> str:
        """Names of the columns, for a message; "" where none has a title."""
        named = any(column.title for column in self.table.columns)
        return ", ".join(column.name for column in self.table.columns[:12]) if named else ""

    def find(self, *roles: str) -> tuple[Column, str] | None:
        """The best column of the first of these roles that the table has, and its role."""
        for role in roles:
            found = [(_score(c, role), c) for c in self.table.columns if _is(c, role)]
            if found:
                return max(found, key=lambda pair: pair[0])[1], role
        return None

    def columns(self, kind: str, beside: Sequence[str] = ()) -> dict[str, tuple[Column, str]]:
        """Of a kind of test (`instruments` in words.yaml) what its columns are, but for what is
        stated beside them; raises InputError where one is absent."""
        found = {what: self.find(*roles) for what, roles in WORDS["instruments"][kind].items()}
        if absent := next((w for w, c in found.items() if c is None and w not in beside), None):
            said = f"no column of {absent} with a known unit among {self.titles or 'no titles'}"
            title = f"{absent.capitalize()} ({QUANTITIES[absent]['example']})"
            raise InputError(f"{self.path}: {said}, expected one as in {title!r}")
        return {what: column for what, column in found.items() if column}

    def has(self, kind: str, beside: Sequence[str] = ()) -> bool:
        """Whether the table has all columns of a kind of test but for those stated beside it."""
        roles = WORDS["instruments"][kind].items()
        return all(what in beside or self.find(*names) for what, names in roles)

    def remark(self, severity: Severity, subject: str, text: str, **numbers: float) -> None:
        """Note a finding."""
        self.findings.append(Finding(severity, subject, f"{self.path}: {text}", numbers))

    def titled(self, names: Sequence[str]) -> "Sheet":
        """The table under titles that its file states elsewhere, or not at all."""
        columns = self.table.columns
        if len(names) != len(columns):
            said = f"{len(columns)} columns, expected {len(names)} numbers a row"
            raise InputError(f"{self.path}: {said}")
        titles = ((name, *split_title(name)) for name in names)
        named = tuple(
            replace(c, name=n, title=t, unit=u)
            for c, (n, t, u) in zip(columns, titles, strict=True)
        )
        return replace(self, table=replace(self.table, columns=named))

    def values(self, column: Column, role: str) -> FloatArray:
        """(n,) in SI units; raises InputError where a cell is missing, or the unit is not told."""
        self.require_complete(column)
        unit = parse_unit(column.unit)
        if unit is None:
            span = f"{column.values.min():.6g} to {column.values.max():.6g}"
            title = f"{column.title} ({QUANTITIES[role]['example']})"
            said = f"{column.name} has no unit, values are {span}: which one? as in {title!r}"
            raise InputError(f"{self.path}: {said}, written in the title")
        return in_si(column.values, unit)

    def require_complete(self, column: Column) -> None:
        """Raise InputError where a cell is missing."""
        missing = np.flatnonzero(~np.isfinite(column.values))
        if len(missing):
            where = f"{self.path}: line {self.table.lines[missing[0]]}"
            raise InputError(f"{where} is without a finite number in {column.name}")

    def noted(self, name: str) -> float | None:
        """A number of `stated` in words.yaml in SI units: given, or in a line above the table."""
        if name in self.given:
            return self.given[name]
        quantity, words = _STATED[name]["quantity"], _STATED[name]["words"]
        for cells in self.table.above:
            text = " ".join(cells).lstrip("#% ")
            plain = plain_title(text)
            if not any(re.search(rf"(?<![a-z]){re.escape(word)}", plain) for word in words):
                continue
            value = number_with_unit(text, quantity)
            key, _, rest = text.partition(":" if ":" in text else "\t")
            unit = parse_unit((re.findall(r"[/(\[]\s*([^\s)\]]+)", key) or [""])[-1])  # Mass/mg: 12
            number = re.search(r"\d+(?:[.,]\d+)?", rest)
            if value is None and unit and unit.quantity == quantity and number:
                value = float(number[0].replace(",", ".")) * unit.factor + unit.offset
            if value is not None:
                return value
        return None

    def account(self, columns: Mapping[str, tuple[Column, str]], rows: int) -> Account:
        """What became of the table's rows and columns."""
        used = {column.name: role for column, role in columns.values()}
        rest = {c.name: "not needed" for c in self.table.columns if c.name not in used}
        outside = (*self.table.unused_lines, *self.file.outside)
        name = self.table.name if len(self.file.tables) > 1 else ""
        ignored = {**rest, **self.table.ignored}
        return Account(self.table.rows, rows, used, ignored, (), outside, name)

    def is_driven(self) -> bool:
        """Whether a title speaks of a duty, voltage or current: a bench's record."""
        drives = (("duty",), ("current",), ("voltage",), ("supply",))
        titled = [c for c in self.table.columns if title_meanings(c.title)]
        named = [c for c in titled if c.unit or len(c.title) > 1]
        return any(meanings(column.title, column.unit) in drives for column in named)


def _is(column: Column, role: str) -> bool:
    """Whether a column may be of a role: its title says so, or of heat flow its unit alone; a set
    temperature is one if there is no other."""
    if role != "heat flow" and not title_meanings(column.title):
        return False
    meant, unit = meanings(column.title, column.unit), parse_unit(column.unit)
    if role == "temperature" and meant in (("setpoint",), ("ambient",)):
        meant = ("temperature",) if "temp" in plain_title(column.title) else ()
    if role not in meant or unit is None:
        return role in meant and not column.unit and role != "heat flow"
    return unit.quantity in QUANTITIES[role]["units"]


def _score(column: Column, role: str) -> int:
    plain = plain_title(column.title)
    words, row = set(re.findall(r"[a-z]+", plain)), QUANTITIES[role]
    better, worse = (
        sum(w in words or (len(w) > 3 and w in plain) for w in row.get(key, ()))
        for key in ("better", "worse")
    )
    return better - 2 * worse


def parse_stated(texts: Iterable[str]) -> dict[str, float]:
    """`stress=200 MPa` and the like in SI units; raises InputError for nothing that can be stated,
    or no number with its unit."""
    found: dict[str, float] = {}
    for text in texts:
        name, _, rest = text.partition("=")
        name = name.strip().replace("-", "_")
        if name not in _STATED:
            raise InputError(f"{text!r}: expected one of {', '.join(_STATED)}, e.g. mass=12 mg")
        quantity = _STATED[name]["quantity"]
        value = number_with_unit(rest, quantity)
        if value is None or not 0.0 < value < np.inf:
            raise InputError(f"{text!r}: expected a number with a unit of {quantity}")
        found[name] = value
    return found
