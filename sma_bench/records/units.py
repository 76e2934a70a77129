"""What a cell of somebody's table says: a number, a moment, a unit; and what a title means.

Numbers come with decimal and thousand signs of any country, moments in the orders that loggers
write, units in brackets anywhere in a title or behind a slash, comma, blank or underscore.
"""

import re
import unicodedata
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import UTC, date, datetime, time, timedelta
from functools import cache, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from sma_bench.border import printable
from sma_bench.errors import InputError

FloatArray = NDArray[np.float64]

# --- Units ----------------------------------------------------------------------------------------

_KNOWN: dict[str, Any] = yaml.load(  # noqa: S506
    (Path(__file__).parent / "words.yaml").read_text(encoding="utf-8"), yaml.CSafeLoader
)
_SPELLINGS = {text: name for name, texts in _KNOWN["units"].items() for text in texts}
MISSING = frozenset(_KNOWN["missing"])
ROLES: dict[str, Any] = _KNOWN["roles"]
STATED: dict[str, Any] = _KNOWN["stated"]
_MONTHS = {name: k for k, names in enumerate(_KNOWN["months"], 1) for name in names}
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
    if lower in _KNOWN["angles"]:
        return Unit("angle", _KNOWN["angles"][lower])
    if lower in _KNOWN["microstrain"]:
        return Unit("ratio", 1e-6)
    name = _KNOWN["cased"].get(plain) or _SPELLINGS.get(lower)
    if name is None and not _HARMLESS.match(plain):
        return None
    for word in (name,) if name else (plain, lower):
        registry = _registry()
        try:
            unit = registry.Unit(word)
            for quantity, base in _KNOWN["si"].items():
                if unit.dimensionality == registry.Unit(base).dimensionality:
                    zero = float(registry.Quantity(0.0, unit).to(base).magnitude)
                    one = float(registry.Quantity(1.0, unit).to(base).magnitude)
                    return Unit(quantity, one - zero, zero)
        except Exception:  # pint raises its parser's and Python's own errors for what is no unit
            continue
    return None


def in_si(values: FloatArray, unit: Unit) -> FloatArray:
    return values * unit.factor + unit.offset


# --- Titles ---------------------------------------------------------------------------------------

# Of brackets that hold no unit: what they say is part of the title.
_DESCRIPTIONS = re.compile(
    r"(?:wire|draht|fil|filo|hilo|room|ambient|avg|mean|rms|raw|absolute?|relative?|measured|filtered|"
    r"elapsed|smoothed|ch(?:annel)?\s?\d+|run\s?#?\d+|\d+|exo (?:up|down)|endo (?:up|down))\Z",
    re.IGNORECASE,
)
_LONE_T = re.compile(r"[tT](?:[cCsSrR]?\d*|[\s_]?(?:[a-zA-Z]{1,9})?\d*)\Z")

def plain_title(title: str) -> str:
    """A title in lower case without accents."""
    folded = unicodedata.normalize("NFKD", title.replace("ß", "ss"))
    return "".join(c for c in folded if not unicodedata.combining(c)).lower()


@lru_cache(maxsize=4096)
def title_meanings(title: str) -> tuple[str, ...]:
    """What a title without its unit may mean; () where it says nothing known."""
    last = re.split(r"[/.](?=\D)", title.strip())[-1].strip() or title.strip()
    if last != title.strip() and {"ambient", "room"} & set(re.findall(r"[a-z]+", title.lower())):
        last = title.strip()
    for text in dict.fromkeys((last, title.strip())):
        plain = plain_title(re.sub(r"(?<=[a-z])(?=[A-Z])", " ", text))
        words = re.findall(r"[^\W\d_]+", plain)
        if text == "t" or words in (["t", "rel"], ["t", "abs"]):
            return ("time",)
        if text == "#" or (words and set(words) <= set(_KNOWN["counters"])):
            return ("counter",)
        joined = " ".join(["", *words])
        for row in _KNOWN["titles"]:
            if set(words) & set(row.get("words", ())) or any(
                part in joined for part in row.get("parts", ())
            ):
                return tuple(row["means"])
        if _LONE_T.match(text):
            room = {"amb", "room", "air", "env", "raum", "inf"} & set(words)
            return ("ambient",) if room else ("temperature",)
    return ()


def fits(meaning: str, quantity: str) -> bool:
    """Whether a column of that meaning may be measured in units of that quantity."""
    return meaning in ("setpoint", "counter") or quantity in _KNOWN["fits"].get(meaning, [meaning])


