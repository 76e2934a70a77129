"""ROS 2 parameter files, in and out."""

import math
import re
from collections.abc import Iterable, Mapping
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from sma_bench.border import printable, read_yaml, write_files
from sma_bench.errors import InputError
from sma_bench.parameters.parameter import EFFECT_PREFIX, Parameter, Value
from sma_bench.parameters.parameters import UNCERTAINTY_PREFIX, Parameters
from sma_bench.parameters.table import BY_NAME, TABLE

WILDCARD = "/**"


def read_parameter_names(path: str | Path, node: str | None = None) -> dict[str, Any]:
    """Dotted names and raw values that a node would load from a ROS parameter file.

    Args:
        path: YAML file.
        node: name of the node; its own section overrides the wildcard's. None reads the wildcard
            section only.

    Raises:
        InputError: unreadable, not YAML, or without a `ros__parameters` section for the node.
    """
    document = read_yaml(path)
    if not isinstance(document, dict):
        raise InputError(f"{path}: expected a ROS parameter file ('{WILDCARD}: ros__parameters:')")
    merged: dict[str, Any] = {}
    wanted = [WILDCARD] if node is None else [WILDCARD, f"/**/{node}", node, f"/{node}"]
    found = False
    for key in wanted:
        section = document.get(key)
        if section is None:
            continue
        if not isinstance(section, dict) or not isinstance(section.get("ros__parameters"), dict):
            raise InputError(f"{path}: {key}: expected a ros__parameters mapping")
        merged.update(flatten(section["ros__parameters"]))
        found = True
    if not found and node is None:
        keys = ", ".join(str(key) for key in document)
        raise InputError(f"{path}: no '{WILDCARD}: ros__parameters:' section, found: {keys}")
    return merged


def read_parameters(path: str | Path, ignore: Iterable[str] = ()) -> Parameters:
    """Contract parameters of a ROS parameter file; absent ones keep the table's default.

    Args:
        path: YAML file with a `/**: ros__parameters:` section.
        ignore: groups (first part of a dotted name) that belong to nodes and are passed over.

    Raises:
        InputError: unreadable file, unknown name, wrong type or value out of range, in one line.
    """
    skipped = frozenset(ignore)
    named = {
        name: value
        for name, value in read_parameter_names(path).items()
        if name.split(".")[0] not in skipped
    }
    return Parameters(*split_names(stated_names(named)), str(path))


def stated_names(named: Mapping[str, Any]) -> Mapping[str, Any]:
    """What of dotted names someone stated: all of them, but of a node's dump, which has every
    parameter, only what is not as the node would declare it."""
    if not named.keys() >= BY_NAME.keys():
        return named

    def is_left(p: Parameter) -> bool:
        std = named.get(UNCERTAINTY_PREFIX + p.name, p.default_std)
        return _plain(named[p.name]) == _plain(p.default) and std == p.default_std

    left = {p.name for p in TABLE if is_left(p)}
    return {n: v for n, v in named.items() if n.removeprefix(UNCERTAINTY_PREFIX) not in left}


