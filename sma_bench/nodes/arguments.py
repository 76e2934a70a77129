"""The parameters that a node's command line brings, checked before ROS starts.

ROS passes over names that a node does not declare, so a slip of the pen in a parameter file would
silently leave a default in force.
"""

import logging
from collections.abc import Iterator, Sequence
from typing import Any

from sma_bench.border import load_yaml
from sma_bench.errors import InputError, did_you_mean
from sma_bench.parameters.node_tables import NODE_TABLES
from sma_bench.parameters.parameter import Parameter
from sma_bench.parameters.parameters import UNCERTAINTY_PREFIX, Parameters
from sma_bench.parameters.table import BY_NAME
from sma_bench.parameters.yaml_file import flatten, read_parameter_names, split_names

_CONTRACT_GROUPS = frozenset(name.split(".")[0] for name in BY_NAME) | {"uncertainty"}
_ROS_GROUPS = frozenset({"use_sim_time", "qos_overrides", "start_type_description_service"})
_GONE = {"managed": "nodes are no lifecycle nodes any more: they start active, and end by a signal"}
_FILE_OPTIONS = ("--params-file",)
_VALUE_OPTIONS = ("-p", "--param")
_REMAP_OPTIONS = ("-r", "--remap")


def node_help(node: str) -> str:
    """What --help prints: usage and the node's own parameters."""
    lines = [
        f"usage: {node} [--ros-args -r __ns:=/bench --params-file P.yaml -p NAME:=VALUE ...]",
        "",
        "parameters of this node, besides the contract's (sma-bench parameters):",
    ]
    for parameter in NODE_TABLES[node]:
        unit = f" [{parameter.unit}]" if parameter.unit else ""
        default = _shown(parameter.default)
        lines.append(f"  {parameter.name:28} {parameter.description}{unit} (default {default})")
    return "\n".join(lines) + "\n"


def _shown(default: object) -> str:
    if isinstance(default, (tuple, list)):
        return f"[{', '.join(map(str, default))}]"
    if isinstance(default, bool):
        return str(default).lower()
    return str(default) or "none"


def check_arguments(node: str, argv: Sequence[str]) -> None:
    """Check every parameter file and `-p name:=value` after `--ros-args`.

    Args:
        node: the name that the node has unless argv renames it.
        argv: command line without the program's name.

    Raises:
        InputError: unreadable file, unknown name in a group of ours, wrong type or out of range;
            one line with the file and, for a name, the nearest known one. A foreign name is only
            warned of.
    """
    for argument in _outside(argv):
        raise InputError(f"unknown argument {argument!r}: what is ROS's stands after --ros-args")
    named = _node_name(node, argv)
    merged: dict[str, Any] = {}
    for where, values in _sources(named, argv):
        merged |= _contract_values(node, values, where)
        Parameters(*split_names(merged), where)


def _sources(node: str, argv: Sequence[str]) -> Iterator[tuple[str, dict[str, Any]]]:
    for option, value in _ros_options(argv):
        if option in _FILE_OPTIONS:
            yield value, read_parameter_names(value, node)
        elif option in _VALUE_OPTIONS:
            yield option, _assignment(value)


def _outside(argv: Sequence[str]) -> Iterator[str]:
    """What ROS passes over: it would run the node on its defaults, safety limits included."""
    inside = False
    for argument in argv:
        if argument in ("--ros-args", "--"):
            inside = argument == "--ros-args"
        elif not inside:
            yield argument


def _ros_options(argv: Sequence[str]) -> Iterator[tuple[str, str]]:
    inside = False
    for k, argument in enumerate(argv):
        if argument in ("--ros-args", "--"):
            inside = argument == "--ros-args"
        elif inside and k + 1 < len(argv):
            yield argument, argv[k + 1]


def _node_name(node: str, argv: Sequence[str]) -> str:
    for option, value in _ros_options(argv):
        name, separator, target = value.partition(":=")
        if option in _REMAP_OPTIONS and separator and name in ("__node", "__name"):
            node = target
    return node


def _assignment(text: str) -> dict[str, Any]:
    name, separator, value = text.partition(":=")
    if not separator:
        raise InputError(f"-p {text}: expected name:=value")
    try:
        return flatten({name.split(":")[-1]: load_yaml(value)})
    except InputError as error:
        raise InputError(f"-p {text:.80}: {error}") from None


def _contract_values(node: str, values: dict[str, Any], where: str) -> dict[str, Any]:
    """The contract's part of the values; the node's own part is checked here."""
    own = {parameter.name: parameter for parameter in NODE_TABLES[node]}
    contract: dict[str, Any] = {}
    for name, value in values.items():
        bare = name.removeprefix(UNCERTAINTY_PREFIX)
        if bare in BY_NAME:
            require_ros_type(BY_NAME[bare] if bare == name else None, name, value, where)
            contract[name] = value
        elif name in own:
            require_ros_type(own[name], name, value, where)
            own[name].validated(value, where)
        else:
            _require_foreign(node, name, where)
    return contract


def require_ros_type(parameter: Parameter | None, name: str, value: Any, where: str) -> None:
    """ROS takes no integer for a double: say so with the value to write."""
    double = parameter is None or parameter.kind == "double"
    if double and isinstance(value, int) and not isinstance(value, bool):
        raise InputError(f"{where}: {name} is the integer {value}, ROS expects {value}.0")


def _require_foreign(node: str, name: str, where: str) -> None:
    if name in _GONE:
        raise InputError(f"{where}: {name}: {_GONE[name]}")
    known_elsewhere = {p.name for table in NODE_TABLES.values() for p in table}
    group = name.split(".")[0]
    if name in known_elsewhere or group in _ROS_GROUPS:
        return
    known = [*BY_NAME, *known_elsewhere, *(UNCERTAINTY_PREFIX + bare for bare in BY_NAME)]
    hint = did_you_mean(name, known)
    own_groups = {n.split(".")[0] for n in known_elsewhere if "." in n}
    if group in _CONTRACT_GROUPS | own_groups and "." in name:
        raise InputError(f"{where}: unknown parameter {name}{hint}")
    logging.getLogger(node).warning(
        "%s: %s is not a parameter of this package%s", where, name, hint
    )
