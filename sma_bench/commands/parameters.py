"""sma-bench parameters: every parameter, or a file to start from."""

from types import SimpleNamespace

from sma_bench.commands import options
from sma_bench.commands.terminal import output_console, print_table, write_json
from sma_bench.parameters import Parameters, write_parameters
from sma_bench.parameters.documentation import parameter_page
from sma_bench.parameters.node_tables import NODE_TABLES
from sma_bench.parameters.parameter import Parameter
from sma_bench.parameters.table import TABLE


@options.command(
    "parameters",
    "parameters --set wire.resistance=2.8 --out lab.yaml",
)
@options.parameter_options
@options.option("--markdown", "print the documentation page")
@options.output("--out P.yaml", options.FILE, "write a ROS 2 parameter file")
@options.json_option("the table")
def run(args: SimpleNamespace) -> int:
    """Print the table, the page, or write the file."""
    parameters = options.parameters_from_options(args)
    if args.json:
        write_json(args.json, {"parameters": [_entry(p, parameters) for p in TABLE]})
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


def _entry(parameter: Parameter, parameters: Parameters) -> dict[str, object]:
    value = parameters[parameter.name]
    return {
        "name": parameter.name,
        "unit": parameter.unit,
        "value": list(value) if isinstance(value, tuple) else value,
        "std": parameters.std(parameter.name) if parameter.uncertainty is not None else None,
        "low": parameter.low,
        "high": parameter.high,
        "description": parameter.description,
        "source": parameter.provenance,
    }
