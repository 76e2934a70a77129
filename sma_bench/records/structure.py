"""Rows of cells to tables: notes, titles, units, blocks of numbers, and what is left out."""

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import zip_longest
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sma_bench.border import Budget, printable
from sma_bench.errors import InputError
from sma_bench.records.cells import (
    cell_kind,
    decimal_signs,
    is_number_row,
    moment_of,
    moments_of,
    numbers_of,
    plain_numbers,
)
from sma_bench.records.sheets import Row
from sma_bench.records.units import FloatArray, parse_unit, split_title

MOST_COLUMNS = 1000
LONGEST_NAME = 120
_FEWEST = 3  # rows of a table beside a larger one
_SHORT = 0.05  # of the rows: as many without their last cells are sparse, not damaged
_LOOK_AT = 50  # rows
_SAMPLE = 1000  # cells, for what a column holds
_PLAIN = re.compile(r"[+-]?\d[\d.,:/T +-]*(?:e[+-]\d+)?\Z", re.IGNORECASE)
_COMMENT = re.compile(r"(?:#+|%+|//+|!+)\s*")
_FORMS = "12.5, 1,069.3, 2026-03-10 10:00:00, 10.03.2026 10:00:00,5, 10:00:00 AM"


@dataclass(frozen=True, eq=False)
class Column:
    """One column of a file."""

    name: str  # unique in the file: its title, or its path (`log/u`)
    title: str  # without unit
    unit: str  # as written, "" where none is
    values: FloatArray  # (n,), NaN where a cell is empty
    group: str = ""  # sheet or folder it lies in
    start: float | None = None  # epoch s of 0 where the column holds dates
    fields: int = 0  # of its clock times: 0 for numbers, 2 where hh:mm and mm:ss look alike
    table: int = 0  # of the file, whose rows it shares


@dataclass(frozen=True)
class Table:
    """Rows of numbers under one set of titles."""

    name: str  # of its sheet
    columns: tuple[Column, ...]  # of numbers or moments
    lines: NDArray[np.int64]  # (n,) line of each row in the file, from 1
    rows: int  # of numbers in the file, left out or not
    ignored: dict[str, str] = field(default_factory=dict)  # columns of no numbers, each with why
    above: tuple[tuple[str, ...], ...] = ()  # lines above the titles, cells of each
    marks: tuple[tuple[int, str], ...] = ()  # (row, text) of lines between the rows
    left_out: tuple[str, ...] = ()  # of the rows, and why
    notes: tuple[str, ...] = ()  # what was decided

    @property
    def unused_lines(self) -> tuple[str, ...]:
        """What is left out, and the lines of text between the rows."""
        said = f"{len(self.marks)} lines of text between the rows, the first"
        return (*self.left_out, *(f"{said} {text[:40]!r}" for _, text in self.marks[:1]))


def tables_of(
    rows: Sequence[Row], separator: str | None, name: str, budget: Budget, lines: Sequence[str] = ()
) -> tuple[list[Table], list[str]]:
    """Tables of a sheet or text, and the lines that are in none of them.

    `separator` is None for blanks, "" of a workbook's sheet. Raises InputError for titles and cells
    that do not go together, a cell that is no number (its line is named), and numbers whose marks
    may be decimal or thousand signs.
    """
    blocks: list[_Block] = []
    between: list[Row] = []
    width = 0
    for row in rows:
        if len(row[1]) == width and not between and _is_plain(row[1]):
            blocks[-1].rows.append(row)
            continue
        budget.check()
        if not is_number_row(row[1]):
            between += [row] if any(map(cell_kind, row[1])) else []
            continue
        if blocks and blocks[-1].takes(row, between):
            blocks[-1].marks += [(len(blocks[-1].rows), _text(cells)) for _, cells in between]
        else:
            blocks.append(_Block(separator, lines, between))
        between, width = [], len(row[1])
        blocks[-1].rows.append(row)
    largest = max((len(block.rows) for block in blocks), default=0)
    tables: list[Table] = []
    heads: list[Row] = []
    for block in blocks:
        heads += block.heads
        if len(block.rows) < min(_FEWEST, largest):
            heads += block.rows  # a line of numbers among notes
            continue
        block.heads, heads = heads, []
        tables.append(block.table(name, budget))
    unused = [*heads, *between] if tables else []
    return tables, [f"line {line} ({_text(cells)[:40]})" for line, cells in unused]


