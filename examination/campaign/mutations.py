"""Good inputs of each kind, with what reads them; what makes them hostile, which chooses by a
`random.Random`: bytes, documents, series of numbers, tables; the pieces of bags that keep their
format's rules and are made to harm."""

import contextlib
import io
import json
import math
import random
import re
import struct
import zipfile
from collections import namedtuple
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import openpyxl
import yaml
import zstandard

from examination.bags import in_sqlite3
from sma_bench.hardware.serial_messages import ProtocolError, Splitter, decode, line
from sma_bench.nodes.start import check_arguments
from sma_bench.parameters import Parameters, read_parameters
from sma_bench.protocols import TEMPERATURE, load_protocol
from sma_bench.records import Signal, open_record, read_record
from sma_bench.records.bag_writer import write_record
from sma_bench.report.reports import read_result

# --- Good ones.
FOLDER = Path(__file__).parent / "good"
GOOD = {path.name: path.read_bytes() for path in FOLDER.iterdir()}
RESULT, DIAGNOSIS = (json.loads(GOOD[f"{name}.json"]) for name in ("result", "diagnosis"))
MAP, PARAMETERS, METADATA = (yaml.safe_load(GOOD[f"{name}.yaml"])
                             for name in ("import_map", "parameters", "metadata"))
_TELEMETRY = b"T 57 3210000 1 0 12003 -102 0 15002 14990 2844 0 0 65535 1"
_SERIAL = (
    b"".join(line(text.decode()) for text in (_TELEMETRY, b"K A 13841", b"N V 6", b"P 3 9 5"))
    + bytes.fromhex("0342390410fb30020105e32e9aff01079a3a8e3a1c0b01010104ffff0103615a00")  # COBS
    + _TELEMETRY)


# A parser, a good input, what reads it, and the file name that it goes by.
Parser = namedtuple("Parser", "name good read file", defaults=("input.txt",))


def _rows(*columns: np.ndarray) -> bytes:
    rows = zip(*(column.tolist() for column in columns), strict=True)
    return "\n".join("\t".join(f"{number:.4f}" for number in row) for row in rows).encode()


def _node_arguments(file: Path) -> None:
    """A parameter file for a node, and each of its lines as -p name:=value."""
    check_arguments("experiment", ["--ros-args", "--params-file", str(file)])
    for text in file.read_text(encoding="utf-8", errors="replace").splitlines():
        name, _, value = text.strip().partition(": ")
        check_arguments("experiment", ["--ros-args", "-p", f"{name}:={value}"])


def _serial(file: Path) -> None:
    """The stream in pieces, as lines and frames, then bodies; wrong is a ProtocolError."""
    received = file.read_bytes()
    bodies = received.split(b"\n")
    for binary in (False, True):
        splitter = Splitter()
        splitter.expect(binary)
        for start in range(0, len(received), 13):
            bodies += splitter.feed(received[start : start + 13])
    for body in bodies:
        with contextlib.suppress(ProtocolError):
            decode(body)


def parsers() -> tuple[Parser, ...]:
    """Every parser of what comes from outside; the first four are of instruments."""
    wire = Parameters.defaults()
    heat, strain = np.linspace(20.0, 120.0, 30), np.linspace(0.0, 0.02, 40)
    cycle = np.concatenate([heat, heat[::-1]]), np.linspace(4.0, 0.0, 60), np.full(60, 99.0)
    of_reference = partial(load_protocol, parameters=wire, quantity=TEMPERATURE)
    pull = b"Strain (-)\tStress (MPa)\n" + _rows(strain, 22_800.0 * strain)
    return (
        Parser("calorimeter, Pyris", GOOD["pyris.txt"], open_record, "pyris.txt"),
        Parser("calorimeter, TA", GOOD["ta.txt"], open_record, "ta.txt"),
        Parser("isobaric test", _rows(*cycle), open_record, "100 MPa.txt"),
        Parser("tensile test", pull, open_record, "tensile.txt"),
        Parser("parameter file", GOOD["parameters.yaml"], read_parameters),
        Parser("parameters of a node", GOOD["parameters.yaml"], _node_arguments),
        Parser("protocol", GOOD["protocol.yaml"], lambda p: load_protocol(p, wire), "input.yaml"),
        Parser("reference", GOOD["reference.yaml"], of_reference, "input.yaml"),
        Parser("metadata of a bag", GOOD["metadata.yaml"], lambda p: read_record(p.parent),
               "metadata.yaml"),
        Parser("result", GOOD["result.json"], read_result, "input.json"),
        Parser("serial bytes", _SERIAL, _serial))


