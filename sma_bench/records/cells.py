"""Reads numbers, units, dates and titles in tables, in the notations of many countries."""

import contextlib
import math
import re
import unicodedata
from collections.abc import Iterable, Sequence
from datetime import date
from functools import cache, lru_cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import yaml

from sma_bench.arrays import Array
from sma_bench.errors import InputError

_FILE = Path(__file__).with_name("words.yaml")
WORDS: dict[str, Any] = yaml.load(_FILE.read_bytes(), yaml.CSafeLoader)  # noqa: S506
QUANTITIES: dict[str, Any] = WORDS["quantities"]
_SPELLINGS = {text: name for name, texts in WORDS["units"].items() for text in texts}
PATTERNS = SimpleNamespace(**{k: re.compile(text) for k, text in WORDS["patterns"].items()})


class Unit(NamedTuple):
    """The quantity of a unit; value in SI = factor * value + offset."""

    quantity: str
    factor: float
    offset: float = 0.0

    def si(self, values: Array) -> Array:
        return values * self.factor + self.offset


def message(key: str, **values: Any) -> str:
    """One of the `sentences` of words.yaml, filled in."""
    return str(WORDS["sentences"][key]).format(**values)


@cache
def parse_unit(text: str) -> Unit | None:
    """The unit a text means (`grad`: degree, `C`: Celsius); None if unknown or not of a bench."""
    plain = re.sub(r"[\s()\[\]{}]", "", text)
    lower = plain.lower().replace("µ", "u").replace("μ", "u")
    if not plain or len(plain) > 30:
        return None
    for quantity, factors in WORDS["factors"].items():
        if lower in factors:
            return Unit(quantity, factors[lower])
    name = WORDS["cased"].get(plain) or _SPELLINGS.get(lower)
    for word in (name,) if name else (plain, lower) if PATTERNS.unit.match(plain) else ():
        with contextlib.suppress(Exception):  # pint raises errors of its parser and of Python
            import pint
            units = pint.get_application_registry()
            zero, one = (units.Quantity(value, word) for value in (0.0, 1.0))
            for quantity, base in WORDS["si"].items():
                if zero.check(units.Unit(base).dimensionality):
                    offset = float(zero.to(base).magnitude)
                    return Unit(quantity, float(one.to(base).magnitude) - offset, offset)
    return None


_PLAUSIBLE = {"mass": (1e-9, 1e-3), "stress": (5e6, 1e9)}  # in SI: decides if 1,200 is 1.2 or 1200


def number_with_unit(text: str, quantity: str) -> float | None:
    """The first number with a unit of `quantity`, in SI; None if there is none or it is unclear."""
    parted = (text.partition(mark) for mark in ":=")
    key, value = next(((k, v) for k, _, v in parted if re.search(r"\d", v)), ("", text))
    units = (unit for unit in re.findall(r"[/(\[]\s*([^\s)\]:]+)", key) if parse_unit(unit))
    value = f"{value} {next(units, '')}"  # Mass/mg: 12
    for found in PATTERNS.amount.finditer(value):
        unit, number = parse_unit(found["unit"].strip(".\"'")), found["number"]
        before = value[max(found.start() - 60, 0) : found.start()]
        groups = PATTERNS.thousands.search(before) if re.match(r"\d{3}(?!\d)", number) else None
        is_none = PATTERNS.no_amount.search(before + number[: number[0] in "+-−"]) and not groups
        if is_none or unit is None or unit.quantity != quantity:
            continue
        values, ways = [], [f"{groups[2]} {number}", number] if groups else [number]
        if groups and (number[0] == "0" or len(groups[2]) > 4 or (key and groups[1] is not None)):
            ways.pop()
        for written in ways:
            shown = decimal_signs([written])
            is_ambiguous = shown == {"?,"} or (shown == {"?."} and quantity in _PLAUSIBLE)
            for decimal in ",." if is_ambiguous else (*shown, ".")[0][-1]:
                amount = float(numbers_of([written], decimal, "")[0][0])
                values.append(amount * unit.factor + unit.offset)
        least, most = _PLAUSIBLE.get(quantity, (math.inf, 0.0))
        values = [v for v in values if len(values) == 1 or least <= v <= most]
        return values[0] if len(values) == 1 and math.isfinite(values[0]) else None
    return None


def plain_title(title: str) -> str:
    folded = unicodedata.normalize("NFKD", title.replace("ß", "ss"))
    return "".join(c for c in folded if not unicodedata.combining(c)).lower()


