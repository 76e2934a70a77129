"""Does identification recover the true parameters of a bench, with correct standard errors?

Benches are drawn at random, simulated with protocols, read by sensors, written to bags, read back
and identified with a parameter file that is off by its stated uncertainty. The simulation runs in
this process (with the physics of the simulator node), not over DDS.

    ./bench check identification --draws 50 --seed 0 --json result.json
"""

import math
import tempfile
from collections import namedtuple
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from examination.pieces import IN_PIECES, Z_95, in_pieces, options_of, print_coverage
from sma_bench.identify import identify
from sma_bench.parameters import Parameters
from sma_bench.parameters.parameter import EXACT_SENSORS
from sma_bench.parameters.parameters import NITI_DENSITY, wire_section
from sma_bench.physics import Boundary, Simulation, simulate
from sma_bench.protocols import parse_protocol
from sma_bench.records import Signal, read_record
from sma_bench.records.bag_writer import write_record
from sma_bench.synthetic.bench_records import read_signals, signals_of, simulate_protocol

# --- A simulated lab: benches drawn from plausible ranges, and their stated parameters.
RIG = {"bench.channels": ("front_1", "front_2", "back_1", "back_2"),
       "bench.channel_sides": ("front", "front", "back", "back")}  # fmt: skip
_DATA = yaml.safe_load(Path(__file__).with_suffix(".yaml").read_text(encoding="utf-8"))
IDENTIFIED = tuple(_DATA["errors"])
EXACT = ("wire.mass", "wire.surface_area", "wire.diameter")
_FARTHEST, PRETENSION = 2.5, 0.002  # largest error in stated standard deviations; strain
STEP = 0.0025  # s
SIDES = ("front", "back")
JITTER, LOST = 0.2, 0.02  # share of a period; share of the samples

# `truth`: true parameters of the bench; `known`: the lab's parameter file.
DrawnBench = namedtuple("DrawnBench", "truth known")


def draw_bench(random: np.random.Generator) -> DrawnBench:
    """One bench: its true parameters, and stated ones with random errors as stated."""
    drawn = {name: random.uniform(*ends) for name, ends in _DATA["ranges"].items()}
    diameter, length = drawn.pop("diameter"), drawn.pop("length")
    section = math.pi * diameter**2 / 4.0
    drawn |= {
        "wire.diameter": diameter, "wire.mass": NITI_DENSITY * section * length,
        "wire.surface_area": math.pi * diameter * length,
        "wire.resistance": drawn.pop("resistivity") * length / section,
        "wire.thermal_expansion_factor": -drawn.pop("expansion") * drawn["wire.martensite_modulus"]}
    # All orders of the transition temperatures of NiTi, also M_s above A_s as in the paper.
    while True:
        a_s = random.uniform(322.0, 345.0)
        a_f = a_s + random.uniform(10.0, 25.0)
        m_s = a_s + random.uniform(-18.0, 6.0)
        m_f = m_s - random.uniform(10.0, 25.0)
        if m_f > drawn["environment.ambient_temperature"] + 10.0 and m_s < a_f - 2.0:
            break
    truth = Parameters(drawn | dict(zip(IDENTIFIED[3:7], (a_s, a_f, m_s, m_f), strict=True)) | RIG)
    # The simulated sensors have noise and resolution, but no errors of their scales.
    std = {n: e.get("std") or e["share"] * float(truth[n]) for n, e in _DATA["errors"].items()}
    while True:
        nominal = {}
        for name in IDENTIFIED:
            while abs(deviation := float(random.standard_normal())) >= _FARTHEST:
                pass
            nominal[name] = truth[name] + std[name] * deviation
        a_s, a_f, m_s, m_f = (nominal[name] for name in IDENTIFIED[3:7])
        if min(a_f - a_s, m_s - m_f) > 1.0:
            exact = dict.fromkeys(EXACT, 0.0) | EXACT_SENSORS
            return DrawnBench(truth, truth.replace(nominal, std | exact))


# --- The experiments, defined in the YAML file.
EXPERIMENTS: dict[str, float] = {name: own["hertz"] for name, own in _DATA["experiments"].items()}


def voltage_for(truth: Parameters, temperature: float) -> float:
    """Voltage [V] with the steady temperature `temperature` [K]; a lab finds it by trial."""
    rise = temperature - truth["environment.ambient_temperature"]
    loss = truth["wire.heat_transfer_coefficient"] * truth["wire.surface_area"]
    return float(np.round(math.sqrt(rise * truth["wire.resistance"] * loss), 3))


