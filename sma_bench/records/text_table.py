"""Tables of numbers in text files: which separator, which header, which unit."""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sma_bench.border import OverBudget, reading_budget
from sma_bench.errors import InputError
from sma_bench.findings import Finding
from sma_bench.records.contract import CELSIUS_ZERO
from sma_bench.records.table_cells import name_and_unit
from sma_bench.records.tables import CANDIDATES, format_of, read_lines

FloatArray = NDArray[np.float64]

# Possessive: thousands of digits that end in a letter would be tried again at each of them.
_HEAD_LINES = 200
_LARGEST_STRAIN = 0.5  # as a ratio: NiTi breaks before
_DRIVES = ("duty", "pwm", "volt", "current")
_GUESSES = {"force": "N", "length": "mm"}
_NUMBER = re.compile(
    r"[+-]?(\d++\.?+\d*+|\.\d++)([eE][+-]?\d++)?\Z|[+-]?(nan|inf)\Z", re.IGNORECASE
)

# unit as written, without case, degree signs and carets -> factor to SI
UNITS: dict[str, dict[str, float]] = {
    "strain": {
        "mm/mm": 1.0,
        "m/m": 1.0,
        "in/in": 1.0,
        "1": 1.0,
        "-": 1.0,
        "": 1.0,
        "%": 1e-2,
        "percent": 1e-2,
        "pct": 1e-2,
        "microstrain": 1e-6,
    },
    "stress": {
        "pa": 1.0,
        "kpa": 1e3,
        "mpa": 1e6,
        "gpa": 1e9,
        "n/mm2": 1e6,
        "psi": 6894.757,
        "ksi": 6.894757e6,
    },
    "force": {"n": 1.0, "mn": 1e-3, "cn": 1e-2, "kn": 1e3, "lbf": 4.448222},
    "length": {"m": 1.0, "mm": 1e-3, "um": 1e-6, "in": 25.4e-3, "inch": 25.4e-3},
    "time": {"s": 1.0, "sec": 1.0, "ms": 1e-3, "min": 60.0, "h": 3600.0, "hr": 3600.0},
    "temperature": {"k": 1.0, "c": 1.0, "degc": 1.0, "degreesc": 1.0, "celsius": 1.0},
}


@dataclass(frozen=True)
class TextTable:
    """Numbers of a text file.

    Attributes:
        path: the file.
        titles: one a column; () for a file without header.
        preamble: the lines above the titles.
        values: (n, k).
        lines: (n,) line number of each row in the file, from 1.
    """

    path: Path
    titles: tuple[str, ...]
    preamble: tuple[str, ...]
    values: FloatArray
    lines: NDArray[np.int64]


@dataclass(frozen=True)
class TitledColumn:
    """One column by its title: position, name, and unit as written or, where `is_guessed`, taken
    for granted."""

    index: int
    name: str
    unit: str
    is_guessed: bool = False

    def remark(self, path: Path) -> list[Finding]:
        """That the unit is a guess, where it is one."""
        if not self.is_guessed:
            return []
        text = f"{path}: {self.name} has no unit; taken as {self.unit} because of its values"
        return [Finding("warning", f"unit of {self.name}", text)]


def read_text_table(path: Path | str) -> TextTable:
    """Read a table of two or more columns; tabs, commas, semicolons or blanks, quoted or not.

    Raises:
        InputError: no such file, no table in it, or a line within the table that is not as many
            finite numbers as the table has columns (the line is named).
    """
    path = Path(path)
    found = _once(path, tuple(read_lines(path)))
    if isinstance(found, InputError):
        raise InputError(str(found))
    return found


@lru_cache(maxsize=1)  # several readers look at one file in turn
def _once(path: Path, content: tuple[str, ...]) -> TextTable | InputError:
    try:
        return _table_of(path, content)
    except OverBudget as error:
        return InputError(f"{path}: {error}")
    except InputError as error:
        return error


def _table_of(path: Path, content: Sequence[str]) -> TextTable:
    budget = reading_budget(sum(map(len, content)))
    rows = [line.replace('"', "").strip() for line in content]
    separator, decimal = _dialect(rows)
    parsed = []
    for row in rows:
        budget.check()
        parsed.append(_numbers(row, separator, decimal))
    first = next((i for i, numbers in enumerate(parsed) if numbers and len(numbers) > 1), None)
    if first is None:
        raise InputError(f"{path}: no table of numbers found, expected two or more columns")
    width = len(parsed[first] or ())
    values, lines = [], []
    for i in range(first, len(rows)):
        if not rows[i]:
            continue
        numbers = parsed[i]
        if numbers is None or len(numbers) != width or not all(map(math.isfinite, numbers)):
            raise InputError(
                f"{path}: line {i + 1} is {rows[i][:60]!r}, expected {width} finite numbers"
            )
        values.append(numbers)
        lines.append(i + 1)
    titles, above = _titles(rows[:first], separator, width)
    return TextTable(
        path, titles, above, np.array(values, dtype=np.float64), np.array(lines, dtype=np.int64)
    )


def head_of(path: Path, size: int) -> bytes:
    """The first bytes of a file, at most `size`, without zeros: without them, UTF-16 looks like
    what it encodes.

    Raises:
        InputError: it cannot be read.
    """
    try:
        with path.open("rb") as file:
            head = file.read(size)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    if format_of(head) == "text":
        return head.replace(b"\0", b"")
    return "\n".join(read_lines(path)[:_HEAD_LINES]).encode(errors="replace")[:size]