def split_names(named: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Dotted names split into values and (without their prefix) uncertainties."""
    values = {n: v for n, v in named.items() if not n.startswith(UNCERTAINTY_PREFIX)}
    uncertainty = {
        n.removeprefix(UNCERTAINTY_PREFIX): v
        for n, v in named.items()
        if n.startswith(UNCERTAINTY_PREFIX)
    }
    return values, uncertainty


def write_parameters(
    path: str | Path, parameters: Parameters, comment: str = "", names: Iterable[str] | None = None,
    *, sources: Mapping[str, str] | None = None, template: str | Path | None = None,
    explain: bool = False,
) -> None:
    """Write a ROS parameter file that every node loads as it is, with units, ranges and sources.

    The file appears whole or not at all. What nobody stated stands in it as a comment, but the
    channels, without which no rig is one.

    Args:
        path: file to write.
        parameters: values and uncertainties.
        comment: lines for the head of the file.
        names: parameters to write, in any order; when None all but effects that nobody stated.
        sources: where values are from, by name; these and their standard deviations are rounded to
            what the error deserves.
        template: a file whose comments a person wrote and that are kept.
        explain: each parameter's description above it.

    Raises:
        InputError: the folder cannot be written.
    """
    chosen = set(_worth_writing(parameters) if names is None else names)
    named_sources, stds = sources or {}, parameters.given_uncertainty
    stated = parameters.given | {"bench.channels", "bench.channel_sides"}
    body: dict[str, Any] = {}
    notes: dict[str, str] = {}
    for parameter in TABLE:
        name = parameter.name
        if name not in chosen:
            continue
        value = parameters[name]
        if name in named_sources and stds.get(name):
            value = _rounded(value, stds[name])
        _insert(body, name, _plain(value))
        by_default = "given" if value != parameter.default else parameter.provenance
        notes[name] = _note(parameter, named_sources.get(name, by_default))
    for name, std in sorted(stds.items()):
        if name in chosen:
            std = _rounded(std, std) if name in named_sources else float(std)
            _insert(body, UNCERTAINTY_PREFIX + name, std)
            notes[UNCERTAINTY_PREFIX + name] = f"[{BY_NAME[name].unit or '1'}]"
    above = {p.name: p.description for p in TABLE} if explain else {}
    _write_body(path, body, comment, notes, above, comments_of(template), chosen - stated)


def write_named_values(path: str | Path, values: Mapping[str, Any], comment: str = "") -> None:
    """Write values by dotted name as a ROS parameter file, whole or not at all; comments of the
    file that is there stay.

    Raises:
        InputError: the folder cannot be written.
    """
    body: dict[str, Any] = {}
    for name, value in values.items():
        _insert(body, name, value)
    _write_body(path, body, comment, {}, {}, comments_of(path))


def _rounded(value: Any, std: float) -> Any:
    """A number to the place of its error's second digit."""
    if not isinstance(value, float) or not 0.0 < std < math.inf:
        return value
    return round(value, 1 - math.floor(math.log10(std)))


def _note(parameter: Parameter, source: str) -> str:
    limits = [x for x in (parameter.low, parameter.high) if x is not None]
    unit = f"[{parameter.unit or '1'}] " if parameter.kind in ("double", "integer") else ""
    between = f"{limits[0]:g} to {limits[1]:g}; " if len(limits) == 2 else ""
    return f"{unit}{between}{source}"


_UNSTATED = "Behind a # stands what nobody stated: uncomment, with its group, what you know."
_NOTES_OF_DEFAULTS = {_note(p, p.provenance) for p in TABLE}
_DESCRIPTIONS = {p.description for p in TABLE}
_GROUPS = {f"{p.name.split('.')[0]}:" for p in TABLE}


# --- Comments: those that this module writes, and those that a person wrote and that it keeps.

_KEY = re.compile(r"( *)([\w.]+|/\*\*):(?: |$)")
_OWN = " | "  # between a person's comment and what is written beside it anew


@dataclass(frozen=True)
class Comments:
    """A person's comments: at the head of a file, and by dotted name above and beside a value."""

    head: tuple[str, ...] = ()
    above: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    beside: Mapping[str, str] = field(default_factory=dict)


def comments_of(path: str | Path | None) -> Comments:
    """What a person wrote into a parameter file; nothing where there is none."""
    if path is None or not Path(path).is_file():
        return Comments()
    head: tuple[str, ...] = ()
    above: dict[str, tuple[str, ...]] = {}
    beside: dict[str, str] = {}
    groups: list[tuple[int, str]] = []
    waiting: list[str] = []
    for line in Path(path).read_text(encoding="utf-8", errors="replace").splitlines():
        if line.lstrip().startswith("#"):
            text = line.strip().lstrip("#").strip()
            if not _is_default(text):
                waiting.append(text)
        elif key := _KEY.match(line):
            depth = len(key[1])
            groups = [group for group in groups if group[0] < depth] + [(depth, key[2])]
            name = ".".join(g for _, g in groups if g not in (WILDCARD, "ros__parameters"))
            if not name and not head:
                head = tuple(waiting)
            elif waiting:
                above[name] = tuple(waiting)
            remark = re.search(r"\s#\s?(.*)", line[key.end() - 1 :].split('"')[-1].split("'")[-1])
            theirs = (remark[1] if remark else "").partition(_OWN)[0].strip()
            if theirs and not _is_note(name, theirs):
                beside[name] = theirs
            waiting = []
    return Comments(head, above, beside)


def _is_default(text: str) -> bool:
    """Whether a comment is a default that this module wrote, or what it writes above one."""
    own = text.rpartition("  # ")[2]
    return text in _DESCRIPTIONS | _GROUPS | {_UNSTATED} or own in _NOTES_OF_DEFAULTS


def _is_note(name: str, text: str) -> bool:
    bare = name.removeprefix(UNCERTAINTY_PREFIX)
    known = BY_NAME.get(bare)
    return known is not None and (
        text.startswith(f"[{known.unit or '1'}]") or text in (known.provenance, "given")
    )


def _write_body(
    path: str | Path, body: dict[str, Any], comment: str, notes: Mapping[str, str],
    explained: Mapping[str, str], theirs: Comments, unstated: AbstractSet[str] = frozenset(),
) -> None:
    """One value a line, those of `unstated` behind a #; what a person wrote stands first, above
    and beside it."""
    own = [printable(line) for line in comment.splitlines()]
    lines = [f"# {line}" for line in [*own, *(t for t in theirs.head if t not in own)]]
    lines += [f"# {_UNSTATED}"] if unstated else []
    lines += [f"{WILDCARD}:", "  ros__parameters:"]

    def write(values: Mapping[str, Any], prefix: str, indent: str) -> None:
        for key, value in values.items():
            name = f"{prefix}{key}"
            lines.extend(f"{indent}# {line}" for line in theirs.above.get(name, ()))
            if isinstance(value, Mapping):
                names = {f"{name}.{leaf}" for leaf in flatten(value)}
                lines.append(f"{indent}{'# ' if names <= unstated else ''}{key}:")
                write(value, f"{name}.", indent + "  ")
                continue
            if name in explained:
                lines.append(f"{indent}# {explained[name]}")
            text = yaml.safe_dump(value, default_flow_style=True, width=10_000)
            remarks = [text for text in (theirs.beside.get(name), notes.get(name)) if text]
            remark = f"  # {_OWN.join(remarks)}" if remarks else ""
            text = f"{key}: {text.removesuffix('...' + chr(10)).strip()}{remark}"
            lines.append(f"{indent}{'# ' if name in unstated else ''}{text}")

    write(body, "", "    ")
    write_text_atomically(path, "".join(f"{line}\n" for line in lines))


def _worth_writing(parameters: Parameters) -> Iterable[str]:
    return (n for n in parameters if n in parameters.given or not n.startswith(EFFECT_PREFIX))


def write_text_atomically(path: str | Path, text: str) -> None:
    """Write a file whole or not at all; one that is replaced keeps its mode, a link stays one.

    Raises:
        InputError: the folder cannot be written.
    """
    try:
        write_files({Path(path): text.encode("utf-8", "backslashreplace")})
    except OSError as error:
        raise InputError(f"{path}: cannot write: {error.strerror}") from None


def flatten(nested: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Nested mapping to dotted names, as ROS does it."""
    flat: dict[str, Any] = {}
    for key, value in nested.items():
        name = f"{prefix}{key}"
        if isinstance(value, Mapping):
            flat.update(flatten(value, name + "."))
        else:
            flat[name] = value
    return flat


def _insert(body: dict[str, Any], name: str, value: Any) -> None:
    *groups, leaf = name.split(".")
    for group in groups:
        body = body.setdefault(group, {})
    body[leaf] = value


def _plain(value: Value) -> Any:
    return list(value) if isinstance(value, tuple) else value
