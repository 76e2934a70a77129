"""sma-bench effects: what the paper's model leaves out, as a table or as the documentation page."""

from types import SimpleNamespace
from typing import TYPE_CHECKING

from sma_bench.commands import options
from sma_bench.commands.terminal import output_console, print_table, write_json

if TYPE_CHECKING:
    from sma_bench.parameters.parameter import Effect


@options.command(
    "effects",
    "effects --json effects.json",
)
@options.option("--markdown", "print the documentation page")
@options.json_option("the table")
def run(args: SimpleNamespace) -> int:
    """Print the table or the page."""
    from sma_bench.parameters.documentation import effects_page, range_of
    from sma_bench.parameters.parameter import EFFECTS

    if args.json:
        write_json(args.json, {"effects": [_entry(effect) for effect in EFFECTS.values()]})
    if args.markdown:
        print(effects_page(), end="")
        return 0
    rows = [(e.name, e.stage, range_of(e.size), e.shows) for e in EFFECTS.values()]
    print_table(output_console(), ("effect", "stage", "size", "how it shows"), rows)
    return 0


def _entry(effect: "Effect") -> dict[str, object]:
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
