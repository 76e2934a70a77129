"""Can the safety tests fail? Mutations of the safety rules, each run against them.

Made mechanically: a comparison turned, a limit doubled, a state forgotten, at every place of the
files below where there is one; drawn by seed. A mutation is made in a copy of this folder. The
fast tests of its file judge it first; then, a minute each, the faults of its rule on the emulated
bench (`./bench check faults`) those that survived. mutations.yaml has the tests, the faults, and of
those that change nothing, why.

    ./bench check mutations [--number 200] [--seed 1] [--tests-only] [--json mutations.json]
"""

import ast
import functools
import hashlib
import itertools
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import yaml

from examination.pieces import IN_PIECES, in_pieces, options_of, print_table

ROOT = Path(__file__).resolve().parents[2]
TABLE = yaml.safe_load(Path(__file__).with_suffix(".yaml").read_text())
FILES: dict[str, dict[str, Any]] = TABLE["files"]
EQUIVALENT: dict[str, str] = TABLE["equivalent"]
KINDS = ("comparison turned", "limit doubled", "state forgotten")
TURNED = {"<": ">", "<=": ">=", "==": "!=", "is": "is not", "in": "not in", "and": "or", "&&": "||"}
TURNED |= {after: before for before, after in TURNED.items()} | {"not ": "", "!": ""}
LIMITS = re.compile(r"maximum_\w+|\w*timeout|\w+_tolerance")
LONGEST_TESTS, LONGEST_FAULTS = 120.0, 60.0  # s
PURE, FAULTS, SURVIVED = "caught by tests", "caught by faults", "survived"
LEAST_CAUGHT = 0.95
LOGIC = """
import pathlib, subprocess, sys, tempfile
sys.path.insert(0, "test/firmware")
from host_firmware import build_program
with tempfile.TemporaryDirectory() as folder:
    program = build_program("test_logic.c", pathlib.Path(folder), ("-O1",))
    sys.exit(subprocess.run([program]).returncode)
"""


class Mutation(NamedTuple):
    """`before`, from place `at` of a file on, replaced by `after`."""

    file: str
    place: str  # function, with its class
    kind: str
    at: int
    before: str
    after: str
    line: int
    text: str  # the line, without indentation
    turn: int  # among equals of its place

    @property
    def name(self) -> str:
        """The same while its function does not change, wherever that stands."""
        change = f"{self.before} -> {self.after}" if self.kind != KINDS[2] else "forgotten"
        turn = f" ({self.turn + 1})" if self.turn else ""
        return f"{self.file} {self.place}: {change} in: {self.text}{turn}"

    def applied(self, source: str) -> str:
        end = self.at + len(self.before)
        assert source[self.at : end] == self.before
        return source[: self.at] + self.after + source[end:]