def simulated(experiment: str, truth: Parameters) -> Simulation:
    """Simulate the bench in one of EXPERIMENTS, with voltages scaled to this wire."""
    own = _DATA["experiments"][experiment]
    if composite := experiment.startswith("composite"):
        # Hot enough for the complete transformation against the stiffer side.
        stiff = max(truth[f"composite.stress_per_deflection_{side}"] for side in SIDES)
        strain = truth["wire.maximum_recoverable_strain"]
        loads = [0.5 * stiff * truth["composite.deflection_per_strain"] * strain]
    else:
        loads = own.get("loads", [0.0])
    one = {"bench.channels": ("wire",), "bench.channel_sides": ("front",)}
    bench, steps = truth if composite else truth.replace(one), [{"kind": "rest", "duration": 3.0}]
    for load in loads * own.get("repeat", 1):
        shift = load / truth["wire.stress_influence_austenite"]
        peak = voltage_for(truth, truth[own["at"]] + own["above"] + shift)
        scales = dict.fromkeys(("start", "stop", "increment", "peak", "level"), peak)
        scales["force"] = load * wire_section(bench)
        steps += [{key: value * scales[key] if key in scales else value
                   for key, value in step.items()} for step in own["steps"]]
    steps.append({"kind": "rest", "duration": 1.0})
    if "loads" not in own:
        boundary = Boundary.clamped(-PRETENSION) if experiment == "clamped" else None
        protocol = parse_protocol({"steps": steps}, bench)
        return simulate(bench, *protocol.sample(STEP), boundary=boundary)
    held = {"load.kind": "force", "load.force": loads[0] * wire_section(bench)}
    frame = bench.replace(held)
    return simulate_protocol(parse_protocol({"steps": steps, "load": "force"}, frame), frame, STEP)


def measured(experiment: str, truth: Parameters, seed: int) -> list[Signal]:
    """Readings of the lab's sensors in one of EXPERIMENTS; signals of a topic share their times."""
    rate = EXPERIMENTS[experiment]
    found, random = simulated(experiment, truth), np.random.default_rng(seed)
    samples: dict[tuple[str, bool], np.ndarray] = {}
    signals = []
    for signal in signals_of(found):
        channel, _, quantity = signal.name.rpartition(".")
        if experiment in ("staircase", "ramp") and not channel:  # these have no load frame
            continue
        topic = channel, quantity == "temperature"
        if topic not in samples:
            hertz = 0.8 * rate if topic[1] else rate
            ticks = np.arange(int(found.time[-1] * hertz) - 1) + 0.5
            ticks = ticks + random.uniform(-JITTER, JITTER, len(ticks))
            ticks = ticks[random.uniform(size=len(ticks)) > LOST] / hertz
            samples[topic] = np.searchsorted(found.time, ticks)
        at = samples[topic]
        signals.append(replace(signal, time=found.time[at], values=signal.values[at]))
    return read_signals(signals, seed)


# --- Comparison of estimates and true values.
BAND = (0.88, 0.99)
def main(argv: Sequence[str] | None = None) -> int:
    options = options_of("identification", __doc__, argv, draws=(50, "benches"),
                         seed=(0, "of the first bench"), **IN_PIECES)
    print(f"inputs of the lab, taken as exact: {', '.join(EXACT)}; bags: {', '.join(EXPERIMENTS)}")
    jobs = [(options.seed + k,) for k in range(options.draws)]
    results = in_pieces(run_draw, jobs, options)
    found = [(name, (p["value"] - p["truth"]) / p["std"])
             for result in results for name, p in result["parameters"].items()]
    share = print_coverage(found, Z_95)
    missing = len(IDENTIFIED) * len(results) - len(found)
    good = missing == 0 and BAND[0] <= share <= BAND[1]
    wanted = f"wanted {BAND[0]:.0%} to {BAND[1]:.0%}"
    print(f"{'PASSED' if good else 'FAILED'}: {share:.1%} inside, {wanted}; {missing} missing")
    return 0 if good else 1


def run_draw(seed: int) -> dict[str, Any]:
    bench = draw_bench(np.random.default_rng(seed))
    with tempfile.TemporaryDirectory(prefix="sma_bench_check_") as folder:
        bags = [Path(folder, name) for name in EXPERIMENTS]
        for number, bag in enumerate(bags):
            write_record(bag, measured(bag.name, bench.truth, 100 * seed + number))
        found = identify([read_record(bag) for bag in bags], bench.known)
    parameters = {name: {"value": float(e.value), "std": float(e.std), "method": e.method,
                         "truth": float(bench.truth[name]), "prior_std": bench.known.std(name)}
                  for name, e in found.estimates.items() if name in IDENTIFIED}
    return {"seed": seed, "parameters": parameters, "warnings": list(found.warnings)}