_PARTS = [t for row in WORDS["titles"] for k in ("parts", "words") for t in row.get(k, ())]
_KNOWN = re.compile("|".join(re.escape(t.strip()) for t in _PARTS if len(t) > 1 + t.isascii()))
_NEUTRAL = {word for key in ("neutral", "room", "wire", "supplies") for word in WORDS[key]}
_NEUTRAL |= {word for part in _PARTS if not part.isascii() for word in part.split()}


def is_neutral(word: str, meaning: str) -> bool:
    """True if a word in a title with this meaning says nothing of another device."""
    return len(word) < 3 or word in _NEUTRAL or meaning in title_meanings(word)


def words_of(title: str) -> list[str]:
    return re.findall(r"[^\W\d_]+", plain_title(re.sub(r"(?<=[a-z])(?=[A-Z])", " ", title)))


def known_letters(text: str) -> int:
    """How many letters of a text are in words that titles are known by."""
    return sum(map(len, _KNOWN.findall(plain_title(text))))


@lru_cache(maxsize=4096)
def title_meanings(title: str) -> tuple[str, ...]:
    """Quantities that a title without its unit may mean; () if unknown."""
    whole = re.sub(r"\s+run\s?#?\d+\Z", "", title.strip(), flags=re.IGNORECASE)
    room = set(WORDS["room"]) & set(words_of(whole))
    last = whole if room else re.split(r"[/.](?=\D)", whole)[-1].strip()
    for text in (last, whole):
        words = words_of(text)
        if text == "t" or words in (["t", "rel"], ["t", "abs"]):
            return ("time",)
        if words in (["t", "f"], ["t", "b"]):  # front and back
            return ("temperature",)
        if set(text) == {"#"} or (words and set(words) <= set(WORDS["counters"])):
            return ("counter",)
        joined = " ".join(["", *words])
        for row in WORDS["titles"]:
            parts = (part for part in row.get("parts", ()) if part in joined)
            if any(parts) or set(words) & set(row.get("words", ())):
                return tuple(row["means"])
        if PATTERNS.lone_t.match(text):
            return ("ambient",) if room else ("temperature",)
    return ()


def fits(meaning: str, quantity: str) -> bool:
    """True if a column of that meaning may have units of that quantity."""
    return quantity in QUANTITIES[meaning].get("units", [quantity])


@lru_cache(maxsize=4096)
def meanings(title: str, unit: str) -> tuple[str, ...]:
    """What a column may be by title and unit, the most likely first; () if unknown."""
    meant, known = title_meanings(title), parse_unit(unit)
    if known is None:
        return meant
    if known.quantity == "ratio" and any(word in plain_title(title) for word in WORDS["stretch"]):
        return ("strain",)
    if fitting := tuple(m for m in meant if fits(m, known.quantity)):
        return fitting
    is_open = not meant or len(title) == 1 or meant[0] in ("ambient", "supply", "counter")
    return tuple(q for q, row in QUANTITIES.items()
                 if is_open and row.get("by_unit") and fits(q, known.quantity))


@lru_cache(maxsize=4096)
def split_title(title: str, below: str = "") -> tuple[str, str]:
    """Title and unit. The unit is `below` if given, or stands in brackets, after a slash or comma,
    or after an underscore or blank if it fits the title (the A of LVDT_A is no ampere). A factor
    (x10) stays with the unit, which is then unknown."""
    text = " ".join(title.translate(_WIDE).split())
    if len(text) < 200 and (factor := PATTERNS.factor.search(text)):
        name, unit = split_title(f"{text[: factor.start()]} {text[factor.end() :]}", below)
        return name, f"{unit} {factor[0].strip()}".strip()
    if below:
        return title, below
    found = list(re.finditer(r"[\[({]((?:[^\[\](){}]|\([^()]*\))*)[\])}]", text))
    for match in reversed(found):
        if parse_unit(match[1]):
            rest = f"{text[: match.start()]} {text[match.end() :]}"
            return " ".join(rest.replace("( )", "").split()).rstrip(" ,_/"), match[1].strip()
    if both := re.search(r"[_ ](([^_ /]+)/[^_ /]+)\Z", text):  # Strain_mm/mm, Speed m/s
        first = parse_unit(both[2])
        if first is not None and first.quantity in ("length", "force", "power"):
            return text[: both.start()].strip("_ "), both[1]
    for mark in (" / ", "/", ",", "_", " in ", " ", "."):
        parted = text.partition(mark) if mark == " / " else text.rpartition(mark)
        name, cut, unit = map(str.strip, parted)
        known = parse_unit(unit) if name else None
        is_open = any(name.count(mark) != name.count(end) for mark, end in ("()", "[]", "{}"))
        is_side = mark == "_" and len(name) == 1 and unit.lower() in ("f", "b")
        if known is None or is_open or is_side or unit.lower() == "adc":  # not volts, but counts
            continue
        meant = title_meanings(name)
        is_sign = mark in (" / ", "/", ",") and (mark, unit) != ("/", "F")  # wire/F: a force
        sure = is_sign or unit[0] in "°℃" or any(fits(m, known.quantity) for m in meant)
        if sure or (not meant and unit.lower() not in WORDS["no_units"] and mark not in " ."):
            return name, unit
    unit = found[-1][1].strip() if found else ""
    if found and not PATTERNS.description.match(unit) and not text.startswith(("(", "[")):
        if parse_unit((outside := split_title(text[: found[-1].start()]))[1]):
            return outside  # Temp, °F (LGR S/N: 10338)
        return text[: found[-1].start()].rstrip(" ,_/"), unit
    known = parse_unit(text) if len(text) > 3 else None
    return text, text if known and known.quantity == "time" else ""  # millis, seconds


