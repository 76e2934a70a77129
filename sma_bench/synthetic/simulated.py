"""A simulated bench, and its signals: exact, or as the simulator node's instruments read them."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from sma_bench.hardware.instruments import Instrument
from sma_bench.parameters import Parameters
from sma_bench.parameters.node_tables import SIMULATOR
from sma_bench.physics import Simulation, simulate
from sma_bench.physics.effects import active_effects
from sma_bench.progress import Report, in_turn, silent
from sma_bench.records.record import Signal

# s. The paper's model is exact in any step; effects that act within one, latent heat above all,
# need short ones.
_FINE_STEP = 0.0025
_OF_SAMPLES = ("time", "voltage", "temperature", "martensite_fraction", "stress", "contraction",
               "bending", "temperature_reading")  # fmt: skip


def simulate_finely(parameters: Parameters, time: ArrayLike, voltage: ArrayLike) -> Simulation:
    """`simulate` at these samples, in steps between them that are short enough for effects.

    Args:
        parameters: of the bench; time: (n,) s; voltage: (n, w) V, held to the next sample.

    Raises:
        InputError: as `simulate`.
    """
    seconds = np.asarray(time, dtype=np.float64)
    if not active_effects(parameters) or seconds.ndim != 1 or len(seconds) < 2:
        return simulate(parameters, time, voltage)
    gaps = np.diff(seconds)
    parts = np.append(np.maximum(np.ceil(gaps / _FINE_STEP), 1.0), 1.0).astype(int)
    if not np.all(gaps > 0.0):
        return simulate(parameters, time, voltage)  # which says what is wrong with them
    first = np.cumsum(parts) - parts
    within = np.arange(parts.sum()) - np.repeat(first, parts)
    fine = np.repeat(seconds, parts) + within * np.repeat(np.append(gaps, 0.0) / parts, parts)
    run = simulate(parameters, fine, np.repeat(np.asarray(voltage), parts, axis=0))
    return replace(run, **{name: getattr(run, name)[first] for name in _OF_SAMPLES})


def signals_of(simulation: Simulation) -> list[Signal]:
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


def read_signals(
    signals: Sequence[Signal], seed: int, report: Report = silent
) -> list[Signal]:
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
    for signal in in_turn(signals, report, lambda s: f"reading {s.name}"):
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
