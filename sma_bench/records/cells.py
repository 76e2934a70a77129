"""Cells of texts and workbooks as they are written: encodings, quotes, separators, sheets."""

import csv
import re
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass, field
from io import BytesIO
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sma_bench.border import Budget, printable
from sma_bench.errors import InputError
from sma_bench.records.units import FloatArray, cell_kind

MOST_COLUMNS = 1000
LONGEST_NAME = 120
_CELL = 100  # bytes that one of a spreadsheet takes while it is read
_LOOK_AT = 400  # rows, for the separator
_SEPARATORS = ("\t", ";", "|", ",", None)  # None: blanks


@dataclass(frozen=True, eq=False)
class Column:
    """One column of a file.

    Attributes:
        name: as the map calls it, unique in the file: its title, or its path (`log/u`).
        title: what it is called, without unit; unit: as written, "" where none is.
        values: (n,), NaN where a cell is empty.
        group: sheet or folder it lies in; table: which table of the file, whose rows it shares.
        start: epoch s of 0 where the column holds dates, else None.
        fields: of its clock times: 0 for numbers, 2 where hh:mm and mm:ss look alike.
    """

    name: str
    title: str
    unit: str
    values: FloatArray
    group: str = ""
    start: float | None = None
    fields: int = 0
    table: int = 0


