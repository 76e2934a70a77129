"""The paper's model: simulated with a protocol or a bag's voltages, and linearised (E11)."""

from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

from sma_bench.commands import options
from sma_bench.commands.terminal import print_findings, print_table, progress, say, write_json
from sma_bench.errors import InputError, errors_in
from sma_bench.parameters import Parameters
from sma_bench.progress import part

if TYPE_CHECKING:
    from sma_bench.physics import Simulation

_INSTRUMENTS = (0.1, 0.5)  # share of the time when reading the sensors begins and ends
_AT = ("voltage", "temperature", "martensite_fraction", "stress")


@options.command("simulate")
def run_simulate(args: SimpleNamespace) -> int:
    from sma_bench.estimation.laws import band_of
    from sma_bench.findings import Finding
    from sma_bench.live.virtual_bench import STANDS
    from sma_bench.parameters.parameters import idle_effects, load_kind
    from sma_bench.physics.effects import with_effect
    from sma_bench.protocols import load_protocol
    from sma_bench.records import read_record
    from sma_bench.records.bag_writer import write_record
    from sma_bench.records.record import drive_of
    from sma_bench.synthetic import bench_records as bench

    options.one_only(args, "protocol", "input", required=True)
    parameters = options.parameters_from_options(args)
    for text in args.effects:
        name, value = options.pair("--effect", text)
        with errors_in(f"--effect {text}"):
            parameters = with_effect(parameters, name, value)
    protocol = load_protocol(args.protocol, parameters) if args.protocol else None
    record = read_record(args.input) if args.input else None
    if args.band is not None and not args.json:
        raise InputError("--band adds to the result file, expected --json FILE")

    def simulated(parameters: Parameters) -> "Simulation":
        if protocol is not None:
            return bench.simulate_protocol(protocol, parameters, 1.0 / args.rate)
        assert record is not None
        return bench.simulate_finely(*drive_of(record, parameters))

    with progress("simulate") as report:
        report(0.0, "simulating the model")
        simulation = simulated(parameters)
        band: dict[str, Any] = {}
        if args.band is not None:
            limits = band_of(parameters, lambda drawn: bench.signals_of(simulated(drawn)),
                             args.band, part(report, 0.0, _INSTRUMENTS[0]))
            named = {name: {"low": own.low.tolist(), "high": own.high.tolist()}
                     for name, own in limits.items()}
            band = {"band": {"share": args.band, "time": simulation.time.tolist(), "limits": named}}
        time, signals, noise = simulation.time, bench.signals_of(simulation), "no noise"
        if args.noise is not None:
            signals = bench.read_signals(signals, args.noise, part(report, *_INSTRUMENTS))
            noise = f"synthetic noise, seed {args.noise}"
        start_ns, writing = record.start_ns if record else 0, part(report, _INSTRUMENTS[1], 1.0)
        write_record(Path(args.out), signals, start_ns=start_ns, report=writing, replace=args.force)
    findings = bench.limits_passed(simulation, parameters)
    idle = idle_effects(parameters).items()
    findings += [Finding("warning", name, f"does nothing: {fault}") for name, fault in idle]
    if protocol is not None and load_kind(simulation.parameters) == "displacement":
        findings.append(Finding("warning", "load.kind", STANDS))
    write_json(args.json, {"bag": args.out, "protocol": args.protocol, "input": args.input,
                           "effects": list(args.effects), "noise_seed": args.noise,
                           "samples": len(time), "duration": float(time[-1] - time[0]),
                           "signals": {signal.name: signal.unit for signal in signals}, **band,
                           "findings": [finding.to_json() for finding in findings]})
    print_findings(findings)
    say(f"{args.out}: {len(time)} simulated samples over {time[-1] - time[0]:.1f} s, {noise}")
    return 0


@options.command("linearise")
def run_linearise(args: SimpleNamespace) -> int:
    import numpy as np

    from sma_bench.paper.printed import coefficient_table
    from sma_bench.physics.linearised import OperatingPoint, linearise
    from sma_bench.report.tables import Table

    # The operating point: from voltages, temperatures or a deflection.
    options.one_only(args, "deflection", "voltage", "temperature")
    parameters, column = options.parameters_from_options(args), options.column_of(args)
    channels = parameters["bench.channels"]
    name = "voltage" if args.voltage else "temperature"
    if given := args.voltage or args.temperature:
        if len(given) not in (1, len(channels)):
            shown = " ".join(f"{number:g}" for number in given)
            raise InputError(f"--{name} {shown}: expected 1 or {len(channels)} numbers")
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
        outputs = [f"{channel}.{kind}"
                   for kind in ("temperature", "stress") for channel in channels]
        write_json(args.json, {
            "operating_point": {"branch": point.branch, "deflection": point.deflection, **numbers},
            "coefficients": {row.name: row._asdict() for row in coefficients},
            "state_space": {
                "states": [f"{channel}.temperature" for channel in channels],
                "inputs": [f"{channel}.voltage" for channel in channels],
                "outputs": ["deflection", *outputs],
                **{matrix: getattr(space, matrix).tolist() for matrix in "ABCD"},
            },
            "poles": np.linalg.eigvals(space.A).real.tolist(),
            "deflection_per_volt": dict(zip(channels, gains.tolist(), strict=True))})
    wires = [(channel, f"{point.voltage[k]:.4g}", f"{point.temperature[k]:.2f}",
              f"{point.martensite_fraction[k]:.4f}", f"{point.stress[k] / 1e6 + 0.0:.4g}",
              f"{1e3 * gains[k]:.4g}") for k, channel in enumerate(channels)]
    rows = [(c.name, c.equation, f"{c.printed:.5g}", f"{c.corrected:.5g}", c.unit, c.remark)
            for c in coefficients]
    title = f"Operating point on {point.branch}, deflection {1e3 * point.deflection:.4g} mm"
    tables = [
        Table(("wire", "V", "K", "xi", "MPa", "mm/V"), wires, frozenset(range(1, 6)),
              "operating_point", title),
        Table(("coefficient", "eq.", "printed", "corrected", "unit", "error in the paper"), rows,
              frozenset({2, 3}), "coefficients", "Coefficients")]
    for table in tables:
        print_table(table)
    if args.report:
        from sma_bench.report.experiment_figures import operating_point_picture
        from sma_bench.report.page import Section, write_report

        section = Section("", tables=tables, pictures=[operating_point_picture(model)])
        page = write_report(args.report, "Linearised model", "E11, eqs. (18) to (23), corrected.",
                            [section], options.provenance_of(args), column=column)
        say(f"report {page}")
    return 0
