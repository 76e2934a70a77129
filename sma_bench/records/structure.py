"""Rows of cells to tables: notes, titles, units, blocks of numbers, and what is left out."""

import re
from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np

from sma_bench.border import Budget, printable
from sma_bench.errors import InputError
from sma_bench.records.cells import LONGEST_NAME, MOST_COLUMNS, Column, Row, Table
from sma_bench.records.units import (
    MISSING,
    cell_kind,
    decimal_signs,
    moment_of,
    moments_of,
    numbers_of,
    parse_unit,
    split_title,
)

_FEWEST = 3  # rows of a table beside a larger one
_SHORT = 0.05  # of the rows: as many without their last cells are sparse, not damaged
_MARKS = ("-", "/", "|", ":", "=", ",", "")
_COMMENT = re.compile(r"(?:#+|%+|//+|!+)\s*")


class _Run:
    """Rows of numbers one after the other, and the lines before them."""

    def __init__(self, heads: list[Row]) -> None:
        self.heads = heads
        self.rows: list[Row] = []
        self.marks: list[tuple[int, str]] = []


def is_missing(cell: Any) -> bool:
    return cell is None or (isinstance(cell, str) and cell.lower() in MISSING)


def tables_of(
    rows: Sequence[Row], separator: str | None, name: str, budget: Budget
) -> tuple[list[Table], list[str]]:
    """Tables of a sheet or text, and the lines that are in none of them.

    Args:
        rows: of cells; separator: of a text, None for blanks, "" of a workbook's sheet.
        name: of the sheet.

    Raises:
        InputError: titles and cells that do not go together, a cell that is no number (its line is
            named), or numbers whose marks may be decimal or thousand signs.
    """
    # Runs of rows of numbers; what stands between two of them is theirs if the titles are the same.
    runs: list[_Run] = []
    between: list[Row] = []
    for row in rows:
        budget.check()
        cells = row[1]
        kinds = [cell_kind(cell) for cell in cells]
        real = sum(k in "nd" and k != "" and not is_missing(c)
                   for k, c in zip(kinds, cells, strict=True))  # fmt: skip
        if not (len(cells) > 1 and real > kinds.count("t") and real):
            if any(k for k in kinds):
                between.append(row)
            continue
        if not runs or not _continues(runs[-1], between, row, separator):
            runs.append(_Run(between))
        else:
            run = runs[-1]
            run.marks += [(len(run.rows), _text(cells)) for _, cells in between]
        between = []
        runs[-1].rows.append(row)
    largest = max((len(run.rows) for run in runs), default=0)
    tables: list[Table] = []
    lost: list[str] = []
    heads: list[Row] = []
    for run in runs:
        heads = [*heads, *run.heads]
        if len(run.rows) < min(_FEWEST, largest):
            heads += run.rows  # a line of numbers among notes
            continue
        tables.append(_table(run, heads, separator, name, budget))
        heads = []
    lost += [f"line {line} ({_text(cells)[:40]})" for line, cells in [*heads, *between]
             if tables]  # fmt: skip
    return tables, lost


def _text(cells: Sequence[Any]) -> str:
    return printable(" ".join(str(c) for c in cells if c not in (None, "")))[:LONGEST_NAME]


def _continues(run: _Run, between: list[Row], row: Row, separator: str | None) -> bool:
    """Whether a row belongs to the rows before, whatever stands in between: a title row that comes
    again, a line of text; not other titles, and no other width after a gap."""
    if not between and row[0] == run.rows[-1][0] + 1:
        return True
    width = len(run.rows[0][1])
    if len(row[1]) != width:
        return False
    again = _headings(between, run.rows[:50], width, separator)[0]
    return not any(again) or again == _headings(run.heads, run.rows[:50], width, separator)[0]