_MISSING = frozenset(WORDS["missing"])
OVERFLOW = 9.9e37  # infinity of SCPI instruments (9.91E37 is their NaN): no reading is as large
_WIDE = {0xFEE0 + k: k for k in range(ord("!"), ord("~") + 1)}  # full-width letters and brackets
_SHAPE = str.maketrans("23456789", "11111111")


@lru_cache(maxsize=65536)
def _parts(cell: Any) -> tuple[str, str, str] | None:
    """Number as written, exponent and unit; None for other text."""
    found = PATTERNS.number.match(cell) if isinstance(cell, str) else None
    unit = found["unit"] or "" if found else ""
    if found is None or (unit and unit not in WORDS["prefixes"] and parse_unit(unit) is None):
        return None
    power = (found["power"] or "").lower().replace("d", "e")
    return "-" * (found["sign"] in ("-", "−", "–")) + found["body"], power, unit


def is_missing(cell: Any) -> bool:
    """True for a cell that stands for no reading: empty, NaN, or a mark such as OL or -----."""
    return str(cell).lower() in _MISSING or bool(PATTERNS.no_value.match(str(cell)))


@lru_cache(maxsize=65536, typed=True)
def cell_kind(cell: Any) -> str:
    """Kind of a cell: "n" number, "d" date or clock time, "t" text, "" missing value."""
    try:
        return "n" if abs(float(cell)) < OVERFLOW else ""
    except ValueError:
        return "" if is_missing(cell) else "n" if _parts(cell) else "d" if moment_of(cell) else "t"


def is_number_row(cells: Sequence[Any]) -> bool:
    """True for two or more cells with more numbers, dates and times than texts."""
    kinds = [cell_kind(cell) for cell in cells] if len(cells) > 1 else []
    marks = sum(is_missing(c) and str(c).lower() not in _MISSING for c in cells)  # ****, +OVER
    more = kinds.count("n") + kinds.count("d") - kinds.count("t") - marks
    return more > 0 or (more == 0 and "d" in kinds and kinds.count("n") > 1)


def decimal_signs(cells: Iterable[Any]) -> set[str]:
    """Decimal signs of cells: "." and ","; "?." and "?," if they may separate thousands (1.069)."""
    shown: set[str] = set()
    for shape in {cell.translate(_SHAPE) for cell in cells if isinstance(cell, str)}:
        body = (_parts(shape) or ("",))[0].lstrip("-")
        marks = re.findall("[.,]", body)
        whole, _, digits = body.rpartition(marks[-1]) if marks else ("", "", "")
        if len(set(marks)) == 2 or PATTERNS.grouping.search(whole):
            shown.add(marks[-1])
        elif len(marks) > 1:
            shown.add("," if marks[-1] == "." else ".")
        elif marks:
            is_ambiguous = len(digits) == 3 and 0 < len(whole) <= 3 and not whole.startswith("0")
            shown.add("?" * is_ambiguous + marks[-1])
    return shown


