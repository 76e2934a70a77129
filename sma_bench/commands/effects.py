"""sma-bench effects: what the paper's model leaves out, as a table or as the documentation page."""

import argparse

from rich.console import Console
from rich.table import Table

from sma_bench.commands.output import write_json
from sma_bench.physics.effects import EFFECTS
from sma_bench.physics.effects.documentation import effects_page, range_of
from sma_bench.physics.effects.effect import Effect

DESCRIPTION = "show every effect with its stage, the unit and range of its size, and how it shows"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("--markdown", action="store_true", help="print the documentation page")
    parser.add_argument("--json", metavar="FILE", help="write the table, machine-readable")


def run(args: argparse.Namespace) -> int:
    """Print the table or the page."""
    if args.json:
        write_json(args.json, {"effects": [_entry(effect) for effect in EFFECTS.values()]})
    if args.markdown:
        print(effects_page(), end="")
        return 0
    table = Table(box=None, pad_edge=False)
    for heading in ("effect", "stage", "size"):
        table.add_column(heading, no_wrap=True)
    table.add_column("how it shows", min_width=30)
    for effect in EFFECTS.values():
        table.add_row(effect.name, effect.stage, range_of(effect.size), effect.shows)
    console = Console(highlight=False)
    console.width = max(console.width, 110)  # a name is not to be cut, nor its range
    console.print(table)
    return 0


def _entry(effect: Effect) -> dict[str, object]:
    return {
        "name": effect.name,
        "stage": effect.stage,
        "acts_on": list(effect.acts_on),
        "shows": effect.shows,
        "parameters": [
            {"name": p.name, "unit": p.unit, "default": p.default, "low": p.low, "high": p.high}
            for p in effect.parameters
        ],
    }