@dataclass(frozen=True)
class Table:
    """Rows of numbers under one set of titles.

    Attributes:
        name: of its sheet; columns: those of numbers or moments.
        above: lines above the titles, cells of each; marks: (row, text) of lines between the rows.
        lines: (n,) line of each row in the file, from 1.
        rows: of numbers in the file, left out or not; left_out: what is, and why.
        ignored: columns that hold no numbers, each with the reason; notes: what was decided.
    """

    name: str
    columns: tuple[Column, ...]
    above: tuple[tuple[str, ...], ...] = ()
    marks: tuple[tuple[int, str], ...] = ()
    lines: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    rows: int = 0
    left_out: tuple[str, ...] = ()
    ignored: dict[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    @property
    def unused_lines(self) -> tuple[str, ...]:
        """What is left out, and the lines of text between the rows."""
        if not self.marks:
            return self.left_out
        first = f"the first {self.marks[0][1][:40]!r}"
        return (*self.left_out, f"{len(self.marks)} lines of text between the rows, {first}")


Row = tuple[int, list[Any]]  # line number from 1, cells


class Words(list[str]):
    """Cells that blanks part, and the line they stand in."""

    def __init__(self, line: str) -> None:
        whole = re.sub(r"(?<=\d) (?=[AaPp]\.?[Mm]\b)", "\u00a0", line.replace('"', " "))
        super().__init__(c.replace("\u00a0", " ") for c in re.split(r"[ \t]+", whole.strip()) if c)
        self.line = line


def missing_package(package: str, apt: str = "") -> InputError:
    """The one line for a reader whose package is not installed."""
    how = f"pip install {package}" + (f", or apt install {apt}" if apt else "")
    return InputError(f"reading it needs {package}: {how}")


def why(error: Exception) -> str:
    """Another library's error in one line."""
    return printable(" ".join(str(error).split()))[:200] or type(error).__name__


def decoded_lines(content: bytes) -> list[str]:
    """Lines of a text in UTF-8, UTF-16, or of Windows, DOS or an old Mac, which its accents and
    degree signs tell.

    Raises:
        InputError: it is binary.
    """
    if content[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return content.decode("utf-16", errors="replace").splitlines()
    if b"\0" in content:
        halves = content[:4000:2], content[1:4000:2]
        zeros = [half.count(0) > 0.9 * len(half) for half in halves]
        if zeros not in ([True, False], [False, True]) or len(content) < 8:
            raise InputError("holds zero bytes, expected a text file")
        return content.decode("utf-16-be" if zeros[0] else "utf-16-le", "replace").splitlines()
    try:
        return content.decode("utf-8-sig").splitlines()
    except UnicodeDecodeError:
        pass

    def score(encoding: str) -> int:
        text = content[:400_000].decode(encoding, errors="replace")
        degrees = len(re.findall(r"(?<![^\W\d_])[°º](?= ?[CFKcfk]?(?:\W|\Z))|[µ](?=[msVAeN])|[²³]",
                                 text))  # fmt: skip
        letters = len(re.findall(r"(?<=[A-Za-z])[äöüßéèàçñíóúáùìòêîôâ]|[ÄÖÜÉ](?=[a-z])", text))
        thousands = len(re.findall("(?<=[0-9])\u00a0(?=[0-9]{3})", text))
        return 3 * (degrees + thousands) + letters

    found = max(("cp1252", "latin-1", "cp850", "mac_roman"), key=score)
    return content.decode(found, errors="replace").splitlines()


def text_rows(lines: Sequence[str]) -> tuple[list[Row], str | None]:
    """Cells of a text's lines, and their separator (None: blanks).

    RFC 4180: a quoted cell may hold separators, doubled quotes and line ends; a line that is quoted
    as a whole is unwrapped.
    """
    joined: list[tuple[int, str]] = []
    waiting: tuple[int, str] | None = None
    for number, line in enumerate(lines, 1):
        if waiting is not None:
            waiting = (waiting[0], f"{waiting[1]} {line}")
            if line.count('"') % 2 or number - waiting[0] > 3:
                joined.append(waiting)
                waiting = None
        elif line.count('"') % 2 and re.search(r'(?:^|[,;\t|])\s*"[^"]*\Z', line):
            waiting = (number, line)
        else:
            joined.append((number, line))
    if waiting is not None:
        joined.append(waiting)
    filled = [line for _, line in joined if line.strip()]
    sample = filled[:_LOOK_AT] + filled[_LOOK_AT:][-50:]

    def rows_of_numbers(separator: str | None) -> int:
        good = 0
        for line in sample:
            kinds = [cell_kind(cell) for cell in cells_of(line, separator)]
            real = kinds.count("n") + kinds.count("d")
            good += len(kinds) > 1 and real > kinds.count("t") and real > 0
        return good

    counts = [rows_of_numbers(separator) for separator in _SEPARATORS]
    best = max(counts)
    separator = next(s for s, n in zip(_SEPARATORS, counts, strict=True) if n >= 0.98 * best)
    return [(number, cells_of(line, separator)) for number, line in joined], separator


def cells_of(line: str, separator: str | None) -> list[str]:
    """The stripped cells of one line."""
    if separator is None:
        return Words(line)
    if '"' not in line:
        return [cell.strip() for cell in line.split(separator)]
    try:
        cells = next(csv.reader([line.strip(" ")], delimiter=separator, skipinitialspace=True), [])
    except csv.Error:
        cells = line.replace('"', "").split(separator)
    if len(cells) == 1 and separator in cells[0] and line.lstrip().startswith('"'):
        # The line as a whole is quoted.
        cells = next(csv.reader([cells[0]], delimiter=separator, skipinitialspace=True), [])
    elif len(cells) == 2 and line.lstrip().startswith('"') and cells[1].startswith('"'):
        cells = [cell.strip('"') for cell in cells]
    return [cell.strip().strip('"').strip() for cell in cells]


def excel_sheets(content: bytes, budget: Budget) -> list[tuple[str, list[Row]]]:
    """Title and rows of every sheet of a workbook.

    Raises:
        InputError: unreadable, or openpyxl is not installed.
    """
    try:
        import openpyxl
    except ImportError:
        raise missing_package("openpyxl", "python3-openpyxl") from None
    try:
        with zipfile.ZipFile(BytesIO(content)) as archive:
            for member in archive.infolist():
                budget.take(member.file_size)
        book = openpyxl.load_workbook(_Watched(content, budget), read_only=True, data_only=True)
        sheets = []
        for sheet in book.worksheets:
            rows: list[Row] = []
            sheet.reset_dimensions()  # what a file claims of its size is not believed
            for number, row in enumerate(sheet.iter_rows(values_only=True), 1):
                budget.take(_CELL * len(row))
                rows.append((number, [c.strip() if isinstance(c, str) else c for c in row]))
            sheets.append((printable(str(sheet.title)), rows))
    except InputError:
        raise
    except Exception as error:  # openpyxl passes on whatever its parsers stumble over
        budget.check()
        raise InputError(f"not a readable Excel file: {why(error)}") from None
    return sheets


class _Watched(BytesIO):
    """A file that is read no longer than its budget lasts: openpyxl takes all texts at once."""

    def __init__(self, content: bytes, budget: Budget) -> None:
        super().__init__(content)
        self._budget = budget

    def read(self, size: int | None = -1, /) -> bytes:
        self._budget.check()
        return super().read(size)
