"""The parameters that a node's command line brings, checked before ROS starts.

ROS passes over names that a node does not declare, so a slip of the pen in a parameter file would
silently leave a default in force.
"""

import logging
from collections.abc import Sequence
from typing import Any

from sma_bench.border import load_yaml
from sma_bench.errors import InputError, did_you_mean
from sma_bench.parameters.node_tables import NODE_TABLES
from sma_bench.parameters.parameters import UNCERTAINTY_PREFIX, Parameters
from sma_bench.parameters.table import BY_NAME
from sma_bench.parameters.yaml_file import flatten, read_parameter_names, split_names

_CONTRACT_GROUPS = frozenset(name.split(".")[0] for name in BY_NAME) | {"uncertainty"}
_ROS_GROUPS = frozenset({"use_sim_time", "qos_overrides", "start_type_description_service"})
_GONE = {"managed": "nodes are no lifecycle nodes any more: they start active, and end by a signal"}


def node_help(node: str) -> str:
    """What --help prints: usage and the node's own parameters."""
    lines = [
        f"usage: {node} [--ros-args -r __ns:=/bench --params-file P.yaml -p NAME:=VALUE ...]",
        "",
        "parameters of this node, besides the contract's (sma-bench parameters):",
    ]
    for parameter in NODE_TABLES[node]:
        unit, default = f" [{parameter.unit}]" if parameter.unit else "", parameter.default
        if isinstance(default, (tuple, list)):
            shown = f"[{', '.join(map(str, default))}]"
        else:
            shown = str(default).lower() if isinstance(default, bool) else str(default) or "none"
        lines.append(f"  {parameter.name:28} {parameter.description}{unit} (default {shown})")
    return "\n".join(lines) + "\n"


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
    # What ROS passes over would run the node on its defaults, safety limits included.
    inside, options = False, []
    for argument, following in zip(argv, [*argv[1:], None], strict=False):
        if argument in ("--ros-args", "--"):
            inside = argument == "--ros-args"
        elif not inside:
            raise InputError(
                f"unknown argument {argument!r}: what is ROS's stands after --ros-args"
            )
        elif following is not None:
            options.append((argument, following))

    # The node's own section of a file is that of its name.
    named = node
    for option, value in options:
        name, separator, target = value.partition(":=")
        if option in ("-r", "--remap") and separator and name in ("__node", "__name"):
            named = target

    # Later sources win; what fits only together may come from several.
    merged: dict[str, Any] = {}
    for option, value in options:
        if option == "--params-file":
            where, values = value, read_parameter_names(value, named)
        elif option in ("-p", "--param"):
            where = option
            name, separator, text = value.partition(":=")
            if not separator:
                raise InputError(f"-p {value}: expected name:=value")
            try:
                values = flatten({name.split(":")[-1]: load_yaml(text)})
            except InputError as error:
                raise InputError(f"-p {value:.80}: {error}") from None
        else:
            continue
        merged |= _contract_values(node, values, where)
        Parameters(*split_names(merged), where)


def _contract_values(node: str, values: dict[str, Any], where: str) -> dict[str, Any]:
    """The contract's part of the values; the node's own part is checked here."""
    own = {parameter.name: parameter for parameter in NODE_TABLES[node]}
    contract: dict[str, Any] = {}
    for name, value in values.items():
        bare = name.removeprefix(UNCERTAINTY_PREFIX)
        parameter = own.get(name) or BY_NAME.get(name)
        if parameter is None and bare not in BY_NAME:
            if name in _GONE:
                raise InputError(f"{where}: {name}: {_GONE[name]}")
            elsewhere = {p.name for table in NODE_TABLES.values() for p in table}
            group = name.split(".")[0]
            if name in elsewhere or group in _ROS_GROUPS:
                continue
            known = [*BY_NAME, *elsewhere, *(UNCERTAINTY_PREFIX + bare for bare in BY_NAME)]
            hint = did_you_mean(name, known)
            groups = _CONTRACT_GROUPS | {n.split(".")[0] for n in elsewhere if "." in n}
            if group in groups and "." in name:
                raise InputError(f"{where}: unknown parameter {name}{hint}")
            logging.getLogger(node).warning(
                "%s: %s is not a parameter of this package%s", where, name, hint
            )
            continue
        whole = isinstance(value, int) and not isinstance(value, bool)
        if whole and (parameter is None or parameter.kind == "double"):
            raise InputError(f"{where}: {name} is the integer {value}, ROS expects {value}.0")
        if name in own:
            own[name].validated(value, where)
        else:
            contract[name] = value
    return contract
