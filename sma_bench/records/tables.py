"""Reads tables of loggers and instruments (text, Excel, MATLAB, HDF5, Parquet) as named columns, in
the units of the file. Packed formats are read in a process of their own (`unfold.py`)."""

import hashlib
import math
import os
import re
import signal
import subprocess
import sys
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from functools import lru_cache
from itertools import accumulate, zip_longest
from pathlib import Path
from typing import Any

import numpy as np

from sma_bench.arrays import Array, IntArray
from sma_bench.border import MEGABYTE, decoded_lines, printable, read_bytes, reading_budget
from sma_bench.errors import InputError, errors_in
from sma_bench.records import cells as read
from sma_bench.records.cells import WORDS, cell_kind, message, parse_unit, split_title
from sma_bench.records.shapes import Row, named_values, reshaped, split, stamped

MOST_COLUMNS, LONGEST_NAME = 1000, 120
_FEWEST = 3  # rows; fewer next to a larger table are notes
_SHORT = 0.05  # of the rows; if more lack their last cells, these are empty, not lost
_CELL_SAMPLE, _ROW_SAMPLE = 1000, 300  # to find the kind of a column, to find the separator
_END_OF_HEADER = "***End_of_Header***"
_RULE = "-/|:=,"  # characters between titles
LARGEST_FILE = 200 * MEGABYTE
_LIBRARIES = 512 * MEGABYTE  # address space for the libraries of a reader and their threads
_ONE_THREAD = {"MALLOC_ARENA_MAX": "1", "OPENBLAS_NUM_THREADS": "1",
               "ARROW_DEFAULT_MEMORY_POOL": "system"}
_TESTS = "stress", "force", "mass", "length"  # a line that states one of these begins a new test
_GROUPS = {*WORDS["room"], *WORDS["wire"], *WORDS["supplies"]}  # that may stand above titles
_MEANS = {text: key for key, texts in WORDS["attributes"].items() for text in texts}
# What a file begins with, and its reader in unfold.py.
_FORMATS = {b"PK\x03\x04": "Excel", b"\x89HDF\r\n\x1a\n": "HDF5", b"MATLAB 7.3": "HDF5",
            b"MATLAB 5": "MATLAB", b"PAR1": "Parquet", b"": "text"}


@dataclass(frozen=True, eq=False)
class Column:
    """One column of a file."""

    name: str  # unique in the file: its title, or its path (`log/u`)
    title: str  # without unit
    unit: str  # as written, "" if none
    values: Array  # (n,), NaN where a cell is empty
    group: str = ""  # its sheet or folder
    start: float | None = None  # epoch (s) of value 0, if the column has dates
    fields: int = 0  # 0 for numbers, else `Moment.fields` of its clock times
    table: int = 0  # index of its table in the file

    @property
    def span(self) -> str:
        return f"{np.nanmin(self.values):.6g} to {np.nanmax(self.values):.6g}"


@dataclass(frozen=True)
class Table:
    """Rows of numbers under one set of titles."""

    name: str  # of its sheet
    columns: tuple[Column, ...]  # of numbers, dates or times
    lines: IntArray  # (n,) line of each row in the file, from 1
    rows: int  # in the file, those left out included
    ignored: dict[str, str] = field(default_factory=dict)  # other columns, with the reason
    above: tuple[tuple[str, ...], ...] = ()  # lines above the titles, cells of each
    marks: tuple[tuple[int, str], ...] = ()  # (row, text) of lines between the rows
    left_out: tuple[str, ...] = ()  # rows and cells left out, with the reason
    notes: tuple[str, ...] = ()  # assumptions made while reading


