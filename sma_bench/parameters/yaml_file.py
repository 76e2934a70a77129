"""ROS 2 parameter files, in and out."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import yaml

from sma_bench.border import printable, read_yaml, write_files
from sma_bench.errors import InputError
from sma_bench.parameters.effect_table import EFFECT_PREFIX
from sma_bench.parameters.parameter import Value
from sma_bench.parameters.parameters import UNCERTAINTY_PREFIX, Parameters
from sma_bench.parameters.table import TABLE

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
    document = _load(path)
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
    return Parameters(*split_names(named), str(path))


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
    path: str | Path,
    parameters: Parameters,
    comment: str = "",
    names: Iterable[str] | None = None,
) -> None:
    """Write a ROS parameter file that every node loads as it is.

    The file appears whole or not at all.

    Args:
        path: file to write.
        parameters: values and uncertainties.
        comment: lines for the head of the file.
        names: parameters to write, in any order; when None all but effects that nobody gave.

    Raises:
        InputError: the folder cannot be written.
    """
    chosen = set(_worth_writing(parameters) if names is None else names)
    body: dict[str, Any] = {}
    for parameter in TABLE:
        if parameter.name in chosen:
            _insert(body, parameter.name, _plain(parameters[parameter.name]))
    for name, std in sorted(parameters.given_uncertainty.items()):
        if name in chosen:
            _insert(body, UNCERTAINTY_PREFIX + name, float(std))
    _write_body(path, body, comment)


def write_named_values(path: str | Path, values: Mapping[str, Any], comment: str = "") -> None:
    """Write values by dotted name as a ROS parameter file, whole or not at all.

    Raises:
        InputError: the folder cannot be written.
    """
    body: dict[str, Any] = {}
    for name, value in values.items():
        _insert(body, name, value)
    _write_body(path, body, comment)


def _write_body(path: str | Path, body: dict[str, Any], comment: str) -> None:
    text = "".join(f"# {printable(line)}\n" for line in comment.splitlines())
    text += yaml.safe_dump({WILDCARD: {"ros__parameters": body}}, sort_keys=False)
    write_text_atomically(path, text)


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


def _load(path: str | Path) -> dict[str, Any]:
    document = read_yaml(path)
    if not isinstance(document, dict):
        raise InputError(f"{path}: expected a ROS parameter file ('{WILDCARD}: ros__parameters:')")
    return document


def _insert(body: dict[str, Any], name: str, value: Any) -> None:
    *groups, leaf = name.split(".")
    for group in groups:
        body = body.setdefault(group, {})
    body[leaf] = value


def _plain(value: Value) -> Any:
    return list(value) if isinstance(value, tuple) else value