def find_column(
    table: TextTable, words: Sequence[str], units: Sequence[str]
) -> tuple[TitledColumn, str] | None:
    """First column whose name holds one of `words`, in their order, and whose unit fits.

    Args:
        table: with titles.
        words: lower-case words or parts of them, the best one first.
        units: keys of UNITS, one of which must know the column's unit.

    Returns:
        The column and the key of UNITS that knows its unit, or None. Where the title has no unit
        and the values make one likely, the column has that and says so (`Column.remark`).
    """
    columns = [_column(i, title) for i, title in enumerate(table.titles)]
    for word in words:
        for column in columns:
            if word not in column.name.lower():
                continue
            for kind in units:
                if not column.unit and (guess := _guess(kind, table.values[:, column.index])):
                    return TitledColumn(column.index, column.name, guess, True), kind
                if plain_unit(column.unit) in UNITS[kind]:
                    return column, kind
    return None


def _guess(kind: str, values: FloatArray) -> str:
    """The unit of a column whose title has none; "" where its values leave it open."""
    largest = float(np.abs(values).max(initial=0.0))
    if kind == "temperature":
        return "K" if float(values.min(initial=0.0)) > 180.0 else "C"
    if kind == "stress":
        return "Pa" if largest > 1e5 else "MPa"
    if kind == "strain":
        return "%" if largest > _LARGEST_STRAIN else ""
    return _GUESSES.get(kind, "")


def is_driven(table: TextTable) -> bool:
    """Whether a title speaks of a duty, voltage or current: a bench's record, no instrument's."""
    return any(word in title.lower() for word in _DRIVES for title in table.titles)


def near_miss(table: TextTable) -> str:
    """What a table lacks to be an isobaric or tensile test; "" where it has little of either."""
    kinds = {"temperature": ("temp",), "strain": ("strain",), "stress": ("stress",),
             "force": ("force", "load"), "length": ("extension", "elongation")}  # fmt: skip
    has = {kind for kind, words in kinds.items() if find_column(table, words, (kind,))}
    bad = [t for t in table.titles for words in kinds.values()
           if any(w in t.lower() for w in words) and not has]  # fmt: skip
    if {"temperature", "strain"} <= has or {"temperature", "length"} <= has:
        return "no stress column: an isobaric test has temperature, strain and stress"
    if "stress" in has:
        return "no strain column: a tensile test has strain and stress"
    if "strain" in has:
        return "no stress column: a tensile test has strain and stress"
    return f"the unit of {bad[0]!r} is not known" if bad else ""


def to_si(values: FloatArray, kind: str, unit: str) -> FloatArray:
    """Values in SI units; Celsius becomes kelvin.

    Raises:
        InputError: the unit is not known.
    """
    known = UNITS[kind]
    plain = plain_unit(unit)
    if plain not in known:
        expected = ", ".join(sorted(u for u in known if u))
        raise InputError(f"unit of {kind} is {unit!r}, expected one of {expected}")
    if kind == "temperature":
        return values if plain == "k" else values + CELSIUS_ZERO
    return values * known[plain]


def plain_unit(unit: str) -> str:
    """A unit in lower case without degree signs, carets and blanks."""
    plain = unit.strip().lower().replace("µ", "u").replace("μ", "u")
    return re.sub(r"[°º^\s]", "", plain)


def _column(index: int, title: str) -> TitledColumn:
    if parts := name_and_unit(title):
        return TitledColumn(index, *parts)
    name, _, unit = title.partition("/")
    if unit:
        return TitledColumn(index, name.strip(), unit.strip())
    return TitledColumn(index, title.strip(), "")


def _dialect(rows: Sequence[str]) -> tuple[str | None, str]:
    def count(candidate: tuple[str | None, str]) -> int:
        tables = (_numbers(row, *candidate) for row in rows[:2000])
        return sum(len(numbers) for numbers in tables if numbers and len(numbers) > 1)

    return max(CANDIDATES, key=count)


def _split(row: str, separator: str | None) -> list[str]:
    fields = [field.strip() for field in row.split(separator)]
    # Some programs end each line with a separator.
    return fields[:-1] if separator and len(fields) > 2 and not fields[-1] else fields


def _numbers(row: str, separator: str | None, decimal: str) -> list[float] | None:
    """The row's numbers, or None where a field is not one."""
    fields = _split(row, separator)
    if decimal == ",":
        fields = [field.replace(",", ".") for field in fields]
    if not row or not all(_NUMBER.match(field) for field in fields):
        return None
    return [float(field) for field in fields]


def _titles(
    rows: Sequence[str], separator: str | None, width: int
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Column titles and the lines above them; a second line of bare units joins the first."""
    filled = [(i, _split(row, separator)) for i, row in enumerate(rows) if row]
    if not filled or len(filled[-1][1]) != width:
        return (), tuple(rows)
    last, titles = filled[-1]
    is_unit_line = all(_is_unit(field) for field in titles)
    if is_unit_line and len(filled) > 1 and len(filled[-2][1]) == width:
        last, names = filled[-2]
        bare = (unit.strip("()[] ") for unit in titles)
        titles = [f"{name} ({unit})" for name, unit in zip(names, bare, strict=True)]
    return tuple(titles), tuple(rows[:last])


def _is_unit(field: str) -> bool:
    plain = plain_unit(field.strip("()[] "))
    return any(plain in known for known in UNITS.values())