# --- Where there is something to mutate
def python_edits(source: str) -> Iterator[tuple[str, str, int, str, str]]:
    """Place, kind, position, before, after."""
    starts = [0]
    for line in source.splitlines(keepends=True):
        starts.append(starts[-1] + len(line.encode()))
    data = source.encode()

    def span(node: Any) -> tuple[int, int]:
        return (starts[node.lineno - 1] + node.col_offset,
                starts[node.end_lineno - 1] + node.end_col_offset)  # fmt: skip

    def edit(place: str, kind: int, at: int, end: int, after: str) -> tuple:
        return (place, KINDS[kind], len(data[:at].decode()), data[at:end].decode(), after)

    def walk(node: Any, place: str) -> Iterator[tuple]:
        at = span(node) if hasattr(node, "lineno") else (0, 0)
        if isinstance(node, ast.ClassDef | ast.FunctionDef):
            place = f"{place}.{node.name}".lstrip(".")
        elif isinstance(node, ast.Compare | ast.BoolOp):
            parts = node.values if isinstance(node, ast.BoolOp) else [node.left, *node.comparators]
            for left, right in itertools.pairwise(parts):  # the operator that stands there
                first, last = span(left)[1], span(right)[0]
                found = re.search(rb"is not|not in|is|in|and|or|[<>=!]=|[<>]", data[first:last])
                if found:
                    begin, end = first + found.start(), first + found.end()
                    yield edit(place, 0, begin, end, TURNED[found.group().decode()])
        elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
            yield edit(place, 0, at[0], at[0] + 4, "")
        elif isinstance(node, ast.Constant) and type(node.value) in (int, float) and node.value:
            yield edit(place, 1, *at, repr(2 * node.value))
        elif isinstance(node, ast.Attribute) and LIMITS.fullmatch(node.attr):
            if isinstance(node.ctx, ast.Load):
                yield edit(place, 1, *at, f"(2.0 * {data[slice(*at)].decode()})")
        elif isinstance(node, ast.Assign | ast.AugAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            parts = [e for t in targets for e in (t.elts if isinstance(t, ast.Tuple) else [t])]
            if any(isinstance(part, ast.Attribute | ast.Subscript) for part in parts):
                yield edit(place, 2, *at, "pass")
        elif isinstance(node, ast.Expr) and isinstance(node.value, ast.Call):
            yield edit(place, 2, *at, "pass")
        for child in ast.iter_child_nodes(node):
            if not isinstance(child, ast.JoinedStr):  # what is said to people
                yield from walk(child, place)

    yield from walk(ast.parse(source), "")


_COMMENT = re.compile(r'/\*.*?\*/|//[^\n]*|"(?:\\.|[^"\\])*"|\'(?:\\.|[^\'\\])*\'', re.S)
_FUNCTION = re.compile(r"^(?:static )?(?:const )?[a-z]\w*(?: \*?|\b)[ *]*(\w+)\([^;{]*\)\n\{", re.M)
_C_EDITS = (
    (KINDS[0], re.compile(r"(?<![<>=!\-+*/%&|^])(?:[<>=!]=|[<>](?![<>=]))|&&|\|\||!(?=[a-z(])")),
    (KINDS[1], re.compile(r"(?<![\w.])[1-9]\d*(?:UL|U|L)?\b|\b[A-Z]+(?:_[A-Z0-9]+)*_"
                          r"(?:MS|MA|MV|US|Q16|S|MOHM|SHIFT)\b|\bDIFFERENCES\b")),
    (KINDS[2], re.compile(
        r"(?m)(?<=    )(?:\*?[a-z_][\w.\[\]>\-]* (?:[-+*/&|^]|<<|>>)?= [^;]*"
        r"|[+-]{2}?\*?[a-z_][\w.\[\]]*|\*?[a-z_][\w.\[\]]*(?:\+\+|--)|[a-z_]\w*\([^;{}]*\));$")))


def c_edits(source: str) -> Iterator[tuple[str, str, int, str, str]]:
    """As for Python, of what stands in functions and in #define."""
    plain = _COMMENT.sub(_blank, source)
    plain = re.sub(r"(?ms)^_Static_assert.*?;$|^#(?!define)[^\n]*", _blank, plain)
    places = [(found.start(), found.group(1)) for found in _FUNCTION.finditer(plain)]
    for kind, pattern in _C_EDITS:
        for found in pattern.finditer(plain):
            at, before = found.start(), source[slice(*found.span())]
            place = next((name for start, name in reversed(places) if start < at), "")
            line = plain[plain.rfind("\n", 0, at) + 1 :].partition("\n")[0]
            is_define = line.startswith("#define") and at > plain.find(line) + len("#define ")
            if is_define:
                place = line.split()[1].partition("(")[0]
            if not (is_define or line.startswith((" ", "\t"))):
                continue
            if is_define and (kind != KINDS[1] or before in line.split()[1]):
                continue
            if kind == KINDS[2] and re.match(r"return|case|goto|else", before):
                continue
            changes = (TURNED.get(before, ""), f"(2 * {before})", "(void)0;")
            yield place, kind, at, before, changes[KINDS.index(kind)]


def _blank(found: re.Match) -> str:
    return re.sub(r"[^\n]", " ", found.group())


def mutations_of(file: str) -> list[Mutation]:
    """All that there are in the part of a file that is a safety rule."""
    source, only = (ROOT / file).read_text(), FILES[file].get("only", "")
    edits = python_edits if file.endswith(".py") else c_edits
    found: list[Mutation] = []
    met: Counter[tuple] = Counter()
    for place, kind, at, before, after in edits(source):
        if re.match(only, place):
            begin, line = source.rfind("\n", 0, at) + 1, source.count("\n", 0, at) + 1
            text = source[begin:].partition("\n")[0].strip()
            turn = met[place, before, text]
            met[place, before, text] += 1
            found.append(Mutation(file, place, kind, at, before, after, line, text, turn))
    return found


def drawn(number: int, seed: int) -> list[Mutation]:
    """The first of a row that seed and names make, of those that compile without a warning."""
    every = [mutation for file in FILES for mutation in mutations_of(file)]
    every.sort(key=lambda one: hashlib.sha256(f"{seed} {one.name}".encode()).hexdigest())
    return list(itertools.islice(filter(compiles, every), number))


def compiles(mutation: Mutation) -> bool:
    source = mutation.applied((ROOT / mutation.file).read_text())
    if mutation.file.endswith(".py"):
        return bool(compile(source, mutation.file, "exec"))
    flags = ["-std=gnu11", "-Wall", "-Wextra", "-Werror", "-Wshadow", f"-I{ROOT / 'firmware'}"]
    command = ["cc", "-fsyntax-only", *flags, "-x", "c", "-"]
    return not subprocess.run(command, input=source.encode(), capture_output=True).returncode


# --- Each in a copy of this folder
class Copy:
    """A copy of this folder, in which one file at a time is another."""

    def __init__(self) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="mutations_")
        self.root = Path(self._folder.name) / "copy"
        left_out = shutil.ignore_patterns(".git", ".venv*", "*.log", ".hypothesis", "pictures")
        shutil.copytree(ROOT, self.root, ignore=left_out, symlinks=True)

    def outcome(self, mutation: Mutation, with_faults: bool = True) -> str:
        path = self.root / mutation.file
        sound = path.read_text()
        try:
            path.write_text(mutation.applied(sound))
            if mutation.file.endswith(".c") and not self.runs(["-c", LOGIC], LONGEST_TESTS):
                return PURE  # found without sanitizers, in a tenth of the time
            if not self.passes(FILES[mutation.file]["tests"], LONGEST_TESTS):
                return PURE
            faults = [name for place, names in FILES[mutation.file]["faults"].items()
                      if re.match(place, mutation.place) for name in names.split()]  # fmt: skip
            if with_faults and faults:
                chosen = ["test/nodes/test_bridge_faults.py", "--acceptance",
                          "-p", "no:rerunfailures", "-k", " or ".join(faults)]  # fmt: skip
                if not self.passes(chosen, LONGEST_FAULTS, hangs=True):
                    return FAULTS
            return SURVIVED
        finally:
            path.write_text(sound)
            self._forget(path)

    def passes(self, tests: Sequence[str], longest: float, hangs: bool = False) -> bool:
        """`hangs`: whoever takes longer has passed, as faults may; else it has not."""
        for path in (self.root / "sma_bench" / "hardware").glob("*.py"):
            self._forget(path)
        few = ["-q", "-x", "-p", "no:cacheprovider", "--hypothesis-seed=0"]
        return self.runs(["-m", "pytest", *few, *tests], longest, hangs)

    def runs(self, arguments: Sequence[str], longest: float, hangs: bool = False) -> bool:
        """Whether Python ends well with these arguments, here."""
        environment = {**os.environ, "PYTHONDONTWRITEBYTECODE": "1", "OMP_NUM_THREADS": "1"}
        # Its own session: nodes that a fault leaves behind end with it.
        process = subprocess.Popen([sys.executable, *arguments], cwd=self.root, env=environment,
                                   stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
                                   start_new_session=True)  # fmt: skip
        try:
            return process.wait(longest) == 0
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, 9)
            process.wait()
            return hangs

    @staticmethod
    def _forget(path: Path) -> None:
        """What was compiled of it: a file of the same second and size would pass for the same."""
        for compiled in (path.parent / "__pycache__").glob(f"{path.stem}.*.pyc"):
            compiled.unlink()