def _headings(
    heads: Sequence[Row], body: Sequence[Row], width: int, separator: str | None
) -> tuple[list[str], list[str], list[Row], int]:
    """Titles and units of the columns, the lines above them, and how many titles there are; those
    of rows that begin with an index or a name are moved behind it."""
    for back in range(1, min(len(heads), 3) + 1):
        _, cells = heads[-back]
        titles = _title_cells(cells, width, separator, heads[-back])
        filled = [t for t in titles if t]
        if len(filled) < max(2, width / 2):
            if back > 1 or not _is_units(titles):
                break
            continue
        if _is_units(titles):
            continue
        units = [""] * len(titles)
        if back > 1:
            below = _title_cells(heads[-back + 1][1], width, separator, heads[-back + 1])
            if _is_units(below):
                units = [u.strip("()[]{} ") for u in below]
                shift = len(titles) - len(units)
                units = [""] * max(shift, 0) + units[: len(titles)]
                units += [""] * (len(titles) - len(units))
            else:  # titles over two lines
                titles = [f"{a} {b}".strip() for a, b in zip(
                    titles, [*below, *[""] * len(titles)], strict=False)]  # fmt: skip
        elif len(heads) > 2 and _is_units(heads[-2][1]):  # titles, units, and the titles again
            below = _title_cells(heads[-2][1], width, separator, heads[-2])
            if _title_cells(heads[-3][1], width, separator, heads[-3]) == titles:
                units = [u.strip("()[]{} ") for u in below[: len(titles)]]
                units += [""] * (len(titles) - len(units))
        count = len(titles)
        if 0 < width - count <= 1 and _begins_with_index(body):
            titles, units = ["", *titles], ["", *units]
        return titles, units, list(heads[:-back]), count
    return [], [], list(heads), 0


def _title_cells(
    cells: Sequence[Any], width: int, separator: str | None, row: Row
) -> list[str]:
    """Cells of a title row: without the sign of a comment; of words parted by blanks those that
    two blanks part, where they are as many as the rows have cells, or but for an index."""
    if separator is None and len(cells) > 1:
        whole = str(getattr(row[1], "line", "")).strip()
        wide = [t for t in re.split(r"\s{2,}|\t", whole) if t not in _MARKS]
        if len(wide) in (width, width - 1) and len(wide) > 1:
            return wide
    texts = ["" if c is None else " ".join(str(c).split()) for c in cells]
    lead = _COMMENT.match(texts[0]) if texts else None
    if lead and (lead.end() < len(texts[0]) or (len(texts) == width + 1 and separator != "")):
        texts[0] = texts[0][lead.end() :].strip('" ')
        if not texts[0]:
            texts = texts[1:]
    if separator is None:
        merged: list[str] = []
        for text in texts:
            if merged and text[:1] in "([{" and text[1:] and merged[-1][-1] not in ")]}":
                merged[-1] += f" {text}"
            elif text not in _MARKS:
                merged.append(text)
        texts = merged
    else:
        while texts and not texts[-1] and len(texts) > width:
            texts.pop()
    return texts


def _is_units(cells: Sequence[Any]) -> bool:
    bare = [str(c).strip("()[]{} ") for c in cells if c is not None and str(c).strip("()[]{} ")]
    return bool(bare) and all(parse_unit(b) or b == "-" for b in bare)


def _begins_with_index(body: Sequence[Row]) -> bool:
    """Whether rows begin with a number that counts them, or with a name."""
    first = [row[1][0] for row in body if row[1]]
    if all(cell_kind(cell) == "t" for cell in first):
        return True
    try:
        numbers = [float(cell) for cell in first]
    except (TypeError, ValueError):
        return False
    return len(numbers) > 1 and bool(np.all(np.diff(numbers) == 1.0))


