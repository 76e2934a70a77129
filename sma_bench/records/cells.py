"""What a cell says: a number with decimal and thousand signs of any country, or a moment in the
orders that loggers write."""

import contextlib
import math
import re
from collections.abc import Iterable, Sequence
from datetime import UTC, date, datetime, time, timedelta
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from sma_bench.records.units import WORDS, FloatArray, parse_unit, plain_title

_MISSING = frozenset(WORDS["missing"])
_MONTHS = {name: k for k, names in enumerate(WORDS["months"], 1) for name in names}
_GROUPING = r"[ \u00a0\u202f'’]"  # signs of thousands that are no decimal signs
_NUMBER = re.compile(
    r"(?P<sign>[+\-−–]?)\s?(?P<body>\d{1,3}(?:(?P<t>[ \u00a0\u202f'’.,])\d{3})(?:(?P=t)\d{3})*+"
    r"(?:[.,]\d*+)?|\d++(?:[.,]\d*+)?+|[.,]\d++)(?P<power>[eEdD][+\-−]?\d{1,3})?"
    r"(?:\s*(?P<unit>[^\W\d_%°µμ]{1,12}[^\s\d]{0,6}|[%°µμ][^\s\d]{0,4}))?\Z"
)
_SHAPE = str.maketrans("23456789", "11111111")
_PREFIXES = dict(
    zip("pnuµμmkMG", (1e-12, 1e-9, 1e-6, 1e-6, 1e-6, 1e-3, 1e3, 1e6, 1e9), strict=True)
)


@lru_cache(maxsize=65536)
def _parts(cell: Any) -> tuple[str, str, str] | None:
    """Number with its marks, power and unit; None for other text."""
    found = _NUMBER.match(cell) if isinstance(cell, str) else None
    if found is None:
        return None
    power, unit = (found["power"] or "").lower().replace("d", "e"), found["unit"] or ""
    if unit and unit not in _PREFIXES and parse_unit(unit) is None:
        return None
    return "-" * (found["sign"] in ("-", "−", "–")) + found["body"], power, unit


def cell_kind(cell: Any) -> str:
    """ "n" for a number, "d" a moment, "t" text, "" nothing or what stands for it."""
    if not isinstance(cell, str):
        is_number = isinstance(cell, (int, float)) and not isinstance(cell, bool)
        return "" if cell is None else "n" if is_number else "t" if cell in (True, False) else "d"
    try:
        return "n" if math.isfinite(float(cell)) else ""
    except ValueError:
        return _text_kind(cell)


@lru_cache(maxsize=65536)
def _text_kind(cell: str) -> str:
    is_missing = cell.lower() in _MISSING
    return "" if is_missing else "n" if _parts(cell) else "d" if moment_of(cell) else "t"


def is_number_row(cells: Sequence[Any]) -> bool:
    """Whether two cells or more hold more numbers and moments than texts."""
    kinds = [cell_kind(cell) for cell in cells] if len(cells) > 1 else []
    return kinds.count("n") + kinds.count("d") > kinds.count("t")


def decimal_signs(cells: Iterable[Any]) -> set[str]:
    """What cells show to be their decimal sign: "." or ","; "?." or "?," where a mark may be of
    thousands."""
    shown: set[str] = set()
    for shape in {cell.translate(_SHAPE) for cell in cells if isinstance(cell, str)}:
        body = (_parts(shape) or ("",))[0].lstrip("-")
        marks = re.findall("[.,]", body)
        if not marks:
            continue
        whole, _, digits = body.rpartition(marks[-1])
        if len(set(marks)) == 2 or re.search(_GROUPING, whole):
            shown.add(marks[-1])
        elif len(marks) > 1:
            shown.add("," if marks[-1] == "." else ".")
        elif len(digits) != 3 or len(whole) > 3 or whole.startswith("0") or not whole:
            shown.add(marks[-1])
        else:
            shown.add("?" + marks[-1])
    return shown