def _is_plain(cells: Sequence[Any]) -> bool:
    """Whether the first two cells are figures and signs alone."""
    return all(isinstance(c, float) or (isinstance(c, str) and _PLAIN.match(c)) for c in cells[:2])


def _text(cells: Sequence[Any]) -> str:
    return printable(" ".join(str(c) for c in cells if c not in (None, "")))[:LONGEST_NAME]


def _bare(text: Any) -> str:
    return "" if text is None else str(text).strip("()[]{} ")


def _is_units(cells: Sequence[Any]) -> bool:
    bare = [text for cell in cells if (text := _bare(cell))]
    return bool(bare) and all(parse_unit(text) or text == "-" for text in bare)


@dataclass
class _Block:
    """Rows of numbers one after the other, the lines before them, and (row, text) between them."""

    separator: str | None
    lines: Sequence[str]
    heads: list[Row]
    rows: list[Row] = field(default_factory=list)
    marks: list[tuple[int, str]] = field(default_factory=list)

    def takes(self, row: Row, between: list[Row]) -> bool:
        """Whether a row belongs to those before, whatever stands in between: a title row that comes
        again, a line of text; not other titles, and no other width after a gap."""
        if not between and row[0] == self.rows[-1][0] + 1:
            return True
        width = len(self.rows[0][1])
        if len(row[1]) != width:
            return False
        again = self.titles(between, width)[0]
        return not any(again) or again == self.titles(self.heads, width)[0]

    def begins_with_index(self) -> bool:
        """Whether rows begin with a number that counts them, or with a name."""
        first = [cells[0] for _, cells in self.rows]
        numbers = plain_numbers(first)
        if numbers is None:
            return all(cell_kind(c) == "t" for c in first)
        return len(numbers) > 1 and bool(np.all(np.diff(numbers) == 1.0))

    def titles(self, heads: Sequence[Row], width: int) -> tuple[list[str], list[str], list[Row]]:
        """Titles and units of the columns and the lines above them: of the last lines the one that
        is as wide; those of rows that begin with an index or a name are moved behind it."""
        texts = [self.title_cells(row, width) for row in heads[-3:]][::-1]
        for back, titles in enumerate(texts):
            is_units = _is_units(titles)
            is_narrow = len([text for text in titles if text]) < max(2, width / 2)
            if is_narrow and (back or not is_units):
                break
            if is_narrow or is_units:
                continue
            below = texts[back - 1] if back else []
            if not back and texts[2:] and _is_units(texts[1]) and texts[2] == titles:
                below = texts[1]  # titles, units, and the titles again
            units = [_bare(u) for u in below] if _is_units(below) else []
            if below and not units:  # titles over two lines
                pairs = zip_longest(titles, below[: len(titles)], fillvalue="")
                titles = [f"{a} {b}".strip() for a, b in pairs]
            shift = len(titles) - len(units) if self.separator is None else 0
            units = [*[""] * shift, *units, *[""] * width][: len(titles)]
            if width - len(titles) == 1 and self.begins_with_index():
                titles, units = ["", *titles], ["", *units]
            return titles, units, list(heads[: len(heads) - back - 1])
        return [], [], list(heads)

    def title_cells(self, row: Row, width: int) -> list[str]:
        """Cells of a title row: without the sign of a comment; of words parted by blanks those that
        two blanks part, where they are as many as the rows have cells, or but for an index."""
        line, cells = row
        texts = ["" if c is None else " ".join(str(c).split()) for c in cells]
        if self.separator is None and len(cells) > 1:
            wide = re.split(r"\s{2,}|\t", self.lines[line - 1].replace('"', " ").strip())
            wide = [text for text in wide if text.strip("-/|:=,")]
            if len(wide) in (width, width - 1) and len(wide) > 1:
                return wide
        lead = _COMMENT.match(texts[0]) if texts else None
        is_alone = len(texts) == width + 1 and self.separator != ""
        if lead and (lead.end() < len(texts[0]) or is_alone):
            texts[0] = texts[0][lead.end() :].strip('" ')
            texts = texts if texts[0] else texts[1:]
        if self.separator is None:
            words, texts = texts, []
            for word in words:
                if texts and word[:1] in "([{" and word[1:] and texts[-1][-1] not in ")]}":
                    texts[-1] += f" {word}"
                elif word.strip("-/|:=,"):
                    texts.append(word)
        while len(texts) > width and not texts[-1]:
            texts.pop()
        return texts

    def table(self, name: str, budget: Budget) -> Table:
        """The table of the block, with what is left out of it."""
        left_out: list[str] = []
        body, is_sheet = self.rows, self.separator == ""
        widths = Counter(len(cells) for _, cells in body)
        width = max(widths) if is_sheet else widths.most_common(1)[0][0]
        widest = max((len(self.title_cells(row, width)) for row in self.heads[-3:]), default=2)
        empty = (None, "")
        while width > max(widest, 2) and all(
            len(c) < width or c[width - 1] in empty for _, c in body
        ):
            width -= 1  # separators at the ends of lines
        titles, units, above = self.titles(self.heads, width)
        # A file cut within its last line, rows without their last cells, and damaged ones.
        if not is_sheet and len(body) > 1 and len(body[-1][1]) < width <= len(body[-2][1]):
            left_out.append(f"line {body[-1][0]}, the last one, is cut short and left out")
            body = body[:-1]
        short = [row for row in body if len(row[1]) != width]
        is_sparse = self.separator and len(titles) >= width and len(short) > _SHORT * len(body)
        for line, cells in short:
            beyond = set(map(cell_kind, cells[width:])) - {""}
            if beyond - {"t"} or (len(cells) < width and not is_sheet and not is_sparse):
                raise InputError(f"line {line} is {_text(cells)[:60]!r}, expected {width} numbers")
            if beyond:
                beside = repr(_text(cells[width:]))
                left_out.append(f"line {line}: {beside} beside the table is left out")
        # Columns without title and cells are none; then titles and cells must go together.
        columns = list(zip_longest(*(cells[:width] for _, cells in body)))
        while columns and not any(titles[len(columns) - 1 :]) and set(columns[-1]) <= set(empty):
            columns.pop()
        width = len(columns)
        if width > MOST_COLUMNS:
            raise InputError(f"{width} columns, expected at most {MOST_COLUMNS}")
        if titles and len(titles) != width and not is_sheet:
            raise InputError(_mismatch(len(titles), width, self.separator, body[0]))
        budget.take(8 * width * len(body))
        titles, units = ([*texts, *[""] * width][:width] for texts in (titles, units))
        lines = np.array([line for line, _ in body], dtype=np.int64)
        made, ignored, notes = _columns(columns, titles, units, name, lines, budget)
        is_untitled = bool(made) and made[0].name == "column 1"
        if is_untitled and any(titles) and self.begins_with_index():
            made, ignored = made[1:], {"column 1": "row number", **ignored}
        texts = tuple(tuple(str(c) for c in cells if c not in empty) for _, cells in above)
        more = (texts, tuple(self.marks), tuple(left_out), tuple(notes))
        return Table(name, tuple(made), lines, len(self.rows), ignored, *more)


