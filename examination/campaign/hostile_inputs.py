"""Inputs that keep the rules of their format and are made to harm, and the commands fed with them.

One maker a kind, each choosing by a `random.Random`.
"""

import contextlib
import io
import json
import math
import os
import random
import shutil
import sqlite3
import stat
import sys
import tempfile
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import yaml

from examination.bags import in_sqlite3
from examination.campaign.allowance import allowance
from examination.campaign.hostile_bags import (
    TOPICS,
    TRICKS,
    Cdr,
    chunk,
    journal_naming,
    mcap_of,
    message,
    named_joints,
    small_bag,
)
from examination.campaign.hostile_tables import hostile_table_file
from examination.campaign.outcome import Outcome
from examination.campaign.parser_seeds import (
    DIAGNOSIS,
    METADATA,
    PARAMETERS,
    RESULT,
    instrument_seeds,
)
from sma_bench.cli import LONGEST_LINE, main
from sma_bench.commands import terminal
from sma_bench.errors import InputError
from sma_bench.records import Record, contract, read_record
from sma_bench.records.bag_writer import write_record
from sma_bench.report.page import Picture

MEMORY = 1 << 30
_DRAWN_ONE_IN = 7
SECONDS = 10.0
_SHOWN = 160
_SHOWN_FAILURES = 5
VICTIM = "victim of a journal.txt"

NUMBERS = (
    0.0, -0.0, 1.0, 5.0, 25.0, 300.0, -1.0, 1e-300, 5e-324, 1e9, 1e38, 1e308, -1e308, math.inf,
    -math.inf, math.nan,
)  # fmt: skip
STAMPS = (-1, 0, 1, 10**9, 2**31 * 10**9 - 1, 2**62, 2**63 - 1, 2**64 - 1)
BASES = (0, 10**9, 1_700_000_000 * 10**9, (2**31 - 10) * 10**9)
STEPS = (0, 1, 10**6, 5 * 10**7, 10**8, 10**9, 3600 * 10**9)
NAMES = (
    "/bench/wire/power", "/other/wire/power", "/bench/\x1b[31mwire/power", "/bench/=1+1/power",
    "/bench/<b>&/temperature", "/bench/caf\udce9/power", "/bench/a\nb/temperature", "", "/",
    "/bench/" + "x" * 3000 + "/power", "/bench/../../etc/passwd", "/bench/$m_1^{/temperature",
    "/bench/wire/temperature", "/bench/\u202egnp/power",
)  # fmt: skip
TEXTS = (
    b"heat", b"\x1b]0;owned\x07", b"=1+1", b"<script>alert(1)</script>", b"\xff\xfe", b"a\r\nb",
    b"$\\frac{", b"x" * 5000, b"", b"{{7*7}}",
)  # fmt: skip
VALUES: tuple[Any, ...] = (
    None, True, 0, -1, 2**63, 10**400, 1e308, math.inf, math.nan, "", "nan", "\x1b[2J", "=1+1",
    "<<", "~", "x" * 3000, "\ud800", "/dev/zero", "../../x", [], {}, [[1, 2], [3]], {"": {"": 0}},
    {"<<": {"a": 1}}, ["a"] * 300, "2020-01-01", "0x" + "f" * 500, "!!python/none",
)  # fmt: skip


@dataclass(frozen=True)
class Case:
    """What the commands get: a record, result or table, and options; `tabled` are import's, None
    where there is nothing to import."""

    path: Path
    options: tuple[str, ...] = ()
    tabled: tuple[str, ...] | None = None


Maker = Callable[[random.Random, Path], Case]


# --- bags ---------------------------------------------------------------------------------------

_DRIVE = """name: drive
steps:
  - {kind: staircase, start: 0.0, stop: 4.0, increment: 1.0, dwell: 2.2}
"""
_RIG = Path(__file__).resolve().parents[2] / "config" / "wire_rig.yaml"