def plain_numbers(cells: Sequence[Any]) -> FloatArray | None:
    """Values (n,) of cells that are all numbers as Python writes them, else None."""
    try:
        values = np.array([float(cell) for cell in cells])
    except (TypeError, ValueError):
        return None
    return np.where(np.isfinite(values), values, np.nan)


def numbers_of(cells: Sequence[Any], decimal: str, unit: str) -> tuple[FloatArray, str, int]:
    """Values (n,), NaN where a cell is missing; the unit, of the title or else of the cells; and
    the index of a cell that is no number in it, -1 where there is none."""
    if decimal == "," and not any("." in str(cell) for cell in cells):
        values = plain_numbers([str(cell).replace(",", ".") for cell in cells])
        if values is not None:
            return values, unit, -1
    parts = {cell: found for cell in set(cells) if (found := _parts(cell))}
    written = sorted({found[2] for found in parts.values() if found[2]})
    own = unit or next((text for text in written if parse_unit(text)), "")
    wanted = parse_unit(own)
    factors = {"": 1.0}
    for text in written:
        known = parse_unit(text)
        if known and wanted and known.quantity == wanted.quantity:
            if known.offset == wanted.offset:
                factors[text] = known.factor / wanted.factor
        elif unit and text in _PREFIXES:
            factors[text] = _PREFIXES[text]
    thousand = "," if decimal == "." else "."
    read: dict[Any, float] = {}
    for cell in set(cells):
        if cell in parts and parts[cell][2] in factors:
            body, power, text = parts[cell]
            body = re.sub(_GROUPING, "", body).replace(thousand, "").replace(",", ".")
            with contextlib.suppress(ValueError):
                read[cell] = float(body + power) * factors[text]
        elif not isinstance(cell, str) and cell_kind(cell) == "n":
            read[cell] = float(cell)
        elif cell_kind(cell) == "":
            read[cell] = np.nan
    bad = next((k for k, cell in enumerate(cells) if cell not in read), -1)
    values = np.array([read.get(cell, np.nan) for cell in cells])
    return np.where(np.isfinite(values), values, np.nan), own, bad


# --- Moments --------------------------------------------------------------------------------------

_DATE = re.compile(
    r"(\d{1,4}|[^\W\d_]{3,10})\.?([-/. ]+)(\d{1,2}|[^\W\d_]{3,10})\.?[-/., ]+(\d{1,4})(?=[T,\s]|\Z)"
)
_CLOCK = re.compile(
    r"(\d{1,4}):(\d{2})(?::(\d{2}))?(?:[.,:](\d{1,9}))?\s*([AaPp]\.?[Mm]\.?)?"
    r"\s*(Z|UTC|GMT|[+-]\d{2}:?\d{2})?\Z"
)
_ISO = re.compile(r"(?:19[7-9]|20|21)\d\d?-\d\d-\d\d[ T]\d\d:\d\d:\d\d(?:\.\d+)?\Z")
_DAY = 86_400.0


class Moment(NamedTuple):
    """A cell's time: `days` since 1970 (None without a date; also those where the month comes
    first, if it may), `seconds` of the day (None without a clock), `fields` of its clock."""

    days: float | None
    seconds: float | None
    fields: int = 3
    month_first: float | None = None
    am_pm: bool = False