@lru_cache(maxsize=4096)
def split_title(title: str) -> tuple[str, str]:
    """Title and unit. In brackets, which may stand anywhere, an unknown unit is one too; after a
    slash or comma it must be known; after an underscore or blank it must fit what the title says,
    or be no single letter: LVDT_A is no current."""
    text = " ".join(title.split())
    found = list(re.finditer(r"[\[({]((?:[^\[\](){}]|\([^()]*\))*)[\])}]", text))
    for match in reversed(found):
        if parse_unit(match[1]):
            rest = f"{text[: match.start()]} {text[match.end() :]}"
            return " ".join(rest.replace("( )", "").split()).rstrip(" ,_/"), match[1].strip()
    for mark in (" / ", "/", ",", "_", " in ", " "):
        name, cut, unit = text.partition(mark) if mark == " / " else text.rpartition(mark)
        known = parse_unit(unit.strip()) if cut and name.strip() else None
        if known is None or name.count("(") != name.count(")"):
            continue
        meant = title_meanings(name.strip())
        sure = mark in (" / ", "/", ",") or any(fits(m, known.quantity) for m in meant)
        if sure or (not meant and unit.strip().lower() not in _KNOWN["no_units"] and mark != " "):
            return name.strip(), unit.strip()
    if found and not _DESCRIPTIONS.match(found[-1][1].strip()) and not text.startswith(("(", "[")):
        return text[: found[-1].start()].rstrip(" ,_/"), found[-1][1].strip()
    return text, ""


def number_with_unit(text: str, quantity: str) -> float | None:
    """The value in SI of the first number in a text with a unit of that quantity behind it."""
    number = r"([+-]?\d+(?:[.,]\d+)?(?:[eE][+-]?\d+)?)\s*([^\s\d,;:=]{1,12}\d?)"
    for found in re.finditer(number, text):
        unit = parse_unit(found[2].strip(".\"'"))
        if unit is not None and unit.quantity == quantity:
            return float(found[1].replace(",", ".")) * unit.factor + unit.offset
    return None


# --- Numbers --------------------------------------------------------------------------------------

_NUMBER = re.compile(
    r"(?P<sign>[+\-−–]?)\s?(?P<body>\d{1,3}(?:(?P<t>[ \u00a0\u202f'’.,])\d{3})(?:(?P=t)\d{3})*+"
    r"(?:[.,]\d*+)?|\d++(?:[.,]\d*+)?+|[.,]\d++)(?P<power>[eEdD][+\-−]?\d{1,3})?"
    r"(?:\s*(?P<unit>[^\W\d_%°µμ]{1,12}[^\s\d]{0,6}|[%°µμ][^\s\d]{0,4}))?\Z"
)
_PREFIXES = {"p": 1e-12, "n": 1e-9, "u": 1e-6, "µ": 1e-6, "μ": 1e-6, "m": 1e-3, "k": 1e3, "M": 1e6,
             "G": 1e9}  # fmt: skip


@lru_cache(maxsize=65536)
def _parts(cell: str) -> tuple[str, str, str, str] | None:
    """Sign, digits with their marks, power and unit of a number; None for other text."""
    found = _NUMBER.match(cell)
    if found is None:
        return None
    unit = found["unit"] or ""
    if unit and unit not in _PREFIXES and parse_unit(unit) is None:
        return None
    sign = "-" if found["sign"] in ("-", "−", "–") else ""
    return sign, found["body"], (found["power"] or "").lower().replace("d", "e"), unit


def cell_kind(cell: Any) -> str:
    """"n" for a number or what stands for a missing one, "d" a moment, "t" text, "" nothing."""
    if cell is None or cell == "":
        return ""
    if isinstance(cell, str):
        try:
            float(cell)
        except ValueError:
            return _text_kind(cell)
        return "n"
    if isinstance(cell, bool):
        return "t"
    return "n" if isinstance(cell, (int, float)) else "d"


@lru_cache(maxsize=65536)
def _text_kind(cell: str) -> str:
    if cell.lower() in MISSING or _parts(cell):
        return "n"
    return "d" if moment_of(cell) else "t"


def decimal_signs(cells: Iterable[Any]) -> set[str]:
    """What cells show to be their decimal sign: "." or ","; "?" where a mark may be either."""
    shown: set[str] = set()
    for cell in cells:
        parts = _parts(cell) if isinstance(cell, str) else None
        marks = [c for c in parts[1] if c in ".,"] if parts else []
        if not parts or not marks:
            continue
        whole, _, digits = parts[1].rpartition(marks[-1])
        other = "," if marks[-1] == "." else "."
        if len(set(marks)) == 2 or re.search(r"[ \u00a0\u202f'’]", whole):
            shown.add(marks[-1])
        elif len(marks) > 1:
            shown.add(other)
        elif len(digits) != 3 or len(whole) > 3 or whole.startswith("0") or not whole:
            shown.add(marks[-1])
        else:
            shown.add("?" + marks[-1])
    return shown