@dataclass(frozen=True)
class Account:
    """What became of a file's rows and columns: used (as what), ignored (why), asked about."""

    rows: int
    rows_used: int
    used: dict[str, str]
    ignored: dict[str, str]
    asked: tuple[str, ...] = ()
    left_out: tuple[str, ...] = ()
    sheet: str = ""

    def __str__(self) -> str:
        used, ignored = (", ".join(f"{name} ({what})" for name, what in columns.items()) or "none"
                         for columns in (self.used, self.ignored))
        where = f"sheet {self.sheet}: " if self.sheet else ""
        more = f" and {len(self.left_out) - 8} more" if len(self.left_out) > 8 else ""
        rest = f"; outside the table: {', '.join(self.left_out[:8])}{more}" * bool(self.left_out)
        rows = f"{where}{self.rows} rows read, {self.rows_used} used; columns used: {used}; "
        asked = f"asked about: {', '.join(self.asked) or 'none'}"
        return printable(f"{rows}ignored: {ignored}; {asked}{rest}")


@dataclass(frozen=True)
class TableFile:
    """A file's tables, with unique names of columns, and the lines outside them."""

    path: Path
    format: str
    sha256: str  # of several files joined, with blanks between
    tables: tuple[Table, ...]
    outside: tuple[str, ...] = ()

    @property
    def columns(self) -> tuple[Column, ...]:
        return tuple(column for table in self.tables for column in table.columns)

    @property
    def notes(self) -> tuple[str, ...]:
        """What was assumed or left out while reading."""
        return tuple(note for t in self.tables for note in (*t.notes, *t.left_out))

    @property
    def is_joined(self) -> bool:
        """True if it was several files."""
        return " " in self.sha256

    def with_tables(self, tables: Sequence[Table], outside: Sequence[str]) -> "TableFile":
        """The same file with other tables; their columns get unique names and the table's index."""
        seen, named = Counter[str](), []
        for k, table in enumerate(tables):
            columns = []
            for column in table.columns:
                name, title, unit = map(_label, (column.name, column.title, column.unit))
                seen[name] += 1
                name += f" ({seen[name]})" if seen[name] > 1 else ""
                columns.append(replace(column, table=k, name=name, title=title, unit=unit))
            ignored = {_label(name): reason for name, reason in table.ignored.items()}
            named.append(replace(table, columns=tuple(columns), ignored=ignored))
        return replace(self, tables=tuple(named), outside=tuple(outside))

    def account(self, tables: Sequence[Table], rows_used: int, used: dict[str, str],
                reasons: Mapping[str, str], asked: Sequence[str] = ()) -> Account:
        """Account of some tables; `reasons`: why columns are not used, "" for all others."""
        held = [column.name for table in tables for column in table.columns]
        ignored = {name: reasons.get(name, reasons[""]) for name in held if name not in used}
        left_out: list[str] = []
        for table in tables:
            ignored |= table.ignored
            left_out += table.left_out
            left_out += [f"{len(table.marks)} lines of text between the rows, first {text[:40]!r}"
                         for _, text in table.marks[:1]]
        left_out += self.outside
        sheet, rows = tables[0].name * (len(tables) < len(self.tables)), sum(t.rows for t in tables)
        return Account(rows, rows_used, used, ignored, tuple(asked), tuple(left_out), sheet)


def read_table_file(path: str | Path) -> TableFile:
    """Read a table, in the format of its content. InputError: it cannot be read."""
    path, content = Path(path), read_bytes(path, LARGEST_FILE)
    with errors_in(str(path)):
        file = _read(content)
    if not file.columns:
        raise InputError(f"{path}: neither a bag nor a table: no columns of numbers in this file")
    return replace(file, path=path)