@cache
def drive() -> Record:
    """Eleven seconds of a wire at five voltages: enough to be identified and diagnosed."""
    with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stdout(io.StringIO()):
        protocol, bag = Path(folder, "drive.yaml"), Path(folder, "drive")
        protocol.write_text(_DRIVE)
        code = main([
            "simulate", "--protocol", str(protocol), "--params", str(_RIG), "--rate", "10",
            "--noise", "1", "--out", str(bag),
        ])  # fmt: skip
        if code:
            raise RuntimeError("the drive cannot be simulated")
        return read_record(bag)


def _good_bag(rng: random.Random, path: Path) -> Path:
    """Twenty readings, or the drive."""
    storage = rng.choice(("mcap", "sqlite3"))
    if rng.random() < 0.8:
        return small_bag(path, storage)
    write_record(path, list(drive().signals.values()))
    if storage == "sqlite3":
        in_sqlite3(path)
    return path


def hostile_drive(rng: random.Random, folder: Path) -> Case:
    """The drive, of which some readings, times or whole signals are not what a bench says."""
    signals = [s for s in drive().signals.values() if rng.random() < 0.9]
    for _ in range(rng.choice((1, 1, 2, 3)) if signals else 0):
        k = rng.randrange(len(signals))
        time, values = signals[k].time.copy(), signals[k].values.copy()
        first, last = sorted((rng.randrange(len(time)), rng.randrange(len(time))))
        trick = rng.randrange(9)
        if trick == 0:
            values[first] = rng.choice(NUMBERS)
        elif trick == 1:
            values[first:last] = rng.choice(NUMBERS)
        elif trick == 2:
            values *= rng.choice((0.0, -1.0, 1e-6, 1e3, 1e9, 1e30))
        elif trick == 3:
            time[first:] += rng.choice((0.5, 60.0, 86_400.0, 3e7, 1e9))
        elif trick == 4:
            time *= rng.choice((1e-9, 1e-3, 0.1, 10.0, 1e4))
        elif trick == 5:
            time, values = time[first:last], values[first:last]
        elif trick == 6:
            values += rng.choice((-300.0, 0.5, 50.0, 1e6))
        elif trick == 7:
            values = np.round(values / (step := rng.choice((1e-6, 0.5, 5.0)))) * step
        else:
            rng.shuffle(values)
        signals[k] = replace(signals[k], time=time, values=values)
    bag = folder / "bag"
    with np.errstate(over="ignore", invalid="ignore"):
        try:
            write_record(bag, signals)
            if rng.random() < 0.5:
                in_sqlite3(bag)
        except (ValueError, OverflowError, InputError):  # not to be written: the drive as it was
            shutil.rmtree(bag, ignore_errors=True)
            write_record(bag, list(drive().signals.values()))
    return Case(bag, ("--params", str(_RIG)) if rng.random() < 0.5 else ())


def _topics(rng: random.Random) -> list[tuple[str, str]]:
    topics = list(TOPICS)
    for _ in range(rng.choice((0, 0, 1, 3))):
        topics.insert(rng.randrange(len(topics)), (rng.choice(NAMES), rng.choice(TOPICS)[1]))
    return topics[: rng.choice((1, 3, len(topics)))]


def _series(rng: random.Random, msgtype: str) -> list[tuple[int, bytes]]:
    """Receive times and messages of one topic: a drive, and here and there what nobody expects."""
    count = rng.choice((0, 1, 2, 19, 40, 150))
    base, step, oddity = rng.choice(BASES), rng.choice(STEPS), rng.choice((0.0, 0.0, 0.02, 0.5))
    series = []
    for k in range(count):
        stamp = base + k * step
        level = 5.0 if k % 40 < 20 else 0.0
        if rng.random() < oddity:
            stamp = rng.choice((rng.choice(STAMPS), base - k * step, base + 10**18))
        if rng.random() < oddity:
            level = rng.choice(NUMBERS)
        received = rng.choice(STAMPS) if rng.random() < oddity else max(base + k * step, 0)
        series.append((received, _message(rng, msgtype, stamp, level, oddity)))
    return series


