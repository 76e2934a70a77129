"""sma-bench simulate: the paper's model on a protocol or on the voltages of a bag."""

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from sma_bench.commands.output import write_json
from sma_bench.commands.parameter_options import add_parameter_options, parameters_from_options
from sma_bench.errors import InputError
from sma_bench.hardware.instruments import Instrument
from sma_bench.parameters.node_tables import SIMULATOR
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
    parser.add_argument(
        "--noise", metavar="SEED", type=int,
        help="read through the simulator node's instruments: their noise, drawn from this seed, "
        "and their steps; exact values when not given",
    )
    parser.add_argument("--json", metavar="FILE", help="write what was simulated as JSON")
    add_parameter_options(parser)


def run(args: argparse.Namespace) -> int:
    """Write a bag of the contract with simulated signals, exact or as instruments read them."""
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
    signals, noise = simulated_signals(simulation), "no noise"
    if args.noise is not None:
        if args.noise < 0:
            raise InputError(f"--noise is {args.noise}, expected a seed of 0 or more")
        signals, noise = read_signals(signals, args.noise), f"synthetic noise, seed {args.noise}"
    write_record(Path(args.out), signals, start_ns=start_ns)
    if args.json:
        write_json(args.json, {
            "bag": args.out, "protocol": args.protocol, "input": args.input,
            "effects": list(args.effects), "noise_seed": args.noise, "samples": len(time),
            "duration": float(time[-1] - time[0]),
            "signals": {signal.name: signal.unit for signal in signals},
        })  # fmt: skip
    print(f"{args.out}: {len(time)} simulated samples over {time[-1] - time[0]:.1f} s, {noise}")
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


def read_signals(signals: Sequence[Signal], seed: int) -> list[Signal]:
    """The same signals as the simulator node's instruments would read them.

    A deflection is half the difference of two distances; an elongation is clamped.
    """
    settings = {p.name: float(p.default) for p in SIMULATOR if isinstance(p.default, float)}
    seeds = iter(np.random.SeedSequence(seed).spawn(2 * len(signals)))

    def read(quantity: str, values: np.ndarray) -> np.ndarray:
        noise, step = f"sensor.{quantity}_noise", f"sensor.{quantity}_resolution"
        instrument = Instrument(settings[noise], settings.get(step, 0.0), next(seeds))
        return np.array([instrument.read(value) for value in values.tolist()])

    found = []
    for signal in signals:
        quantity, values = signal.name.rpartition(".")[2], np.asarray(signal.values)
        if quantity == "elongation":
            found.append(signal)
        elif quantity == "deflection":
            away = settings["sensor.range_standoff"]
            front, back = read("range", away - values), read("range", away + values)
            found.append(replace(signal, values=0.5 * (back - front)))
        else:
            found.append(replace(signal, values=read(quantity, values)))
    return found
