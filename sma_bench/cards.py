"""An answer on one card: the same on a terminal, a page, a topic and in a notebook.

Results hold facts; every sentence is made last, by the template of the result's kind in
`templates/`, and no program reads one.
"""

import math
import shlex
import textwrap
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from sma_bench.border import printable
from sma_bench.parameters.parameter import EFFECTS
from sma_bench.results import (
    Invocation,
    in_print,
    in_unit,
    percent,
    signed,
    with_error,
)

if TYPE_CHECKING:
    import jinja2

NUMBER_HEADER = (
    "parameter", "value ± statistical ± systematic", "from the records", "reference", "off it",
    "by",
)
TEMPLATES = Path(__file__).with_name("templates")
_NO_BORDERS = str.maketrans("\n|", " /")
_WIDTH, _NARROWEST = 96, 40


class Card(NamedTuple):
    """The verdict in one line, and rows of a label ("" for that of the row above) and a text."""

    title: str
    rows: tuple[tuple[str, str], ...]


# --- From a result's facts to text.


def sentences(result: Any, macro: str, *more: Any) -> list[str]:
    """Lines that a macro of the result's template makes; `result.template` names it."""
    made = str(getattr(_templates(TEMPLATES).get_template(result.template).module, macro)(
        result, *more
    ))  # fmt: skip
    return [" ".join(line.split()) for line in made.splitlines() if line.strip()]


def cells(result: Any, macro: str, *more: Any) -> list[tuple[str, ...]]:
    """The same for lines of cells with a bar between them."""
    lines = sentences(result, macro, *more)
    return [tuple(cell.strip() for cell in line.split("|")) for line in lines]


def card(result: Any, asked: Invocation | None = None, numbers: bool = False) -> Card:
    """The card of an identification or a diagnosis.

    Args:
        asked: the command that made it; numbers: with a row for each, where no table has them.
    """
    (_, title), *rows = (_row(line) for line in sentences(result, "card", asked))
    if numbers and getattr(result, "estimates", None):
        rows = [*map(_row, sentences(result, "number_lines")), *rows]
    above = ["", *(label for label, _ in rows)]
    return Card(title, tuple(
        ("" if label == last else label, text)
        for last, (label, text) in zip(above, rows, strict=False)
    ))  # fmt: skip


def _row(line: str) -> tuple[str, str]:
    label, _, text = line.partition("|")
    return label.strip(), text.strip()


def card_rows(result: Any) -> list[list[str]]:
    """The card as plain data, the title first under "": for whoever shows a result and no more."""
    shown = card(result)
    return [["", shown.title], *map(list, shown.rows)]


@cache
def _templates(folder: Path) -> "jinja2.Environment":
    import jinja2  # a tenth of a second that only those who read a result wait for

    environment = jinja2.Environment(  # noqa: S701 (no HTML: pages escape it)
        loader=jinja2.FileSystemLoader(folder), trim_blocks=True, lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
        # What comes from a file begins no row and no cell of its own.
        finalize=lambda shown: shown.translate(_NO_BORDERS) if isinstance(shown, str) else shown,
    )
    environment.globals["effects"] = EFFECTS
    environment.filters |= {
        "in_print": in_print, "percent": percent, "signed": signed, "quoted": shlex.quote,
        "two_errors": two_errors, "is_finite": math.isfinite, "plain_effect": _plain_effect,
        "shown_unit": lambda unit: "" if unit == "1" else unit,
        "with_error": lambda number: with_error(number.value, number.std),
    }
    return environment


def two_errors(number: Any) -> str:
    """Value ± statistical ± systematic error of an `Estimate`, to the digits that the smaller
    leaves it, and the unit."""
    parts = [part for part in (number.statistical, number.systematic) if part > 0.0]
    if not number.systematic > 0.0 or not all(map(math.isfinite, (number.value, *parts))):
        return in_unit(with_error(number.value, number.std), number.unit)
    value = with_error(number.value, min(parts)).partition(" ±")[0]
    both = f"{value} ± {number.statistical:.2g} ± {number.systematic:.2g}"
    return in_unit(both, number.unit)


def _plain_effect(name: str) -> str:
    """Its title and stage; "" of one that is not known here."""
    effect = EFFECTS.get(name)
    if effect is None:
        return ""
    title = effect.text.strip().partition("\n")[0].rstrip(".")
    return f"{title[:1].lower()}{title[1:]} ({effect.stage} stage)."


# --- As lines, and as HTML.


def card_lines(shown: Card, width: int = _WIDTH) -> list[str]:
    """The title and the rows, folded; no line is longer than can be read at ease."""
    width = max(min(width, _WIDTH), _NARROWEST)
    lines = textwrap.wrap(printable(shown.title), width)
    for label, text in shown.rows:
        lines += textwrap.wrap(
            printable(text), width, initial_indent=f"{label:7} ", subsequent_indent=" " * 8,
            break_on_hyphens=False,
        )
    return lines


def card_text(result: Any, width: int = _WIDTH, asked: Invocation | None = None) -> str:
    """The card as lines for a terminal of `width`, folded, labels once; of an identification with
    a number a line below its title."""
    shown, rows = card(result, asked), number_rows(result)
    title = card_lines(Card(shown.title, ()), width)
    return "\n".join([*title, *_table(rows), *card_lines(shown, width)[len(title) :]])


def number_rows(result: Any) -> list[tuple[str, ...]]:
    """A row a number, as `NUMBER_HEADER`; none of a diagnosis."""
    return cells(result, "numbers") if getattr(result, "estimates", None) else []


def _table(rows: list[tuple[str, ...]]) -> list[str]:
    """Columns of numbers with something in them, side by side."""
    if not rows:
        return []
    every = [NUMBER_HEADER, *rows]
    kept = [k for k in range(len(NUMBER_HEADER)) if any(row[k] for row in rows)]
    wide = [max(len(row[k]) for row in every) for k in kept]
    return [
        printable("  ".join(f"{row[k]:{w}}" for k, w in zip(kept, wide, strict=True)).rstrip())
        for row in every
    ]


def card_html(result: Any, asked: Invocation | None = None) -> str:
    """The same as tables, every text escaped."""
    return _templates(TEMPLATES).get_template("card.html.j2").render(
        card=card(result, asked), header=NUMBER_HEADER, numbers=number_rows(result)
    )