def decimal_of(label: str, shown: set[str], everywhere: set[str], cells: Sequence[Any]) -> str:
    """The decimal sign of a column, by its own cells, else the others'. InputError: ambiguous."""
    own, unsure = ({sign[-1] for sign in shown if len(sign) == size} for size in (1, 2))
    is_ambiguous = unsure == {"."} and not everywhere and _may_be_thousands(cells)
    if len(own) == 2:
        raise InputError(f"{label} has decimal points and decimal commas, expected one of them")
    if own or not unsure or (unsure == {"."} and everywhere <= {"."} and not is_ambiguous):
        return own.pop() if own else "."
    if unsure == {","} and len(everywhere) == 1:
        return next(iter(everywhere))
    marked = {cell for cell in set(cells) if decimal_signs([cell])}
    bare = {str(c).lstrip("-") for c in set(cells) - marked if cell_kind(c) == "n"}
    is_ambiguous |= len(unsure) == 2 or bool(everywhere & unsure)
    if bare - {"0"} and max(map(len, bare)) < 4 and not is_ambiguous:
        return "." if unsure == {","} else ","  # 980 and 1,069: thousands
    raise InputError(message("open_sign", label=label, cell=min(marked)))


def _may_be_thousands(cells: Sequence[Any]) -> bool:
    """True if a column holds numbers like 985 and 1.069 only, whose dots may separate thousands."""
    forms: set[Any] = set()
    for cell in cells:
        form = PATTERNS.dotted.match(cell) if isinstance(cell, str) else None
        if form is None and not is_missing(cell):
            return False
        forms.add(form and form.lastgroup)
    return forms >= {"dot", "bare"}


def plain_numbers(cells: Sequence[Any]) -> Array | None:
    """Values (n,) of cells that float() reads; None if it cannot, or dots may mean thousands."""
    try:
        values = np.array([float(cell) for cell in cells])
    except (TypeError, ValueError):
        return None
    return None if _may_be_thousands(cells) else np.where(abs(values) < OVERFLOW, values, np.nan)


def numbers_of(cells: Sequence[Any], decimal: str, unit: str) -> tuple[Array, str, int]:
    """Values (n,), NaN where missing; `unit` or that in the cells; index of a bad cell, else -1."""
    if decimal == "," and not any("." in str(cell) for cell in cells):
        values = plain_numbers([str(cell).replace(",", ".") for cell in cells])
        if values is not None:
            return values, unit, -1
    parts = {cell: found for cell in set(cells) if (found := _parts(cell))}
    written = sorted({found[2] for found in parts.values()} - {""})
    own = unit or next((text for text in written if parse_unit(text)), "")
    wanted, factors = parse_unit(own), {"": 1.0}
    for text in written:
        known = parse_unit(text)
        if known and wanted and known._replace(factor=wanted.factor) == wanted:
            factors[text] = known.factor / wanted.factor
        elif unit and text in WORDS["prefixes"]:
            factors[text] = WORDS["prefixes"][text]
    thousand = "," if decimal == "." else "."
    read: dict[Any, float] = {}
    for cell in set(cells):
        body, power, text = parts.get(cell, ("", "", "none"))
        if text in factors:
            body = PATTERNS.grouping.sub("", body).replace(thousand, "").replace(",", ".")
            with contextlib.suppress(ValueError):
                read[cell] = float(body + power) * factors[text]
        elif cell not in parts and (kind := cell_kind(cell)) in ("", "n"):
            read[cell] = float(cell) if kind and not isinstance(cell, str) else np.nan
    bad = next((k for k, cell in enumerate(cells) if cell not in read), -1)
    values = np.array([read.get(cell, np.nan) for cell in cells])
    return np.where(abs(values) < OVERFLOW, values, np.nan), own, bad


def in_units(values: Array, texts: Sequence[Any]) -> tuple[Array, str] | None:
    """Values (n,), each in its own unit, in the first unit; and that. None if the units differ."""
    known = [unit for text in texts if (unit := parse_unit(str(text)))]
    if len(known) < len(texts) or len({unit[::2] for unit in known}) > 1:
        return None
    return values * np.array([unit.factor for unit in known]) / known[0].factor, str(texts[0])


_MONTHS = {name: k for k, names in enumerate(WORDS["months"], 1) for name in names}
_DAY = 86_400.0  # s
_LONGEST_PAUSE = 14.0  # days, of a run: a longer one means that day and month are swapped
_ELAPSED = 3600.0  # s after midnight, before which no bench runs
_SHORT_DAYS = 2e-5  # days: a step that would be 20 us if the dates were seconds
_EPOCH, _LAST_DAY = date(1970, 1, 1).toordinal(), date(2199, 12, 31).toordinal()