@lru_cache(maxsize=2)  # several readers try the same file
def _read(content: bytes) -> TableFile:
    if content.startswith(b"\xd0\xcf\x11\xe0"):
        raise InputError("an old Excel file (.xls), expected .xlsx: save it as that")
    reader = next(name for begin, name in _FORMATS.items() if content.startswith(begin))
    tables, outside = list[Table](), list[str]()
    if reader == "text":
        # The separator that gives the most rows of numbers; None stands for blanks.
        lines = decoded_lines(content, WORDS["encodings"], read.known_letters)
        stamps, lines = stamped(lines)
        filled = [line for line in lines if line.strip()]  # the last ones, too: below long notes
        sample = filled[:_ROW_SAMPLE] + filled[_ROW_SAMPLE:][-_ROW_SAMPLE:]
        parted = {s: [cells for _, cells in split(sample, s)] for s in ("\t", *";|,", None)}
        counts = {s: sum(map(read.is_number_row, rows)) for s, rows in parted.items()}
        rows = [] if 2 * max(counts.values()) > len(sample) else named_values(lines)
        if not any(counts.values()):  # Time;Sensor;Value;Unit
            counts = {s: sum(len(cells) > 2 for cells in rows) for s, rows in parted.items()}
        separator = next(s for s, n in counts.items() if n >= 0.98 * max(counts.values()))
        separator, rows = ("\t", rows) if rows else (separator, split(lines, separator))
        if stamps:
            rows = [(n, [stamps[n - 1], *cells]) for n, cells in rows]
        tables, outside = tables_of(rows, separator, "", lines)
    elif reader == "Excel":
        for (title,), rows, _ in _unfolded(content, reader):
            name = printable(title)
            with errors_in(f"sheet {name}"):
                found, lost = tables_of(list(enumerate(rows, 1)), "", name)
            tables += found
            outside += [f"sheet {name}, {line}" for line in lost]
            outside += [f"sheet {name} (no table of numbers)"] if rows and not found else []
    else:
        tables, outside = _read_leaves(_unfolded(content, reader), "/" if reader == "HDF5" else ".")
    digest = hashlib.sha256(content).hexdigest()
    return TableFile(Path(), reader, digest, ()).with_tables(tables, outside)


def _unfolded(content: bytes, reader: str) -> list[Any]:
    import msgspec  # not installed on a robot, whose nodes import this package, too
    budget = reading_budget(len(content))
    seconds, script = math.ceil(budget.seconds), Path(__file__).with_name("unfold.py")
    size, there = str(_LIBRARIES + budget.size), os.environ | _ONE_THREAD
    words = [sys.executable, "-P", str(script), reader, size, str(seconds)]
    child = subprocess.run(words, input=content, capture_output=True, check=False, env=there)
    if child.returncode == -signal.SIGXCPU:
        raise InputError(f"takes more than {seconds} s to read")
    if child.returncode:
        last = printable(child.stderr.decode(errors="replace").strip().rpartition("\n")[2])[:200]
        why = f"{child.returncode}: {last}".removesuffix(": ")
        raise InputError(f"not a readable {reader} file: it crashes its reader ({why})")
    error, found = msgspec.msgpack.decode(child.stdout, type=tuple[str, list[Any]])
    if error:
        raise InputError(printable(error))
    return found


