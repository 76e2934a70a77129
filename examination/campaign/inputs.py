"""Good inputs of each kind, functions that make their bytes, documents and readings hostile, and
trials of the parsers and of every command with them."""

import contextlib
import io
import json
import logging
import math
import random
import shutil
import sys
import warnings
from collections import namedtuple
from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import yaml

import sma_bench
from examination.bags import in_sqlite3
from examination.campaign import Outcome, counted
from examination.pieces import allowance
from sma_bench.cli import LONGEST_LINE, main
from sma_bench.commands.answers import MISFIT
from sma_bench.errors import InputError
from sma_bench.hardware.serial_messages import ProtocolError, Splitter, decode, line
from sma_bench.nodes.start import check_arguments
from sma_bench.parameters import Parameters, read_parameters
from sma_bench.protocols import TEMPERATURE, load_protocol
from sma_bench.records import Record, Signal, open_record, read_record
from sma_bench.records.bag_writer import write_record
from sma_bench.report.page import Picture
from sma_bench.report.reports import read_result

MEMORY, SECONDS = 1 << 30, 10.0
_DRAWN_ONE_IN, _SHOWN = 7, 160

# --- Good inputs.
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


# A parser: its name, a good input, the reading function, and a file name.
Parser = namedtuple("Parser", "name good read file", defaults=("input.txt",))


def _node_arguments(file: Path) -> None:
    """Read a parameter file as a node does, and each of its lines as -p name:=value."""
    check_arguments("experiment", ["--ros-args", "--params-file", str(file)])
    for text in file.read_text(encoding="utf-8", errors="replace").splitlines():
        name, _, value = text.strip().partition(": ")
        check_arguments("experiment", ["--ros-args", "-p", f"{name}:={value}"])


def _serial(file: Path) -> None:
    """Read a serial stream in pieces: lines and frames, then bodies; a ProtocolError is fine."""
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
    """Every parser of data from outside; the first four are of instrument files."""
    wire = Parameters.defaults()
    of_reference = partial(load_protocol, parameters=wire, quantity=TEMPERATURE)
    return (
        Parser("calorimeter, Pyris", GOOD["pyris.txt"], open_record, "pyris.txt"),
        Parser("calorimeter, TA", GOOD["ta.txt"], open_record, "ta.txt"),
        Parser("isobaric test", GOOD["isobaric.txt"], open_record, "100 MPa.txt"),
        Parser("tensile test", GOOD["tensile.txt"], open_record, "tensile.txt"),
        Parser("parameter file", GOOD["parameters.yaml"], read_parameters),
        Parser("parameters of a node", GOOD["parameters.yaml"], _node_arguments),
        Parser("protocol", GOOD["protocol.yaml"], lambda p: load_protocol(p, wire), "input.yaml"),
        Parser("reference", GOOD["reference.yaml"], of_reference, "input.yaml"),
        Parser("metadata of a bag", GOOD["metadata.yaml"], lambda p: read_record(p.parent),
               "metadata.yaml"),
        Parser("result", GOOD["result.json"], read_result, "input.json"),
        Parser("serial bytes", _SERIAL, _serial))


# --- Hostile inputs.
NUMBERS = (0.0, -0.0, 1.0, 5.0, 25.0, 300.0, -1.0, 1e-300, 5e-324, 1e9, 1e38, 1e308, -1e308,
           math.inf, -math.inf, math.nan)  # fmt: skip


_ENTRIES = yaml.safe_load(Path(__file__).with_name("hostile.yaml").read_text(encoding="utf-8"))
TRIPWIRES = [(e if isinstance(e, str) else e[0] + e[1] * e[2] + e[3]).encode("latin-1")
             for e in _ENTRIES]  # fmt: skip
_VALUES: tuple[Any, ...] = (None, True, 0, -1, 2**63, 10**400, 1e308, math.inf, math.nan, "", "nan",
                            "\x1b[2J", "=1+1", "<<", "~", "x" * 3000, "\ud800", "/dev/zero",
                            "../../x", [], {}, [[1, 2], [3]], {"": {"": 0}}, {"<<": {"a": 1}},
                            ["a"] * 300, "2020-01-01", "0x" + "f" * 500, "!!python/none")
EDITS = ("cut", "drop", "twice", "insert", "replace", "replace")


def edited(content: bytes, edits: list[tuple[str, float, int, bytes]]) -> bytes:
    """Apply edits at places (0 to 1): cut, drop, repeat or insert `n` bytes, replace a token."""
    for kind, place, n, payload in edits:
        at = int(place * (len(content) + 1))
        end = at + n
        if kind == "replace":  # a whole token, as a mistake of a file's author
            end = at
            while end < len(content) and content[end : end + 1] not in b" \t\n,:{}[]":
                end += 1
        content = {"cut": content[:at], "drop": content[:at] + content[end:],
                   "twice": content[:end] + content[at:],
                   "insert": content[:at] + payload + content[at:],
                   "replace": content[:at] + payload + content[end:]}[kind]
    return content


