"""Each node's own parameters, besides the contract's: what nodes.yaml declares; and the pages of
documentation that the tables of parameters and effects generate."""

from collections.abc import Collection, Iterable

from sma_bench.errors import InputError
from sma_bench.parameters.parameter import (
    BY_NAME,
    EFFECTS,
    LOAD_KINDS,
    TABLE,
    Parameter,
    declared,
    read_declarations,
)
from sma_bench.parameters.parameters import UNCERTAINTY_PREFIX, unknown_parameter_message

_TREE = read_declarations("nodes.yaml")
_SHARED = _TREE.pop("shared")
NODE_TABLES: dict[str, tuple[Parameter, ...]] = {n: declared(tree) for n, tree in _TREE.items()}
SIMULATOR, SERIAL_BRIDGE = NODE_TABLES["simulator"], NODE_TABLES["serial_bridge"]
TUNING = declared(_SHARED["tuning"])  # of both controllers
OF_NODES = frozenset(p.name for table in NODE_TABLES.values() for p in table)
# Declared by rclpy itself, in every node.
_ROS_GROUPS = frozenset({"use_sim_time", "qos_overrides", "start_type_description_service"})
# What former versions had, and what does the same now.
GONE = {
    "managed": "nodes are no lifecycle nodes any more: they start active, and end by a signal",
    "mode:=emulated": "in a checkout ./bench check hardware plays the firmware on an emulated Uno",
}


def refuse_unknown(names: Iterable[str], where: str, known: Collection[str] = OF_NODES) -> None:
    """InputError for the first name of a source that is not the contract's, known, or ROS's own."""
    for name in names:
        contracts = name.removeprefix(UNCERTAINTY_PREFIX) in BY_NAME
        if contracts or name in known or name.split(".")[0] in _ROS_GROUPS:
            continue
        if name in GONE:
            raise InputError(f"{where}: {name} is gone: {GONE[name]}")
        raise InputError(f"{where}: {unknown_parameter_message(name, (*BY_NAME, *known))}")


# --- Pages.


def parameter_page() -> str:
    """Markdown page of the contract's parameters and of every node's own."""
    lines = [read_declarations("pages.yaml")["parameters"], *parameter_table(TABLE)]
    for node, table in NODE_TABLES.items():
        lines += ["", f"## Node `{node}`", "", *parameter_table(table)]
    return "\n".join(lines) + "\n"


def parameter_table(table: tuple[Parameter, ...]) -> list[str]:
    """Lines of a Markdown table, a row a parameter."""
    lines = [
        "| parameter | unit | default | uncertainty | spread | range | meaning | source |",
        "| --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for p in table:
        meaning = p.description + (" Read only." if p.read_only else "")
        source = p.provenance + (f"; spread: {p.spread_source}" if p.spread_source else "")
        known = p.low is not None or p.high is not None
        between = f"{_number(p.low)} to {_number(p.high)}" if known else ""
        cells = (f"`{p.name}`", p.unit, _number(p.default), _number(p.uncertainty),
                 _number(p.default_std), between, meaning, source)  # fmt: skip
        escaped = (cell.replace("|", "\\|").replace("<", "&lt;") for cell in cells)
        lines.append(f"| {' | '.join(escaped)} |")
    return lines


def effects_page() -> str:
    """Markdown page: one line an effect, then every effect's equation, source and numbers."""
    lines = [read_declarations("pages.yaml")["effects"].rstrip("\n")]
    for effect in EFFECTS.values():
        number = effect.size.name.rsplit(".", 1)[1]
        cells = (f"[`{effect.name}`](#{effect.name})", effect.stage, f"`{number}`",
                 range_of(effect.size), ", ".join(effect.acts_on), effect.shows)  # fmt: skip
        lines.append(f"| {' | '.join(cells)} |")
    for effect in EFFECTS.values():
        lines += ["", f"## `{effect.name}`", "", effect.text, ""]
        if effect.loads != LOAD_KINDS:
            lines += [f"Only under `load.kind` {' or '.join(effect.loads)}.", ""]
        lines += [
            f"- `{p.name}` ({range_of(p)}, default {p.default:g}): {p.description} "
            f"{p.provenance[0].upper()}{p.provenance[1:]}."
            for p in effect.parameters
        ]
    return "\n".join(lines) + "\n"


def range_of(parameter: Parameter) -> str:
    """Range of a number with its unit; pure numbers without."""
    unit = "" if parameter.unit == "1" else f" {parameter.unit}"
    return f"{parameter.low:g} to {parameter.high:g}{unit}"


def _number(value: object) -> str:
    if isinstance(value, tuple):
        return f"[{', '.join(value)}]"
    if isinstance(value, float):
        return f"{value:.6g}"
    return "" if value is None else str(value).lower() if isinstance(value, bool) else str(value)