class Moment(NamedTuple):
    """A date, a clock time or both, as written in a cell."""

    days: tuple[float, float]  # since 1970, read day first and month first; NaN where impossible
    seconds: float | None  # of the day; None without a clock time
    fields: int = 3  # of the clock time: 1 for mm:ss.s, 2 for hh:mm or mm:ss, 3 for all others
    am_pm: bool = False


@lru_cache(maxsize=65536)
def moment_of(cell: Any) -> Moment | None:
    """The date or clock time written in a cell; None for other text."""
    is_text = isinstance(cell, str) and 4 <= len(cell) <= 40
    found = PATTERNS.moment.match(cell.strip()) if is_text else None
    if is_text and found is None and re.search(r"\d{4}", cell):
        for pattern, new in WORDS["rewritten"].items():
            cell = re.sub(pattern, new, cell)
        found = PATTERNS.moment.match(cell.strip())
    if found is None or not found[0]:
        return None
    passed, written, a, mark, b, c, h, m, s, broken, half, zone = found.groups()
    orders: list[tuple[str, Any, str]] = []
    year, days = f"20{c}"[-4:] if written else "", [math.nan, math.nan]
    if written and a.isdigit() != b.isdigit():  # the month is a name
        name, number = (b, a) if a.isdigit() else (a, b)
        orders = [(year, _MONTHS.get(plain_title(name)[:3], 0), number)]
    elif written and written == mark.join((a, b, c)) and len(mark.strip()) == 1:
        orders = [(a, b, c)] if len(a) == 4 else [(year, b, a), (year, a, b)]
    for k, order in enumerate(orders[:1] if mark == "." else orders):
        with contextlib.suppress(ValueError):
            day = date(*map(int, order)).toordinal()
            days[k] = float(day - _EPOCH) if _EPOCH <= day <= _LAST_DAY else math.nan
    both = days[0], days[1]
    if written and np.isnan(days).all():
        return None
    if h is None:
        return Moment(both, None)
    hours = int(h) % 12 + 12 * (half[0] in "pP") if half else int(h)
    is_short = not s and not written and not half  # hh:mm or mm:ss, with a fraction mm:ss.s
    total = (hours * 60.0 + int(m)) * (1.0 if is_short else 60.0) + float(f"{s or 0}.{broken or 0}")
    total += _DAY * int(passed or 0)
    if zone and zone[0] in "+-":
        total -= float(f"{zone[0]}60") * (60 * int(zone[1:3]) + int(zone[-2:]))
    return Moment(both, total, 3 if not is_short else 1 if broken else 2, bool(half))


def moments_of(cells: Sequence[Any],
               dates: Sequence[Any] | None = None) -> tuple[Array, float | None, int, str] | None:
    """Times of cells: seconds (n,) since the first one, NaN where missing; the epoch of the first
    if they or `dates`, a second column, have dates, or s after midnight of a time of day; the
    fewest `Moment.fields`; a remark. None if a cell is neither date nor time."""
    if dates is None and PATTERNS.iso.match(str(cells[0])):
        with contextlib.suppress(ValueError):  # a cell in another form
            stamps = np.array(cells, dtype="datetime64[ns]")
            seconds = (stamps - stamps[0]) / np.timedelta64(1, "s")
            return seconds, float(stamps[0].astype(np.int64)) / 1e9, 3, ""
    there = [k for k, cell in enumerate(cells) if not is_missing(cell)]
    found = [m for k in there if (m := moment_of(cells[k]))]
    dated = [m for k in there if (m := moment_of(dates[k]))] if dates else found
    if not found or not len(found) == len(dated) == len(there):
        return None
    # 03/10/2026 is October 3rd or March 10th: AM/PM, dates that go back or a long pause decide.
    first, second = np.array([m.days for m in dated]).T  # day first, month first
    day, remark = np.where(np.isnan(first), second, first), ""
    can_be = [bool(np.isfinite(order).all()) for order in (first, second)]
    forward = [bool(np.all(np.diff(order) >= 0.0)) for order in (first, second)]
    pauses = [np.diff(order).max(initial=0.0) for order in (first, second)]
    is_next = all(forward) and pauses[0] > _LONGEST_PAUSE and pauses[1] <= 1.0
    if can_be[1] and (not can_be[0] or found[0].am_pm or forward == [False, True] or is_next):
        day = second
    text = str((dates or cells)[there[0]]).split()[0]
    has_short_year = re.match(r"\d\d?([-/])\d\d?\1\d\d(?!\d)", text)  # 26/03/01: first or last?
    if has_short_year or (all(can_be) and forward[0] == forward[1]):
        remark = f"{text} is taken as {date.fromordinal(int(day[0]) + _EPOCH)}"
    is_absolute = bool(np.isfinite(day).all())
    total = (_DAY * day if is_absolute else 0.0) + np.array([m.seconds or 0.0 for m in found])
    if not is_absolute:  # past midnight
        total += _DAY * np.cumsum(np.diff(total, prepend=total[0]) < -0.5 * _DAY)
    seconds = np.full(len(cells), np.nan)
    seconds[there] = total - total[0]
    fields = min(m.fields for m in found)
    is_of_day = fields == 3 and total[0] >= _ELAPSED  # 10:04:05; 0:04:05 was counted from a start
    return seconds, float(total[0]) if is_absolute or is_of_day else None, fields, remark