def mutated(rng: random.Random, content: bytes, most: int = 5) -> bytes:
    """The bytes after one to `most` random edits."""
    return edited(content, [(rng.choice(EDITS), rng.random(), rng.choice((1, 2, 4, 8, 40, 512)),
                             rng.choice((*TRIPWIRES, rng.randbytes(4))))
                            for _ in range(rng.randint(1, most))])


# --- documents ----------------------------------------------------------------------------------
def changed(rng: random.Random, node: Any) -> Any:
    """A document in which a leaf, a name or a branch is replaced."""
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
    """A changed document as YAML or JSON; in one of three, bytes are edited, too."""
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
    """Times and values of a sensor, one of them impossible."""
    time, values, pick = time.copy(), values.copy(), rng.choice
    first, last = sorted((rng.randrange(len(time)), rng.randrange(len(time))))
    trick = pick(("set", "scaled", "gap", "paced", "cut", "shifted", "rounded"))
    if trick == "set":
        values[first : pick((first + 1, last))] = pick(NUMBERS)
    elif trick == "scaled":
        values *= pick((0.0, -1.0, 1e-6, 1e3, 1e9, 1e30))
    elif trick == "gap":
        time[first:] += pick((0.5, 60.0, 86_400.0, 3e7, 1e9))
    elif trick == "paced":
        time *= pick((1e-9, 1e-3, 0.1, 10.0, 1e4))
    elif trick == "cut":
        time, values = time[first:last], values[first:last]
    elif trick == "shifted":
        values += pick((-300.0, 0.5, 50.0, 1e6))
    else:
        values = np.round(values / (step := pick((1e-6, 0.5, 5.0)))) * step
    return time, values


# --- Cases: input and options of commands; the options of import are None if it is not a table.
Case = namedtuple("Case", "path options tabled", defaults=((), None))
_RIG = Path(__file__).resolve().parents[2] / "config" / "wire_rig.yaml"


@cache
def drive() -> Record:
    """Eleven seconds of a wire at five voltages: enough to be identified and diagnosed."""
    return sma_bench.measure(sma_bench.simulate(FOLDER / "drive.yaml", _RIG, rate=10.0), seed=1)


def _bag(rng: random.Random, bag: Path, signals: list[Signal]) -> Path:
    write_record(bag, signals)
    if rng.random() < 0.5:
        in_sqlite3(bag)
    return bag


def hostile_drive(rng: random.Random, folder: Path) -> Case:
    """The drive, with some impossible readings, times, signals or bytes."""
    signals = [s for s in drive().signals.values() if rng.random() < 0.9]
    for _ in range(rng.choice((0, 1, 1, 2, 3)) if signals else 0):
        k = rng.randrange(len(signals))
        if len(signals[k]) > 1:
            time, values = changed_series(rng, signals[k].time, signals[k].values)
            signals[k] = replace(signals[k], time=time, values=values)
    with np.errstate(over="ignore", invalid="ignore"):
        try:
            bag = _bag(rng, folder / "bag", signals)
        except (ValueError, OverflowError, InputError):  # cannot be written: take the good one
            shutil.rmtree(folder / "bag", ignore_errors=True)
            bag = _bag(rng, folder / "bag", list(drive().signals.values()))
    if rng.random() < 0.4:
        storage = next(file for file in bag.iterdir() if file.name != "metadata.yaml")
        storage.write_bytes(mutated(rng, storage.read_bytes(), most=2))
    return Case(bag, ("--params", str(_RIG)) if rng.random() < 0.5 else ())


def hostile_yaml(rng: random.Random, folder: Path) -> Case:
    """A bag whose metadata, or the parameters with it, are altered."""
    bag = _bag(rng, folder / "bag", list(drive().signals.values()))
    good, path = PARAMETERS, folder / "p.yaml"
    if rng.random() < 0.3:
        good, path = METADATA, bag / "metadata.yaml"
    path.write_bytes(hostile_document(rng, good))
    return Case(bag, ("--params", str(path)) if path.parent == folder else ())


def hostile_result(rng: random.Random, folder: Path) -> Case:
    """A result of identify or diagnose, altered."""
    path = folder / "result.json"
    path.write_bytes(hostile_document(rng, rng.choice((RESULT, DIAGNOSIS)), is_json=True))
    return Case(path)


def hostile_instrument(rng: random.Random, folder: Path) -> Case:
    """A file of an instrument whose numbers, titles or units are altered."""
    parser = rng.choice(parsers()[:4])
    content = mutated(rng, parser.good, rng.choice((1, 2, 8))) * rng.choice((1, 1, 1, 3))
    (folder / parser.file).write_bytes(content)
    return Case(folder / parser.file)


def hostile_table(rng: random.Random, folder: Path) -> Case:
    """A table of another logger that is altered, or the map with it."""
    path, beside = folder / "table.csv", folder / "map.yaml"
    path.write_bytes(mutated(rng, GOOD["table.csv"]) if rng.random() < 0.7 else GOOD["table.csv"])
    beside.write_bytes(hostile_document(rng, MAP))
    return Case(path, tabled=("--map", str(beside)) if rng.random() < 0.4 else ())


