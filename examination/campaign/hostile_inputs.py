"""Inputs that keep the rules of their format and are made to harm, the commands fed with them, the
parsers fed with good inputs whose bytes are edited, and disks that fill up."""

import contextlib
import io
import logging
import os
import random
import resource
import shutil
import sqlite3
import stat
import subprocess
import sys
import warnings
from collections import namedtuple
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path
from unittest import mock

import numpy as np
import yaml

import sma_bench
from examination.bags import in_sqlite3
from examination.campaign import mutations
from examination.check.bags import HABITS, Stream, write_bag
from examination.pieces import Outcome, allowance
from sma_bench.cli import LONGEST_LINE, main
from sma_bench.commands import terminal
from sma_bench.commands.answers import MISFIT
from sma_bench.errors import InputError
from sma_bench.parameters import Parameters, write_parameters
from sma_bench.records import Record, Signal, read_record
from sma_bench.records.bag_writer import BagWriter, streams_of, write_record
from sma_bench.report.page import Picture

MEMORY, SECONDS = 1 << 30, 10.0
_DRAWN_ONE_IN = 7
_SHOWN, _SHOWN_FAILURES = 160, 5
VICTIM = "victim of a journal.txt"
_STAMPS = (0, 1, 10**9, 2**31 * 10**9 - 1)


# What commands get: record, result or table, options; of import None where nothing is.
Case = namedtuple("Case", "path options tabled", defaults=((), None))
Maker = Callable[[random.Random, Path], Case]


# --- bags ---------------------------------------------------------------------------------------
_RIG = Path(__file__).resolve().parents[2] / "config" / "wire_rig.yaml"


@cache
def drive() -> Record:
    """Eleven seconds of a wire at five voltages: enough to be identified and diagnosed."""
    run = sma_bench.simulate(mutations.FOLDER / "drive.yaml", _RIG, rate=10.0)
    return sma_bench.measure(run, seed=1)


def hostile_drive(rng: random.Random, folder: Path) -> Case:
    """The drive, of which some readings, times, signals or bytes are not what a bench says."""
    signals = [s for s in drive().signals.values() if rng.random() < 0.9]
    for _ in range(rng.choice((0, 1, 1, 2, 3)) if signals else 0):
        k = rng.randrange(len(signals))
        if len(signals[k]) > 1:
            time, values = mutations.changed_series(rng, signals[k].time, signals[k].values)
            signals[k] = replace(signals[k], time=time, values=values)
    bag = folder / "bag"
    with np.errstate(over="ignore", invalid="ignore"):
        try:
            write_record(bag, signals)
        except (ValueError, OverflowError, InputError):  # not to be written: the drive as it was
            shutil.rmtree(bag, ignore_errors=True)
            write_record(bag, list(drive().signals.values()))
    if rng.random() < 0.5:
        in_sqlite3(bag)
    if rng.random() < 0.4:
        storage = next(file for file in bag.iterdir() if file.name != "metadata.yaml")
        storage.write_bytes(mutations.mutated(rng, storage.read_bytes(), most=2))
    return Case(bag, ("--params", str(_RIG)) if rng.random() < 0.5 else ())


def _altered_bag(rng: random.Random, folder: Path, **habits: str) -> Path:
    """A bag's storage file with names, numbers and times that nobody expects."""

    def alter(streams: list[Stream]) -> None:
        for s in streams:
            s.topic = rng.choice(mutations.TOPICS) if rng.random() < 0.2 else s.topic
            some = slice(rng.randrange(len(s.stamp)), None, rng.choice((1, 7, 1000)))
            for values in s.fields.values() if rng.random() < 0.3 else ():
                with np.errstate(over="ignore"):  # some messages have 32 bits for it
                    values[some] = np.float32(rng.choice(mutations.NUMBERS))
            if rng.random() < 0.3:
                s.stamp[some] = rng.choice(_STAMPS)
            if rng.random() < 0.3:
                s.received[some] = rng.choice((*_STAMPS, 2**62, 2**63 - 1))

    plain = {kind: names[0] for kind, names in HABITS.items()}
    random_too = np.random.default_rng(rng.getrandbits(32))
    return write_bag(folder, random_too, plain | habits | {"path": "file"}, alter).path


