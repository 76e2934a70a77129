"""sma-bench linearise: the paper's linearised model (E11) about any operating point of any rig."""

from types import SimpleNamespace

from sma_bench.commands import options
from sma_bench.commands.terminal import print_table, say, write_json
from sma_bench.errors import InputError

_AT = ("voltage", "temperature", "martensite_fraction", "stress")


@options.command("linearise")
def run(args: SimpleNamespace) -> int:
    import numpy as np

    from sma_bench.paper.printed import coefficient_table
    from sma_bench.physics.linearised import OperatingPoint, linearise
    from sma_bench.report.tables import Table

    # The point, of voltages, of temperatures or of a deflection.
    options.one_only(args, "deflection", "voltage", "temperature")
    parameters, column = options.parameters_from_options(args), options.column_of(args)
    channels = parameters["bench.channels"]
    name = "voltage" if args.voltage else "temperature"
    if given := args.voltage or args.temperature:
        if len(given) not in (1, len(channels)) or not np.isfinite(given).all():
            shown = " ".join(f"{number:g}" for number in given)
            raise InputError(f"--{name} {shown}: expected 1 or {len(channels)} finite numbers")
        at = OperatingPoint.at_voltage if args.voltage else OperatingPoint.at_temperature
        point = at(parameters, given[0] if len(given) == 1 else given, args.branch)
    else:
        point = OperatingPoint.at_deflection(parameters, args.deflection, args.branch)
    model = linearise(point, args.latent_heat)
    coefficients = coefficient_table(point, int(point.temperature.argmax()))  # the warmest wire
    gains = model.deflection_per_volt()

    if args.json:
        space = model.state_space()
        numbers = {n: dict(zip(channels, getattr(point, n).tolist(), strict=True)) for n in _AT}
        fields = ("equation", "unit", "printed", "corrected", "remark")
        coefficient = {row.name: {f: getattr(row, f) for f in fields} for row in coefficients}
        write_json(args.json, {
            "operating_point": {"branch": point.branch, "deflection": point.deflection, **numbers},
            "coefficients": coefficient,
            "state_space": {
                "states": [f"{channel}.temperature" for channel in channels],
                "inputs": [f"{channel}.voltage" for channel in channels],
                "outputs": list(model.output_names),
                **{matrix: getattr(space, matrix).tolist() for matrix in "ABCD"},
            },
            "poles": np.linalg.eigvals(space.A).real.tolist(),
            "deflection_per_volt": dict(zip(channels, gains.tolist(), strict=True)),
        })  # fmt: skip
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
    title = f"Operating point on {point.branch}, deflection {1e3 * point.deflection:.4g} mm"
    tables = [
        Table(("wire", "V", "K", "xi", "MPa", "mm/V"), wires, frozenset(range(1, 6)),
              "operating_point", title),
        Table(("coefficient", "eq.", "printed", "corrected", "unit", "what was wrong"), rows,
              frozenset({2, 3}), "coefficients", "Coefficients"),
    ]  # fmt: skip
    for table in tables:
        print_table(table)
    if args.report:
        from sma_bench.report.experiment_figures import operating_point_picture
        from sma_bench.report.page import Section, write_report

        section = Section("", tables=tables, pictures=[operating_point_picture(model)])
        about = "E11, eqs. (18) to (23), corrected."
        page = write_report(args.report, "Linearised model", about, [section],
                            options.made_of(args), column=column)  # fmt: skip
        say(f"report {page}")
    return 0
