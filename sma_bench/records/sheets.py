"""Rows of cells of texts and workbooks as they are written: encodings, quotes, separators."""

import csv
import re
import zipfile
from collections.abc import Sequence
from io import BytesIO
from typing import Any

from sma_bench.border import Budget, printable
from sma_bench.errors import InputError
from sma_bench.records.cells import is_number_row

Row = tuple[int, list[Any]]  # line number from 1, cells
_CELL = 100  # bytes that one of a spreadsheet takes while it is read
_LOOK_AT = 400  # rows, for the separator
_LONGEST_CELL = 4  # lines that a quoted cell may run over
_DEGREES = (
    r"(?<![^\W\d_])[°º](?= ?[CFKcfk]?(?:\W|\Z))|µ(?=[msVAeN])|[²³]|(?<=[0-9])\u00a0(?=[0-9]{3})"
)
_LETTERS = r"(?<=[A-Za-z])[äöüßéèàçñíóúáùìòêîôâ]|[ÄÖÜÉ](?=[a-z])"


def why(error: Exception) -> str:
    """Another library's error in one line."""
    return printable(" ".join(str(error).split()))[:200] or type(error).__name__


def decoded_lines(content: bytes) -> list[str]:
    """Lines of a text in UTF-8, UTF-16, or of Windows, DOS or an old Mac, which its accents and
    degree signs tell; raises InputError for what is binary."""
    encoding = "utf-16" if content[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig"
    if b"\0" in content and encoding != "utf-16":
        zeros = [content[k:4000:2].count(0) > 0.9 * len(content[k:4000:2]) for k in (0, 1)]
        if zeros[0] == zeros[1] or len(content) < 8:
            raise InputError("holds zero bytes, expected a text file")
        encoding = "utf-16-be" if zeros[0] else "utf-16-le"
    try:
        strictly = "strict" if encoding == "utf-8-sig" else "replace"
        return content.decode(encoding, strictly).splitlines()
    except UnicodeDecodeError:
        pass

    def score(encoding: str) -> int:
        text = content[:400_000].decode(encoding, "replace")
        return 3 * len(re.findall(_DEGREES, text)) + len(re.findall(_LETTERS, text))

    found = max(("cp1252", "latin-1", "cp850", "mac_roman"), key=score)
    return content.decode(found, "replace").splitlines()


def text_rows(lines: Sequence[str]) -> tuple[list[Row], str | None]:
    """Stripped cells of a text's lines, and their separator (None: blanks).

    RFC 4180: a quoted cell may hold separators, doubled quotes and line ends; a line that is quoted
    as a whole is unwrapped.
    """
    filled = [line for line in lines if line.strip()]
    sample = filled[:_LOOK_AT] + filled[_LOOK_AT:][-50:]
    counts = {s: sum(is_number_row(c) for _, c in _split(sample, s)) for s in ("\t", *";|,", None)}
    separator = next(s for s, n in counts.items() if n >= 0.98 * max(counts.values()))
    return _split(lines, separator), separator


def _split(lines: Sequence[str], separator: str | None) -> list[Row]:
    if separator is None:  # a date and its clock are one cell, as are a clock and its AM or PM
        joined = (re.sub(r"(?<=\d) (?=\d+:\d\d|[AaPp]\.?[Mm]\b)", "\1", s) for s in lines)
        parted = (line.replace('"', " ").split() for line in joined)
        return [(n, [c.replace("\1", " ") for c in row]) for n, row in enumerate(parted, 1)]
    if not any('"' in line for line in lines):
        return [(n, [c.strip() for c in s.split(separator)]) for n, s in enumerate(lines, 1)]
    rows: list[Row] = []
    # A comment's sign before a quote would end the quoting.
    plain = (re.sub(r'^\s*[#%]+\s*(?=")', "", f"{line.rstrip()} ") for line in lines)
    reader = csv.reader(plain, delimiter=separator, skipinitialspace=True)
    before = 0
    try:
        for cells in reader:
            if reader.line_num > before + _LONGEST_CELL:
                raise csv.Error("a quote without end")
            if len(cells) == 1 and separator in cells[0]:
                cells = next(csv.reader(cells, delimiter=separator, skipinitialspace=True), [])
            rows.append((before + 1, [cell.strip().strip('"').strip() for cell in cells]))
            before = reader.line_num
    except csv.Error:
        return _split([line.replace('"', "") for line in lines], separator)
    return rows


def excel_sheets(content: bytes, budget: Budget) -> list[tuple[str, list[Row]]]:
    """Title and rows of every sheet of a workbook; raises InputError where it is unreadable, or
    openpyxl is not installed."""
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


def missing_package(package: str, apt: str = "") -> InputError:
    """The one line for a reader whose package is not installed."""
    how = f"pip install {package}" + (f", or apt install {apt}" if apt else "")
    return InputError(f"reading it needs {package}: {how}")