MAKERS: dict[str, Callable[[random.Random, Path], Case]] = {
    "bag": hostile_drive, "metadata, parameters": hostile_yaml, "result": hostile_result,
    "instrument file": hostile_instrument, "table of a logger": hostile_table}


# --- The commands.
COMMANDS: dict[str, Callable[[Case, Path], list[str]]] = {
    "info": lambda case, _: [],
    "identify": lambda case, out: [*case.options, "--out", str(out / "identified.yaml")],
    "diagnose": lambda case, out: [*case.options, "--out", str(out / "improved.yaml")],
    "report": lambda case, out: [*case.options, "--out", str(out / "report")],
    "import": lambda case, out: [*(case.tabled or ()), "--out", str(out / "imported")]}
FOR_ALL = tuple(command for command in COMMANDS if command != "import")


def hostile_inputs(size: int, seed: int, folder: Path) -> list[Outcome]:
    """`size` inputs of alternating kinds, each given to all commands."""
    _warm_up(folder)
    outcomes = []
    for first, (name, maker) in enumerate(MAKERS.items()):
        failed, results = list[str](), list[str]()
        numbers = range(first, size, len(MAKERS))
        for k in numbers:
            for left in ("given", "out"):
                shutil.rmtree(folder / left, ignore_errors=True)
            # Figures are composed but not rendered, which would take most of the time.
            undrawn = mock.patch.object(Picture, "_file", lambda *_, **__: b"")
            with contextlib.nullcontext() if k % _DRAWN_ONE_IN == 0 else undrawn:
                said, succeeded = try_case(maker, random.Random(f"{seed} {k}"), folder)
            for text in said:
                failed.append(f"input {k} of seed {seed}: {text}")
                print(f"{name}, {failed[-1]}", file=sys.stderr, flush=True)
            results += succeeded
        counts = [f"{n} {command}" for command in COMMANDS if (n := results.count(command))]
        one = counted(f"{name}, through all commands", len(numbers), failed)
        found = f"{one.found}, results: {', '.join(counts) or 'none'}"
        outcomes.append(one._replace(found=found))
    return outcomes


def _warm_up(folder: Path) -> None:
    """Load and compile everything first, so that it does not count as time of an input."""
    bag, table = folder / "warm", FOLDER / "table.csv"
    (folder / "out").mkdir()
    write_record(bag, list(drive().signals.values()))
    for command in COMMANDS:
        case = Case(table, tabled=()) if command == "import" else Case(bag, ("--params", str(_RIG)))
        said, code = run_command(command, case, folder / "out", 600.0)
        assert not said and code != 2, f"{command} of what is good ends with {code}: {said}"


def try_case(maker: Callable[[random.Random, Path], Case], rng: random.Random,
             folder: Path) -> tuple[list[str], list[str]]:
    """Errors with one input, and the commands that gave a result."""
    given, out = folder / "given", folder / "out"
    given.mkdir(parents=True)
    out.mkdir()
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
    return failures, results


def run_command(command: str, case: Case, out: Path, seconds: float = SECONDS) -> tuple[str, int]:
    """What a command did wrong, "" for nothing, and its exit code."""
    told, errors = io.StringIO(), io.StringIO()
    arguments = [command, *COMMANDS[command](case, out), "--", str(case.path)]
    try:
        with (allowance(MEMORY, seconds), warnings.catch_warnings(),
              contextlib.redirect_stdout(told), contextlib.redirect_stderr(errors)):
            code = main(arguments)
    except Exception as error:  # any exception is a finding
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


def _everything(folder: Path) -> dict[Path, bytes]:
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


# --- The parsers.
def try_input(parser: Parser, content: bytes, folder: Path) -> str:
    """What went wrong with one input, or ""."""
    path = folder / parser.file
    path.write_bytes(content)
    try:
        with allowance(MEMORY, SECONDS), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            parser.read(path)
    except InputError as error:
        return "" if "\n" not in str(error) else f"more than one line: {str(error)[:_SHOWN]!r}"
    except Exception as error:  # any exception is a finding
        return f"{type(error).__name__}: {str(error)[:_SHOWN]!r}"
    return ""


def edited_inputs(size: int, seed: int, folder: Path) -> list[Outcome]:
    """`size` edited inputs for every parser, and the good input."""
    logging.disable(logging.WARNING)
    folder.mkdir(parents=True, exist_ok=True)
    outcomes = []
    for parser in parsers():
        rng = random.Random(f"{seed} {parser.name}")
        inputs = [parser.good, *(mutated(rng, parser.good) for _ in range(size))]
        tried = [(try_input(parser, content, folder), content) for content in inputs]
        wrong = [f"{text} at {content[:_SHOWN]!r}" for text, content in tried if text]
        outcomes.append(counted(f"edited: {parser.name}", size, wrong))
    logging.disable(logging.NOTSET)
    return outcomes
