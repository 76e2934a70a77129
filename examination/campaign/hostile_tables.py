"""Tables of other loggers that keep their format's rules and are made to harm: text, spreadsheets,
MATLAB, HDF5 and Parquet, with the rig files and maps beside them that `import` takes."""

import io
import random
import re
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import openpyxl
import yaml

from examination.campaign.parser_seeds import PARAMETERS

ROWS = 60
TITLES = (
    "time [s]", "t", "Zeit (s)", "voltage [V]", "duty [%]", "current (A)", "temperature [degC]",
    "position [mm]", "force [N]", "=1+1", "\x1b[2J", "<script>", "x" * 3000, "", "caf\xe9", "a\tb",
    "time [s]", "Spannung; V", "$m_1$", "u/V", "@SUM(A1)", "\u202eV", "units", "name",
)  # fmt: skip
CELLS = (
    "nan", "inf", "-inf", "1e308", "-1e308", "1e-320", "9" * 400, "1" * 5000 + "x", "=1+1", "",
    "=cmd|' /C calc'!A1", "\x1b]0;owned\x07", "\ud800", "\0", "\r", "\n", '"', "12:00:60",
    "9999-12-31 23:59:59", "0001-01-01", "1,5", "1.5.5", "x" * 5000, "-", "TRUE", "#DIV/0!",
    "2020-13-45", "25:00:00", "1_000", "\uff11", "0x10",
)  # fmt: skip
_MAP: dict[str, Any] = {
    "time": {"time [s]": "s"}, "supply_voltage": 12.0, "lever": 0.1,
    "signals": [
        {"signal": "wire.voltage", "column": "voltage [V]", "unit": "V", "clock": "time [s]",
         "scale": 1.0, "offset": 0.0, "sign": 1, "reference": "none", "form": "rms"},
        {"signal": "wire.temperature", "column": "temperature [degC]", "unit": "degC",
         "clock": "time [s]", "sign": 1, "reference": "none"},
    ],
    "ignored": ["x"],
}  # fmt: skip
_MAIN = "http://schemas.openxmlformats.org/spreadsheetml/2006/main"
_BOMB = (
    '<!DOCTYPE b [<!ENTITY a0 "xxxxxxxxxx">'
    + "".join(f'<!ENTITY a{k} "{f"&a{k - 1};" * 10}">' for k in range(1, 9)) + "]>"
)
_FILE = '<!DOCTYPE b [<!ENTITY a8 SYSTEM "file:///etc/passwd">]>'


def columns(rng: random.Random, rows: int = ROWS) -> dict[str, np.ndarray]:
    """A good table: a drive, what it did, and now and then what no sensor says."""
    time = np.arange(rows) * 0.1
    voltage = np.where((time > 1.0) & (time < 3.0), 5.0, 0.0)
    found = {"time [s]": time, "voltage [V]": voltage, "temperature [degC]": 23.0 + voltage}
    if rng.random() < 0.5:  # the harm is in the file's format, or in what lies beside it
        return found
    if rng.random() < 0.3:  # which `import` asks about
        found["position [mm]"] = 12.0 + 0.1 * voltage
    for title in rng.sample(TITLES, rng.choice((0, 1, 4))):
        found[title] = time if rng.random() < 0.5 else voltage
    if rng.random() < 0.6:
        chosen = found[rng.choice(list(found))] = found[rng.choice(list(found))].copy()
        odd = (np.nan, np.inf, -1.0, 1e308, 1e18, 5e-324, 0.0)
        chosen[rng.randrange(rows) :: rng.choice((1, 2, 100))] = rng.choice(odd)
    if rng.random() < 0.2:
        rng.shuffle(titles := list(found))
        found = {title: found[title] for title in titles}
    return found


def text_table(rng: random.Random) -> tuple[str, bytes]:
    """Cells of anything, ragged rows, mixed separators and encodings."""
    found = columns(rng)
    separator = rng.choice((",", ";", "\t", " ", ", "))
    rows = [list(found), *([f"{v:.9g}" for v in row] for row in np.column_stack([*found.values()]))]
    for _ in range(rng.choice((0, 0, 1, 5))):
        row = rows[rng.randrange(len(rows))]
        row[rng.randrange(len(row))] = rng.choice(CELLS)
    shape = rng.choice(("plain", "plain", "plain", "ragged", "wide", "long", "above"))
    if shape == "ragged":
        rows[rng.randrange(len(rows)) :] = [["1"] * rng.choice((0, 1, 7, 3000))] * 3
    elif shape == "wide":
        rows = [row * rng.choice((300, 1100)) for row in rows]
    elif shape == "long":
        rows += rows[1:] * 300
    elif shape == "above":
        rows[:0] = [[rng.choice(CELLS)] * rng.choice((1, 2, 40)) for _ in range(30)]
    text = rng.choice(("\n", "\n", "\r\n", "\r")).join(separator.join(row) for row in rows)
    encoding = rng.choice(("utf-8", "utf-8", "utf-8-sig", "utf-16", "latin-1"))
    return "table.csv", text.encode(encoding, "replace")


