"""How times grow: with the record's length, wires, effects, parameter sets; the fitted exponent."""

from collections.abc import Callable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from examination.perf.figures import Figure, Outcome, at_most
from examination.perf.simulation import drive
from examination.perf.timing import exponent, interleaved
from examination.perf.whole_commands import staircase_signals
from sma_bench.identify import identify
from sma_bench.parameters import Parameters
from sma_bench.physics import simulate
from sma_bench.records import read_record
from sma_bench.records.bag_writer import write_record

# On top of one another, each as its table's default or this.
EFFECTS = (
    ("effect.latent_heat.heat", 12e3),
    ("effect.phase_dependent_resistance.austenite_change", -0.1),
    ("effect.temperature_dependent_convection.rise", 2e-3),
    ("effect.temperature_lag.time_constant", 0.1),
    ("effect.supply_drop.resistance", 0.2),
    ("effect.ambient_drift.rate", 1e-3),
    ("effect.transition_drift.shift", -2.0),
    ("effect.temperature_underfill.missing", 0.1),
)
_LINEAR = 1.15


def measure(tiny: bool = False) -> list[Outcome]:
    """Exponents, and the price of all effects."""
    scale = 20 if tiny else 1
    with TemporaryDirectory() as folder:
        lengths = (10.0, 20.0) if tiny else (60.0, 180.0, 600.0)
        longer = (30.0, 60.0) if tiny else (120.0, 360.0, 1080.0)
        bags = {duration: Path(folder, f"{duration:g}") for duration in (*lengths, *longer)}
        for duration, bag in bags.items():
            write_record(bag, staircase_signals(duration))
        records = {duration: read_record(bags[duration]) for duration in longer}
        return [
            *_simulated(scale),
            _exponent("reading over the record's length", lengths, lambda d: read_record(bags[d])),
            _exponent("identification over the record's length", longer,
                      lambda d: identify([records[d]], Parameters.of_paper()), rounds=3),
        ]


def _simulated(scale: int) -> list[Outcome]:
    wire = Parameters.of_paper()
    lengths = [10_000 // scale, 30_000 // scale, 100_000 // scale, 300_000 // scale]
    inputs = {n: drive(n, 1) for n in lengths}
    outcomes: list[Outcome] = [
        _exponent("simulation over samples", lengths, lambda n: simulate(wire, *inputs[n]))
    ]
    counts = [1, 2, 4, 8, 16]
    rigs = {w: _rig(wire, w) for w in counts}
    beams = {w: drive(20_000 // scale, w) for w in counts}
    outcomes.append(
        _exponent("simulation over wires", counts, lambda w: simulate(rigs[w], *beams[w]))
    )
    sets = [2, 4, 8, 16]
    few = drive(20_000 // scale, 1)
    outcomes.append(
        _exponent(
            "simulation over parameter sets", sets,
            lambda n: [simulate(wire.replace({"wire.resistance": 2.5 + 0.01 * k}), *few)
                       for k in range(n)],
        )
    )
    with_effects = {k: wire.replace(dict(EFFECTS[:k])) for k in range(len(EFFECTS) + 1)}
    seconds = interleaved(
        {str(k): (lambda k=k: simulate(with_effects[k], *few)) for k in with_effects}, 5
    )
    medians = [float(np.median(seconds[str(k)])) for k in with_effects]
    each = float(np.polyfit(list(with_effects), np.array(medians) / medians[0], 1)[0])
    outcomes.append(
        Figure("simulation over effects", f"{len(EFFECTS)} effects on: times the time of none",
               medians[-1] / medians[0], "x")
    )
    what = "added by each, of the time of none"
    outcomes.append(Figure("simulation over effects", what, each, ""))
    return outcomes


def _rig(wire: Parameters, wires: int) -> Parameters:
    """A composite with half of its wires on each side; a single one is clamped."""
    if wires == 1:
        return wire
    sides = ["front"] * (wires // 2) + ["back"] * (wires // 2)
    names = tuple(f"{side}_{k}" for k, side in enumerate(sides))
    return wire.replace({"bench.channels": names, "bench.channel_sides": tuple(sides)})


def _exponent(
    case: str, sizes: Sequence[float], call: Callable[..., object], rounds: int = 5
) -> Figure:
    seconds = interleaved(
        {str(size): (lambda size=size: call(size)) for size in sizes}, rounds, budget=20.0
    )
    medians = np.array([np.median(seconds[str(size)]) for size in sizes])
    what = f"exponent from {sizes[0]:g} to {sizes[-1]:g}"
    return Figure(case, what, exponent(np.array(sizes), medians), "", at_most(_LINEAR))