def hostile_mcap(rng: random.Random, folder: Path) -> Case:
    """Messages in chunks that are nested, lie about their size, repeat, or unfold to a lot."""
    path = _altered_bag(rng, folder, inside="no chunks", end="not closed")
    content = path.read_bytes()[len(mutations.MAGIC) :]
    shape = rng.choice(("plain", "edited", "chunk", "chunk", "twice", "nested", "size", "bomb"))
    if shape == "edited":
        content = mutations.mutated(rng, content)
    elif shape == "nested":
        for _ in range(rng.choice((1, 30, 1200))):
            content = mutations.chunk(content, compressed=False)
    elif shape == "bomb":
        run = mutations.message(rng.randrange(1, 8), 1, rng.choice((b"", bytes(4), bytes(60))))
        content += b"".join([mutations.chunk(run * 20_000)] * rng.choice((60, *[1] * 30)))
    elif shape != "plain":
        size = rng.choice((0, 1, 2**40, 2**64 - 1)) if shape == "size" else None
        content = mutations.chunk(content, rng.random() < 0.7, size)
        content *= 2 if shape == "twice" else 1
    path.write_bytes(mutations.MAGIC + content)
    return Case(path)


def hostile_sqlite(rng: random.Random, folder: Path) -> Case:
    """Tables with anything in them, views and virtual tables in their place, journals beside."""
    path = _altered_bag(rng, folder, storage="sqlite3")
    with contextlib.closing(sqlite3.connect(path)) as database:
        trick = rng.randrange(3 * len(mutations.TRICKS))
        if trick < len(mutations.TRICKS):
            database.execute("DROP TABLE messages")
            database.execute(mutations.TRICKS[trick])
        for _ in range(rng.choice((0, 0, 2))):
            value = rng.choice(("x" * 100_000, -1, None, 1e308, b"", 2**63 - 1))
            column = rng.choice(("topic_id", "timestamp", "data"))
            with contextlib.suppress(sqlite3.Error):
                database.execute(f"UPDATE messages SET {column} = ? WHERE id % 7 = 3", (value,))
        database.commit()
    beside = rng.choice(("", "", "journal", "wal"))
    if beside == "journal":
        mutations.journal_naming(path, folder / VICTIM)
    elif beside:
        Path(f"{path}-wal").write_bytes(rng.randbytes(rng.choice((32, 5000))))
    return Case(path)


# --- other files --------------------------------------------------------------------------------
def hostile_yaml(rng: random.Random, folder: Path) -> Case:
    """Twenty readings or the drive, whose metadata or parameters are altered."""
    bag, storage = folder / "bag", rng.choice(("mcap", "sqlite3"))
    if rng.random() < 0.8:
        mutations.small_bag(bag, storage)
    else:
        write_record(bag, list(drive().signals.values()))
        if storage == "sqlite3":
            in_sqlite3(bag)
    good, path = mutations.PARAMETERS, folder / "p.yaml"
    if rng.random() < 0.3:
        good, path = mutations.METADATA, bag / "metadata.yaml"
    path.write_bytes(mutations.hostile_document(rng, good))
    return Case(bag, ("--params", str(path)) if path.parent == folder else ())


def hostile_result(rng: random.Random, folder: Path) -> Case:
    """A result of identify or diagnose, altered."""
    path, good = folder / "result.json", rng.choice((mutations.RESULT, mutations.DIAGNOSIS))
    path.write_bytes(mutations.hostile_document(rng, good, is_json=True))
    return Case(path)


def hostile_instrument(rng: random.Random, folder: Path) -> Case:
    """A file of an instrument whose numbers, titles or units are altered."""
    parser = rng.choice(mutations.parsers()[:4])
    content = mutations.mutated(rng, parser.good, rng.choice((1, 2, 8))) * rng.choice((1, 1, 1, 3))
    (folder / parser.file).write_bytes(content)
    return Case(folder / parser.file)