def _message(
    rng: random.Random, msgtype: str, stamp: int, level: float, oddity: float
) -> bytes:
    cdr = Cdr()
    if msgtype == contract.STRING:
        return bytes(cdr.text(rng.choice(TEXTS)))
    if msgtype == contract.MULTI_ARRAY:
        width = rng.choice((0, 1, 6, 300)) if rng.random() < oddity else 1
        return bytes(cdr.put("I", 0, 0).numbers([level] * width))
    cdr.header(stamp)
    if msgtype == contract.TEMPERATURE:
        cdr.put("d", 25.0 + 5.0 * level, 0.0)
    elif msgtype == contract.RANGE:
        cdr.put("B", 1).put("f", 0.1, 0.0, 1.0, _single(0.05 - 1e-3 * level), 0.0)
    elif msgtype == contract.JOINT_STATE:
        if rng.random() < oddity:
            return named_joints(rng.choice((0, 3, 1000, 100_000)))
        cdr.put("I", 2).text(b"tip").text(rng.choice((b"wire", b"tip", b"")))
        cdr.numbers([1e-3 * level] * 2).numbers([]).numbers([level] * rng.choice((0, 2)))
    else:
        cdr.put("f", _single(level), math.nan, _single(level / 3.0), *[math.nan] * 4)
        cdr.put("B", 0, 0, 0, 1).put("I", 0, 0).text(b"wire").text(b"")
    return bytes(cdr)


def _single(value: float) -> float:
    """What fits into 32 bits."""
    return value if not math.isfinite(value) or abs(value) < 3e38 else math.copysign(3e38, value)


def hostile_mcap(rng: random.Random, folder: Path) -> Case:
    """Messages in chunks that are nested, lie about their size, repeat, or unfold to a lot."""
    topics = _topics(rng)
    content = b"".join(
        message(number, time, data)
        for number, (_, msgtype) in enumerate(topics, 1)
        for time, data in _series(rng, msgtype)
    )
    shape = rng.choice(("plain", "chunk", "chunk", "twice", "nested", "size", "bomb"))
    if shape == "nested":
        for _ in range(rng.choice((1, 30, 1200))):
            content = chunk(content, compressed=False)
    elif shape == "bomb":
        run = message(rng.randrange(1, 8), 1, rng.choice((b"", bytes(4), bytes(60))))
        content += b"".join([chunk(run * 20_000)] * rng.choice((60, *[1] * 30)))
    elif shape != "plain":
        size = rng.choice((0, 1, 2**40, 2**64 - 1)) if shape == "size" else None
        content = chunk(content, rng.random() < 0.7, size) * (2 if shape == "twice" else 1)
    path = folder / "bag.mcap"
    path.write_bytes(mcap_of(content, topics=topics))
    return Case(path)


def hostile_sqlite(rng: random.Random, folder: Path) -> Case:
    """Tables with anything in them, views and virtual tables in their place, journals beside."""
    path = folder / "bag.db3"
    topics = _topics(rng)
    with contextlib.closing(sqlite3.connect(path)) as database:
        database.execute("CREATE TABLE topics (id, name, type, serialization_format, qos)")
        database.execute(
            "CREATE TABLE messages (id INTEGER PRIMARY KEY, topic_id, timestamp, data)"
        )
        for number, (name, msgtype) in enumerate(topics, 1):
            row = (number, name.encode("utf-8", "surrogateescape").decode("utf-8", "replace"))
            database.execute("INSERT INTO topics VALUES (?, ?, ?, 'cdr', '')", (*row, msgtype))
            database.executemany(
                "INSERT INTO messages (topic_id, timestamp, data) VALUES (?, ?, ?)",
                [(number, time % 2**63, data) for time, data in _series(rng, msgtype)],
            )
        trick = rng.randrange(3 * len(TRICKS))
        if trick < len(TRICKS):
            database.execute("DROP TABLE messages")
            database.execute(TRICKS[trick])
        for _ in range(rng.choice((0, 0, 2))):
            value = rng.choice(("x" * 100_000, -1, None, 1e308, b"", 2**63 - 1))
            column = rng.choice(("topic_id", "timestamp", "data"))
            with contextlib.suppress(sqlite3.Error):
                database.execute(f"UPDATE messages SET {column} = ? WHERE id % 7 = 3", (value,))
        database.commit()
    beside = rng.choice(("", "", "journal", "wal"))
    if beside == "journal":
        journal_naming(path, folder / VICTIM)
    elif beside:
        Path(f"{path}-wal").write_bytes(rng.randbytes(rng.choice((32, 5000))))
    return Case(path)