def _table(
    run: _Run, heads: list[Row], separator: str | None, name: str, budget: Budget
) -> Table:
    left_out: list[str] = []
    body, rows = list(run.rows), len(run.rows)
    width = Counter(len(cells) for _, cells in body).most_common(1)[0][0]
    if separator == "":
        width = max(len(cells) for _, cells in body)
    widest = max((len(_title_cells(cells, width, separator, (line, cells)))
                  for line, cells in heads[-3:]), default=0)  # fmt: skip
    while width > max(widest, 2) and all(
        len(c) < width or c[width - 1] in (None, "") for _, c in body
    ):
        width -= 1  # separators at the ends of lines
    body = [(n, c[:width] if all(x in (None, "") for x in c[width:]) else c) for n, c in body]
    titles, units, above, count = _headings(heads, body, width, separator)
    if separator is None and count == width - 1:
        body, width = _joined_moments(body, width)
        titles, units, above, count = _headings(heads, body, width, separator)
    # A file cut within its last line, rows without their last cells, and damaged ones.
    if separator != "" and len(body) > 1 and len(body[-1][1]) < width and len(body[-2][1]) >= width:
        left_out.append(f"line {body[-1][0]}, the last one, is cut short and left out")
        body.pop()
    sparse = separator and count >= width
    short = [(line, cells) for line, cells in body if len(cells) != width]
    for line, cells in short:
        if separator == "" or (sparse and len(cells) < width and len(short) > _SHORT * len(body)):
            continue
        if len(cells) > width and {cell_kind(c) for c in cells[width:]} <= {"t", ""}:
            left_out.append(f"line {line}: {_text(cells[width:])!r} beside the table is left out")
        elif any(c not in (None, "") for c in cells[width:]) or len(cells) < width:
            raise InputError(
                f"line {line} is {_text(cells)[:60]!r}, expected {width} numbers"
            )
    # Columns without title and cells are none; then titles and cells must go together.
    texts = [[row[1][k] if k < len(row[1]) else None for row in body] for k in range(width)]
    while texts and all(c in (None, "") for c in texts[-1]) and not any(titles[len(texts) - 1 :]):
        texts.pop()
    width = len(texts)
    if width > MOST_COLUMNS:
        raise InputError(f"{width} columns, expected at most {MOST_COLUMNS}")
    if titles and len(titles) != width and separator != "":
        raise InputError(_mismatch(count, width, separator, body, above))
    titles = (titles + [""] * width)[:width] if titles or separator == "" else [""] * width
    units = (units + [""] * width)[:width]
    budget.take(8 * width * len(body))

    # Decimal signs: each column's own, else that of the others.
    named = [t or f"column {k + 1}" for k, t in enumerate(titles)]
    odd = [not all(_is_float(c) for c in column) for column in texts]
    shown = [decimal_signs(column) if strange else set() for column, strange in zip(
        texts, odd, strict=True)]  # fmt: skip
    everywhere = {sign for signs in shown for sign in signs if len(sign) == 1}
    if "," in everywhere:
        shown = [signs or decimal_signs(column) for column, signs in zip(texts, shown, strict=True)]
    elif any("?," in signs for signs in shown):
        everywhere |= {s for column in texts for s in decimal_signs(column) if len(s) == 1}
    columns: list[Column] = []
    ignored: dict[str, str] = {}
    notes: list[str] = []
    dates: dict[str, list[Any]] = {}
    for k, cells in enumerate(texts):
        budget.check()
        title, unit = (titles[k], units[k]) if units[k] else split_title(titles[k])
        label = named[k]
        if all(is_missing(c) for c in cells):
            ignored[label] = "empty"
            continue
        kinds = Counter(cell_kind(c) for c in cells if not is_missing(c))
        if kinds["d"] > 0.5 * sum(kinds.values()):
            lead = [moment_of(c) for c in cells[:50] if not is_missing(c)]
            if all(m is not None and m.seconds is None for m in lead) and k + 1 < width:
                dates[label] = cells
                ignored[label] = "dates that go with no clock"
                continue
            beside = None
            if dates and all(m is not None and m.days is None for m in lead):
                beside = list(dates.values())[-1]
            found = moments_of(cells, beside)
            if found is None:
                wrong = next(i for i, c in enumerate(cells)
                             if not is_missing(c) and moment_of(c) is None)  # fmt: skip
                raise InputError(_no_number(body[wrong][0], label, cells[wrong]))
            seconds, start, fields, remark = found
            if beside is not None:
                ignored[list(dates)[-1]] = f"its dates are in {label}"
            if remark:
                notes.append(remark)
            columns.append(Column(label, title, "s" if fields != 2 else "", seconds, name, start,
                                  fields))  # fmt: skip
            continue
        if not kinds["n"] or (kinds["t"] > 0.5 * sum(kinds.values())):
            example = next(c for c in cells if cell_kind(c) in "td" and not is_missing(c))
            ignored[label] = f"text such as {printable(str(example))[:40]!r}"
            continue
        decimal = _decimal(label, shown[k], everywhere, cells)
        values, own, bad = numbers_of(cells, decimal, unit)
        if bad >= 0:
            raise InputError(_no_number(body[bad][0], label, cells[bad]))
        if k == 0 and not titles[0] and count and _begins_with_index(body):
            ignored[label] = "row number"
            continue
        columns.append(Column(label, title, unit or own, values, name))
    for label in [d for d, reason in ignored.items() if reason.startswith("dates that")]:
        found = moments_of(dates[label])
        if found is not None and float(np.ptp(found[0])) > 0.0:
            del ignored[label]
            columns.append(Column(label, label, "s", found[0], name, found[1], 3))
    return Table(
        name, tuple(columns), tuple(tuple(str(c) for c in cells if c not in (None, ""))
                                    for _, cells in above),
        tuple(run.marks), np.array([line for line, _ in body], dtype=np.int64), rows,
        tuple(left_out), ignored, tuple(notes),
    )  # fmt: skip