def numbers_of(cells: Sequence[Any], decimal: str, title_unit: str) -> tuple[FloatArray, str, int]:
    """Values (n,), NaN where a cell is missing; the unit that the cells themselves write; and the
    index of a cell that is none, -1 where all are."""
    values = np.full(len(cells), np.nan)
    own, bad = "", -1
    thousand = "," if decimal == "." else "."
    for k, cell in enumerate(cells):
        if isinstance(cell, (int, float)) and not isinstance(cell, bool):
            values[k] = cell
            continue
        if cell is None or (isinstance(cell, str) and cell.lower() in MISSING):
            continue
        parts = _parts(cell) if isinstance(cell, str) else None
        if parts is None:
            return values, own, k
        sign, body, power, unit = parts
        body = re.sub(r"[ \u00a0\u202f'’]", "", body).replace(thousand, "").replace(",", ".")
        factor = 1.0
        if unit:
            known, wanted = parse_unit(unit), parse_unit(title_unit or own)
            if known and wanted and known.quantity == wanted.quantity:
                if known.offset != wanted.offset:
                    return values, own, k
                factor = known.factor / wanted.factor
            elif title_unit and unit in _PREFIXES and (wanted is None or known is None
                                                       or known.quantity != wanted.quantity):
                factor = _PREFIXES[unit]
            elif known and not title_unit and not own:
                own = unit
            else:
                return values, own, k
        try:
            values[k] = float(sign + body + power) * factor
        except ValueError:
            return values, own, k
    return np.where(np.isfinite(values), values, np.nan), own, bad


# --- Moments --------------------------------------------------------------------------------------

_YMD = re.compile(r"(\d{4})([-/.])(\d{1,2})\2(\d{1,2})(?=[T\s]|\Z)")
_DMY = re.compile(r"(\d{1,2})([-/.])(\d{1,2})\2(\d{4}|\d{2})(?=,?\s|\Z)")
_DNY = re.compile(r"(\d{1,2})[-. ]+([^\W\d_]{3,10})\.?[-, ]+(\d{4})(?=,?\s|\Z)")
_NDY = re.compile(r"([^\W\d_]{3,10})\.?[- ]+(\d{1,2}),?\s+(\d{4})(?=,?\s|\Z)")
_CLOCK = re.compile(
    r"(\d{1,4}):(\d{2})(?::(\d{2}))?(?:[.,:](\d{1,9}))?\s*([AaPp]\.?[Mm]\.?)?"
    r"\s*(Z|UTC|GMT|[+-]\d{2}:?\d{2})?\Z"
)


@dataclass(frozen=True)
class Moment:
    """A cell's time: `days` since 1970 (None without a date), `seconds` of the day (None without a
    clock), `fields` of its clock; `slashed`: numbers of a date whose month may come first."""

    days: float | None
    seconds: float | None
    fields: int = 3
    slashed: tuple[int, int, int] | None = None
    am_pm: bool = False