def _read_leaves(leaves: list[Any], mark: str) -> tuple[list[Table], list[str]]:
    """Tables of the arrays of numbers, one for each length; and names of what was not read."""
    # A text called unit, label or name describes the arrays in its folder.
    beside: dict[tuple[str, ...], dict[str, Any]] = defaultdict(dict)
    leaves = [(tuple(path), value, about) for path, value, about in leaves]
    for path, value, _ in leaves:
        key = _MEANS.get(path[-1].lower())
        if key in ("unit", "title") and isinstance(value, str):
            beside[path[:-1]][key] = value
    columns: dict[int, list[Column]] = defaultdict(list)
    notes: dict[int, list[str]] = defaultdict(list)
    outside: list[str] = []
    for path, value, about in leaves:
        folder, last, label = path[:-1], path[-1], mark.join(path)
        group = mark.join(folder)
        if value is None:
            outside.append(printable(f"{label} ({about['unread']})"))
        if not isinstance(value, list) or not isinstance(value[-1], bytes):
            continue
        array = np.frombuffer(value[2], value[0]).reshape(value[1])
        if value[0] == "<i8":  # ns since 1970
            seconds, start = (array[:, 0] - array[0, 0]) / 1e9, array[0, 0] / 1e9
            columns[len(array)].append(Column(label, last, "s", seconds, group, float(start), 3))
            continue
        known = {_MEANS[key]: v for key, v in about.items() if key in _MEANS}
        scale = {key: v for key, v in known.items() if isinstance(v, float)}
        applied = [f"{key} {scale[key]:g}" for key in ("scale", "offset") if key in scale]
        if applied:
            notes[len(array)].append(f"{label}: {' and '.join(applied)} of its attributes applied")
        array = np.where(abs(array) < read.OVERFLOW, array, np.nan)
        array[array == scale.get("fill")] = np.nan
        array = array * scale.get("scale", 1.0) + scale.get("offset", 0.0)
        is_time, many = last.lower() in ("time", "t", "tout"), array.shape[1]
        named = {} if is_time else dict(beside.get(folder, {}))
        named |= {key: known[key] for key in ("unit", "title") if isinstance(known.get(key), str)}
        if is_time and any(p[-1] == "values" and p[: len(folder)] == folder for p, _, _ in leaves):
            named.setdefault("unit", "s")  # in a Simulink "structure with time"
        title, unit = split_title(named.get("title") or last)
        ends = [f" {k + 1}" for k in range(many)] if many > 1 else [""]
        found = [(label + end, title + end, named.get("unit", unit)) for end in ends]
        for where, texts, _ in leaves if many > 1 else ():
            is_list = isinstance(texts, list) and isinstance(texts[-1], str)
            if not is_list or where[:-1] != folder or len(texts) != many:
                continue
            if where[-1].lower() in WORDS["lists"] or not all(map(parse_unit, texts)):
                titles = [(f"{label}{mark}{text}", *split_title(text)) for text in texts]
                found = [(*t[:2], t[2] or old[2]) for t, old in zip(titles, found, strict=True)]
            else:
                found = [(*old[:2], text) for old, text in zip(found, texts, strict=True)]
        parted = zip(found, array.T.copy(), strict=True)
        columns[len(array)] += [Column(*texts, values, group) for texts, values in parted]
    if sum(map(len, columns.values())) > MOST_COLUMNS:
        raise InputError(f"more than {MOST_COLUMNS} columns, expected at most that")
    lines = ((n, tuple(c), np.arange(1, n + 1)) for n, c in columns.items())
    return [Table("", c, k, n, notes=tuple(notes[n])) for n, c, k in lines], outside


def tables_of(rows: Sequence[Row], separator: str | None, name: str,
              lines: Sequence[str] = ()) -> tuple[list[Table], list[str]]:
    """Tables in a text or sheet (`separator`: None for blanks, "" for a sheet), and the lines
    outside them. InputError: titles or cells that cannot be understood."""
    # Rows of headers (LabVIEW: up to a mark; Yokogawa: with a name), whose numbers are no data.
    rows, headers, start, is_header = reshaped(rows), set[int](), 0, False
    for k, (_, cells) in enumerate(rows):
        first = str(cells[0]) if cells else ""
        start = k if first == "Channels" else start
        headers |= set(range(start, k + 1)) if first == _END_OF_HEADER else set()
        is_header = first == "TraceName" or (is_header and cell_kind(first) == "t")
        headers |= {k} if is_header else set()
    blocks, between, width, plain = list[_Block](), list[Row](), -1, read.PATTERNS.plain_cell.match
    for k, row in enumerate(rows):
        is_plain = all(type(c) is float or (type(c) is str and plain(c)) for c in row[1][:2])
        if k in headers:
            between.append(row)
        elif is_plain and len(row[1]) == width and not between:
            blocks[-1].rows.append(row)  # quickly: its first cells have only digits and signs
        elif not read.is_number_row(row[1]):
            between += [row] if any(map(cell_kind, row[1])) else []
        else:
            if blocks and blocks[-1].takes(row, between):
                blocks[-1].marks += [(len(blocks[-1].rows), _text(cells)) for _, cells in between]
            else:
                blocks.append(_Block(separator, lines, between, [], []))
            between, width = [], len(row[1])
            blocks[-1].rows.append(row)
    # A few rows of numbers next to a larger table are notes.
    fewest = min(_FEWEST, max((len(block.rows) for block in blocks), default=0))
    tables, heads = list[Table](), list[Row]()
    for block in blocks:
        heads += block.heads
        if len(block.rows) < fewest:
            heads += block.rows
        else:
            block.heads, heads = heads, []
            tables.append(block.table(name))
    unused = [*heads, *between] if tables else []
    return tables, [f"line {line} ({_text(cells)[:40]})" for line, cells in unused]