# --- Excel ----------------------------------------------------------------------------------------

_ODD_CELLS = (
    '<c r="XFD1048576"><v>1</v></c>', '<c r="A1048576"><v>1</v></c>', '<c r="A0"><v>1</v></c>',
    '<c r="ZZZZ9"><v>1</v></c>', "<c><v>1</v></c>", '<c r="B2" t="s"><v>99999</v></c>',
    '<c r="B2" t="s"><v>-1</v></c>', '<c r="B2" t="d"><v>x</v></c>', '<c r="B2"><v>1e999</v></c>',
    '<c r="B2"><f>HYPERLINK("http://a","b")</f></c>', '<c r="B2"><f>1+1</f><v>2</v></c>',
    '<c r="B2" s="1"><v>1e300</v></c>', '<c r="B2" s="1"><v>-5</v></c>', '<c r="B2" s="7"/>',
    '<c r="B2" t="e"><v>#DIV/0!</v></c>', '<c r="B2" t="b"><v>7</v></c>', '<c r="B2" t="q"/>',
    '<c r="B2"><v>&a8;</v></c>', '<c r="B2" s="1"><v>nan</v></c>',
)  # fmt: skip
_ROWS = (
    '<row r="1048576"><c r="XFD1048576"><v>1</v></c></row>', '<row r="99999999999"/>',
    '<row r="-5"><c><v>1</v></c></row>', '<row r="x"/>',
    "".join(f'<row r="{k}"><c r="XFD{k}"><v>1</v></c></row>' for k in range(70, 700)),
    "<row><c><v>1</v></c><c><v>2</v></c></row>" * 60_000,
)  # fmt: skip
_ENTITY = r'\1<row r="70"><c r="A70"><v>&a8;</v></c></row></sheetData>'
# Part of the archive, what is found there, and what may stand in its place.
_ALTERED: tuple[tuple[str, str, tuple[str, ...]], ...] = (
    ("worksheets/sheet1.xml", "</row>", tuple(cell + "</row>" for cell in _ODD_CELLS)),
    ("worksheets/sheet1.xml", "</sheetData>", tuple(row + "</sheetData>" for row in _ROWS)),
    ("worksheets/sheet1.xml", "(?s)^(.*)</sheetData>", (_BOMB + _ENTITY, _FILE + _ENTITY)),
    ("worksheets/sheet1.xml", '<dimension ref="[^"]*"', tuple(
        f'<dimension ref="{size}"' for size in ("A1:XFD1048576", "A1:ZZZZZZ9", "", "B7"))),
    ("workbook.xml", "<sheet [^>]*/>", (r"\g<0>" * 300,)),
    ("workbook.xml", '<sheet ([^>]*)name="[^"]*"', tuple(
        rf'<sheet \1name="{name}"' for name in ("=1+1", "\x9b2J", "s" * 2000, "../x"))),
    ("_rels/workbook.xml.rels", 'Target="[^"]*sheet1.xml"', tuple(
        f'Target="{place}"' for place in ("../../../etc/passwd", "/etc/passwd", "http://a/b"))),
)  # fmt: skip


