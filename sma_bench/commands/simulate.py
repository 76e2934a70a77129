"""sma-bench simulate: the paper's model on a protocol or on the voltages of a bag."""

import argparse
from pathlib import Path

import numpy as np

from sma_bench.commands.parameter_options import add_parameter_options, parameters_from_options
from sma_bench.errors import InputError
from sma_bench.physics.effects import effect_values
from sma_bench.physics.simulate import Simulation, simulate
from sma_bench.protocols import load_protocol
from sma_bench.records import Signal, read_record
from sma_bench.records.held_voltages import held_voltages
from sma_bench.records.write import write_record

LARGEST_RATE = 10_000.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    source = parser.add_mutually_exclusive_group(required=True)
    source.add_argument("--protocol", metavar="NAME", help="a protocol's name or .yaml file")
    source.add_argument("--input", metavar="BAG", help="use the voltages measured in a bag")
    parser.add_argument("--out", metavar="BAG", required=True, help="bag to write (new folder)")
    parser.add_argument(
        "--rate", metavar="HZ", type=float, default=100.0, help="samples a second of a protocol"
    )
    parser.add_argument(
        "--effect", metavar="NAME=VALUE", action="append", default=[], dest="effects",
        help="switch an effect on by its size, e.g. --effect latent_heat=12e3; NAME.NUMBER=VALUE "
        "for its other numbers (repeatable; sma-bench effects lists them)",
    )
    add_parameter_options(parser)


def run(args: argparse.Namespace) -> int:
    """Write a bag of the contract with exact (noise-free) simulated signals."""
    parameters = parameters_from_options(args)
    for text in args.effects:
        parameters = parameters.replace(_effect(text), where="--effect")
    start_ns = 0
    if args.protocol:
        if not 0.0 < args.rate <= LARGEST_RATE:
            raise InputError(f"--rate is {args.rate:g} Hz, expected 0 to {LARGEST_RATE:g}")
        time, voltage = load_protocol(args.protocol, parameters).sample(1.0 / args.rate)
    else:
        record = read_record(args.input)
        start_ns = record.start_ns
        time, voltage = held_voltages(record, parameters["bench.channels"])
    simulation = simulate(parameters, time, voltage)
    write_record(Path(args.out), simulated_signals(simulation), start_ns=start_ns)
    print(f"{args.out}: {len(time)} simulated samples over {time[-1] - time[0]:.1f} s, no noise")
    return 0


def _effect(text: str) -> dict[str, float]:
    name, equals, value = text.partition("=")
    try:
        return effect_values(name.strip(), float(value))
    except ValueError as error:
        if isinstance(error, InputError):
            raise InputError(f"--effect {text}: {error}") from None
        wanted = "expected NAME=VALUE" if not equals else f"{value!r} is not a number"
        raise InputError(f"--effect {text}: {wanted}") from None


def simulated_signals(simulation: Simulation) -> list[Signal]:
    """Signals of the contract that a bench would have measured."""
    time, channels = simulation.time, simulation.parameters["bench.channels"]
    signals = []
    for k, channel in enumerate(channels):
        signals += [
            Signal(f"{channel}.voltage", "V", time, simulation.voltage[:, k]),
            Signal(f"{channel}.current", "A", time, simulation.current[:, k]),
            Signal(f"{channel}.temperature", "K", time, simulation.temperature_reading[:, k]),
        ]
    if len(channels) > 1:
        return [*signals, Signal("deflection", "m", time, simulation.deflection_reading)]
    return [
        *signals,
        Signal("elongation", "m", time, np.zeros_like(time)),
        Signal("force", "N", time, simulation.force[:, 0]),
    ]
