"""sma-bench effects: what the paper's model leaves out, as a table or as the documentation page."""

from types import SimpleNamespace

from sma_bench.commands import options
from sma_bench.commands.terminal import print_table, write_json


@options.command("effects")
def run(args: SimpleNamespace) -> int:
    from sma_bench.parameters.node_tables import effects_page, range_of
    from sma_bench.parameters.parameter import EFFECTS
    from sma_bench.report.tables import Table

    numbers = ("name", "unit", "default", "low", "high")
    entries = [
        {"name": e.name, "stage": e.stage, "acts_on": list(e.acts_on), "shows": e.shows,
         "parameters": [{key: getattr(p, key) for key in numbers} for p in e.parameters]}
        for e in EFFECTS.values()
    ]
    write_json(args.json, {"effects": entries})
    if args.markdown:
        print(effects_page(), end="")
    else:
        rows = [(e.name, e.stage, range_of(e.size), e.shows) for e in EFFECTS.values()]
        print_table(Table(("effect", "stage", "size", "how it shows"), rows))
    return 0
