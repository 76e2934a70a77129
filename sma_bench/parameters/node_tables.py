"""Each node's own parameters (nodes.yaml); the generated pages of parameters and effects."""

from collections.abc import Collection, Iterable
from pathlib import Path
from typing import Any

from sma_bench.errors import InputError
from sma_bench.parameters import parameter
from sma_bench.parameters.parameter import BY_NAME, TABLE, Parameter, declared, read_declarations
from sma_bench.parameters.parameters import UNCERTAINTY_PREFIX, unknown_parameter_message

_TREE = read_declarations("nodes.yaml")
_SHARED = _TREE.pop("shared")
NODE_TABLES: dict[str, tuple[Parameter, ...]] = {n: declared(tree) for n, tree in _TREE.items()}
SIMULATOR, SERIAL_BRIDGE = NODE_TABLES["simulator"], NODE_TABLES["serial_bridge"]
TUNING = declared(_SHARED["tuning"])  # of both controllers
OF_NODES = frozenset(p.name for table in NODE_TABLES.values() for p in table)
# Declared by rclpy itself, in every node.
_ROS_GROUPS = frozenset({"use_sim_time", "qos_overrides", "start_type_description_service"})


def refuse_unknown(names: Iterable[str], where: str, known: Collection[str] = OF_NODES) -> None:
    """InputError for the first name that is neither of the contract, nor known, nor of ROS."""
    for name in names:
        contracts = name.removeprefix(UNCERTAINTY_PREFIX) in BY_NAME
        if not contracts and name not in known and name.split(".")[0] not in _ROS_GROUPS:
            raise InputError(f"{where}: {unknown_parameter_message(name, (*BY_NAME, *known))}")


def markdown(macro: str, *tables: Any) -> str:
    """A page of pages.md.j2: "parameters", of the contract and of every node, or "effects"; or the
    "table" of some parameters."""
    import jinja2  # not needed by nodes

    own = {"parameters": (TABLE, NODE_TABLES), "table": tables,
           "effects": (parameter.EFFECTS, parameter.LOAD_KINDS)}
    environment = jinja2.Environment(  # noqa: S701 (no HTML)
        loader=jinja2.FileSystemLoader(Path(__file__).parent), undefined=jinja2.StrictUndefined,
        trim_blocks=True, lstrip_blocks=True)
    environment.filters["range"] = range_of
    return str(getattr(environment.get_template("pages.md.j2").module, macro)(*own[macro]))


def range_of(p: Parameter) -> str:
    """Range of a number with its unit; pure numbers without."""
    return f"{p.low:g} to {p.high:g}{'' if p.unit == '1' else f' {p.unit}'}"
