"""How times grow: with the record's length, wires, effects, parameter sets; the fitted exponent."""

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from examination.perf.measuring import LINEAR, Figure, exponent, interleaved
from examination.perf.records import staircase_bag
from examination.perf.simulation import drive
from sma_bench.identify import identify
from sma_bench.parameters import Parameters
from sma_bench.physics import simulate
from sma_bench.records import read_record

# On top of one another, each as its table's default or this.
EFFECTS = {
    "effect.latent_heat.heat": 12e3,
    "effect.phase_dependent_resistance.austenite_change": -0.1,
    "effect.temperature_dependent_convection.rise": 2e-3,
    "effect.temperature_lag.time_constant": 0.1,
    "effect.supply_drop.resistance": 0.2,
    "effect.ambient_drift.rate": 1e-3,
    "effect.transition_drift.shift": -2.0,
    "effect.temperature_underfill.missing": 0.1,
}


def measure(tiny: bool = False) -> Iterator[Figure]:
    """Exponents, and the price of all effects."""
    scale, wire = 20 if tiny else 1, Parameters.of_paper()
    few = drive(20_000 // scale, 1)
    inputs = {n // scale: drive(n // scale, 1) for n in (10_000, 30_000, 100_000, 300_000)}
    samples = {n: (lambda given=given: simulate(wire, *given)) for n, given in inputs.items()}
    yield _exponent("simulation over samples", samples)
    rigs = {w: (_rig(wire, w), *drive(20_000 // scale, w)) for w in (1, 2, 4, 8, 16)}
    wires = {w: (lambda given=given: simulate(*given)) for w, given in rigs.items()}
    yield _exponent("simulation over wires", wires)
    many = [wire.replace({"wire.resistance": 2.5 + 0.01 * k}) for k in range(16)]
    sets = {n: (lambda n=n: [simulate(p, *few) for p in many[:n]]) for n in (2, 4, 8, 16)}
    yield _exponent("simulation over parameter sets", sets)

    on = [wire.replace(dict(list(EFFECTS.items())[:k])) for k in range(len(EFFECTS) + 1)]
    seconds = interleaved({str(k): (lambda p=p: simulate(p, *few)) for k, p in enumerate(on)}, 5)
    times = np.median([*seconds.values()], axis=1) / np.median(seconds["0"])
    case, what = "simulation over effects", f"{len(EFFECTS)} effects on: times the time of none"
    yield Figure(case, what, times[-1], "x")
    each = float(np.polyfit(range(len(on)), times, 1)[0])
    yield Figure(case, "added by each, of the time of none", each)

    with TemporaryDirectory() as folder:
        lengths = (20.0, 60.0) if tiny else (120.0, 360.0, 1080.0)
        bags = {length: staircase_bag(Path(folder, f"{length:g}"), length) for length in lengths}
        reading = {length: (lambda bag=bag: read_record(bag)) for length, bag in bags.items()}
        yield _exponent("reading over the record's length", reading)
        records = {length: [read_record(bag)] for length, bag in bags.items()}
        identifying = {n: (lambda r=r: identify(r, wire)) for n, r in records.items()}
        yield _exponent("identification over the record's length", identifying)


def _rig(wire: Parameters, wires: int) -> Parameters:
    """A composite with half of its wires on each side; a single one is clamped."""
    if wires == 1:
        return wire
    sides = ["front"] * (wires // 2) + ["back"] * (wires // 2)
    names = tuple(f"{side}_{k}" for k, side in enumerate(sides))
    return wire.replace({"bench.channels": names, "bench.channel_sides": tuple(sides)})


def _exponent(case: str, calls: Mapping[float, Callable[[], object]]) -> Figure:
    seconds = interleaved({str(size): call for size, call in calls.items()}, 5, budget=20.0)
    sizes, medians = list(calls), [np.median(taken) for taken in seconds.values()]
    what = f"exponent from {sizes[0]:g} to {sizes[-1]:g}"
    return Figure(case, what, exponent(sizes, medians), most=LINEAR)