def _label(text: str) -> str:
    return printable(text)[:LONGEST_NAME]


def _text(cells: Sequence[Any]) -> str:
    return _label(" ".join(str(c) for c in cells if c != ""))


def _specimen(rows: Sequence[Row]) -> str:
    """The last line that numbers a specimen, such as Specimen 2, or ""."""
    form = rf"(?i)\W*(?:{'|'.join(WORDS['specimens'])})\W*(?:no|nr|id)?\W*\d+\W*\Z"
    return next((text for _, cells in rows[::-1] if re.match(form, text := _text(cells))), "")


def _units(cells: Sequence[str], above: Sequence[str] = ()) -> list[str]:
    """The cells without brackets if all (but those of clocks, counters, set values) are units, else
    []."""
    bare = [text.strip("()[]{} ") for text in cells]
    bare[:1] = ["" if _MEANS.get(text.lower()) == "unit" else text for text in bare[:1]]
    meant = [*map(read.title_meanings, above)]
    if len(above) == len(cells) > 3 and sum(map(bool, meant)) > 1:
        bare = [text if parse_unit(text) or not {*means} & {*WORDS["unitless"]} else ""
                for text, means in zip(bare, meant, strict=True)]
    are_units = all(parse_unit(text) or text == "-" for text in bare if text)
    return bare if are_units and any(bare) else []


