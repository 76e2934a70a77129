"""Do the safety tests notice errors? Mutations of the safety rules, each run against their tests.

Mutations are made automatically: a comparison reversed, a limit doubled, a statement removed, at
every such place of the files in mutations.yaml; a sample is drawn by seed. Each is made in a copy
of this folder. mutations.yaml also lists mutations without any effect, with the reason.

    ./bench check mutations [--number 200] [--seed 1] [--json mutations.json]
"""

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
LONGEST = 120.0  # s, of the tests of one mutation
LEAST_CAUGHT = 0.95
TURNED = {"<": ">", "<=": ">=", "==": "!=", "is": "is not", "and": "or", "&&": "||"}
TURNED |= {after: before for before, after in TURNED.items()} | {"not ": "", "!": ""}
_COMPARED = re.compile(r"(?<= )(?:[<>]=?|[=!]=|is not|is|and|or|&&|\|\|)(?= )|\bnot |!(?=[a-z(])")
_NUMBER = r"(?<![\w.])(?!0+\.?0*\b)\d+(?:\.\d+)?(?:e[-+]?\d+)?(?:UL|U|L)?(?![\w.])|"


class Language(NamedTuple):
    """Patterns of comments and strings, functions, limits and statements; and of no statements."""

    silent: re.Pattern
    function: re.Pattern
    limit: re.Pattern
    statement: re.Pattern
    nothing: str


PYTHON = Language(
    re.compile(r'""".*?"""|[rf]?"(?:\\.|[^"\\\n])*"|#[^\n]*', re.S),
    re.compile(r"^( *)(?:class|def) (\w+)", re.M),
    re.compile(_NUMBER + r"\b[\w.]+\.(?:maximum_\w+|\w*timeout|\w+_tolerance)\b(?! =)"),
    re.compile(r"^(?<=\n) +(?:[\w, ]*[.\[][\w., \[\]]* [-+*/|&]?= [^\n]+|[\w.]+\([^\n]*\))$", re.M),
    "pass")
C = Language(
    re.compile(r'(?ms)/\*.*?\*/|//[^\n]*|"(?:\\.|[^"\\])*"|\'(?:\\.|[^\'\\])*\''
               r"|^_Static_assert.*?;$|^#(?!define)[^\n]*"),
    re.compile(r"^()(?:static )?(?:const )?[a-z]\w*(?: \*?|\b)[ *]*(\w+)\([^;{]*\)\n\{", re.M),
    re.compile(_NUMBER + r"\b[A-Z]+(?:_[A-Z0-9]+)*_(?:MS|MA|MV|US|Q16|S|MOHM|SHIFT)\b"),
    re.compile(r"^ +(?!return|case|goto|else)(?:\*?[a-z_][\w.\[\]>\-]* (?:[-+*/&|^]|<<|>>)?= [^;]*"
               r"|[+-]{2}?\*?[a-z_][\w.\[\]]*(?:\+\+|--)?|[a-z_]\w*\([^;{}]*\));$", re.M),
    "(void)0;")


class Mutation(NamedTuple):
    """`before`, at position `at` of a file, replaced by `after`. `name` depends on the function
    only, not on its place in the file."""

    file: str
    at: int
    before: str
    after: str
    name: str

    def applied(self) -> str:
        source = (ROOT / self.file).read_text()
        assert source.startswith(self.before, self.at)
        return source[: self.at] + self.after + source[self.at + len(self.before) :]


@functools.cache
def mutations_of(file: str) -> dict[str, Mutation]:
    """All mutations of the safety rules in a file, by name."""
    source, only = (ROOT / file).read_text(), FILES[file].get("only", "")
    language = PYTHON if file.endswith(".py") else C
    plain = language.silent.sub(lambda found: re.sub(r"[^\n]", " ", found.group()), source)
    found: dict[str, Mutation] = {}
    met: Counter[str] = Counter()
    for at, end, after in edits(plain, language):
        before, begin = source[at:end], source.rfind("\n", 0, at) + 1
        text = source[begin:].partition("\n")[0].strip()
        place = place_of(plain, at, language)
        if not re.match(only, place):
            continue
        change = f"{before} -> {after}" if after != language.nothing else "forgotten"
        name = f"{file} {place}: {change} in: {text}"
        met[name] += 1
        name += f" ({met[name]})" if met[name] > 1 else ""
        found[name] = Mutation(file, at, before, after, name)
    return found


