"""sma-bench simulate: the paper's model on a protocol or on the voltages of a bag."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING

from sma_bench.commands import options
from sma_bench.commands.terminal import print_findings, progress, say, write_json
from sma_bench.errors import InputError
from sma_bench.progress import part

if TYPE_CHECKING:
    from sma_bench.physics import Simulation

LARGEST_RATE = 10_000.0
_INSTRUMENTS = (0.1, 0.5)  # from which share of the time to which


@options.command("simulate")
def run(args: SimpleNamespace) -> int:
    """Write a bag of the contract with simulated signals, exact or as instruments read them."""
    from sma_bench.protocols import load_protocol
    from sma_bench.records import read_record
    from sma_bench.records.bag_writer import write_record
    from sma_bench.records.samples import drive_of
    from sma_bench.synthetic.bench_records import (
        limits_passed,
        read_signals,
        signals_of,
        simulate_finely,
        simulate_protocol,
    )

    options.one_only(args, "protocol", "input", required=True)
    parameters = options.parameters_from_options(args)
    for text in args.effects:
        parameters = parameters.replace(_effect(text), where="--effect")
    start_ns = 0
    drive: Callable[[], Simulation]
    if args.protocol:
        if not 0.0 < args.rate <= LARGEST_RATE:
            raise InputError(f"--rate is {args.rate:g} Hz, expected 0 to {LARGEST_RATE:g}")
        protocol = load_protocol(args.protocol, parameters)
        drive = partial(simulate_protocol, protocol, parameters, 1.0 / args.rate)
    else:
        record = read_record(args.input)
        start_ns = record.start_ns
        drive = partial(simulate_finely, *drive_of(record, parameters))
    if args.noise is not None and args.noise < 0:
        raise InputError(f"--noise is {args.noise}, expected a seed of 0 or more")
    with progress("simulate") as report:
        report(0.0, "the model")
        simulation = drive()
        time = simulation.time
        signals, noise = signals_of(simulation), "no noise"
        if args.noise is not None:
            signals = read_signals(signals, args.noise, part(report, *_INSTRUMENTS))
            noise = f"synthetic noise, seed {args.noise}"
        writing = part(report, _INSTRUMENTS[1], 1.0)
        write_record(Path(args.out), signals, start_ns=start_ns, report=writing, replace=args.force)
    findings = limits_passed(simulation)
    if args.json:
        write_json(args.json, {
            "bag": args.out, "protocol": args.protocol, "input": args.input,
            "effects": list(args.effects), "noise_seed": args.noise, "samples": len(time),
            "duration": float(time[-1] - time[0]),
            "signals": {signal.name: signal.unit for signal in signals},
            "findings": [finding.to_json() for finding in findings],
        })  # fmt: skip
    print_findings(findings)
    say(f"{args.out}: {len(time)} simulated samples over {time[-1] - time[0]:.1f} s, {noise}")
    return 0


def _effect(text: str) -> dict[str, float]:
    from sma_bench.physics.effects import effect_values

    name, equals, value = text.partition("=")
    try:
        return effect_values(name.strip(), float(value))
    except ValueError as error:
        if isinstance(error, InputError):
            raise InputError(f"--effect {text}: {error}") from None
        wanted = "expected NAME=VALUE" if not equals else f"{value!r} is not a number"
        raise InputError(f"--effect {text}: {wanted}") from None