# --- Hostile ones.
NUMBERS = (0.0, -0.0, 1.0, 5.0, 25.0, 300.0, -1.0, 1e-300, 5e-324, 1e9, 1e38, 1e308, -1e308,
           math.inf, -math.inf, math.nan)  # fmt: skip
# YAML documents that are a kilobyte as a file and gigabytes when every alias is followed.
_BOMB = b"a0: &a0 [x, x, x, x, x, x, x, x, x]\n" + b"".join(
    b"a%d: &a%d [%s]\n" % (k, k, b", ".join([b"*a%d" % (k - 1)] * 9)) for k in range(1, 12))
_MAP_BOMB = b"b0: &b0 {x: 1, y: 2}\n" + b"".join(
    b"b%d: &b%d {%s}\n" % (k, k, b", ".join(b"k%d: *b%d" % (n, k - 1) for n in range(9)))
    for k in range(1, 12))


def _told(entry: str | list) -> str:
    """A text of hostile.yaml, or one with a part that is repeated."""
    if isinstance(entry, str):
        return entry
    head, part, times, tail = entry
    return str(head) + part * times + tail


_DATA = yaml.safe_load(Path(__file__).with_name("hostile.yaml").read_text(encoding="utf-8"))
TRIPWIRES = (*(_told(e).encode("latin-1") for e in _DATA["tripwires"]), b"\n" + _BOMB,
             b"\n" + _MAP_BOMB)  # fmt: skip
_TITLES, TOPICS, PLACES = ([_told(entry) for entry in _DATA[kind]]
                           for kind in ("titles", "topics", "places"))
_VALUES: tuple[Any, ...] = (None, True, 0, -1, 2**63, 10**400, 1e308, math.inf, math.nan, "", "nan",
                            "\x1b[2J", "=1+1", "<<", "~", "x" * 3000, "\ud800", "/dev/zero",
                            "../../x", [], {}, [[1, 2], [3]], {"": {"": 0}}, {"<<": {"a": 1}},
                            ["a"] * 300, "2020-01-01", "0x" + "f" * 500, "!!python/none")
EDITS = ("cut", "drop", "twice", "insert", "replace", "replace")


def edited(content: bytes, edits: list[tuple[str, float, int, bytes]]) -> bytes:
    """Edits at places (0 to 1): cut, drop, twice, insert `n` bytes, replace a whole token."""
    for kind, place, n, payload in edits:
        at = int(place * (len(content) + 1))
        end = at + n
        if kind == "replace":  # a whole token: what a file's author would have got wrong
            end = at
            while end < len(content) and content[end : end + 1] not in b" \t\n,:{}[]":
                end += 1
        content = {"cut": content[:at], "drop": content[:at] + content[end:],
                   "twice": content[:end] + content[at:],
                   "insert": content[:at] + payload + content[at:],
                   "replace": content[:at] + payload + content[end:]}[kind]
    return content


def mutated(rng: random.Random, content: bytes, most: int = 5) -> bytes:
    """Bytes with one to `most` edits."""
    return edited(content, [(rng.choice(EDITS), rng.random(), rng.choice((1, 2, 4, 8, 40, 512)),
                             rng.choice((*TRIPWIRES, rng.randbytes(4))))
                            for _ in range(rng.randint(1, most))])


# --- documents ----------------------------------------------------------------------------------
def changed(rng: random.Random, node: Any) -> Any:
    """A document with a leaf, a name or a branch put in place of something else."""
    if type(node) in (int, float) and abs(node) < 1e300 and rng.random() < 0.7:
        return node * rng.choice((0.5, 0.9, 1.1, 1.5, 3.0, 100.0, 1e-3))
    if not isinstance(node, (dict, list)) or not node or rng.random() < 0.15:
        nest: Any = rng.choice(_VALUES)
        for _ in range(rng.choice((*[0] * 9, 100))):
            nest = [nest] if rng.random() < 0.5 else {"a": nest}
        return nest
    if isinstance(node, list):
        k = rng.randrange(len(node))
        return [*node[:k], changed(rng, node[k]), *node[k + 1 :]]
    key = rng.choice(list(node))
    if rng.random() < 0.2:
        return {**node, rng.choice(("", "\x1b", "<<", "=", "x" * 3000, "a.b", key)): node[key]}
    return {**node, key: changed(rng, node[key])}