def _joined_moments(body: list[Row], width: int) -> tuple[list[Row], int]:
    """Rows whose date and clock, which a blank parts, are one cell."""
    for k in range(width - 1):
        pairs = [(moment_of(c[k]), moment_of(c[k + 1])) for _, c in body[:50] if len(c) == width]
        if pairs and all(a and a.seconds is None and b and b.days is None for a, b in pairs):
            return [(n, [*c[:k], f"{c[k]} {c[k + 1]}", *c[k + 2 :]]) for n, c in body], width - 1
    return body, width


def _is_float(cell: Any) -> bool:
    if isinstance(cell, str):
        try:
            float(cell)
        except ValueError:
            return False
    return True


def _no_number(line: int, label: str, cell: Any) -> str:
    shown = printable(str(cell))[:40]
    return (
        f"line {line}: {label} is {shown!r}, expected a number or a date of a form known here "
        "(12.5, 1,069.3, 2026-03-10 10:00:00, 10.03.2026 10:00:00,5, 10:00:00 AM)"
    )


def _decimal(label: str, shown: set[str], everywhere: set[str], cells: Sequence[Any]) -> str:
    """The decimal sign of a column, by its own cells or by the others' where those say one."""
    own = {sign for sign in shown if len(sign) == 1}
    open_ = {sign[1] for sign in shown if len(sign) == 2}
    if len(own) == 2:
        first, second = (next(str(c) for c in cells if decimal_signs([c]) == {s}) for s in ",.")
        raise InputError(f"{label}: {first!r} and {second!r} have different decimal signs")
    if own:
        return own.pop()
    if not open_ or open_ == {"."} and everywhere <= {"."}:
        return "."
    if open_ == {","} and len(everywhere) == 1:
        return next(iter(everywhere))
    # 980 beside 1,069: thousands.
    bare = [str(c) for c in cells if not is_missing(c) and not decimal_signs([c])]
    if len(open_) == 1 and not everywhere & open_ and any(b.strip("-0") for b in bare) and all(
        len(b.lstrip("-")) < 4 for b in bare
    ):
        return "." if open_ == {","} else ","
    example = next(str(c) for c in cells if decimal_signs([c]))
    raise InputError(
        f"{label}: {example!r} may have a decimal or a thousand sign, and no other cell tells; "
        "write it without thousand signs, or with other than three decimals"
    )


def _mismatch(
    count: int, width: int, separator: str | None, body: Sequence[Row], above: Sequence[Row]
) -> str:
    cells = body[0][1]
    said = f"{count} titles, {width} cells a row (line {body[0][0]} is {_text(cells)[:40]!r})"
    if separator == "," and width > count:
        return f"{said}: decimal commas in a comma-separated table? quote them, or part by ;"
    if separator and width < count:
        return f"{said}: a separator within a title? quote it, or give every title its cells"
    return f"{said}: give every column one title, without blanks or parted by tabs"