def hostile_import(rng: random.Random, folder: Path) -> Case:
    """A table of another logger, of two in five with a rig file or a map beside it."""
    name, content = mutations.hostile_table(rng)
    (folder / name).write_bytes(content)
    beside = rng.choice(("", "", "", "--params", "--map"))
    if not beside:
        return Case(folder / name, tabled=())
    document = mutations.MAP if beside == "--map" else mutations.PARAMETERS
    is_hostile, good = rng.random() < 0.8, yaml.safe_dump(document).encode()
    hostile = mutations.hostile_document(rng, document) if is_hostile else good
    (folder / "beside.yaml").write_bytes(hostile)
    return Case(folder / name, tabled=(beside, str(folder / "beside.yaml")))


def hostile_place(rng: random.Random, folder: Path) -> Case:
    """A good bag of a hostile name; links, pipes and folders where files should be."""
    name = os.fsdecode(rng.choice(mutations.PLACES).encode("latin-1"))
    bag = mutations.small_bag(folder / name, rng.choice(("mcap", "sqlite3")))
    storage = next(file for file in bag.iterdir() if file.name != "metadata.yaml")
    trick = rng.choice(("", "link in", "link out", "pipe", "folder", "circle", "pipe alone"))
    if trick == "link in":
        (bag / "x.mcap").symlink_to(folder / VICTIM)
    elif trick == "link out":
        storage.rename(folder / "moved")
        storage.symlink_to(folder / "moved")
    elif trick == "pipe":
        os.mkfifo(bag / "y.mcap")
    elif trick == "folder":
        storage.unlink()
        storage.mkdir()
    elif trick == "circle":
        (bag / "metadata.yaml").unlink()
        (bag / "metadata.yaml").symlink_to("metadata.yaml")
    elif trick:
        os.mkfifo(folder / "pipe.mcap")
        return Case(folder / "pipe.mcap")
    return Case(bag)


MAKERS: dict[str, tuple[int, Maker]] = {
    "mcap": (4, hostile_mcap), "sqlite3": (4, hostile_sqlite), "drive": (1, hostile_drive),
    "metadata, parameters": (6, hostile_yaml), "result": (5, hostile_result),
    "instrument file": (5, hostile_instrument), "table of a logger": (6, hostile_import),
    "place": (1, hostile_place)}


# --- the commands -------------------------------------------------------------------------------
COMMANDS: dict[str, Callable[[Case, Path], list[str]]] = {
    "info": lambda case, _: [],
    "identify": lambda case, out: [*case.options, "--out", str(out / "identified.yaml")],
    "diagnose": lambda case, out: [*case.options, "--out", str(out / "improved.yaml")],
    "report": lambda case, out: [*case.options, "--out", str(out / "report")],
    "import": lambda case, out: [*(case.tabled or ()), "--out", str(out / "imported")]}
FOR_ALL = tuple(command for command in COMMANDS if command != "import")


def hostile_inputs(size: int, seed: int, folder: Path) -> list[Outcome]:
    """`size` inputs, each through all commands."""
    terminal.FIRST_LINE = 1e6  # said on a machine that is busy with something else
    most = max(weight for weight, _ in MAKERS.values())  # one of each kind first
    names = [name for k in range(most) for name, (weight, _) in MAKERS.items() if k < weight]
    tried: list[tuple[str, list[str], list[str]]] = []  # kind, failures, commands with a result
    _warm_up(folder)
    for k in range(size):
        name, rng = names[k % len(names)], random.Random(f"{seed} {k}")
        for left in ("given", "out"):
            shutil.rmtree(folder / left, ignore_errors=True)
        # Figures are put together but not rendered, which takes most of the time.
        undrawn = mock.patch.object(Picture, "_file", lambda *_, **__: b"")
        with contextlib.nullcontext() if k % _DRAWN_ONE_IN == 0 else undrawn:
            said, succeeded = try_case(MAKERS[name][1], rng, folder)
        said = [f"input {k} of seed {seed}: {text}" for text in said]
        print(*(f"{name}, {text}\n" for text in said), sep="", end="", file=sys.stderr, flush=True)
        tried.append((name, said, succeeded))
    outcomes = []
    for name in dict.fromkeys(name for name, *_ in tried):
        own = [one for one in tried if one[0] == name]
        failures = [text for _, said, _ in own for text in said]
        results = [command for *_, succeeded in own for command in succeeded]
        counts = [f"{n} {command}" for command in COMMANDS if (n := results.count(command))]
        lines = [f"failed {len(failures)}, results: {', '.join(counts) or 'none'}"]
        found = "; ".join(lines + failures[:_SHOWN_FAILURES])
        what = f"well formed: {name}, through all commands"
        outcomes.append(Outcome("hostile", what, len(own), found, "failed 0", not failures))
    return outcomes


