"""Rows of cells, of a text or a spreadsheet, to named columns: where the numbers begin, which rows
above them are titles and which units, what is a date."""

import re
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, time
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sma_bench.border import Budget, printable
from sma_bench.errors import InputError

FloatArray = NDArray[np.float64]

MOST_COLUMNS = 1000
LONGEST_NAME = 120
_PLAIN = re.compile(r"[+-]?(?:\d++(?:\.\d*+)?+|\.\d++)(?:[eE][+-]?\d++)?+\Z")
_MISSING = frozenset({"", "nan", "na", "n/a", "#n/a", "null", "none", "-", "--", "inf", "-inf"})
_CLOCK = re.compile(r"(\d{1,2}):(\d{2}):(\d{2}(?:[.,]\d{1,9})?)\Z")


@dataclass(frozen=True)
class Column:
    """One column of a file.

    Attributes:
        name: as the map calls it, unique in the file: its title, or its path (`log/u`).
        title: what it is called, without unit; unit: as written, "" where none is.
        values: (n,), NaN where a cell is empty.
        group: columns of one group share rows, and so their clock.
        start: epoch s of 0 where the column holds dates, else None.
    """

    name: str
    title: str
    unit: str
    values: FloatArray
    group: str = ""
    start: float | None = None


Found = tuple[list[Column], Sequence[str], Sequence[str]]


def number_in(cell: Any, decimal: str) -> float | None:
    """The cell's number, NaN for a missing one, None for text."""
    if cell.lower() in _MISSING:
        return float("nan")
    plain = cell.replace(",", ".") if decimal == "," else cell
    return float(plain) if _PLAIN.match(plain) else None


def columns_of_rows(
    rows: list[list[Any]], number: Callable[[Any], float | None], budget: Budget, group: str = ""
) -> Found:
    """Columns of rows of cells: where numbers begin, titles and units above them.

    Raises:
        InputError: a row within the table with a cell that is no number (its line is named).
    """
    width, first = _block(rows, number)
    if not width:
        return [], [], []
    body = [(i, row) for i, row in enumerate(rows[first:], first) if any(is_filled(c) for c in row)]
    budget.take(8 * width * len(body))
    notes: list[str] = []
    if len(body) > 1 and len(body[-1][1]) < width:  # the logger died within its last line
        notes.append(f"line {body[-1][0] + 1}, the last one, is cut short and left out")
        body.pop()
    titles, units, above = _headings(rows[:first], width, number)
    columns = []
    for k in range(width):
        cells = [(i, row[k] if k < len(row) else None) for i, row in body]
        name = titles[k] or f"column {k + 1}"
        column = _column(name, units[k], cells, number, group)
        budget.check()
        if column is not None:
            columns.append(column)
    texts = [" ".join(str(c) for c in row if is_filled(c)) for row in above]
    return columns, [printable(text)[:LONGEST_NAME] for text in texts if text], notes


def is_filled(cell: Any) -> bool:
    return cell is not None and cell != ""


def _block(
    rows: list[list[Any]], number: Callable[[Any], float | None]
) -> tuple[int, int]:
    """How many columns the table has and in which row it begins; 0, 0 without one."""

    def counts(row: list[Any]) -> bool:
        filled = [cell for cell in row if is_filled(cell)]
        found = sum(number(cell) == number(cell) is not None for cell in filled)
        return len(filled) > 1 and 2 * found > len(filled)

    candidates = [i for i, row in enumerate(rows) if counts(row)]
    if not candidates:
        return 0, 0
    width = Counter(len(rows[i]) for i in candidates).most_common(1)[0][0]
    if width > MOST_COLUMNS:
        raise InputError(f"{width} columns, expected at most {MOST_COLUMNS}")
    return width, next(i for i in candidates if len(rows[i]) == width)