@dataclass
class _Block:
    """Rows of numbers that may be one table."""

    separator: str | None
    lines: Sequence[str]  # of the file
    heads: list[Row]  # lines before the rows
    rows: list[Row]
    marks: list[tuple[int, str]]  # (row, text) of lines between the rows

    def takes(self, row: Row, between: list[Row]) -> bool:
        """True if a row continues the block: equally wide, after text or the same titles."""
        if not between and row[0] == self.rows[-1][0] + 1:
            return True
        width = len(self.rows[0][1])
        if len(row[1]) != width:
            return False
        again, units, notes = self.titles(between, width)
        if not any(again) or "n" in map(cell_kind, again):  # 20.0,****,****: cells that overflowed
            return True
        # Repeated titles begin a new table only with other units, load or specimen.
        titles, before, above = self.titles(self.heads, width)
        stated = any(read.number_with_unit(_text(c), q) for _, c in notes for q in _TESTS)
        is_next = _specimen(notes) not in ("", _specimen(above))
        is_other = any(units) and units != before
        return again == titles and not (is_other or stated or is_next)

    def begins_with_index(self) -> bool:
        """True if the first cells count the rows or are all text."""
        first = [cells[0] for _, cells in self.rows]
        if (numbers := read.plain_numbers(first)) is None:
            return all(cell_kind(c) == "t" for c in first)
        return len(numbers) > 1 and bool(np.all(np.diff(numbers) == 1.0))

    def titles(self, heads: Sequence[Row], width: int) -> tuple[list[str], list[str], list[Row]]:
        """Titles ("" for an index that has none), units, and the lines above them."""
        most = width + 1 if self.separator == "" else None  # next to a sheet's table are notes
        texts = [self.title_cells(row, width)[:most] for row in heads[-3:]][::-1]
        remarks, units = list[Row](), list[str]()  # rows between titles and numbers
        for back, titles in enumerate(texts):
            is_narrow = sum(map(bool, titles)) < max(2, width / 2)
            above, beyond = [*texts, [], []][back + 1 : back + 3]
            found = _units(titles, above)
            is_remark = is_narrow and (back or not found)
            if not found and _units(above, beyond):  # Origin's comments, below units
                is_remark |= sum(map(bool, map(read.title_meanings, beyond))) > width / 2
            if is_remark or found or {*map(str.lower, titles)} <= {*WORDS["statistics"]}:
                units = found or units
                remarks = [heads[-1 - back], *remarks] if is_remark else remarks
                continue
            known = sum(bool(read.title_meanings(t)) for t in titles if cell_kind(t) == "t")
            if remarks and (known < width / 2 or "n" in map(cell_kind, titles)):
                break
            shift = len(titles) - len(units) if self.separator is None else 0
            units = [*[""] * shift, *units, *[""] * width][: len(titles)]
            # The row above may name wire, room or supply, for one or more columns each.
            are_names = all(cell_kind(name) in "t" and ":" not in name for name in above)
            if are_names and len(above) == width == len(titles) > above.count("") + 1:
                names: list[str] = [*accumulate(above, lambda last, name: str(name or last))]
                named = (_GROUPS & {*read.words_of(a)} or titles.count(b) > 1
                         for a, b in zip(names, titles, strict=True))
                over = [f"{name} " * bool(use) for name, use in zip(names, named, strict=True)]
                titles = [a + b if b else "" for a, b in zip(over, titles, strict=True)]
            if width - len(titles) == 1 and self.begins_with_index():
                titles, units = ["", *titles], ["", *units]
            return titles, units, [*heads[: -back - 1], *remarks]
        return [], [], list(heads)

    def title_cells(self, row: Row, width: int) -> list[str]:
        """Cells of a title row without a comment sign, split at two blanks if that fits `width`."""
        line, cells = row
        texts = [" ".join(str(cell).split()) for cell in cells]
        if self.separator is None and len(cells) > 1:
            wide = re.split(r"\s{2,}|\t", self.lines[line - 1].replace('"', " ").strip())
            wide = [text for text in wide if text.strip(_RULE)]
            if len(wide) in (width, width - 1) and len(wide) > 1:
                return wide
        lead = read.PATTERNS.comment.match(texts[0]) if texts else None
        is_alone = len(texts) == width + 1 and self.separator != ""
        if lead and (lead.end() < len(texts[0]) or is_alone):
            texts[0] = texts[0][lead.end() :].strip('" ')
            texts = texts if texts[0] else texts[1:]
        if self.separator is None:
            texts = [text for text in texts if text.strip(_RULE)]
        return texts

    def note(self, row: Row) -> tuple[str, ...]:
        """Cells of a line above the table; 12,3 is one number even if commas separate the rows."""
        line, cells = row
        if self.separator == "," and '"' not in (text := self.lines[line - 1]):
            cells = [cell.strip() for cell in re.split(r"(?<!\d),|,(?!\d)", text)]
        return tuple(str(cell) for cell in cells if cell != "")

    def table(self, name: str) -> Table:
        """The block as a table. InputError: rows that differ in width, or from their titles."""
        left_out: list[str] = []
        body, is_sheet = self.rows, self.separator == ""
        widths = Counter(len(cells) for _, cells in body)
        width = max(widths) if is_sheet else widths.most_common(1)[0][0]
        widest = max((len(self.title_cells(row, width)) for row in self.heads[-3:]), default=2)
        while width > max(widest, 2) and not any(any(map(str, c[width - 1 :])) for _, c in body):
            width -= 1  # separators at line ends
        if width > MOST_COLUMNS:
            raise InputError(f"{width} columns, expected at most {MOST_COLUMNS}")
        titles, units, above = self.titles(self.heads, width)
        # Lines that name channels, as of Graphtec: "CH1", "Wire voltage", "DC", ...
        names = {str(c[0]): str(c[1]) for _, c in above if len(c) > 2 and cell_kind(c[1]) == "t"}
        titles = [names.get(t, t) if t and not read.title_meanings(t) else t for t in titles]
        # Headers of LabVIEW and Yokogawa: one column of times, or one per channel, or none.
        held = {str(cells[0]): list(map(str, cells[1:])) for _, cells in self.heads if cells}
        header = {role: held[key] for key, role in WORDS["header"].items() if held.get(key)}
        if "units" in header:
            titles = ["Time", *header["titles"]] if "titles" in header else titles
            x, of_y = titles[0], iter(header["units"])
            units = ["s" if title == x else next(of_y, "") for title in titles]
            named = header.get("x", titles)[0]
            titles = [named if title == x else title for title in titles[:width]]
        # A last line that is cut short, rows without their last cells, damaged rows.
        if not is_sheet and len(body) > 1 and len(body[-1][1]) < width <= len(body[-2][1]):
            left_out.append(f"line {body[-1][0]}, the last one, is cut short and left out")
            body = body[:-1]
        while read.plain_title(str(body[-1][1][0])).strip(":") in WORDS["summaries"]:
            left_out.append(f"line {body[-1][0]} ({_text(body[-1][1])[:40]})")
            body = body[:-1]
        short = [row for row in body if len(row[1]) != width]
        is_sparse = self.separator and len(titles) >= width and len(short) > _SHORT * len(body)
        for line, cells in short:
            beyond = set(map(cell_kind, cells[width:])) - {""}
            if beyond - {"t"} or (len(cells) < width and not is_sheet and not is_sparse):
                raise InputError(f"line {line} is {_text(cells)[:60]!r}, expected {width} numbers")
            if beyond:
                left_out.append(f"line {line}: {_text(cells[width:])!r} beside the table, left out")
        columns = list(zip_longest(*(cells[:width] for _, cells in body), fillvalue=""))
        if len(titles) == width + 1 and read.title_meanings(titles[-1]) == ("counter",):
            titles = titles[:-1]  # a column of comments without any
        if titles and len(titles) != width and not is_sheet:
            line, cells = body[0]
            are_commas = self.separator == "," and width > len(titles)
            hint = message("commas" if are_commas else "one_title")
            raise InputError(message("mismatch", titles=len(titles), width=width, line=line,
                                     cells=_text(cells)[:40], hint=hint))  # fmt: skip
        titles, units = ([*texts, *[""] * width][:width] for texts in (titles, units))
        # Temperature unit: Fahrenheit
        told = [m for c in above if (m := read.PATTERNS.unit_note.match(_text(c[1])))]
        unit_of = {read.title_meanings(m[1]): m[2] for m in told if parse_unit(m[2])}
        unit_of.pop((), None)
        units = [u if u or split_title(t)[1] else unit_of.get(read.title_meanings(t), "")
                 for t, u in zip(titles, units, strict=True)]
        lines = np.array([line for line, _ in body], dtype=np.int64)
        made, ignored, notes = _columns(columns, titles, units, name, lines)
        begun, said = read.stated_start(list(map(self.note, above)))
        for k, column in enumerate(made if begun else ()):
            is_clock = column.start is None and "time" in read.meanings(column.title, column.unit)
            if is_clock and abs(column.values[0]) < 1.0:
                made[k] = replace(column, start=begun)
                day = datetime.fromtimestamp(begun, UTC).replace(tzinfo=None).isoformat(" ")
                notes.append(message("begun", clock=column.name, day=day, line=said))
        if any(titles) and not titles[0] and self.begins_with_index():
            made = [column for column in made if column.name != "column 1"]
            ignored = {"column 1": "row number", **ignored}
        period = [("Sample period", f"{texts[0]} s") for texts in [header.get("period")] if texts]
        more = ((*map(self.note, above), *period), tuple(self.marks), tuple(left_out), tuple(notes))
        return Table(name, tuple(made), lines, len(self.rows), ignored, *more)


