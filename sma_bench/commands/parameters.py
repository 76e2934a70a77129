"""sma-bench parameters: every parameter, or a file to start from."""

from types import SimpleNamespace

from sma_bench.commands import options
from sma_bench.commands.terminal import print_table, write_json


@options.command("parameters")
def run(args: SimpleNamespace) -> int:
    from sma_bench.parameters import write_parameters
    from sma_bench.parameters.node_tables import parameter_page
    from sma_bench.parameters.parameter import TABLE
    from sma_bench.report.tables import Table, value_cell

    parameters = options.parameters_from_options(args)
    entries = [
        {"name": p.name, "unit": p.unit,
         "value": list(value) if isinstance(value := parameters[p.name], tuple) else value,
         "std": parameters.std(p.name) if p.uncertainty is not None else None,
         "low": p.low, "high": p.high, "description": p.description, "source": p.provenance}
        for p in TABLE
    ]
    write_json(args.json, {"parameters": entries})
    if args.markdown:
        print(parameter_page(), end="")
    elif args.out:
        comment = "Parameters of an SMA bench in SI units.\nLoad with: --ros-args --params-file"
        write_parameters(args.out, parameters, comment, template=args.params or args.out,
                         explain=True)
        print(args.out)
    else:
        rows = [(p.name, value_cell(parameters[p.name]), p.unit, p.provenance) for p in TABLE]
        print_table(Table(("parameter", "value", "unit", "source"), rows))
    return 0