def _headings(
    rows: list[list[Any]], width: int, number: Callable[[Any], float | None]
) -> tuple[list[str], list[str], list[list[Any]]]:
    """Titles and units of the columns, and the rows above them.

    A row of units below a row of titles may name some units only.
    """
    wide = [i for i, row in enumerate(rows) if sum(map(is_filled, row)) > width / 2]
    if not wide or any(is_filled(c) for row in rows[wide[-1] + 1 :] for c in row):
        return [""] * width, [""] * width, rows
    last = wide[-1]
    titles = [str(c).strip() if is_filled(c) else "" for c in rows[last][:width]]
    titles += [""] * (width - len(titles))
    bare = [title.strip("()[]{} ") for title in titles]
    if len(wide) > 1 and wide[-2] == last - 1 and all(not b or parse_unit(b) for b in bare):
        last -= 1
        names = [str(c).strip() if is_filled(c) else "" for c in rows[last][:width]]
        return names + [""] * (width - len(names)), bare, rows[:last]
    return titles, [""] * width, rows[:last]


def _column(
    name: str, unit: str, cells: list[tuple[int, Any]], number: Callable[[Any], float | None],
    group: str,
) -> Column | None:
    """A column of numbers or of dates; None for one of text."""
    title, own = (name, unit) if unit else split_title(name)
    lead = next((cell for _, cell in cells if is_filled(cell)), None)
    if lead is None:
        return None
    if number(lead) is None:
        start, seconds = _dates([cell for _, cell in cells])
        return None if seconds is None else Column(name, title, "s", seconds, group, start)
    values = np.full(len(cells), np.nan)
    for k, (i, cell) in enumerate(cells):
        value = float("nan") if cell is None else number(cell)
        if value is None:
            shown = printable(str(cell))[:40]
            raise InputError(f"line {i + 1}: {name} is {shown!r}, expected a number")
        values[k] = value
    return Column(name, title, own, values, group)


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


def split_title(title: str) -> tuple[str, str]:
    """Title and unit: of brackets, of what follows a slash, comma or underscore where it is one."""
    if parts := name_and_unit(title):
        return parts
    for mark in ("/", ",", "_", " in ", " "):
        name, found, unit = title.rpartition(mark)
        if found and name.strip() and parse_unit(unit.strip()):
            return name.strip(), unit.strip()
    return title.strip(), ""


def _dates(cells: list[Any]) -> tuple[float | None, FloatArray | None]:
    """Epoch of 0 (None for times of day) and seconds since the first; None, None for text."""
    seconds, absolute = [], True
    for cell in cells:
        found = _seconds_of(cell)
        if found is None:
            return None, None
        seconds.append(found[0])
        absolute = absolute and found[1]
    values = np.array(seconds)
    if not absolute:  # past midnight
        values = values + 86_400.0 * np.cumsum(np.diff(values, prepend=values[0]) < -43_200.0)
    return (float(values[0]) if absolute else None), values - values[0]


def _seconds_of(cell: Any) -> tuple[float, bool] | None:
    """Seconds, and whether since 1970 rather than midnight."""
    if isinstance(cell, str):
        if match := _CLOCK.match(cell):
            hours, minutes, seconds = match.groups()
            return int(hours) * 3600 + int(minutes) * 60 + float(seconds.replace(",", ".")), False
        try:
            cell = datetime.fromisoformat(cell.replace(",", "."))
        except ValueError:
            return None
    if isinstance(cell, time):
        return cell.hour * 3600 + cell.minute * 60 + cell.second + cell.microsecond * 1e-6, False
    if isinstance(cell, datetime):
        moment = cell if cell.tzinfo else cell.replace(tzinfo=UTC)
        return (moment.timestamp(), True) if moment.year >= 1970 else None
    return None


