"""Does a bench's model, fitted to motion and voltage of two runs, predict runs of other shapes?

Benches with a weight, a spring or an antagonist are drawn from the population of the blind check
and played by its reality, which shares no code with the model: grains with temperatures of their
own, smoother kinetics, inner loops that remember, instruments with noise, jitter and losses.
The lab's numbers are off by their stated errors. Shapes of the model's kinetics and its effects
have no truth there that could lie in an interval. `--rich` adds what a real wire has besides:
latent heat, free convection and radiation, a resistance that changes with phase. `--hard` adds what
makes a bench hard to predict: grains far apart, loops that remember, an R-phase, strain that stays
when the wire cools, a room that warms and cools.

    ./bench check loads --benches 20 --seed 0 --json result.json
"""

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from examination.blind import rigs
from examination.blind.reality import World, happen
from examination.blind.sensors import Noise, Sensors, measure
from examination.pieces import IN_PIECES, Z_95, in_pieces, options_of
from sma_bench.estimation.unknowns import SHAPES
from sma_bench.identify import identify
from sma_bench.parameters import Parameters
from sma_bench.physics import simulate
from sma_bench.records import Record

LOADS = ("force", "spring", "antagonist")
UNSEEN = 5
MEDIAN, TAIL = 0.02, 0.04  # of the stroke
BAND = (0.88, 0.99)
NOISE = {"voltage": 2e-3, "current": 5e-3, "temperature": 0.2, "deflection": 2e-5}
MILD = {"grain_spread": (0.0, 2.0), "kinetics_smoothness": (0.0, 0.5),
        "return_point_memory": (0.0, 0.2)}  # fmt: skip
RICH = {"latent_heat": (5e3, 15e3), "convection_by_correlation": (0.5, 1.0),
        "resistance_austenite_change": (-0.12, 0.05)}  # fmt: skip
HARD = RICH | {
    "grain_spread": (1.0, 7.0), "kinetics_smoothness": (0.0, 1.0), "ambient_wave": (-1.5, 1.5),
    "return_point_memory": (0.2, 1.0), "r_phase": (0.0, 0.12), "unrecovered_strain": (0.0, 0.03),
}  # fmt: skip
BENCHES = {"mild": MILD, "rich": MILD | RICH, "hard": MILD | HARD}


def main(argv: Sequence[str] | None = None) -> int:
    """Run the campaign; 0 if predictions and stated errors are good enough, 1 if not."""
    options = options_of(
        "loads", __doc__, argv, benches=(20, "of each load"), seed=(0, "of the first bench"),
        load=(LOADS, "which loads"), hard=(False, "and worse"),
        rich=(False, "with latent heat, convection, R(xi)"), **IN_PIECES,
    )  # fmt: skip
    kind = "hard" if options.hard else "rich" if options.rich else "mild"
    jobs = [(load, options.seed + k, kind) for load in options.load for k in range(options.benches)]
    return 0 if report(in_pieces(try_bench, jobs, options)) else 1


def try_bench(job: tuple[str, int, str]) -> dict[str, Any]:
    """One bench: two runs fitted, five of the other shapes predicted."""
    load, seed, kind = job
    rng = np.random.default_rng([LOADS.index(load), seed])
    truth = rigs.draw_truth(rng, load)
    nominal = rigs.draw_nominal(truth, rng)
    ranges = BENCHES[kind]
    world = rigs.world_of(truth, {n: float(rng.uniform(*r)) for n, r in ranges.items()})
    families = rng.permutation(rigs.FAMILIES).tolist()
    seen = [rigs.draw_drive(family, truth, rng) for family in families[:2]]
    unseen = [rigs.draw_drive(families[2 + k % 2], truth, rng) for k in range(UNSEEN)]

    # Voltage and motion, as instruments of the withheld-effect check read them.
    sensors = Sensors({quantity: Noise(std) for quantity, std in NOISE.items()})
    channels = tuple(world.parameters["bench.channels"])
    records = []
    for k, drive in enumerate(seen):
        signals = measure(_played(world, drive), world, sensors, channels, rng, ("deflection",))
        records.append(Record(Path(f"run_{k}"), 0, {signal.name: signal for signal in signals}))
    found = identify(records, nominal)
    estimates = {
        name: (e.value, e.std, float(truth[name]), e.informed)
        for name, e in found.estimates.items() if name not in SHAPES and "effect." not in name
    }
    return {
        "load": load, "seed": seed, "features": dict(world.features), "estimates": estimates,
        "believed": [_error(world, nominal, drive) for drive in unseen],
        "seen": [_error(world, found.parameters, drive) for drive in seen],
        "unseen": [_error(world, found.parameters, drive) for drive in unseen],
    }


def _played(world: World, drive: rigs.Drive) -> Any:
    time = drive.grid(rigs.COMMAND_PERIOD)
    return happen(world, time, drive.voltage(time, tuple(world.parameters["bench.channel_sides"])))


def _error(world: World, parameters: Parameters, drive: rigs.Drive) -> float:
    """Root mean square of predicted less true motion, as a share of the stroke."""
    played = _played(world, drive)
    left = simulate(parameters, played.time, played.voltage).deflection - played.deflection
    return float(np.sqrt(np.mean(np.square(left))) / np.ptp(played.deflection))


def report(results: Sequence[dict[str, Any]]) -> bool:
    """Print a line a load, and the numbers that are off; whether all is within the limits."""
    print("unseen error in % of stroke; truth in the stated 95 % interval")
    print(f"{'load':12s}{'benches':>8s}{'believed':>10s}{'median':>8s}{'90 %':>8s}{'inside':>8s}")
    passed = True
    for load in dict.fromkeys(r["load"] for r in results):
        own = [r for r in results if r["load"] == load]
        unseen = np.concatenate([r["unseen"] for r in own])
        believed = float(np.median(np.concatenate([r["believed"] for r in own])))
        median, tail = float(np.median(unseen)), float(np.quantile(unseen, 0.9))
        inside = [
            abs(value - true) <= Z_95 * std
            for r in own for value, std, true, _ in r["estimates"].values() if std > 0.0
        ]
        share = float(np.mean(inside))
        good = median < MEDIAN and tail < TAIL and BAND[0] <= share <= BAND[1]
        passed &= good
        print(
            f"{load:12s}{len(own):8d}{100 * believed:10.2f}{100 * median:8.2f}{100 * tail:8.2f}"
            f"{100 * share:8.1f}{'' if good else '  outside the limits'}"
        )
    print(f"\n{'number':44s}{'inside':>8s}{'rms z':>8s}{'informed':>10s}")
    for name in dict.fromkeys(name for r in results for name in r["estimates"]):
        rows = np.array([r["estimates"][name] for r in results if name in r["estimates"]])
        rows = rows[rows[:, 1] > 0.0]
        z = (rows[:, 0] - rows[:, 2]) / rows[:, 1]
        share, rms = np.mean(np.abs(z) <= Z_95), np.sqrt(np.mean(z**2))
        print(f"{name:44s}{100 * share:8.0f}{rms:8.2f}{np.median(rows[:, 3]):10.2f}")
    return passed


if __name__ == "__main__":
    sys.exit(main())