@lru_cache(maxsize=65536)
def moment_of(cell: Any) -> Moment | None:
    """The moment that a cell writes, None for other text."""
    if isinstance(cell, timedelta):
        return Moment(None, cell.total_seconds())
    if isinstance(cell, (time, date)):
        cell = cell.isoformat()
    if not isinstance(cell, str) or len(cell) > 40 or not re.search(r"\d[:./\-\s][\d\w]", cell):
        return None
    rest, days, month_first = cell.strip(), None, None
    if (found := _DATE.match(rest)) and ":" not in found[0]:
        first, mark, second, last = found.groups()
        names = [part for part in (first, second) if not part.isdigit()]
        if len(names) == 1:
            number = second if names[0] == first else first
            days = _days(last, _MONTHS.get(plain_title(names[0])[:3], 0), number)
        elif found[0] == mark.join((first, second, last)) and mark in "-/." and not names:
            if len(first) == 4:
                days = _days(first, second, last)
            elif len(last) in (2, 4):
                year = last if len(last) == 4 else f"20{last}"
                days = _days(year, second, first)
                month_first = None if mark == "." else _days(year, first, second)
        if days is None and month_first is None:
            return None
        days, month_first = (month_first, None) if days is None else (days, month_first)
        rest = rest[found.end() :].lstrip("T, ").strip()
        if not rest:
            return Moment(days, None, 3, month_first)
    clock = _CLOCK.match(rest)
    if clock is None:
        return None
    hours, minutes, seconds = int(clock[1]), int(clock[2]), int(clock[3] or 0)
    broken, half, zone = clock[4], clock[5], clock[6]
    if minutes > 59 or seconds > 59 or (half and not 1 <= hours <= 12):
        return None
    hours = hours % 12 + 12 * (half[0] in "pP") if half else hours
    is_short = not clock[3] and days is None and not half  # mm:ss or hh:mm
    total = hours * 60.0 + minutes if is_short else hours * 3600.0 + minutes * 60.0 + seconds
    total += float(f"0.{broken}") if broken else 0.0
    if zone and zone[0] in "+-":
        total -= float(f"{zone[0]}60") * (60 * int(zone[1:3]) + int(zone[-2:]))
    fields = 3 if not is_short else 1 if broken else 2  # mm:ss.s leaves no doubt
    return Moment(days, total, fields, month_first, bool(half))


def _days(year: str, month: int | str, day: str) -> float | None:
    try:
        moment = datetime(int(year), int(month), int(day), tzinfo=UTC)
    except ValueError:
        return None
    return moment.timestamp() / _DAY if 1970 <= moment.year < 2200 else None


def moments_of(
    cells: Sequence[Any], dates: Sequence[Any] | None = None
) -> tuple[FloatArray, float | None, int, str] | None:
    """Seconds since the first cell (n,), NaN where one is missing; the epoch of it where the cells
    have dates; how many fields their clocks have (2: hh:mm or mm:ss, asked); and a remark. None
    where a cell is no moment. `dates`: cells of the column of dates that goes with a clock."""
    if dates is None and _ISO.match(str(cells[0])):
        with contextlib.suppress(ValueError):  # of what is written otherwise
            stamps = np.array(cells, dtype="datetime64[ns]").astype(np.int64)
            seconds = np.where(stamps == stamps.min(initial=0), np.nan, (stamps - stamps[0]) / 1e9)
            return seconds, float(stamps[0]) / 1e9, 3, ""
    there = [k for k, cell in enumerate(cells) if str(cell or "").lower() not in _MISSING]
    found = [m for k in there if (m := moment_of(cells[k]))]
    dated = [m for k in there if (m := moment_of(dates[k]))] if dates else found
    if not found or not len(found) == len(dated) == len(there):
        return None
    # 03/10/2026 is October 3rd or March 10th: AM and PM, or an order that goes back, tell.
    day = np.array([np.nan if m.days is None else m.days for m in dated])
    other = np.array([np.nan if m.month_first is None else m.month_first for m in dated])
    remark = ""
    if np.isfinite(other).all():
        forward = [bool(np.all(np.diff(order) >= 0.0)) for order in (day, other)]
        day = other if found[0].am_pm or forward == [False, True] else day
        if forward[0] == forward[1]:
            taken = datetime.fromtimestamp(day[0] * _DAY, UTC).date()
            remark = f"{str((dates or cells)[there[0]])[:10]} is taken as {taken}"
    is_absolute = bool(np.isfinite(day).all())
    total = (_DAY * day if is_absolute else 0.0) + np.array([m.seconds or 0.0 for m in found])
    if not is_absolute:  # past midnight
        total += _DAY * np.cumsum(np.diff(total, prepend=total[0]) < -0.5 * _DAY)
    seconds = np.full(len(cells), np.nan)
    seconds[there] = total - total[0]
    return seconds, float(total[0]) if is_absolute else None, min(m.fields for m in found), remark
