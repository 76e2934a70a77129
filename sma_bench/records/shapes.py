"""Splits lines into rows, and turns those of other shapes into those of a plain table, which has a
column for each quantity: stamps of a terminal, names in every line, one value a row, channels as
rows."""

import csv
import re
from collections import Counter
from collections.abc import Sequence
from itertools import zip_longest
from typing import Any

from sma_bench.records.cells import PATTERNS, WORDS, cell_kind, moment_of, title_meanings, words_of

Row = tuple[int, list[Any]]  # line number from 1, cells
_LONGEST_CELL = 4  # lines that a quoted cell may run over
_LYING, _TOP = 12, 60  # cells from which a row may be a channel; rows with titles of a long table
_MOST_NAMES = 60  # of one table, or in lines of a text


def split(lines: Sequence[str], separator: str | None) -> list[Row]:
    """Stripped cells of lines, quoted as in RFC 4180; a line quoted as a whole is unwrapped."""
    if separator is None:  # date, clock time and AM or PM are one cell
        joined = (re.sub(r"(?<=\d) (?=\d+:\d\d|[AaPp]\.?[Mm]\b)", "\1", s) for s in lines)
        parted = (line.replace('"', " ").split() for line in joined)
        return [(n, [c.replace("\1", " ") for c in row]) for n, row in enumerate(parted, 1)]
    if not any('"' in line for line in lines):
        return [(n, [c.strip() for c in s.split(separator)]) for n, s in enumerate(lines, 1)]
    rows, before = list[Row](), 0
    # A comment sign in front of a quote would make it part of the text.
    plain = (re.sub(r'^\s*[#%]+\s*(?=")', "", f"{line.rstrip()} ") for line in lines)
    reader = csv.reader(plain, delimiter=separator, skipinitialspace=True)
    try:
        for cells in reader:
            if reader.line_num > before + _LONGEST_CELL * max(len(cells), 1):
                raise csv.Error("a quote without end")
            if len(cells) == 1 and separator in cells[0]:
                cells = next(csv.reader(cells, delimiter=separator, skipinitialspace=True), [])
            rows.append((before + 1, [cell.strip().strip('"').strip() for cell in cells]))
            before = reader.line_num
    except csv.Error:
        return split([line.replace('"', "") for line in lines], separator)
    return rows


def stamped(lines: list[str]) -> tuple[list[str], list[str]]:
    """The stamps of a terminal in front of lines, "" where none is, and the lines without them;
    no stamps if most lines have none: `[10:04:05.123] 2.0,5.3`, `10:04:05.123 -> 2.0,5.3`."""
    is_any = any(map(PATTERNS.stamp.match, lines[:_TOP]))  # quickly: mostly none is
    parted = [PATTERNS.stamp.match(line) if is_any else None for line in lines]
    stamps = [found[1] if found and moment_of(found[1]) else "" for found in parted]
    if 2 * sum(map(bool, stamps)) <= sum(map(bool, map(str.strip, lines))):
        return [], lines
    return stamps, [found[2] if found and stamp else line
                    for stamp, found, line in zip(stamps, parted, lines, strict=True)]


def named_values(lines: Sequence[str]) -> list[Row]:
    """Rows of lines that name each value (`t=0 ms, U=2.0 V`, `T:25.1 F:3.2`, JSON), titles first;
    [] if most lines are not of this kind. A date in front of the names is a column, too."""
    found = list[dict[str, str]]()
    for line in lines:
        lead, named = PATTERNS.lead.match(line), dict[str, str]()
        if lead and moment_of(lead[1]):
            named["Time"], line = lead[1], line[lead.end() :]
        for k, m in enumerate(PATTERNS.pair.finditer(line)):
            name = f"{m['name']} {k}" if m["name"] in named else m["name"]
            named[name] = m["text"] or m["word"] or f"{m['number'] or ''}{m['unit'] or ''}"
        has_others = PATTERNS.lone.search(PATTERNS.pair.sub("", line))  # a: 1, 2, 3
        found.append({} if has_others or named.keys() <= {"Time"} else named)
    names = list(dict.fromkeys(name for named in found for name in named))
    most = sum(map(bool, map(str.strip, lines))) < 2 * sum(map(bool, found))
    if not most or len(names) > _MOST_NAMES:
        return []
    rows: list[Row] = [(n, [named.get(name, "") for name in names] if named else [line.strip()])
                       for n, (line, named) in enumerate(zip(lines, found, strict=True), 1)]
    first = next(k for k, named in enumerate(found) if named)
    return [*rows[:first], (first + 1, [*names]), *rows[first:]]


def reshaped(rows: Sequence[Row]) -> Sequence[Row]:
    """Rows of a table with one value a row, or with channels as rows, as those of a plain one."""
    lying = [cells for _, cells in rows if len(cells) > _LYING and cell_kind(cells[0]) == "t"
             and {*map(cell_kind, cells[2:_LYING])} <= {"n", "d"}]
    meant = [title_meanings(str(cells[0])) for cells in lying]
    if len({*meant}) > 1 and all(meant) and 4 * len(lying) < len(lying[0]):
        others = (row for row in rows if row[1] not in lying)
        return [*others, *enumerate(map(list, zip_longest(*lying, fillvalue="")), 1)]
    for k, (_, titles) in enumerate(rows[:_TOP]):
        are_titles = {*map(cell_kind, titles)} <= {"t", ""}
        words = [{*words_of(str(t))} for t in titles if are_titles]
        for j in (j for j, own in enumerate(words) if own and own <= {*WORDS["long"]["names"]}):
            count = Counter(c[j] for _, c in rows[k + 1 :] if len(c) == len(titles) > 2)
            are_names = {*map(cell_kind, count)} == {"t"} and min(count.values()) > 2
            if are_names and 1 < len(count) <= _MOST_NAMES:
                return [*rows[:k], *_widened(rows[k:], j, list(count))]
    return rows


def _widened(rows: Sequence[Row], j: int, names: list[str]) -> list[Row]:
    """Rows, titles first, with a column for each of the names in column j and column of values."""
    (line, cells), *body = rows
    titles = list(map(str, cells))
    units = [k for k, t in enumerate(titles) if t.lower() in WORDS["attributes"]["unit"]]
    spread = [k for k, t in enumerate(titles) if not {*title_meanings(t)} & {"time", "counter"}
              and "n" in {cell_kind(c[k]) for _, c in body[:_LYING] if len(c) == len(titles)}]
    kept = [k for k in range(len(titles)) if k not in (*spread, *units, j)]
    made = [titles[k] for k in kept]
    for k in spread:
        is_value = {*words_of(titles[k])} <= {*WORDS["long"]["values"]}
        made += names if is_value else [f"{name} {titles[k]}" for name in names]
    found: list[Row] = [(line, made)]
    for n, cells in body:
        if len(cells) == len(titles):
            unit = "".join(str(cells[k]).replace(" ", "") for k in units)
            held = [f"{cells[k]} {unit}" if units and cells[k] != "" else cells[k] for k in spread]
            cells = [*(cells[k] for k in kept),
                     *(c if cells[j] == name else "" for c in held for name in names)]
        found.append((n, cells))
    return found