# --- documents ----------------------------------------------------------------------------------


def mutated(rng: random.Random, document: Any) -> Any:
    """A document with a few of its leaves, names or branches put in place of something else."""
    for _ in range(rng.choice((1, 1, 2, 4))):
        document = _one_changed(rng, document)
    return document


def _one_changed(rng: random.Random, node: Any) -> Any:
    if type(node) in (int, float) and abs(node) < 1e300 and rng.random() < 0.7:
        return node * rng.choice((0.5, 0.9, 1.1, 1.5, 3.0, 100.0, 1e-3))
    if not isinstance(node, (dict, list)) or not node or rng.random() < 0.15:
        return _deep(rng) if rng.random() < 0.1 else rng.choice(VALUES)
    if isinstance(node, list):
        k = rng.randrange(len(node))
        return [*node[:k], _one_changed(rng, node[k]), *node[k + 1 :]]
    key = rng.choice(list(node))
    if rng.random() < 0.2:
        return {**node, rng.choice(("", "\x1b", "<<", "=", "x" * 3000, "a.b", key)): node[key]}
    return {**node, key: _one_changed(rng, node[key])}


def _deep(rng: random.Random) -> Any:
    nest: Any = 0
    for _ in range(rng.choice((10, 100))):
        nest = [nest] if rng.random() < 0.5 else {"a": nest}
    return nest


def hostile_yaml(rng: random.Random, document: Any) -> str:
    """A mutated document as YAML: with anchors, merge keys, tags, or numbers beyond all measure."""
    text = str(yaml.safe_dump(mutated(rng, document), allow_unicode=False))
    return text + rng.choice((
        *[""] * 16, "zz: &a [1, 2]\nzy: *a\n", "zz: &a {b: 1}\nzy: {<<: *a}\n", "zz: !!set {a}\n",
        "zz: &a [*a]\n", "zz: " + "9" * 401 + "\n", "zz: 1e999\n", "zz: !!binary x\n", "...\n---\n",
        "zz: 1" + ":59" * 40 + "\n", "zz: " + "[" * 200 + "]" * 200 + "\n", "? [a]\n: b\n",
        "zz: " + "{a: " * 900 + "}" * 900 + "\n", 'zz: "\\uD800"\n', "zz: !!timestamp x\n",
    ))  # fmt: skip


def hostile_json(rng: random.Random, document: Any) -> str:
    """A mutated document as JSON, in which NaN, Infinity and half characters may stand."""
    text = json.dumps(mutated(rng, document))
    nested = "[" * 900 + text + "]" * 900
    return rng.choice((text, text, text, nested, f'{{"a": {text}}}', text * 2))


def hostile_metadata(rng: random.Random, folder: Path) -> Case:
    """A good bag whose metadata is not."""
    bag = _good_bag(rng, folder / "bag")
    (bag / "metadata.yaml").write_text(hostile_yaml(rng, yaml.safe_load(METADATA)))
    return Case(bag)


def hostile_parameters(rng: random.Random, folder: Path) -> Case:
    """A good bag, and parameters that are not."""
    (folder / "p.yaml").write_text(hostile_yaml(rng, yaml.safe_load(PARAMETERS)))
    bag = _good_bag(rng, folder / "bag")
    return Case(bag, ("--params", str(folder / "p.yaml")))


def hostile_result(rng: random.Random, folder: Path) -> Case:
    """A result of identify or diagnose, altered."""
    path = folder / "result.json"
    path.write_text(hostile_json(rng, rng.choice((RESULT, DIAGNOSIS))))
    return Case(path)