def edits(plain: str, language: Language) -> Iterator[tuple[int, int, str]]:
    """Start, stop and replacement of each mutation."""
    for found in _COMPARED.finditer(plain):
        yield *found.span(), TURNED[found.group()]
    for found in language.limit.finditer(plain):
        if not plain[: found.start()].endswith("#define "):
            yield *found.span(), f"(2 * {found.group()})"
    for found in language.statement.finditer(plain):
        yield found.end() - len(found.group().lstrip()), found.end(), language.nothing


def place_of(plain: str, at: int, language: Language) -> str:
    """Name of the function, with its class, or of the definition at this position."""
    line = plain[plain.rfind("\n", 0, at) + 1 :].partition("\n")[0]
    if line.startswith("#define"):
        return line.split()[1].partition("(")[0]
    indentation, names = len(line) - len(line.lstrip()), list[str]()
    for found in reversed(list(language.function.finditer(plain, 0, at))):
        if len(found[1]) < indentation:
            indentation, names = len(found[1]), [found[2], *names]
    return ".".join(names)


def compiles(mutation: Mutation) -> bool:
    """True if the mutated file compiles without a warning."""
    if mutation.file.endswith(".py"):
        try:
            return bool(compile(mutation.applied(), mutation.file, "exec"))
        except SyntaxError:
            return False
    flags = ["-std=gnu11", "-Wall", "-Wextra", "-Werror", "-Wshadow", f"-I{ROOT / 'firmware'}"]
    command = ["cc", "-fsyntax-only", *flags, "-x", "c", "-"]
    made = mutation.applied().encode()
    return not subprocess.run(command, input=made, capture_output=True).returncode


@functools.cache
def copy() -> tempfile.TemporaryDirectory:
    """A copy of this folder, one per process, in which the tests of the unchanged files pass."""
    folder = tempfile.TemporaryDirectory(prefix="mutations_")
    left_out = shutil.ignore_patterns(".git", ".venv*", "*.log", ".hypothesis", "__pycache__")
    shutil.copytree(ROOT, folder.name, ignore=left_out, symlinks=True, dirs_exist_ok=True)
    for file in FILES:
        if not passes(file, folder.name, 3 * LONGEST):
            raise SystemExit(f"check mutations: the tests of {file} fail without a mutation")
    return folder


def passes(file: str, folder: str, longest: float = LONGEST) -> bool:
    """True if the tests of a file pass in a copy of this folder, within the time."""
    # Without byte code: Python would take a file of the same second and size for the same.
    environment = {**os.environ, "PYTHONDONTWRITEBYTECODE": "1", "PYTHONPATH": folder}
    few = ["-q", "-x", "-p", "no:cacheprovider", "--hypothesis-seed=0"]
    command = [sys.executable, "-P", "-m", "pytest", *few, *FILES[file]["tests"]]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    try:
        return not subprocess.run(command, cwd=folder, env=environment, timeout=longest,
                                  check=False, **quiet).returncode
    except subprocess.TimeoutExpired:
        return False


def survives(name: str) -> bool:
    mutation, folder = mutations_of(name.partition(" ")[0])[name], copy().name
    path = Path(folder, mutation.file)
    path.write_text(mutation.applied())
    survived = passes(mutation.file, folder)
    path.write_text((ROOT / mutation.file).read_text())
    return survived


def main(argv: Sequence[str] | None = None) -> int:
    """0 if enough of the mutations with an effect were noticed."""
    options = options_of("mutations", __doc__, argv, number=(200, "of mutations"),
                         seed=(1, "of the draw"), **IN_PIECES)
    every = [one for file in FILES for one in mutations_of(file).values()]
    every.sort(key=lambda one: hashlib.sha256(f"{options.seed} {one.name}".encode()).hexdigest())
    names = [one.name for one in itertools.islice(filter(compiles, every), options.number)]
    survived = in_pieces(survives, [(name,) for name in names], options)
    rows = []
    for file in [*FILES, "all"]:
        own = [name.startswith(file) or file == "all" for name in names]
        left = [name for name, *is_left in zip(names, own, survived, strict=True) if all(is_left)]
        drawn, alike = sum(own), sum(name in EQUIVALENT for name in left)
        caught, missed = drawn - len(left), len(left) - alike
        share = caught / max(caught + missed, 1)
        rows.append((file, drawn, caught, alike, missed, f"{share:.1%}"))
    print_table(("mutations of", ">drawn", ">caught", ">equivalent", ">survived", ">caught"), rows)
    for name in sorted(left):
        print(f"{name}\n    {EQUIVALENT.get(name, 'NO TEST')}")
    return 0 if share >= LEAST_CAUGHT else 1