def _warm_up(folder: Path) -> None:
    """What the commands load, and compile once for a machine, is no input's fault."""
    bag, table = folder / "warm", folder / "warm.csv"
    write_record(bag, list(drive().signals.values()))
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


def run_command(command: str, case: Case, out: Path, seconds: float = SECONDS) -> tuple[str, int]:
    """What is wrong with what a command did, "" for nothing, and its exit code."""
    told, errors = io.StringIO(), io.StringIO()
    arguments = [command, *COMMANDS[command](case, out), "--", str(case.path)]
    try:
        with (allowance(MEMORY, seconds), warnings.catch_warnings(),
              contextlib.redirect_stdout(told), contextlib.redirect_stderr(errors)):
            code = main(arguments)
    except Exception as error:  # that is what is looked for
        return f"{type(error).__name__}: {str(error)[:_SHOWN]!r}", 1
    said = errors.getvalue().splitlines()
    lines = [line for line in said if not line.startswith("sma-bench: note:")]
    if code not in (0, 2, MISFIT) or (code == 2 and len(lines) != 1):
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


# --- the parsers --------------------------------------------------------------------------------
def try_input(parser: mutations.Parser, content: bytes, folder: Path) -> str:
    """What went wrong with one input, or ""."""
    path = folder / parser.file
    path.write_bytes(content)
    try:
        with allowance(MEMORY, SECONDS), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            parser.read(path)
    except InputError as error:
        return "" if "\n" not in str(error) else f"more than one line: {str(error)[:_SHOWN]!r}"
    except Exception as error:  # that is what is looked for
        return f"{type(error).__name__}: {str(error)[:_SHOWN]!r}"
    return ""


def edited_inputs(size: int, seed: int, folder: Path) -> list[Outcome]:
    """`size` edited inputs for every parser, and the good one."""
    logging.disable(logging.WARNING)
    folder.mkdir(parents=True, exist_ok=True)
    outcomes = []
    for parser in mutations.parsers():
        rng = random.Random(f"{seed} {parser.name}")
        inputs = [parser.good, *(mutations.mutated(rng, parser.good) for _ in range(size))]
        tried = [(try_input(parser, content, folder), content) for content in inputs]
        wrong = [f"{text} at {content[:_SHOWN]!r}" for text, content in tried if text]
        outcomes.append(Outcome.of("parsers", f"edited: {parser.name}", size, wrong))
    logging.disable(logging.NOTSET)
    return outcomes


# --- a disk that fills up: one line, what was written stays readable, good files stay good --------
_SMALLEST, _LARGEST = 30_000, 600_000  # bytes
_MANY, _PER_FLUSH = 200_000, 40  # messages


@contextlib.contextmanager
def small_disk(folder: Path, size: int) -> Iterator[str]:
    """`folder` with room for `size` bytes; whether a file system or a limit on files."""
    folder.mkdir(parents=True)
    command = ["mount", "-t", "tmpfs", "-o", f"size={size}", "sma_bench_full_disk", str(folder)]
    root = os.geteuid() == 0 and shutil.which("mount") is not None
    if root and subprocess.run(command, capture_output=True, check=False).returncode == 0:
        try:
            yield "tmpfs"
        finally:
            subprocess.run(["umount", "-l", str(folder)], check=True)
            folder.rmdir()
        return
    before, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield "limit on files"
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (before, hard))
        shutil.rmtree(folder)