def stated_start(above: Sequence[tuple[str, ...]]) -> tuple[float, str]:
    """Epoch (s) of the start that lines above a table state, and that line; 0 if there is none."""
    parts: dict[str, tuple[Moment, str]] = {}
    for line in map(" ".join, above):
        parted = [*re.split(r"[:=\t]| (?=\d)", line, maxsplit=1), ""]
        key, value = (text.strip(" #,;") for text in parted[:2])
        if not (moment := moment_of(value)):
            continue
        title, day = plain_title(key).strip(), np.nan_to_num(moment.days[0])
        if day and moment.seconds is not None and title.startswith(tuple(WORDS["begins"])):
            return day * _DAY + moment.seconds, line
        for what in ("begin_day", "begin_time"):
            if title in WORDS[what]:
                parts[what] = moment, line
    if len(parts) < 2 or not (day := np.nan_to_num(parts["begin_day"][0].days[0])):
        return 0.0, ""
    (_, one), (time, two) = parts["begin_day"], parts["begin_time"]
    return day * _DAY + (time.seconds or 0.0), f"{one}, {two}"


def serial_dates(title: str, values: Array) -> tuple[Array, float] | None:
    """Seconds (n,) since the first of dates that Excel or MATLAB counts in days, and its epoch;
    None for other numbers. Without a date in the title, the steps are too short for seconds."""
    there = values[np.isfinite(values)]
    is_date = any(word in plain_title(title) for word in WORDS["dates"])
    if len(there) < 2 or not (is_date or np.median(np.abs(np.diff(there))) < _SHORT_DAYS):
        return None
    for low, high, zero in WORDS["serial"]:
        if low <= there.min() and there.max() <= high:
            return (values - there[0]) * _DAY, float(there[0] - zero) * _DAY
    return None


def continued(values: Array) -> Array:
    """A counter's values (n,), continued where it began again after 2^16 or 2^32 counts, or
    after 2^32 us or ms in s."""
    there = np.isfinite(values)
    steps = np.diff(values[there])
    back = steps < 0.0
    for full in (2.0**16, 2.0**32, 2.0**32 * 1e-3, 2.0**32 * 1e-6) if back.any() else ():
        after = steps[back] + full
        if np.all(after > 0.0) and after.max() <= 3.0 * np.median(steps):
            made = values.copy()
            made[there] += full * np.append(0.0, np.cumsum(back))
            return made
    return values


def spread_stamps(time: Array, where: str) -> tuple[Array, str]:
    """Times (n,) s in which repeated stamps are spread, and a remark. InputError: all are equal."""
    stamps, first, count = np.unique(time, return_index=True, return_counts=True)
    rows = len(time)
    if len(stamps) < 2:
        raise InputError(f"{where}: all {rows} rows are at one time, expected a running clock")
    step = float(np.diff(stamps).min())
    remark = message("spread", repeated=rows - len(stamps), rows=rows, step=step)
    if np.median(count) > 1.0 and len(stamps) > 2:  # one straight line, if rows came evenly
        period = float(stamps[-1] - stamps[1]) / float(first[-1] - first[1])
        even = period * np.arange(rows)
        even += float(np.max(time - even))
        if np.max(even - time) < step + 0.5 * period:
            return np.asarray(even), f"{remark}, {1.0 / period:.4g} Hz"
    gaps = np.minimum(np.append(np.diff(stamps), step), step)
    within = np.arange(rows) - np.repeat(first, count)
    return np.asarray(time + within * np.repeat(gaps / count, count)), remark