def hostile_table(rng: random.Random, folder: Path) -> Case:
    """A file of an instrument whose numbers, titles or units are altered."""
    name, content = rng.choice(instrument_seeds())
    tokens = content.split(b"\t")
    for _ in range(rng.choice((1, 2, 8))):
        tokens[rng.randrange(len(tokens))] = rng.choice((
            b"nan", b"1e308", b"-1e308", b"0", b"-5", b"1e-320", b"9" * 400, b"=1+1", b"\x1b[2J",
            b"inf", b"\xff", b"1\n2\t3", b"x" * 5000,
        ))  # fmt: skip
    path = folder / name
    path.write_bytes(b"\t".join(tokens) * rng.choice((1, 1, 1, 3)))
    return Case(path)


def hostile_import(rng: random.Random, folder: Path) -> Case:
    """A table of another logger, or what `import` takes with it."""
    path, options = hostile_table_file(rng, folder, hostile_yaml)
    return Case(path, tabled=options)


def hostile_place(rng: random.Random, folder: Path) -> Case:
    """A good bag of a hostile name; links, pipes and folders where files should be."""
    name = rng.choice((
        b"a\x1b[31mb", b"caf\xe9", b"a\nb", b"=1+1", b"<img src=x>", b"x" * 120, b"-rf", b"$m^{",
    ))  # fmt: skip
    bag = small_bag(folder / os.fsdecode(name), rng.choice(("mcap", "sqlite3")))
    storage = next(file for file in bag.iterdir() if file.name != "metadata.yaml")
    trick = rng.randrange(7)
    if trick == 0:
        (bag / "x.mcap").symlink_to(folder / VICTIM)
    elif trick == 1:
        storage.rename(folder / "moved")
        storage.symlink_to(folder / "moved")
    elif trick == 2:
        os.mkfifo(bag / "y.mcap")
    elif trick == 3:
        storage.unlink()
        storage.mkdir()
    elif trick == 4:
        (bag / "metadata.yaml").unlink()
        (bag / "metadata.yaml").symlink_to("metadata.yaml")
    elif trick == 5:
        os.mkfifo(folder / "pipe.mcap")
        return Case(folder / "pipe.mcap")
    return Case(bag)


MAKERS: dict[str, tuple[int, Maker]] = {
    "mcap": (4, hostile_mcap),
    "sqlite3": (4, hostile_sqlite),
    "drive": (1, hostile_drive),
    "metadata": (2, hostile_metadata),
    "parameters": (4, hostile_parameters),
    "result": (5, hostile_result),
    "instrument file": (5, hostile_table),
    "table of a logger": (6, hostile_import),
    "place": (1, hostile_place),
}


# --- the commands -------------------------------------------------------------------------------

COMMANDS: dict[str, Callable[[Case, Path], list[str]]] = {
    "info": lambda case, _: [],
    "identify": lambda case, out: [*case.options, "--out", str(out / "identified.yaml")],
    "diagnose": lambda case, out: [*case.options, "--out", str(out / "improved.yaml")],
    "report": lambda case, out: [*case.options, "--out", str(out / "report")],
    "import": lambda case, out: [*(case.tabled or ()), "--out", str(out / "imported")],
}
FOR_ALL = tuple(command for command in COMMANDS if command != "import")


def hostile_inputs(size: int, seed: int, folder: Path) -> list[Outcome]:
    """`size` inputs, each through all commands."""
    terminal.FIRST_LINE = 1e6  # said on a machine that is busy with something else
    names = [name for name, (weight, _) in MAKERS.items() for _ in range(weight)]
    tried: Counter[str] = Counter()
    results: dict[str, Counter[str]] = {name: Counter() for name in MAKERS}
    failures: dict[str, list[str]] = {name: [] for name in MAKERS}
    _warm_up(folder)
    for k in range(size):
        name = names[k % len(names)]
        rng = random.Random(f"{seed} {k}")
        tried[name] += 1
        for left in ("given", "out"):
            shutil.rmtree(folder / left, ignore_errors=True)
        with contextlib.nullcontext() if k % _DRAWN_ONE_IN == 0 else _undrawn():
            said, succeeded = try_case(MAKERS[name][1], rng, folder)
        results[name].update(succeeded)
        failures[name] += [f"input {k} of seed {seed}: {text}" for text in said]
        for text in said:
            print(f"{name}, input {k} of seed {seed}: {text}", file=sys.stderr, flush=True)
    return [
        Outcome(
            "hostile", f"well formed: {name}, through all commands", tried[name],
            f"failed {len(failures[name])}, results: "
            + (", ".join(f"{c} {results[name][c]}" for c in COMMANDS if results[name][c]) or "none")
            + "".join(f"; {text}" for text in failures[name][:_SHOWN_FAILURES]),
            "failed 0", not failures[name],
        )
        for name in MAKERS if tried[name]
    ]  # fmt: skip