@lru_cache(maxsize=65536)
def moment_of(cell: Any) -> Moment | None:
    """The moment that a cell writes, None for other text."""
    if isinstance(cell, timedelta):
        return Moment(None, cell.total_seconds())
    if isinstance(cell, time):
        return Moment(None, timedelta(
            hours=cell.hour, minutes=cell.minute, seconds=cell.second,
            microseconds=cell.microsecond).total_seconds())  # fmt: skip
    if isinstance(cell, datetime):
        stamp = (cell if cell.tzinfo else cell.replace(tzinfo=UTC)).timestamp()
        return Moment(stamp // 86_400, stamp % 86_400) if 1970 <= cell.year < 2200 else None
    if isinstance(cell, date):
        return _dated(cell.year, cell.month, cell.day)
    if not isinstance(cell, str) or len(cell) > 40 or not re.search(r"\d[:./\-\s][\d\w]", cell):
        return None
    day: Moment | None = None
    rest = cell.strip()
    for pattern, order in ((_YMD, "ymd"), (_DMY, "dmy"), (_DNY, "dny"), (_NDY, "ndy")):
        if found := pattern.match(rest):
            if order == "ymd":
                day = _dated(int(found[1]), int(found[3]), int(found[4]))
            elif order == "dmy":
                first, second, year = int(found[1]), int(found[3]), int(found[4])
                year += 2000 if year < 100 else 0
                if found[2] == "." or first > 12:
                    day = _dated(year, second, first)
                elif second > 12:
                    day = _dated(year, first, second)
                else:
                    day = _dated(year, second, first, (first, second, year))
            else:
                name, number = (found[2], found[1]) if order == "dny" else (found[1], found[2])
                month = _MONTHS.get(plain_title(name)[:3], 0)
                day = _dated(int(found[3]), month, int(number))
            if day is None:
                return None
            rest = rest[found.end() :].lstrip("T, ").strip()
            break
    if not rest:
        return day
    clock = _CLOCK.match(rest)
    if clock is None:
        return None
    _, _, third, broken, half, zone = clock.groups()
    fields = 3 if third else 2
    hours, minutes, seconds = (int(clock[1]), int(clock[2]), int(third or 0))
    if fields == 2 and (day is not None or half):
        fields = 3  # 09:59 AM, 2026-03-10 10:00
    if minutes > 59 or seconds > 59 or (half and not 1 <= hours <= 12):
        return None
    if half:
        hours = hours % 12 + 12 * (half[0] in "pP")
    total = hours * 3600.0 + minutes * 60.0 + seconds if fields == 3 else hours * 60.0 + minutes
    total += float(f"0.{broken}") if broken else 0.0
    if broken and not third and fields == 2:
        fields = 1  # mm:ss.s, no doubt
    if zone and zone[0] in "+-":
        total -= (60 * int(zone[1:3]) + int(zone[-2:])) * 60.0 * (1 if zone[0] == "+" else -1)
    days, slashed = (day.days, day.slashed) if day else (None, None)
    return Moment(days, total, fields, slashed, bool(half))


def _dated(
    year: int, month: int, day: int, slashed: tuple[int, int, int] | None = None
) -> Moment | None:
    try:
        whole = datetime(year, month, day, tzinfo=UTC).timestamp() / 86_400
    except ValueError:
        return None
    return Moment(whole, None, 3, slashed) if 1970 <= year < 2200 else None


def moments_of(
    cells: Sequence[Any], dates: Sequence[Any] | None = None
) -> tuple[FloatArray, float | None, int, str] | None:
    """Seconds since the first cell (n,), NaN where one is missing; the epoch of it where the cells
    have dates; how many fields their clocks have (2: hh:mm or mm:ss, asked); and a remark. None
    where a cell is no moment. `dates`: cells of the column of dates that goes with a clock."""
    found = [None if c is None or (isinstance(c, str) and c.lower() in MISSING) else moment_of(c)
             for c in cells]  # fmt: skip
    given = [m for m in found if m is not None]
    empty = sum(c is None or (isinstance(c, str) and c.lower() in MISSING) for c in cells)
    if len(given) + empty != len(cells) or not given:
        return None
    beside = [moment_of(c) for c in dates] if dates is not None else found
    if dates is not None and any(m is None for m in beside):
        return None
    # 03/10/2026 is October 3rd or March 10th: AM and PM, or a month beyond 12, tell.
    known = [m for m in beside if m is not None]
    slashed = [m.slashed for m in known if m.slashed]
    american, remark = False, ""
    if slashed and len(slashed) == len(known):
        order = [[(y, a, b) for a, b, y in slashed], [(y, b, a) for a, b, y in slashed]]
        sorted_us, sorted_eu = (o == sorted(o) for o in order)
        if any(m.am_pm for m in given) or (sorted_us and not sorted_eu):
            american = True
        if len(set(slashed)) == 1 or sorted_us == sorted_eu:
            a, b, year = slashed[0]
            order_of = (a, b) if american else (b, a)
            remark = "{:02d}/{:02d}/{} is taken as {}-{:02d}-{:02d}".format(
                a, b, year, year, *order_of
            )
    seconds = np.full(len(cells), np.nan)
    absolute = True
    for k, (moment, day) in enumerate(zip(found, beside, strict=True)):
        if moment is None:
            continue
        days = day.days if day else None
        if day and day.slashed and american:
            turned = _dated(day.slashed[2], day.slashed[0], day.slashed[1])
            days = turned.days if turned else days
        absolute = absolute and days is not None
        seconds[k] = (days or 0.0) * 86_400.0 + (moment.seconds or 0.0)
    if not absolute:  # past midnight
        kept = np.isfinite(seconds)
        seconds[kept] += 86_400.0 * np.cumsum(np.diff(seconds[kept], prepend=seconds[kept][0])
                                              < -43_200.0)  # fmt: skip
    first = float(seconds[np.isfinite(seconds)][0])
    fields = min(m.fields for m in given)
    shown = printable(remark)
    return seconds - first, (first if absolute else None), fields, shown
