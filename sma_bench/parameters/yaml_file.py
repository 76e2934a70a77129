"""Reads and writes ROS 2 parameter files."""

import math
import re
from collections.abc import Iterable, Iterator, Mapping
from collections.abc import Set as AbstractSet
from pathlib import Path
from typing import Any

import yaml

from sma_bench.border import printable, read_yaml, write_files
from sma_bench.errors import InputError, errors_in
from sma_bench.parameters.parameter import BY_NAME, EFFECT_PREFIX, TABLE, Parameter, Value
from sma_bench.parameters.parameters import UNCERTAINTY_PREFIX, Parameters

WILDCARD = "/**"


def read_parameter_names(path: str | Path, node: str | None = None) -> dict[str, Any]:
    """Raw values by dotted name that a node (`/bench/simulator`; None: every) loads from a file.
    InputError: unreadable, not YAML, no section for it, or two that disagree."""
    document = read_yaml(path)
    if not isinstance(document, dict):
        raise InputError(f"{path}: expected a ROS parameter file ('{WILDCARD}: ros__parameters:')")
    sections = list(_sections(document, "", path))
    fitting = [(key, values) for key, values in sections if _fits(key, node)]
    if not fitting:
        found = ", ".join(key for key, _ in sections) or "none"
        wanted = f"found {found}, expected {f'{WILDCARD} or {node}' if node else WILDCARD}"
        raise InputError(f"{path}: no section for {node or 'every node'}, {wanted}")
    merged: dict[str, Any] = {}
    origin: dict[str, str] = {}
    for key, values in fitting:
        with errors_in(f"{path}: {key}"):
            flat = flatten(values)
        for name, value in flat.items():
            if name in merged and merged[name] != value:
                there = f"{merged[name]!r} in {origin[name]}"
                raise InputError(f"{path}: {name} is {there} and {value!r} in {key}")
            merged[name], origin[name] = value, key
    return merged


def _sections(document: Mapping[Any, Any], above: str, path: str | Path) -> Iterator[Any]:
    """Each name or pattern of nodes with the `ros__parameters` that they load."""
    for key, value in document.items():
        name = f"{above}/{str(key).strip('/')}"
        if isinstance(value, dict) and isinstance(value.get("ros__parameters"), dict):
            yield name, value["ros__parameters"]
        elif isinstance(value, dict) and "ros__parameters" not in value:
            yield from _sections(value, name, path)
        elif value is not None:
            raise InputError(f"{path}: {key}: expected a ros__parameters mapping")


def _fits(key: str, node: str | None) -> bool:
    """True if a node loads a section, by ROS's rule for * and **."""
    if node is None:
        return key == WILDCARD
    wild = {"**": r"(/\w+)*", "*": r"/\w+"}
    pattern = "".join(wild.get(part, f"/{re.escape(part)}") for part in key.split("/")[1:])
    return bool(re.fullmatch(pattern, node))


def read_parameters(path: str | Path) -> Parameters:
    """Contract parameters of a ROS parameter file with a `/**: ros__parameters:` section; absent
    ones keep the table's default, groups that only nodes declare are ignored. Raises
    InputError: unreadable file, unknown name, wrong type or value out of range, in one line."""
    named = read_parameter_names(path)
    stds = {name for name in named if name.startswith(UNCERTAINTY_PREFIX)}
    own = {name: value for name, value in named.items() if name in BY_NAME or name in stds}
    if others := named.keys() - own.keys():
        from sma_bench.parameters.node_tables import refuse_unknown  # takes 0.1 s

        refuse_unknown(others, str(path))
    return Parameters(stated_names(own), where=str(path))


def stated_names(named: Mapping[str, Any]) -> Mapping[str, Any]:
    """The values that someone stated: all, but in a dump of a node only those off their default."""
    if not named.keys() >= BY_NAME.keys():
        return named
    defaults = {p.name for p in TABLE if _plain(named[p.name]) == _plain(p.default)
                and named.get(UNCERTAINTY_PREFIX + p.name, p.default_std) == p.default_std}
    return {n: v for n, v in named.items() if n.removeprefix(UNCERTAINTY_PREFIX) not in defaults}


def write_parameters(path: str | Path, parameters: Parameters, comment: str = "",
                     names: Iterable[str] | None = None, *,
                     sources: Mapping[str, str] | None = None, template: str | Path | None = None,
                     explain: bool = False) -> None:
    """Write a ROS parameter file that every node loads as it is, with units, ranges and sources.

    The file appears whole or not at all. Values that are not stated are written as comments, except
    the channels, which every rig needs. `comment`: lines for the head of the file; `names`:
    parameters to write, in any order, when None all but effects not stated; `sources`:
    where values are from, by name: these and their standard deviations are rounded to the second
    digit of the error; `template`: a file whose handwritten comments are kept; `explain`:
    each parameter's description above it. Raises InputError: the folder cannot be written."""
    given, stds, sources = parameters.given, parameters.given_uncertainty, sources or {}
    usual = (n for n in parameters if n in given or not n.startswith(EFFECT_PREFIX))
    chosen = set(usual if names is None else names)

    def rounded(name: str, value: Any) -> Any:
        """To the place of the second digit of its error."""
        std = stds.get(name, 0.0)
        if name not in sources or not isinstance(value, float) or not 0.0 < std < math.inf:
            return value
        return round(value, 1 - math.floor(math.log10(std)))

    values: dict[str, Any] = {}
    notes: dict[str, str] = {}
    for p in (p for p in TABLE if p.name in chosen):
        value = rounded(p.name, parameters[p.name])
        by_default = "given" if value != p.default else p.provenance
        values[p.name], notes[p.name] = _plain(value), _note(p, sources.get(p.name, by_default))
    for name in sorted(stds.keys() & chosen):
        own = UNCERTAINTY_PREFIX + name
        values[own], notes[own] = rounded(name, float(stds[name])), _unit(BY_NAME[name])
    above = {p.name: p.description for p in TABLE} if explain else {}
    unstated = chosen - given - {"bench.channels", "bench.channel_sides"}
    write_named_values(path, values, comment, template, notes, above, unstated)