@contextlib.contextmanager
def _undrawn() -> Iterator[None]:
    """Reports whose figures are put together but not rendered, which takes most of the time."""
    with mock.patch.object(Picture, "_file", lambda *_, **__: b""):
        yield


def _warm_up(folder: Path) -> None:
    """What the commands load, and compile once for a machine, is no input's fault."""
    bag = folder / "warm"
    write_record(bag, list(drive().signals.values()))
    table = folder / "warm.csv"
    rows = "".join(f"{k},{k % 5},{20 + k}\n" for k in range(20))
    table.write_text("time [s],voltage [V],temperature [degC]\n" + rows)
    for command in FOR_ALL:
        run_command(command, Case(bag, ("--params", str(_RIG))), folder / "out", 600.0)
    said, code = run_command("import", Case(table, tabled=()), folder / "out", 600.0)
    assert not said and code == 0, f"import of a plain table ends with {code}: {said}"


def try_case(maker: Maker, rng: random.Random, folder: Path) -> tuple[list[str], list[str]]:
    """What went wrong with one input, and the commands that had a result."""
    given, out = folder / "given", folder / "out"
    given.mkdir(parents=True)
    out.mkdir()
    (given / VICTIM).write_text("nobody may change this\n")
    case = maker(rng, given)
    before = _everything(given)
    failures, results = [], []
    for command in FOR_ALL if case.tabled is None else COMMANDS:
        text, code = run_command(command, case, out)
        failures += [f"{command}: {text}"] if text else []
        results += [command] if code == 0 else []
        if (after := _everything(given)) != before:
            changed = sorted(str(p) for p in {*after, *before} if after.get(p) != before.get(p))
            failures.append(f"{command}: changed {', '.join(changed)[:_SHOWN]}")
            before = after
    if "import" in results:  # what was imported is a bag like any other
        text, code = run_command("info", Case(out / "imported"), out)
        failures += [f"info of what was imported: {text}"] if text or code else []
    return failures, results


def run_command(
    command: str, case: Case, out: Path, seconds: float = SECONDS
) -> tuple[str, int]:
    """What is wrong with what a command did, "" for nothing, and its exit code."""
    told, errors = io.StringIO(), io.StringIO()
    arguments = [command, *COMMANDS[command](case, out), "--", str(case.path)]
    try:
        with (
            allowance(MEMORY, seconds), warnings.catch_warnings(),
            contextlib.redirect_stdout(told), contextlib.redirect_stderr(errors),
        ):  # fmt: skip
            code = main(arguments)
    except Exception as error:  # that is what is looked for
        return f"{type(error).__name__}: {str(error)[:_SHOWN]!r}", 1
    lines = [
        line for line in errors.getvalue().splitlines() if not line.startswith("sma-bench: note:")
    ]
    if code not in (0, 2) or (code == 2 and len(lines) != 1):
        return f"ends with {code} and {len(lines)} lines {lines[:2]!r:.{_SHOWN}}", code
    if lines and max(map(len, lines)) > LONGEST_LINE + 20:
        return f"says a line of {max(map(len, lines))} characters", code
    both = told.getvalue() + errors.getvalue()
    odd = next((line for line in both.split("\n") if not line.isprintable()), "")
    return (f"prints {odd[:_SHOWN]!r}" if odd else ""), code


def _everything(folder: Path) -> dict[Path, tuple[int, bytes | str]]:
    found: dict[Path, tuple[int, bytes | str]] = {}
    for path in folder.rglob("*"):
        mode = path.lstat().st_mode
        content: bytes | str = path.read_bytes() if stat.S_ISREG(mode) else ""
        found[path] = mode, os.readlink(path) if stat.S_ISLNK(mode) else content
    return found