def excel_table(rng: random.Random) -> tuple[str, bytes]:
    """A workbook whose archive, dimensions, rows, styles or entities are not what they should."""
    book = openpyxl.Workbook()
    found = columns(rng)
    book.active.append(["".join(c for c in title if c.isprintable()) for title in found])
    for row in zip(*found.values(), strict=True):
        book.active.append([float(value) for value in row])
    book.active["B2"].number_format = "yyyy-mm-dd"  # the style s="1" of the odd cells
    good, written = io.BytesIO(), io.BytesIO()
    book.save(good)
    with zipfile.ZipFile(good) as archive:
        parts = {name: archive.read(name).decode() for name in archive.namelist()}

    trick = rng.choice(("", "", *["altered"] * 6, "part gone", "strings", "bomb", "size"))
    if trick == "altered":
        part, pattern, texts = rng.choice(_ALTERED)
        parts[f"xl/{part}"] = re.sub(pattern, rng.choice(texts), parts[f"xl/{part}"], count=1)
    elif trick == "strings":
        kind = "application/vnd.openxmlformats-officedocument.spreadsheetml.sharedStrings+xml"
        override = f'<Override PartName="/xl/sharedStrings.xml" ContentType="{kind}"/></Types>'
        types = "[Content_Types].xml"
        parts[types] = parts[types].replace("</Types>", override)
        texts = "<si><t>x</t></si>" * rng.choice((1_000_000, *[2000] * 19))
        parts["xl/sharedStrings.xml"] = f'<sst xmlns="{_MAIN}" count="9">{texts}</sst>'
    elif trick == "part gone":
        parts.pop(rng.choice(list(parts)))
    with zipfile.ZipFile(written, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, text in parts.items():
            archive.writestr(name, text)
        if trick == "bomb":
            size = rng.choice((1 << 24, 1 << 28))
            archive.writestr(rng.choice(("xl/media/a.png", "xl/theme/theme2.xml")), bytes(size))
    content = bytearray(written.getvalue())
    if trick == "size":  # what the directory says of a member is a lie
        at = content.find(b"PK\x01\x02") + rng.choice((20, 24))
        content[at : at + 4] = rng.choice((b"\0\0\0\0", b"\xff\xff\xff\x7f", b"\xff\xff\xff\xff"))
    return "table.xlsx", bytes(content)


# --- MATLAB, HDF5, Parquet ------------------------------------------------------------------------


def binary_table(rng: random.Random) -> tuple[str, bytes]:
    """A good file of one of the three with an array that takes no room, a nest or a link out of it,
    and here and there bytes that are lies."""
    import h5py
    import pyarrow
    from pyarrow import parquet
    from scipy.io import savemat

    found: dict[str, Any] = {
        re.sub(r"\W+", "_", title, flags=re.ASCII).strip("_0123456789")[:31] or "c": values
        for title, values in columns(rng).items()
    }
    kind, trick = rng.choice(("mat", "h5", "parquet")), rng.choice(("", "large", "odd"))
    written = io.BytesIO()
    if kind == "mat":
        if trick == "large":
            found["large"] = np.zeros(1 << 22)
        elif trick == "odd":
            found["odd"] = rng.choice((np.zeros((3, 3, 3)), 1j * np.ones(9), "V", {"a": {"b": 1}}))
        savemat(written, found, do_compression=rng.random() < 0.6)
    elif kind == "h5":
        with h5py.File(written, "w") as file:
            for title, values in found.items():
                file[title] = values
            if trick == "large":
                shape = rng.choice(((10**9,), (10**6, 10**6), (2, 10**7)))
                file.create_dataset("empty", shape, "d", chunks=True)
            elif trick == "odd":
                file["again"], file["self"] = file["/"], h5py.SoftLink("/self")
                file["out"] = h5py.ExternalLink("/etc/passwd", "/")
    else:
        if trick == "large":
            found = dict.fromkeys(found, np.zeros(1 << 18))
        elif trick == "odd":
            found["odd"] = rng.choice((pyarrow.nulls(ROWS), pyarrow.array([[1.0]] * ROWS)))
        parquet.write_table(pyarrow.table(found), written)
    content = bytearray(written.getvalue())
    for _ in range(rng.choice((0, 0, 1, 3))):
        at = rng.randrange(4, len(content) - 8)
        content[at : at + 4] = rng.choice((b"\xff\xff\xff\x7f", bytes(4), b"abcd"))
    return f"table.{kind}", bytes(content)


TABLES: tuple[Callable[[random.Random], tuple[str, bytes]], ...] = (
    text_table, text_table, excel_table, binary_table,
)  # fmt: skip


def hostile_table_file(
    rng: random.Random, folder: Path, altered: Callable[[random.Random, Any], str]
) -> tuple[Path, tuple[str, ...]]:
    """A table, and of two in five a rig file or a map beside it, `altered` from a good one; the
    options that name these."""
    name, content = rng.choice(TABLES)(rng)
    (folder / name).write_bytes(content)
    beside = rng.choice(("", "", "", "--params", "--map"))
    if not beside:
        return folder / name, ()
    document = _MAP if beside == "--map" else yaml.safe_load(PARAMETERS)
    (folder / "beside.yaml").write_text(
        altered(rng, document) if rng.random() < 0.8 else str(yaml.safe_dump(document))
    )
    return folder / name, (beside, str(folder / "beside.yaml"))