@functools.cache
def copy() -> Copy:
    """One a process, in which the sound files pass."""
    made = Copy()
    for file, own in FILES.items():
        if not made.passes(own["tests"], 3 * LONGEST_TESTS):
            raise SystemExit(f"check mutations: the tests of {file} fail without a mutation")
    return made


def tried(name: str, tests_only: bool) -> str:
    """How a mutation ended, by its name."""
    mutation = next(m for file in FILES for m in mutations_of(file) if m.name == name)
    return copy().outcome(mutation, with_faults=not tests_only)


def report(outcomes: dict[Mutation, str]) -> float:
    """Print the table and who survived; the share caught of those that can be noticed."""
    rows = []
    for file in [*FILES, "all"]:
        own = {m: ended for m, ended in outcomes.items() if file in (m.file, "all")}
        ends = Counter(own.values())
        alike = sum(e == SURVIVED and m.name in EQUIVALENT for m, e in own.items())
        caught, survived = ends[PURE] + ends[FAULTS], ends[SURVIVED] - alike
        share = caught / (caught + survived) if caught + survived else 1.0
        rows.append((file, len(own), ends[PURE], ends[FAULTS], alike, survived, f"{share:.1%}"))
    print_table(("mutations of", ">drawn", ">caught by tests", ">by faults",
                 ">equivalent", ">survived", ">caught"), rows)  # fmt: skip
    for mutation in sorted(outcomes, key=lambda m: (m.file, m.line)):
        if outcomes[mutation] == SURVIVED:
            why = EQUIVALENT.get(mutation.name, "NO TEST")
            print(f"{mutation.file}:{mutation.line} {mutation.name.partition(' ')[2]}\n    {why}")
    return share


def main(argv: Sequence[str] | None = None) -> int:
    """0 when enough of those that can be noticed were."""
    options = options_of("mutations", __doc__, argv, number=(200, "of mutations"),
                         seed=(1, "of the draw"), tests_only=(False, "without the faults, which "
                         "need a computer that does nothing else"), **IN_PIECES)
    chosen = drawn(options.number, options.seed)
    ends = in_pieces(tried, [(one.name, True) for one in chosen], options)
    outcomes = dict(zip(chosen, ends, strict=True))
    if not options.tests_only:
        left = [m for m, end in outcomes.items() if end == SURVIVED and m.name not in EQUIVALENT]
        ends = in_pieces(tried, [(one.name, False) for one in left], options)
        outcomes |= dict(zip(left, ends, strict=True))
    return 0 if report(outcomes) >= LEAST_CAUGHT else 1