# As written (lower case, without blanks and brackets) -> as pint calls it. pint knows prefixes and
# some thousand units; this is what loggers write and it does not know, or takes for another one.
_SPELLINGS = {
    "c": "degC", "°c": "degC", "ºc": "degC", "℃": "degC", "degc": "degC", "deg.c": "degC",
    "gradc": "degC", "celsius": "degC", "degreesc": "degC", "°f": "degF", "degf": "degF",
    "f": "degF", "k": "kelvin", "°k": "kelvin",
    "v_rms": "volt", "vrms": "volt", "v(rms)": "volt", "v_eff": "volt", "veff": "volt",
    "volts": "volt", "v": "volt", "mvrms": "millivolt", "mv_rms": "millivolt",
    "amp": "ampere", "amps": "ampere", "a": "ampere", "a_rms": "ampere",
    "sec": "second", "secs": "second", "s": "second", "msec": "millisecond", "ms": "millisecond",
    "usec": "microsecond", "h": "hour", "hr": "hour", "min": "minute", "mins": "minute",
    "%": "percent", "pct": "percent", "percent": "percent", "prozent": "percent",
    "-": "dimensionless", "1": "dimensionless", "0..1": "dimensionless", "0-1": "dimensionless",
    "mm/mm": "dimensionless", "m/m": "dimensionless", "ratio": "dimensionless",
    "n/mm2": "megapascal", "n/mm^2": "megapascal", "n/mm²": "megapascal", "ksi": "kilopsi",
    "gf": "gram_force", "kgf": "kilogram_force", "cn": "centinewton", "n": "newton",
    "in": "inch", "mil": "thou", "mm": "millimeter", "cm": "centimeter", "m": "meter",
    "um": "micrometer",
    "microstrain": "1e-6 dimensionless",
}  # fmt: skip
_CASED = {"mN": "millinewton", "mV": "millivolt", "mA": "milliampere", "MPa": "megapascal",
          "GPa": "gigapascal", "kN": "kilonewton", "mW": "milliwatt"}  # fmt: skip
_ANGLES = {"rad": 1.0, "radian": 1.0, "radians": 1.0, "mrad": 1e-3, "deg": 0.017453292519943295,
           "°": 0.017453292519943295, "grad": 0.017453292519943295, "rev": 6.283185307179586,
           "degree": 0.017453292519943295, "degrees": 0.017453292519943295,
           "turn": 6.283185307179586}  # fmt: skip
_SI = {
    "time": "second", "length": "meter", "voltage": "volt", "current": "ampere",
    "temperature": "kelvin", "force": "newton", "stress": "pascal", "power": "watt",
    "ratio": "dimensionless", "resistance": "ohm",
}  # fmt: skip
# pint evaluates what it is given: 9**9**9 would never end.
_HARMLESS = re.compile(r"[A-Za-zµμΩ][A-Za-zµμΩ_]{0,24}(?:[*/][A-Za-zµμΩ_]{1,12}(?:\^?[23])?)?\Z")


@dataclass(frozen=True)
class Unit:
    """What a unit measures, and value in SI = factor * value + offset."""

    quantity: str
    factor: float
    offset: float = 0.0


@cache
def _registry() -> Any:
    try:
        import pint
    except ImportError:
        raise InputError(
            "units of tables need pint: pip install pint, or apt install python3-pint"
        ) from None
    return pint.UnitRegistry()


@cache
def parse_unit(text: str) -> Unit | None:
    """The unit that a text names; None where it names none that a bench measures.

    `grad` is the German degree, `C` Celsius and `F` Fahrenheit: loggers write no coulombs.
    """
    plain = re.sub(r"[\s()\[\]{}]", "", text)
    lower = plain.lower().replace("µ", "u").replace("μ", "u")
    if not plain or len(plain) > 30:
        return None
    if lower in _ANGLES:
        return Unit("angle", _ANGLES[lower])
    name = _CASED.get(plain) or _SPELLINGS.get(lower)
    if name == "1e-6 dimensionless":
        return Unit("ratio", 1e-6)
    if name is None and not _HARMLESS.match(plain):
        return None
    for word in (name,) if name else (plain, lower):
        found = _from_pint(word)
        if found is not None:
            return found
    return None


def _from_pint(word: str) -> Unit | None:
    registry = _registry()
    try:
        unit = registry.Unit(word)
        for quantity, base in _SI.items():
            if unit.dimensionality == registry.Unit(base).dimensionality:
                zero = float(registry.Quantity(0.0, unit).to(base).magnitude)
                one = float(registry.Quantity(1.0, unit).to(base).magnitude)
                return Unit(quantity, one - zero, zero)
    except Exception:  # pint raises its parser's and Python's own errors for what is no unit
        return None
    return None