def _kind(cells: Sequence[Any]) -> str:
    """What most of a column's cells are: "n" numbers, "d" moments, "t" texts, "" nothing."""
    filled = [c for c in cells if c not in (None, "")]
    kinds = Counter(map(cell_kind, filled[:: 1 + len(filled) // _SAMPLE]))
    kinds = kinds if set(kinds) - {""} else Counter(map(cell_kind, filled))
    kinds.pop("", None)
    most = kinds.most_common(1)[0][0] if kinds else ""
    is_number = kinds["n"] and max(kinds["d"], kinds["t"]) <= 0.5 * kinds.total()
    return "n" if is_number else "t" if most == "n" else most


def _columns(
    texts: Sequence[Sequence[Any]],
    titles: Sequence[str],
    units: Sequence[str],
    group: str,
    lines: NDArray[np.int64],
    budget: Budget,
) -> tuple[list[Column], dict[str, str], list[str]]:
    """Columns of numbers and moments, what else there is and why, and remarks."""
    made: list[Column] = []
    ignored: dict[str, str] = {}
    notes: list[str] = []
    plain = [plain_numbers(cells) for cells in texts]
    kinds = [
        "n" if values is not None and not np.isnan(values).all() else _kind(cells)
        for cells, values in zip(texts, plain, strict=True)
    ]
    # Decimal signs: each column's own, else that of the others.
    signs = [
        set() if p is not None else decimal_signs(c) for c, p in zip(texts, plain, strict=True)
    ]
    if any("," in sign for found in signs for sign in found):
        signs = [found or decimal_signs(c) for found, c in zip(signs, texts, strict=True)]
    everywhere = {sign for found in signs for sign in found if len(sign) == 1}
    # Dates go with the next clock.
    lead = [
        next(filter(None, map(moment_of, c)), None) if kind == "d" else None
        for c, kind in zip(texts, kinds, strict=True)
    ]
    dates = [k for k, moment in enumerate(lead) if moment and moment.seconds is None]
    clocks = [k for k, moment in enumerate(lead) if moment and moment.days is None]
    labels = [title or f"column {k}" for k, title in enumerate(titles, 1)]

    def no_number(row: int, k: int) -> InputError:
        said = f"line {lines[row]}: {labels[k]} is {printable(str(texts[k][row]))[:40]!r}"
        return InputError(f"{said}, expected a number or a date of a form known here ({_FORMS})")

    for k, (cells, label, moment) in enumerate(zip(texts, labels, lead, strict=True)):
        budget.check()
        title, unit = (titles[k], units[k]) if units[k] else split_title(titles[k])
        if kinds[k] in ("", "t"):
            example = next((str(c) for c in cells if cell_kind(c) in ("t", "d")), "")
            ignored[label] = f"text such as {printable(example)[:40]!r}" if example else "empty"
        elif k in dates and (clock := next((c for c in clocks if c > k), None)) is not None:
            ignored[label] = f"its dates are in {labels[clock]}"
        elif moment:
            before = [texts[d] for d in dates if d < k and k in clocks]
            found = moments_of(cells, *before[-1:])
            if found is None:
                bad = [cell_kind(c) != "" and not moment_of(c) for c in cells]
                raise no_number(bad.index(True), k)
            seconds, start, fields, remark = found
            notes += [remark] if remark else []
            if k in dates and np.ptp(seconds) == 0.0:
                ignored[label] = "dates that go with no clock"
                continue
            unit = "" if fields == 2 else "s"
            made.append(Column(label, title, unit, seconds, group, start, fields))
        else:
            values = plain[k] if "," not in everywhere else None
            if values is None:
                decimal = _decimal(label, signs[k], everywhere, cells)
                values, unit, wrong = numbers_of(cells, decimal, unit)
                if wrong >= 0:
                    raise no_number(wrong, k)
            made.append(Column(label, title, unit, values, group))
    return made, ignored, notes


def _decimal(label: str, shown: set[str], everywhere: set[str], cells: Sequence[Any]) -> str:
    """The decimal sign of a column, by its own cells or by the others' where those say one."""
    own = {sign for sign in shown if len(sign) == 1}
    open_ = {sign[1] for sign in shown if len(sign) == 2}
    if len(own) == 2:
        first, second = (next(c for c in cells if decimal_signs([c]) == {s}) for s in ",.")
        raise InputError(f"{label}: {first!r} and {second!r} have different decimal signs")
    if own or not open_ or (open_ == {"."} and everywhere <= {"."}):
        return own.pop() if own else "."
    if open_ == {","} and len(everywhere) == 1:
        return next(iter(everywhere))
    # 980 beside 1,069: thousands.
    marked = {c for c in set(cells) if decimal_signs([c])}
    bare = [str(c).lstrip("-") for c in set(cells) - marked if cell_kind(c) == "n"]
    is_sure = not everywhere & open_ and len(open_) == 1 and all(len(b) < 4 for b in bare)
    if is_sure and any(b.strip("0") for b in bare):
        return "." if open_ == {","} else ","
    raise InputError(
        f"{label}: {min(marked)!r} may have a decimal or a thousand sign, and no other cell tells; "
        "write it without thousand signs, or with other than three decimals"
    )


def _mismatch(count: int, width: int, separator: str | None, first: Row) -> str:
    said = f"{count} titles, {width} cells a row (line {first[0]} is {_text(first[1])[:40]!r})"
    if separator == "," and width > count:
        return f"{said}: decimal commas in a comma-separated table? quote them, or part by ;"
    if separator and width < count:
        return f"{said}: a separator within a title? quote it, or give every title its cells"
    return f"{said}: give every column one title, without blanks or parted by tabs"