def _unit(p: Parameter) -> str:
    return f"[{p.unit or '1'}]"


def _note(p: Parameter, source: str) -> str:
    return source if p.low is None else f"{_unit(p)} {p.low:g} to {p.high:g}; {source}"


_UNSTATED = "Values behind a # are defaults, not stated: uncomment yours, with their group."
_NOTES_OF_DEFAULTS = {_note(p, p.provenance) for p in TABLE}
_GROUPS = {f"{p.name.split('.')[0]}:" for p in TABLE}
_OWN_LINES = {_UNSTATED, *(p.description for p in TABLE), *_GROUPS}
_KEY = re.compile(r"( *)([\w.]+|/\*\*):(?: |$)")
_OWN = " | "  # between a handwritten comment and the note of this module


def _comments_of(path: str | Path | None) -> tuple[list[str], dict[str, list[str]], dict[str, str]]:
    """Handwritten comments of a file, if there is one: head; by name above and next to values."""
    head: list[str] = []
    above: dict[str, list[str]] = {}
    beside: dict[str, str] = {}
    groups: list[tuple[int, str]] = []
    waiting: list[str] = []
    there = path is not None and Path(path).is_file()
    text = Path(str(path)).read_text(encoding="utf-8", errors="replace") if there else ""
    for line in text.splitlines():
        if line.lstrip().startswith("#"):
            text = line.strip().lstrip("#").strip()
            if text not in _OWN_LINES and text.rpartition("  # ")[2] not in _NOTES_OF_DEFAULTS:
                waiting.append(text)
        elif key := _KEY.match(line):
            depth = len(key[1])
            groups = [group for group in groups if group[0] < depth] + [(depth, key[2])]
            name = ".".join(g for _, g in groups if g not in (WILDCARD, "ros__parameters"))
            if not name and not head:
                head = waiting
            elif waiting:
                above[name] = waiting
            waiting = []
            # Next to a value: a comment that is not this module's note.
            remark = re.search(r"\s#\s?(.*)", line[key.end() - 1 :].split('"')[-1].split("'")[-1])
            theirs = (remark[1] if remark else "").partition(_OWN)[0].strip()
            if p := BY_NAME.get(name.removeprefix(UNCERTAINTY_PREFIX)):
                own = theirs.startswith(_unit(p)) or theirs in (p.provenance, "given")
                theirs = "" if own else theirs
            if theirs:
                beside[name] = theirs
    return head, above, beside


def write_named_values(path: str | Path, named: Mapping[str, Any], comment: str = "",
                       template: str | Path | None = None,
                       notes: Mapping[str, str] | None = None,
                       explained: Mapping[str, str] | None = None,
                       unstated: AbstractSet[str] = frozenset()) -> None:
    """Write values by dotted name as a ROS parameter file, as `write_parameters`: one a line,
    `notes` next to and `explained` above them, `unstated` ones behind a #."""
    notes, explained = notes or {}, explained or {}
    head, above, beside = _comments_of(template)
    body: dict[str, Any] = {}
    for name, value in named.items():
        *groups, leaf = name.split(".")
        inner = body
        for group in groups:
            inner = inner.setdefault(group, {})
        inner[leaf] = value
    own = [printable(line) for line in comment.splitlines()]
    own += [line for line in head if line not in own]
    own += [_UNSTATED] if unstated else []
    lines = [*(f"# {line}" for line in own), f"{WILDCARD}:", "  ros__parameters:"]

    def write(values: Mapping[str, Any], prefix: str, indent: str) -> None:
        for key, value in values.items():
            name = f"{prefix}{key}"
            lines.extend(f"{indent}# {line}" for line in above.get(name, ()))
            if isinstance(value, Mapping):
                names = {f"{name}.{leaf}" for leaf in flatten(value)}
                lines.append(f"{indent}{'# ' if names <= unstated else ''}{key}:")
                write(value, f"{name}.", indent + "  ")
                continue
            if name in explained:
                lines.append(f"{indent}# {explained[name]}")
            text = yaml.safe_dump(value, default_flow_style=True, width=10_000)
            text = f"{key}: {text.removesuffix('...' + chr(10)).strip()}"
            if remarks := [r for r in (beside.get(name), notes.get(name)) if r]:
                text += f"  # {_OWN.join(remarks)}"
            lines.append(f"{indent}{'# ' if name in unstated else ''}{text}")

    write(body, "", "    ")
    write_text_atomically(path, "".join(f"{line}\n" for line in lines))


def write_text_atomically(path: str | Path, text: str) -> None:
    """Write a file whole or not at all, mode and link kept; InputError: it cannot be written."""
    with errors_in(f"{path}: cannot write"):
        write_files({Path(path): text.encode("utf-8", "backslashreplace")})


def flatten(nested: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Nested mapping to dotted names, as ROS does it. Raises InputError: a name occurs twice."""
    flat: dict[str, Any] = {}
    for key, value in nested.items():
        name = f"{prefix}{key}"
        own = flatten(value, name + ".") if isinstance(value, Mapping) else {name: value}
        if twice := own.keys() & flat.keys():
            raise InputError(f"{min(twice)} stands twice")
        flat |= own
    return flat


def _plain(value: Value) -> Any:
    return list(value) if isinstance(value, tuple) else value