def _finer(clock: Column, title: str, values: Array) -> Column | None:
    """A clock of whole seconds with fractions (n,) from the next column; None if that has none."""
    names, units = (read.plain_title(title), *read.words_of(title)[-1:]), WORDS["fractions"]
    part = values * next((units[name] for name in names if name in units), np.nan)
    unit = clock.unit or "".join(read.words_of(clock.title)[-1:])
    is_clock = clock.fields == 3 or parse_unit(unit) == parse_unit("s")
    if not is_clock or np.any(clock.values % 1.0 > 0.0) or not np.all(part // 1.0 == 0.0):
        return None
    first = float(part[np.isfinite(clock.values)][0]) if clock.fields else 0.0
    start = None if clock.start is None else clock.start + first
    return replace(clock, values=clock.values + part - first, start=start, unit="s")


def _columns(texts: Sequence[Sequence[Any]], titles: Sequence[str], units: Sequence[str],
             group: str, lines: IntArray) -> tuple[list[Column], dict[str, str], list[str]]:
    """Columns of numbers, dates and times; the other columns, with reasons; and remarks."""
    plain = [read.plain_numbers(cells) for cells in texts]
    kinds = []
    for cells in texts:
        filled = [c for c in cells if not read.is_missing(c)]
        count = Counter(map(cell_kind, filled[:: 1 + len(filled) // _CELL_SAMPLE]))
        kinds.append(count.most_common(1)[0][0] if count else "")
    # Decimal signs: the column's own, else that of the other columns.
    is_plain = all(values is not None for values in plain)
    signs = [set() if is_plain else read.decimal_signs(cells) for cells in texts]
    everywhere = {sign for found in signs for sign in found if len(sign) == 1}
    # A column of dates belongs to the next column of clock times.
    lead = [next(filter(None, map(read.moment_of, c)), None) if kind == "d" else None
            for c, kind in zip(texts, kinds, strict=True)]  # fmt: skip
    dates = [k for k, moment in enumerate(lead) if moment and moment.seconds is None]
    clocks = [k for k, moment in enumerate(lead) if moment and np.isnan(moment.days).all()]
    made, ignored, notes = list[Column](), dict[str, str](), list[str]()
    labels = [title or f"column {k}" for k, title in enumerate(titles, 1)]
    for k, (cells, label) in enumerate(zip(texts, labels, strict=True)):
        title, unit = split_title(titles[k], units[k])
        clock, bad = next((c for c in clocks if c > k), None), -1
        if kinds[k] in ("", "t"):
            is_unit = _MEANS.get(titles[k].lower()) == "unit" and label != labels[0]
            last = made[-1] if is_unit and made and made[-1].name == labels[k - 1] else None
            if last and not last.unit and (scaled := read.in_units(last.values, cells)):
                made[-1] = replace(last, values=scaled[0], unit=scaled[1])
                ignored[label] = f"units of {last.name}"  # 0.5 mV, 3.24 V
                continue
            example = next((str(c) for c in cells if cell_kind(c) in ("t", "d")), "")
            ignored[label] = f"text such as {printable(example)[:40]!r}" if example else "empty"
            notes += [f"{label}: {ignored[label]}"] if example and parse_unit(unit) else []
        elif k in dates and clock is not None:
            ignored[label] = f"its dates are in {labels[clock]}"
        elif kinds[k] == "d":
            found = read.moments_of(cells, *[texts[d] for d in dates if d < k and k in clocks][-1:])
            if found is None:
                bad = [cell_kind(c) != "" and not read.moment_of(c) for c in cells].index(True)
            else:
                seconds, start, fields, remark = found
                notes += [remark] if remark else []
                unit = "" if fields == 2 else "s"
                made.append(Column(label, title, unit, seconds, group, start, fields))
        else:
            values = plain[k] if "," not in everywhere else None
            if values is None:
                decimal = read.decimal_of(label, signs[k], everywhere, cells)
                values, unit, bad = read.numbers_of(cells, decimal, unit)
            is_time = bad < 0 and "time" in read.meanings(title, unit)
            start, fields = None, 0
            if is_time and not unit and (dated := read.serial_dates(title, values)):
                values, start, unit, fields = *dated, "s", 3
                day = datetime.fromtimestamp(start, UTC).date()
                notes.append(message("serial", label=label, day=day))
            elif is_time and (longer := read.continued(values)) is not values:
                values = longer
                notes.append(message("overflow", label=label))
            is_next = bool(made) and made[-1].name == labels[k - 1]
            if is_next and (finer := _finer(made[-1], titles[k], values)):
                made[-1], ignored[label] = finer, f"fractions of the seconds of {finer.name}"
            else:
                made.append(Column(label, title, unit, values, group, start, fields))
        if bad >= 0:
            cell = printable(str(cells[bad]))[:40]
            raise InputError(message("no_cell", line=lines[bad], label=label, cell=cell))
    return made, ignored, notes
