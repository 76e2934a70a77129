"""sma-bench linearise: the paper's linearised model (E11) about any operating point of any rig."""

from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

from sma_bench.commands import options
from sma_bench.commands.terminal import output_console, print_table, say, write_json
from sma_bench.errors import InputError
from sma_bench.parameters import Parameters

if TYPE_CHECKING:
    import numpy as np

    from sma_bench.physics.linearised import Coefficient, Linearised
    from sma_bench.physics.operating_point import OperatingPoint


@options.command("linearise")
def run(args: SimpleNamespace) -> int:
    """Print point, coefficients as printed and corrected, gains; write what was asked for."""
    from sma_bench.physics.linearised import coefficient_table, linearise

    options.one_only(args, "deflection", "voltage", "temperature")
    parameters, column = options.parameters_from_options(args), options.column_of(args)
    model = linearise(_point(args, parameters), args.latent_heat)
    point, channels = model.point, parameters["bench.channels"]
    coefficients = coefficient_table(point, int(point.temperature.argmax()))  # the warmest wire
    if args.json:
        write_json(args.json, document(model, coefficients))
    title = f"operating point on {point.branch}, deflection {1e3 * point.deflection:.4g} mm"
    gains = model.deflection_per_volt()
    heading = ("wire", "V", "K", "xi", "MPa", "mm/V")
    wires = [
        (channel, f"{point.voltage[k]:.4g}", f"{point.temperature[k]:.2f}",
         f"{point.martensite_fraction[k]:.4f}", f"{point.stress[k] / 1e6:.4g}",
         f"{1e3 * gains[k]:.4g}")
        for k, channel in enumerate(channels)
    ]  # fmt: skip
    rows = [
        (row.name, row.equation, f"{row.printed:.5g}", f"{row.corrected:.5g}", row.unit, row.remark)
        for row in coefficients
    ]
    names = ("coefficient", "eq.", "printed", "corrected", "unit", "what was wrong")
    print_table(output_console(), heading, wires, right=range(1, 6), title=title)
    output_console().print()
    print_table(output_console(), names, rows, right=(2, 3))
    if args.report:
        from sma_bench.report.composite_figures import operating_point_picture
        from sma_bench.report.page import Made, Section, Table, write_report

        made = Made(args.command_line, [*filter(None, [args.params])])
        tables = [
            Table(heading, wires, frozenset(range(1, 6)), "operating_point"),
            Table(names, rows, frozenset({2, 3}), "coefficients", "Coefficients"),
        ]
        picture = operating_point_picture(model)
        sections = [Section(title.capitalize(), tables=tables, pictures=[picture]), made.section()]
        about = f"E11, eqs. (18) to (23), corrected. {made.head}"
        page = write_report(args.report, "Linearised model", about, sections, column=column)
        say(f"report {page}")
    return 0


def _point(args: SimpleNamespace, parameters: Parameters) -> "OperatingPoint":
    from sma_bench.physics.operating_point import OperatingPoint, full_stroke

    wires = len(parameters["bench.channels"])
    for name in ("voltage", "temperature"):
        given = getattr(args, name)
        if not given:
            continue
        if len(given) not in (1, wires):
            raise InputError(f"--{name}: {len(given)} numbers, expected 1 or {wires}")
        at = OperatingPoint.at_voltage if name == "voltage" else OperatingPoint.at_temperature
        return at(parameters, given[0] if len(given) == 1 else given, args.branch)
    deflection = args.deflection
    if deflection is None:
        deflection = 0.5 * full_stroke(parameters)
    return OperatingPoint.at_deflection(parameters, deflection, args.branch)


def document(model: "Linearised", coefficients: "list[Coefficient]") -> dict[str, Any]:
    """Everything as plain numbers in SI units."""
    import numpy as np

    point, space = model.point, model.state_space()
    channels = point.parameters["bench.channels"]

    def named(values: "np.ndarray") -> dict[str, float]:
        return dict(zip(channels, values.tolist(), strict=True))

    return {
        "operating_point": {
            "branch": point.branch,
            "deflection": point.deflection,
            "voltage": named(point.voltage),
            "temperature": named(point.temperature),
            "martensite_fraction": named(point.martensite_fraction),
            "stress": named(point.stress),
        },
        "coefficients": {
            row.name: {
                name: getattr(row, name)
                for name in ("equation", "unit", "printed", "corrected", "remark")
            }
            for row in coefficients
        },
        "state_space": {
            "states": [f"{channel}.temperature" for channel in channels],
            "inputs": [f"{channel}.voltage" for channel in channels],
            "outputs": list(model.output_names),
            **{name: getattr(space, name).tolist() for name in "ABCD"},
        },
        "poles": np.linalg.eigvals(space.A).real.tolist(),
        "deflection_per_volt": named(model.deflection_per_volt()),
    }