def full_disk(size: int, seed: int, folder: Path) -> list[Outcome]:
    """Fill `size` disks of random sizes with a bag, and as many with each command's files."""
    rng, bags, commands = random.Random(seed), [], []
    for number in range(size):
        with small_disk(folder / f"bag_{number}", rng.randrange(_SMALLEST, _LARGEST)) as kind:
            bags.append(_fill_with_a_bag(folder / f"bag_{number}" / "bag"))
        for command in _WRITING:
            with small_disk(folder / f"out_{number}", rng.randrange(1, 4) * 4096):
                found = _fill_with(command, folder / f"out_{number}")
                commands.append(f"{command}: {found}" if found else "")
    return [
        Outcome.of("disk", f"{what} ({kind})", len(wrong), wrong)
        for what, wrong in (("recorder's bag fills the disk", bags),
                            (", ".join(_WRITING), commands))  # fmt: skip
    ]


def _fill_with_a_bag(path: Path) -> str:
    """What went wrong, or ""."""
    noise = np.random.default_rng(0).normal(300.0, 10.0, _MANY)
    signal = Signal("wire.temperature", "K", np.arange(_MANY) * 0.01, noise)
    ((topic, msgtype, received, blobs),) = streams_of({signal.name: signal}, "/bench/", 10**18)
    safe = 0
    try:
        bag = BagWriter(path, flush_every=float("inf"))
        bag.add_topic(topic, msgtype)
        for number, (stamp, blob) in enumerate(zip(received, blobs, strict=True), 1):
            bag.write(topic, int(stamp), blob)
            if number % _PER_FLUSH == 0:
                bag.flush()
                safe = number
    except InputError as error:
        if "\n" in str(error) or "cannot be written" not in str(error):
            return f"says {error!s:.80}"
    except Exception as error:  # that is what is looked for
        return f"{type(error).__name__}: {error}"
    else:
        return "the disk never filled"
    finally:
        with contextlib.suppress(InputError, UnboundLocalError):
            bag.close()
    try:
        found = read_record(path)["wire.temperature"].values
    except InputError as error:
        return f"{safe} messages were flushed, but: {error}" if safe else ""
    if len(found) < safe or (np.abs(found[:safe] - noise[:safe]) > 1e-9).any():
        return f"{safe} messages were flushed, {len(found)} are read"
    return ""


# Commands that write more than these disks hold; `good` is a good file on them.
_WRITING = {"simulate": "--params {params} --protocol quick_ramp --out {disk}/bag",
             "simulate --json": "{disk}/good --protocol quick_ramp --out {beside}/bag --force",
             "parameters": "--params {params} --out {disk}/good --force"}  # fmt: skip


def _fill_with(command: str, disk: Path) -> str:
    """What went wrong, or "": a command's file or bag on a full disk, over a good file."""
    (disk / "good").write_text("good")
    # Take what room the disk has left; with a limit on files there is no need.
    with (disk / "ballast").open("wb", buffering=0) as file, contextlib.suppress(OSError):
        for _ in range(1000):
            file.write(bytes(4096))
    beside = disk.parent / f"{disk.name}_beside"
    shutil.rmtree(beside, ignore_errors=True)
    beside.mkdir()
    params, said = beside / "params.yaml", io.StringIO()
    write_parameters(params, Parameters.defaults())
    with contextlib.redirect_stderr(said), contextlib.redirect_stdout(io.StringIO()):
        try:
            rest = _WRITING[command].split()
            words = [word.format(params=params, beside=beside, disk=disk) for word in rest]
            status = main([*command.split(), *words])
        except Exception as error:  # that is what is looked for
            return f"{type(error).__name__}: {error}"
    # What takes its time says how far it is.
    lines = [line for line in said.getvalue().splitlines() if "cannot" in line or "Error" in line]
    if status != 2 or len(lines) != 1:
        return f"status {status}, says {said.getvalue()[-200:]!r}"
    if (disk / "good").read_text() != "good":
        return "the good file is damaged"
    left = sorted(p.name for p in disk.iterdir() if p.name not in ("good", "ballast", "bag"))
    return f"leaves {', '.join(left)}" if left else ""
