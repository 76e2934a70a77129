"""Results: their files (docs/topics.md), formatting of their numbers, and the card that shows the
answer. The types, in `identify/result.py` and `diagnose/result.py`, hold facts only; all sentences
are made last, by the templates in `templates/`."""

import json
import math
import shlex
import textwrap
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, TypeVar

from sma_bench.border import printable
from sma_bench.errors import InputError
from sma_bench.parameters.parameter import EFFECTS
from sma_bench.parameters.yaml_file import write_text_atomically

if TYPE_CHECKING:
    import jinja2

LARGEST = 1 << 24  # bytes of a result file
_LARGEST_NUMBER = 1e100  # in any unit; larger ones mean a damaged file
T = TypeVar("T")
NUMBER_HEADER = ("parameter", "value ± statistical ± systematic", "difference", "informed",
                 "reference", "by")  # the most important first
_SCALES = {
    "voltage_command": ("V", 1.0), "voltage": ("V", 1.0), "current": ("mA", 1e3),
    "temperature": ("K", 1.0), "force": ("N", 1.0),
    **dict.fromkeys(("deflection", "range", "elongation"), ("mm", 1e3))}
TEMPLATES = Path(__file__).with_name("templates")
_NO_BORDERS = str.maketrans("\n|", " /")  # a text from a file must not begin a row or a cell
_WIDTH, _NARROWEST = 96, 40  # characters of a card's line
_LONGEST = 400  # characters of a result's repr
_EXACT = 1e-10  # error over its number that only rounding makes
_NEGLIGIBLE = 0.01  # part of an error that is shown as 0


@dataclass(frozen=True)
class Invocation:
    """The parts of the command that made a result, for the advice on what to do next."""

    records: tuple[str, ...] = ()
    params: str = ""
    out: str = ""
    report: str = ""


def decoded(kind: type[T], document: Any, where: str) -> T:
    """A dataclass from its parsed JSON; null, which stands for a number that is not finite, becomes
    NaN. Raises InputError: a wrong field, which it names after `where`."""
    import msgspec  # may be missing on a robot, which reads no results

    try:
        return msgspec.convert(_numbers(document), kind)
    except (msgspec.ValidationError, ValueError, TypeError, OverflowError) as error:
        raise InputError(f"{where}: damaged result: {' '.join(str(error).split())}") from None


