"""Units that tables write, and what a title means; the words that are known lie in words.yaml."""

import contextlib
import re
import unicodedata
from dataclasses import dataclass
from functools import cache, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from sma_bench.errors import InputError

FloatArray = NDArray[np.float64]

WORDS: dict[str, Any] = yaml.load(  # noqa: S506
    (Path(__file__).parent / "words.yaml").read_text(encoding="utf-8"), yaml.CSafeLoader
)
QUANTITIES: dict[str, Any] = WORDS["quantities"]
_SPELLINGS = {text: name for name, texts in WORDS["units"].items() for text in texts}
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
        raise InputError("units need pint: pip install pint, or apt install python3-pint") from None
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
    if lower in WORDS["angles"]:
        return Unit("angle", WORDS["angles"][lower])
    if lower in WORDS["microstrain"]:
        return Unit("ratio", 1e-6)
    name = WORDS["cased"].get(plain) or _SPELLINGS.get(lower)
    if name is None and not _HARMLESS.match(plain):
        return None
    registry = _registry()
    for word in (name,) if name else (plain, lower):
        with contextlib.suppress(Exception):  # pint raises its parser's and Python's own errors
            unit = registry.Unit(word)
            for quantity, base in WORDS["si"].items():
                if unit.dimensionality == registry.Unit(base).dimensionality:
                    zero = float(registry.Quantity(0.0, unit).to(base).magnitude)
                    one = float(registry.Quantity(1.0, unit).to(base).magnitude)
                    return Unit(quantity, one - zero, zero)
    return None


def in_si(values: FloatArray, unit: Unit) -> FloatArray:
    return values * unit.factor + unit.offset


def number_with_unit(text: str, quantity: str) -> float | None:
    """The value in SI of the first number in a text with a unit of that quantity behind it."""
    number = r"([+-]?\d+(?:[.,]\d+)?(?:[eE][+-]?\d+)?)\s*([^\s\d,;:=]{1,12}\d?)"
    for found in re.finditer(number, text):
        unit = parse_unit(found[2].strip(".\"'"))
        if unit is not None and unit.quantity == quantity:
            return float(found[1].replace(",", ".")) * unit.factor + unit.offset
    return None


# --- Titles ---------------------------------------------------------------------------------------

_DESCRIPTION = re.compile(WORDS["description"], re.IGNORECASE)
_LONE_T = re.compile(r"[tT](?:[cCsSrR]?\d*|[\s_]?(?:[a-zA-Z]{1,9})?\d*)\Z")


def plain_title(title: str) -> str:
    """A title in lower case without accents."""
    folded = unicodedata.normalize("NFKD", title.replace("ß", "ss"))
    return "".join(c for c in folded if not unicodedata.combining(c)).lower()


def words_of(title: str) -> list[str]:
    """The words of a title, plain."""
    return re.findall(r"[^\W\d_]+", plain_title(re.sub(r"(?<=[a-z])(?=[A-Z])", " ", title)))


@lru_cache(maxsize=4096)
def title_meanings(title: str) -> tuple[str, ...]:
    """Quantities that a title without its unit may mean; () where it says nothing known."""
    whole = title.strip()
    room = set(WORDS["room"]) & set(words_of(whole))
    last = whole if room else re.split(r"[/.](?=\D)", whole)[-1].strip()
    for text in (last, whole):
        words = words_of(text)
        if text == "t" or words in (["t", "rel"], ["t", "abs"]):
            return ("time",)
        if set(text) == {"#"} or (words and set(words) <= set(WORDS["counters"])):
            return ("counter",)
        joined = " ".join(["", *words])
        for row in WORDS["titles"]:
            is_part = any(part in joined for part in row.get("parts", ()))
            if is_part or set(words) & set(row.get("words", ())):
                return tuple(row["means"])
        if _LONE_T.match(text):
            return ("ambient",) if room else ("temperature",)
    return ()


def fits(meaning: str, quantity: str) -> bool:
    """Whether a column of that meaning may be measured in units of that quantity."""
    return quantity in QUANTITIES[meaning].get("units", [quantity])


@lru_cache(maxsize=4096)
def meanings(title: str, unit: str) -> tuple[str, ...]:
    """What a column may be, the most telling first: what its title says and its unit fits, or what
    the unit alone tells where the title says nothing; () where nothing is known."""
    meant, known = title_meanings(title), parse_unit(unit)
    if known is None:
        return meant
    fitting = tuple(m for m in meant if fits(m, known.quantity))
    is_open = not meant or len(title) == 1 or meant[0] in ("ambient", "supply")
    told = (q for q, row in QUANTITIES.items() if row.get("by_unit") and fits(q, known.quantity))
    return fitting or (tuple(told) if is_open else ())


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
    if both := re.search(r"[_ ](([^_ /]+)/[^_ /]+)\Z", text):  # Strain_mm/mm, Speed m/s
        first = parse_unit(both[2])
        if first is not None and first.quantity in ("length", "force", "power"):
            return text[: both.start()].strip("_ "), both[1]
    for mark in (" / ", "/", ",", "_", " in ", " "):
        name, cut, unit = text.partition(mark) if mark == " / " else text.rpartition(mark)
        name, unit = name.strip(), unit.strip()
        known = parse_unit(unit) if cut and name else None
        if known is None or name.count("(") != name.count(")"):
            continue
        meant = title_meanings(name)
        sure = mark in (" / ", "/", ",") or any(fits(m, known.quantity) for m in meant)
        if sure or (not meant and unit.lower() not in WORDS["no_units"] and mark != " "):
            return name, unit
    if found and not _DESCRIPTION.match(found[-1][1].strip()) and not text.startswith(("(", "[")):
        return text[: found[-1].start()].rstrip(" ,_/"), found[-1][1].strip()
    return text, ""
