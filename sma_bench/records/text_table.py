"""Tables of numbers in text files: which separator, which header, which unit."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sma_bench.errors import InputError
from sma_bench.records.contract import CELSIUS_ZERO

FloatArray = NDArray[np.float64]

LARGEST_FILE = 200_000_000  # bytes
_CANDIDATES: tuple[tuple[str | None, str], ...] = (
    ("\t", "."),
    (";", "."),
    (",", "."),
    (None, "."),
    (";", ","),
    ("\t", ","),
    (None, ","),
)  # separator (None: blanks) and decimal sign
# Possessive: thousands of digits that end in a letter would be tried again at each of them.
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
class Column:
    """One column by its title: position, name and unit as written ("" where none is given)."""

    index: int
    name: str
    unit: str


def read_text_table(path: Path | str) -> TextTable:
    """Read a table of two or more columns; tabs, commas, semicolons or blanks, quoted or not.

    Raises:
        InputError: no such file, no table in it, or a line within the table that is not as many
            finite numbers as the table has columns (the line is named).
    """
    path = Path(path)
    rows = [line.replace('"', "").strip() for line in read_lines(path)]
    separator, decimal = _dialect(rows)
    parsed = [_numbers(row, separator, decimal) for row in rows]
    first = next((i for i, numbers in enumerate(parsed) if numbers and len(numbers) > 1), None)
    if first is None:
        raise InputError(f"{path}: no table of numbers found, expected two or more columns")
    width = len(parsed[first] or ())
    values, lines = [], []
    for i in range(first, len(rows)):
        if not rows[i]:
            continue
        numbers = parsed[i]
        if numbers is None or len(numbers) != width or not np.all(np.isfinite(numbers)):
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
            return file.read(size).replace(b"\0", b"")
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None


def read_lines(path: Path) -> list[str]:
    """Lines of a text file in UTF-8, UTF-16 or Latin-1.

    Raises:
        InputError: the file is absent, unreadable, binary or larger than any such file.
    """
    try:
        if path.stat().st_size > LARGEST_FILE:
            raise InputError(f"{path}: {path.stat().st_size} bytes, expected a text file")
        content = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: {error.strerror or error}") from None
    if content[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return content.decode("utf-16", errors="replace").splitlines()
    if b"\0" in content:
        raise InputError(f"{path}: holds zero bytes, expected a text file")
    try:
        return content.decode("utf-8-sig").splitlines()
    except UnicodeDecodeError:
        return content.decode("latin-1").splitlines()


def find_column(
    table: TextTable, words: Sequence[str], units: Sequence[str]
) -> tuple[Column, str] | None:
    """First column whose name holds one of `words`, in their order, and whose unit fits.

    Args:
        table: with titles.
        words: lower-case words or parts of them, the best one first.
        units: keys of UNITS, one of which must know the column's unit.

    Returns:
        The column and the key of UNITS that knows its unit, or None.
    """
    columns = [_column(i, title) for i, title in enumerate(table.titles)]
    for word in words:
        for column in columns:
            if word not in column.name.lower():
                continue
            for kind in units:
                if plain_unit(column.unit) in UNITS[kind]:
                    return column, kind
    return None


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


def name_and_unit(title: str) -> tuple[str, str] | None:
    """`Stress, true (MPa)` or `... [MPa]` in its parts; None where no brackets end it."""
    text = title.strip()
    if not text.endswith((")", "]")):
        return None
    inner = text[:-1]
    before = max(inner.rfind(")"), inner.rfind("]")) + 1
    opening = re.compile(r"[(\[]").search(inner, before)
    if opening is None:
        return None
    return inner[: opening.start()].rstrip(" \t,_"), inner[opening.end() :].strip()


def _column(index: int, title: str) -> Column:
    if parts := name_and_unit(title):
        return Column(index, *parts)
    name, _, unit = title.partition("/")
    if unit:
        return Column(index, name.strip(), unit.strip())
    return Column(index, title.strip(), "")


def _dialect(rows: Sequence[str]) -> tuple[str | None, str]:
    def count(candidate: tuple[str | None, str]) -> int:
        tables = (_numbers(row, *candidate) for row in rows[:2000])
        return sum(len(numbers) for numbers in tables if numbers and len(numbers) > 1)

    return max(_CANDIDATES, key=count)


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