def _numbers(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _numbers(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_numbers(item) for item in value]
    if isinstance(value, (int, float)) and abs(value) > _LARGEST_NUMBER:
        raise ValueError(f"{value!r:.40} is too large, expected below 1e100")
    return math.nan if value is None else value


def write_result(path: str | Path, document: dict[str, Any]) -> None:
    """Write a result file as a whole or not at all. InputError: the folder cannot be written."""
    write_text_atomically(path, json_text(document))


def json_text(document: Mapping[str, Any]) -> str:
    """A result as JSON; NaN becomes null, because standard JSON has no NaN."""
    return json.dumps(_finite(document), indent=2, allow_nan=False) + "\n"


def _finite(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def scale_of(signal: str) -> tuple[str, float]:
    """Display unit of a quantity or a signal `channel.quantity`, and the factor from SI to it."""
    return _SCALES.get(signal.rpartition(".")[2], ("", 1.0))


def in_print(value: float, signal: str) -> str:
    """An SI value of a signal with its display unit, to three digits."""
    unit, factor = scale_of(signal)
    return f"{round(factor * value, 12) + 0.0:.3g} {unit}".rstrip()  # rounding errors are 0


def percent(share: float) -> str:
    """A share as text; values near 0 or 1 are not rounded to 0 % or 100 %."""
    if 0.0 < share < 0.005:
        return "below 1 %"
    if 0.995 < share < 1.0:
        return "above 99 %"
    return f"{100.0 * share:.0f} %"


def signed(value: float, form: str) -> str:
    """A number with its sign, without it if rounded to 0."""
    text = f"{value:+{form}}"
    return text if float(text) else text[1:]


def in_unit(number: str, unit: str) -> str:
    """A number as text with its unit, "1" for none."""
    return number if unit in ("", "1") else f"{number} {unit}"


def with_error(value: float, *errors: float) -> str:
    """`value ± error`: errors with two digits, the value with the decimals of all of them."""
    std = math.hypot(*errors)
    if not (math.isfinite(std) and std > _EXACT * abs(value) and math.isfinite(value)):
        return f"{value:.6g}"
    shown = (_rounded(e, e if e > _NEGLIGIBLE * std else std) for e in errors)
    return " ± ".join([_rounded(value, std), *shown])


def _rounded(value: float, error: float) -> str:
    """A number with the decimals that two digits of its error have."""
    decimals = 1 - math.floor(math.log10(float(f"{error:.1e}")))
    value = round(value, decimals)
    if 1e-4 <= abs(value) < 1e6:
        return f"{value:.{max(decimals, 0)}f}"
    return f"{value:.{max(math.floor(math.log10(abs(value))) + decimals, 0)}e}" if value else "0"


def for_people(unit: str, size: float) -> tuple[str, float]:
    """The unit in which a number of that size is printed, and the factor from SI to it."""
    prefix, factor = ("G", 1e-9) if abs(size) >= 1e9 else ("M", 1e-6)
    shown = unit.replace("Pa", f"{prefix}Pa")
    return shown, 1.0 if shown == unit else 1.0 / factor if "/Pa" in unit else factor


class Carded:
    """A result that is shown as its card, in a terminal and in a notebook."""

    template: ClassVar[str]

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: {str(self).partition(chr(10))[0][:_LONGEST]}>"

    def __str__(self) -> str:
        return card_text(self)

    def _repr_html_(self) -> str:
        return card_html(self)


class Card(NamedTuple):
    """A title in one line, and rows of label and text; label "": the same as in the row above."""

    title: str
    rows: tuple[tuple[str, str], ...]


def lines_of(template: str, macro: str, *facts: Any) -> list[str]:
    """The lines that a macro of a template renders from facts."""
    made = str(getattr(_templates().get_template(template).module, macro)(*facts))
    return [" ".join(line.split()) for line in made.splitlines() if line.strip()]


def sentences(result: Any, macro: str, *more: Any) -> list[str]:
    """The lines that a macro of a result's own template renders."""
    return lines_of(result.template, macro, result, *more)


def cells(result: Any, macro: str, *more: Any) -> list[tuple[str, ...]]:
    """As `sentences`, with each line split at | into cells."""
    return [tuple(c.strip() for c in line.split("|")) for line in sentences(result, macro, *more)]


def card(result: Any, asked: Invocation | None = None, numbers: bool = False) -> Card:
    """The card of a result. `asked`: for advice; `numbers`: with a row per estimated number."""
    lines = sentences(result, "card", asked)
    if numbers and getattr(result, "estimates", None):
        lines[1:1] = sentences(result, "number_lines")
    (_, title), *rows = ([part.strip() for part in line.split("|", 1)] for line in lines)
    return Card(title, tuple(("" if label == above else label, text)
                             for (above, _), (label, text) in pairwise([("", ""), *rows])))


def card_rows(result: Any) -> list[list[str]]:
    """The card as plain data, the title first with label "": for the JSON of a result."""
    shown = card(result)
    return [["", shown.title], *map(list, shown.rows)]


@cache
def _templates() -> "jinja2.Environment":
    import jinja2  # takes 0.1 s, so only when a result is shown

    environment = jinja2.Environment(  # noqa: S701 (no HTML: pages escape it)
        loader=jinja2.FileSystemLoader(TEMPLATES), trim_blocks=True, lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
        finalize=lambda shown: shown.translate(_NO_BORDERS) if isinstance(shown, str) else shown)
    environment.globals["effects"] = EFFECTS
    environment.filters |= {
        "in_print": in_print, "percent": percent, "signed": signed, "quoted": shlex.quote,
        "two_errors": two_errors, "changed": changed,
        "stated_of": lambda number: with_unit(number.unit, number.stated.value, number.stated.std),
        "two_digits": lambda std: _rounded(std, std) if std > 0.0 else f"{std:g}",
        "is_finite": math.isfinite, "shown_unit": lambda unit: "" if unit == "1" else unit,
        "with_std": lambda value, std: with_error(value, std).partition(" ")[0],
        "or_empty": lambda value, form, unit="":
            f"{value:{form}}{unit}" if math.isfinite(value) else ""}
    return environment


def with_unit(unit: str, value: float, *errors: float) -> str:
    """`value ± errors unit`, for people."""
    shown, factor = for_people(unit, value)
    return in_unit(with_error(*(factor * number for number in (value, *errors))), shown)


def two_errors(number: Any) -> str:
    """Value ± statistical ± systematic error of an `Estimate`, with its unit."""
    errors = (number.statistical, number.systematic) if number.systematic else (number.std,)
    return with_unit(number.unit, number.value, *errors)


def changed(value: float, unit: str) -> str:
    """A change of a parameter with its sign and unit."""
    unit, factor = for_people(unit, value)
    return in_unit(f"{factor * value:+.3g}", unit)


def card_lines(shown: Card, width: float) -> list[str]:
    """Title and rows, folded to `width`, between 40 and 96 characters."""
    most = int(max(min(width, _WIDTH), _NARROWEST))
    lines = textwrap.wrap(printable(shown.title), most)
    for label, text in shown.rows:
        lines += textwrap.wrap(printable(text), most, initial_indent=f"{label:7} ",
                               subsequent_indent=" " * 8, break_on_hyphens=False)
    return lines


def card_text(result: Any, width: float = math.inf, asked: Invocation | None = None) -> str:
    """The card as text of `width` characters, at most 96. An identification's has a table of its
    numbers: their names and values, and the other columns that fit."""
    shown, rows = card(result, asked), number_rows(result)
    title = card_lines(Card(shown.title, ()), width)
    columns = [own for own in zip(NUMBER_HEADER, *rows, strict=True) if any(own[1:])]
    padded = [[f"{cell:{max(map(len, own))}}" for cell in own] for own in columns]
    while len(padded) > 2 and sum(len(own[0]) + 2 for own in padded) - 2 > width:
        padded.pop()
    table = [printable("  ".join(row).rstrip()) for row in zip(*padded, strict=True)]
    return "\n".join([*title, *table, *card_lines(shown, width)[len(title) :]])


def number_rows(result: Any) -> list[tuple[str, ...]]:
    """Rows of the table with NUMBER_HEADER, one per number; none for a diagnosis."""
    return cells(result, "numbers") if getattr(result, "estimates", None) else []


def card_html(result: Any) -> str:
    """The card as HTML tables, all text escaped."""
    template = _templates().get_template("card.html.j2")
    return template.render(card=card(result), header=NUMBER_HEADER, numbers=number_rows(result))
