"""Does a model fitted to motion and voltage of two runs predict runs with other drives?

Benches are drawn from the population of the blind check and simulated by its reality, which shares
no code with the model; the lab's parameters have errors as stated. `--rich` adds further properties
of real wires, `--hard` properties that make a bench hard to predict: see loads.yaml.

    ./bench check loads --benches 20 --seed 0 --json result.json
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from examination.blind import rigs
from examination.blind.reality import World, happen
from examination.blind.sensors import Noise, Sensors, measure
from examination.pieces import IN_PIECES, Z_95, in_pieces, options_of, print_coverage, print_table
from sma_bench.estimation.unknowns import SHAPES
from sma_bench.identify import identify
from sma_bench.parameters import Parameters
from sma_bench.physics import simulate
from sma_bench.records import Record

LOADS = ("force", "spring", "antagonist")
UNSEEN = 5
MEDIAN, TAIL = 0.02, 0.04  # shares of the stroke, limits of the error
BAND = (0.88, 0.99)
NOISE = {"voltage": 2e-3, "current": 5e-3, "temperature": 0.2, "deflection": 2e-5}
BENCHES = yaml.safe_load(Path(__file__).with_suffix(".yaml").read_text())


def main(argv: Sequence[str] | None = None) -> int:
    options = options_of("loads", __doc__, argv, benches=(20, "of each load"),
                         seed=(0, "of the first bench"), load=(LOADS, "which loads"),
                         rich=(False, "with latent heat, convection, R(xi)"),
                         hard=(False, "and worse"), **IN_PIECES)
    kind = "hard" if options.hard else "rich" if options.rich else "mild"
    jobs = [(load, options.seed + k, kind) for load in options.load for k in range(options.benches)]
    return 0 if report(in_pieces(try_bench, jobs, options)) else 1


def try_bench(load: str, seed: int, kind: str) -> dict[str, Any]:
    """One bench: two runs fitted, five with other drives predicted."""
    rng = np.random.default_rng([LOADS.index(load), seed])
    truth = rigs.draw_truth(rng, load)
    nominal = rigs.draw_nominal(truth, rng)
    world = rigs.world_of(truth, {n: float(rng.uniform(*r)) for n, r in BENCHES[kind].items()})
    families = rng.permutation(rigs.FAMILIES).tolist()
    seen = [rigs.draw_drive(family, truth, rng) for family in families[:2]]
    unseen = [rigs.draw_drive(families[2 + k % 2], truth, rng) for k in range(UNSEEN)]
    sensors, records = Sensors({quantity: Noise(std) for quantity, std in NOISE.items()}), []
    for k, drive in enumerate(seen):
        signals = measure(_played(world, drive), world, sensors, rng, ("deflection",))
        records.append(Record(Path(f"run_{k}"), 0, {signal.name: signal for signal in signals}))
    found = identify(records, nominal)
    deviations = {name: (e.value - float(truth[name])) / e.std
                  for name, e in found.estimates.items()
                  if name not in SHAPES and "effect." not in name and e.std > 0.0}
    return {"load": load, "deviations": deviations,
            "believed": [_error(world, nominal, drive) for drive in unseen],
            "unseen": [_error(world, found.parameters, drive) for drive in unseen]}


def _error(world: World, parameters: Parameters, drive: rigs.Drive) -> float:
    """Rms of predicted minus true motion, as a share of the stroke."""
    played = _played(world, drive)
    left = simulate(parameters, played.time, played.voltage).deflection - played.deflection
    return float(np.sqrt(np.mean(np.square(left))) / np.ptp(played.deflection))


def _played(world: World, drive: rigs.Drive) -> Any:
    time = drive.grid(rigs.COMMAND_PERIOD)
    return happen(world, time, drive.voltage(time, tuple(world.parameters["bench.channel_sides"])))


def report(results: Sequence[dict[str, Any]]) -> bool:
    print("unseen error in % of stroke; truth in the stated 95 % interval")
    passed, rows = True, []
    for load in dict.fromkeys(r["load"] for r in results):
        own = [r for r in results if r["load"] == load]
        unseen = np.concatenate([r["unseen"] for r in own])
        stated = float(np.median(np.concatenate([r["believed"] for r in own])))
        median, tail = float(np.median(unseen)), float(np.quantile(unseen, 0.9))
        off = np.concatenate([list(r["deviations"].values()) for r in own])
        share = float(np.mean(np.abs(off) <= Z_95))
        good = median < MEDIAN and tail < TAIL and BAND[0] <= share <= BAND[1]
        passed &= good
        percent = (f"{100 * x:.2f}" for x in (stated, median, tail, share))
        rows.append((load, len(own), *percent, "" if good else "outside the limits"))
    print_table(("load", ">benches", ">as stated", ">median", ">90 %", ">inside", ""), rows)
    print()
    print_coverage((item for r in results for item in r["deviations"].items()), Z_95)
    return passed
