"""sma-bench parameters: every parameter, or a file to start from."""

from types import SimpleNamespace

from sma_bench.commands import options
from sma_bench.commands.terminal import output_console, print_table, write_json
from sma_bench.parameters import write_parameters
from sma_bench.parameters.documentation import parameter_page
from sma_bench.parameters.node_tables import NODE_TABLES
from sma_bench.parameters.table import TABLE


@options.command("parameters")
def run(args: SimpleNamespace) -> int:
    """Print the table, the page, or write the file."""
    parameters = options.parameters_from_options(args)
    if args.json:
        entries = [
            {"name": p.name, "unit": p.unit,
             "value": list(value) if isinstance(value := parameters[p.name], tuple) else value,
             "std": parameters.std(p.name) if p.uncertainty is not None else None,
             "low": p.low, "high": p.high, "description": p.description, "source": p.provenance}
            for p in TABLE
        ]  # fmt: skip
        write_json(args.json, {"parameters": entries})
    if args.markdown:
        print(parameter_page(NODE_TABLES), end="")
        return 0
    if args.out:
        comment = "Parameters of an SMA bench in SI units.\nLoad with: --ros-args --params-file"
        write_parameters(
            args.out, parameters, comment, template=args.params or args.out, explain=True
        )
        print(args.out)
        return 0
    rows = [(p.name, _shown(parameters[p.name]), p.unit, p.provenance) for p in TABLE]
    print_table(output_console(), ("parameter", "value", "unit", "source"), rows)
    return 0


def _shown(value: object) -> str:
    if isinstance(value, tuple):
        return ", ".join(map(str, value))
    return f"{value:.6g}" if isinstance(value, float) else str(value)