def hostile_document(rng: random.Random, document: Any, is_json: bool = False) -> bytes:
    """A changed document as YAML or JSON, of one in three with bytes edited too."""
    for _ in range(rng.choice((1, 1, 2, 4))):
        document = changed(rng, document)
    text = json.dumps(document) if is_json else str(yaml.safe_dump(document, allow_unicode=False))
    if is_json and rng.random() < 0.2:
        text = rng.choice(("[" * 900 + text + "]" * 900, f'{{"a": {text}}}', text * 2))
    content = text.encode("utf-8", "surrogatepass")
    return mutated(rng, content, most=2) if rng.random() < 0.3 else content


# --- numbers ------------------------------------------------------------------------------------
def changed_series(rng: random.Random, time: np.ndarray,
                   values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Times and values of a sensor, one of them as no sensor says it."""
    time, values, pick = time.copy(), values.copy(), rng.choice
    first, last = sorted((rng.randrange(len(time)), rng.randrange(len(time))))
    trick = rng.randrange(8)
    if trick == 0:
        values[first : last if rng.random() < 0.5 else first + 1] = pick(NUMBERS)
    elif trick == 1:
        values *= pick((0.0, -1.0, 1e-6, 1e3, 1e9, 1e30))
    elif trick == 2:
        time[first:] += pick((0.5, 60.0, 86_400.0, 3e7, 1e9))
    elif trick == 3:
        time *= pick((1e-9, 1e-3, 0.1, 10.0, 1e4))
    elif trick == 4:
        time, values = time[first:last], values[first:last]
    elif trick == 5:
        values += pick((-300.0, 0.5, 50.0, 1e6))
    elif trick == 6:
        values = np.round(values / (step := pick((1e-6, 0.5, 5.0)))) * step
    else:
        rng.shuffle(values)
    return time, values


# --- tables -------------------------------------------------------------------------------------
_UNFOLDS = "".join(f'<!ENTITY a{k} "{f"&a{k - 1};" * 10}">' for k in range(1, 9))
_UNFOLDS = f'<!DOCTYPE b [<!ENTITY a0 "xxxxxxxxxx">{_UNFOLDS}]>'
_WORKBOOK = [(pattern, [_told(text).replace("{unfolds}", _UNFOLDS) for text in texts])
             for pattern, texts in _DATA["workbook"]]


def hostile_table(rng: random.Random) -> tuple[str, bytes]:
    """Name and content of a table of another logger: a drive and now and then what no sensor says,
    as text, workbook, MATLAB, HDF5 or Parquet, of which some bytes may be lies."""
    time = np.arange(60) * 0.1
    voltage = np.where((time > 1.0) & (time < 3.0), 5.0, 0.0)
    found = {"time [s]": time, "voltage [V]": voltage, "temperature [degC]": 23.0 + voltage}
    if rng.random() < 0.5:  # else the harm is in the file's format, or in what lies beside it
        for title in rng.sample(_TITLES, rng.choice((0, 1, 4))):
            found[title] = time if rng.random() < 0.5 else voltage
        chosen = rng.choice(list(found))
        found[chosen] = found[chosen].copy()
        found[chosen][rng.randrange(60) :: rng.choice((1, 2, 100))] = rng.choice(NUMBERS)
    kind = rng.choice(("csv", "csv", "xlsx", "mat", "h5", "parquet"))
    content = _WRITERS.get(kind, _other)(rng, found, kind)
    if kind != "csv" and rng.random() < 0.3:
        at = rng.randrange(4, len(content) - 8)
        lie = rng.choice((b"\xff\xff\xff\x7f", bytes(4), b"abcd"))
        content = content[:at] + lie + content[at + 4 :]
    return f"table.{kind}", content


def _csv(rng: random.Random, found: dict[str, np.ndarray], _: str) -> bytes:
    separator = rng.choice((",", ";", "\t", " ", ", "))
    rows = [list(found), *([f"{v:.9g}" for v in row] for row in np.column_stack([*found.values()]))]
    shape = rng.choice(("plain", "plain", "ragged", "wide", "long", "edited", "edited"))
    if shape == "ragged":
        rows[rng.randrange(len(rows)) :] = [["1"] * rng.choice((0, 1, 7, 3000))] * 3
    elif shape == "wide":
        rows = [row * rng.choice((300, 1100)) for row in rows]
    elif shape == "long":
        rows += rows[1:] * 300
    text = rng.choice(("\n", "\n", "\r\n", "\r")).join(separator.join(row) for row in rows)
    encoding = rng.choice(("utf-8", "utf-8", "utf-8-sig", "utf-16", "latin-1"))
    content = text.encode(encoding, "replace")
    return mutated(rng, content) if shape == "edited" else content


def _workbook(rng: random.Random, found: dict[str, np.ndarray], _: str) -> bytes:
    book = openpyxl.Workbook()
    book.active.append(["".join(c for c in title if c.isprintable()) for title in found])
    for row in zip(*found.values(), strict=True):
        book.active.append([float(value) for value in row])
    book.active["B2"].number_format = "yyyy-mm-dd"  # the style s="1" of the odd cells
    good, written = io.BytesIO(), io.BytesIO()
    book.save(good)
    with zipfile.ZipFile(good) as archive:
        parts = {name: archive.read(name).decode() for name in archive.namelist()}
    pattern, texts = rng.choice(_WORKBOOK)
    for name in parts if rng.random() < 0.7 else ():
        parts[name] = re.sub(pattern, rng.choice(texts), parts[name], count=1)
    with zipfile.ZipFile(written, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, text in parts.items():
            archive.writestr(name, text)
        if rng.random() < 0.1:
            archive.writestr("xl/media/a.png", bytes(rng.choice((1 << 20, 1 << 28))))
    return written.getvalue()


def _other(rng: random.Random, found: dict[str, Any], kind: str) -> bytes:
    """With an array that takes no room, a nest, or a link out of the file."""
    import h5py
    import pyarrow
    from pyarrow import parquet
    from scipy.io import savemat
    found = {re.sub(r"\W+", "_", title, flags=re.ASCII).strip("_0123456789")[:31] or "c": values
             for title, values in found.items()}  # fmt: skip
    is_large, is_odd = rng.random() < 0.3, rng.random() < 0.3
    written = io.BytesIO()
    if kind == "mat":
        found |= {"large": np.zeros(1 << 22)} if is_large else {}
        odd = rng.choice((np.zeros((3, 3, 3)), 1j * np.ones(9), "V", {"a": {"b": 1}}))
        savemat(written, found | ({"odd": odd} if is_odd else {}), do_compression=is_large)
    elif kind == "h5":
        with h5py.File(written, "w") as file:
            for title, values in found.items():
                file[title] = values
            if is_large:
                file.create_dataset("empty", (10**6, 10**6), "d", chunks=True)
            if is_odd:
                file["again"], file["self"] = file["/"], h5py.SoftLink("/self")
                file["out"] = h5py.ExternalLink("/etc/passwd", "/")
    else:
        if is_odd:
            found["odd"] = rng.choice((pyarrow.nulls(60), pyarrow.array([[1.0]] * 60)))
        found = dict.fromkeys(found, np.zeros(1 << 18)) if is_large else found
        parquet.write_table(pyarrow.table(found), written)
    return written.getvalue()


_WRITERS = {"csv": _csv, "xlsx": _workbook}


# --- Hostile bags.
MAGIC = b"\x89MCAP0\r\n"
_SUPER_JOURNAL = b"\xd9\xd5\x05\xf9\x20\xa1\x63\xd7"
_PAGE, _SECTOR = 4096, 512
TRICKS = _DATA["tricks"]


def small_bag(path: Path, storage: str) -> Path:
    write_record(path, [Signal("wire.voltage", "V", np.arange(20) * 0.1, np.ones(20))])
    if storage == "sqlite3":
        in_sqlite3(path)
    return path


def record(opcode: int, content: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(content)) + content


def message(channel: int, time: int, data: bytes) -> bytes:
    """A message record; `channel` counts from 1, in the order of the topics."""
    head = struct.pack("<HIQQ", channel, 0, time % 2**64, time % 2**64)
    return record(5, head + data)


def chunk(content: bytes, compressed: bool = True, size: int | None = None) -> bytes:
    """A chunk record, of `size` bytes as it says."""
    stored = zstandard.compress(content, 3) if compressed else content
    codec = b"zstd" if compressed else b""
    head = struct.pack("<QQQII", 0, 0, len(content) if size is None else size, 0, len(codec))
    return record(6, head + codec + struct.pack("<Q", len(stored)) + stored)


def journal_naming(db3: Path, victim: Path) -> Path:
    """A dead writer's journal with `victim`: SQLite deletes that file once it has rolled back."""
    pages = db3.stat().st_size // _PAGE
    head = struct.pack(">8sIIIII", _SUPER_JOURNAL, 0, 1, pages, _SECTOR, _PAGE)
    name = str(victim).encode()
    tail = struct.pack(">I", (1 << 30) // _PAGE + 1) + name
    tail += struct.pack(">II", len(name), sum(name)) + _SUPER_JOURNAL
    journal = db3.with_name(db3.name + "-journal")
    journal.write_bytes(head.ljust(_SECTOR, b"\0") + tail)
    return journal
