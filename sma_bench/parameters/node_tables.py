"""Each node's own parameters, beside the contract's (table.py): what nodes.yaml declares."""

from sma_bench.parameters.parameter import Parameter, declared, read_declarations
from sma_bench.parameters.parameters import UNCERTAINTY_PREFIX
from sma_bench.parameters.table import BY_NAME

_TREE = read_declarations("nodes.yaml")
_SHARED = _TREE.pop("shared")
NODE_TABLES: dict[str, tuple[Parameter, ...]] = {n: declared(tree) for n, tree in _TREE.items()}
SIMULATOR, SERIAL_BRIDGE = NODE_TABLES["simulator"], NODE_TABLES["serial_bridge"]
TUNING = declared(_SHARED["tuning"])  # of both controllers


def node_groups() -> set[str]:
    """Groups that only nodes declare: the same file may hold them beside the contract's."""
    contract = {name.split(".")[0] for name in BY_NAME} | {UNCERTAINTY_PREFIX.rstrip(".")}
    nodes = {p.name.split(".")[0] for table in NODE_TABLES.values() for p in table}
    return nodes - contract
