"""sma-bench simulate: the paper's model on a protocol or on the voltages of a bag, and on the
elongation that a testing machine imposed."""

from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

from sma_bench.commands import options
from sma_bench.commands.terminal import print_findings, progress, say, write_json
from sma_bench.errors import InputError, errors_in
from sma_bench.parameters import Parameters
from sma_bench.progress import part

if TYPE_CHECKING:
    from sma_bench.physics import Simulation

LARGEST_RATE = 10_000.0  # Hz
_INSTRUMENTS = (0.1, 0.5)  # from which share of the time to which


@options.command("simulate")
def run(args: SimpleNamespace) -> int:
    from sma_bench.estimation.bands import band_of
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
    if not 0.0 < args.rate <= LARGEST_RATE:
        raise InputError(f"--rate is {args.rate:g} Hz, expected 0 to {LARGEST_RATE:g}")
    if args.noise is not None and args.noise < 0:
        raise InputError(f"--noise is {args.noise}, expected a seed of 0 or more")
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
        report(0.0, "the model")
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
