"""Does identification give back what a bench was made of, with errors that are true?

Benches are drawn at random, run through protocol, simulated bench, instruments and bag on disk,
read back and identified from a parameter file that is off by its stated uncertainty. The bench is
simulated in this process (the physics that the simulator node steps), not over DDS.

    ./bench check identification --draws 50 --seed 0 --json result.json
"""

import math
import tempfile
from collections import namedtuple
from collections.abc import Callable, Iterable, Sequence
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

# --- A simulated lab: benches drawn within believable ranges, and what their lab knows beforehand.
RIG = {"bench.channels": ("front_1", "front_2", "back_1", "back_2"),
       "bench.channel_sides": ("front", "front", "back", "back")}  # fmt: skip
_DATA = yaml.safe_load(Path(__file__).with_suffix(".yaml").read_text(encoding="utf-8"))
IDENTIFIED = tuple(_DATA["errors"])
EXACT = ("wire.mass", "wire.surface_area", "wire.diameter")
_FARTHEST, PRETENSION = 2.5, 0.002  # stated errors; strain
STEP = 0.0025  # s
LOADS, SIDES = (10e6, 50e6, 100e6, 150e6, 200e6), ("front", "back")
JITTER, LOST = 0.2, 0.02  # of a period, of the samples
_HEATED, _REST = 25.0, 15.0  # s
Steps = Iterable[dict[str, Any]]

# `truth` simulates the bench, `known` is the parameter file of its lab.
DrawnBench = namedtuple("DrawnBench", "truth known")


def draw_bench(random: np.random.Generator) -> DrawnBench:
    """One bench: its true parameters, and nominal ones that are off by their stated errors."""
    drawn = {name: random.uniform(*ends) for name, ends in _DATA["ranges"].items()}
    diameter, length = drawn.pop("diameter"), drawn.pop("length")
    section = math.pi * diameter**2 / 4.0
    drawn |= {
        "wire.diameter": diameter, "wire.mass": NITI_DENSITY * section * length,
        "wire.surface_area": math.pi * diameter * length,
        "wire.resistance": drawn.pop("resistivity") * length / section,
        "wire.thermal_expansion_factor": -drawn.pop("expansion") * drawn["wire.martensite_modulus"]}
    # Every order of the ranges that is seen on NiTi, M_s above A_s as in the paper included.
    while True:
        a_s = random.uniform(322.0, 345.0)
        a_f = a_s + random.uniform(10.0, 25.0)
        m_s = a_s + random.uniform(-18.0, 6.0)
        m_f = m_s - random.uniform(10.0, 25.0)
        if m_f > drawn["environment.ambient_temperature"] + 10.0 and m_s < a_f - 2.0:
            break
    truth = Parameters(drawn | dict(zip(IDENTIFIED[3:7], (a_s, a_f, m_s, m_f), strict=True)) | RIG)
    # The simulated instruments have noise and steps, but no scale of their own.
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


# --- Its experiments.
def _rest(duration: float) -> dict[str, Any]:
    return {"kind": "rest", "duration": duration}


def _run(parameters: Parameters, steps: Steps, **more: Any) -> Simulation:
    """One wire, or what bench there is, on a protocol of these steps."""
    protocol = parse_protocol({"steps": [_rest(3.0), *steps, _rest(1.0)]}, parameters)
    return simulate(parameters, *protocol.sample(STEP), **more)


def voltage_for(truth: Parameters, temperature: float) -> float:
    """Voltage [V] that ends at `temperature` [K]: a lab finds it by trying."""
    rise = temperature - truth["environment.ambient_temperature"]
    loss = truth["wire.heat_transfer_coefficient"] * truth["wire.surface_area"]
    return float(np.round(math.sqrt(rise * truth["wire.resistance"] * loss), 3))


def one_wire(truth: Parameters) -> Parameters:
    return truth.replace({"bench.channels": ("wire",), "bench.channel_sides": ("front",)})


def staircase(truth: Parameters) -> Simulation:
    """E1, E2: voltage up and down in steps of 30 s."""
    peak = voltage_for(truth, truth["wire.austenite_finish_temperature"] + 20.0)
    levels = {"kind": "staircase", "increment": peak / 8.0, "dwell": 30.0}
    down = levels | {"start": 7.0 * peak / 8.0, "stop": 0.0}
    return _run(one_wire(truth), [levels | {"start": 0.0, "stop": peak}, down])


def ramp(truth: Parameters) -> Simulation:
    """E3: four ramps that stay below A_s."""
    peak = voltage_for(truth, truth["wire.austenite_start_temperature"] - 8.0)
    up = {"kind": "ramp", "start": 0.0, "stop": peak, "duration": 7.0}
    return _run(one_wire(truth), [up, _rest(12.0)] * 4)


def isobaric(truth: Parameters) -> Simulation:
    """E6: the load frame holds five loads in turn, the wire is heated and cooled under each."""
    wire, steps = one_wire(truth), [_rest(3.0)]
    hottest = truth["wire.austenite_finish_temperature"] + 20.0
    for load in LOADS:
        peak = voltage_for(truth, hottest + load / truth["wire.stress_influence_austenite"])
        steps += [_rest(1.0) | {"force": load * wire_section(wire)}, _rest(_REST),
                  {"kind": "triangle", "peak": peak, "rise": _HEATED, "fall": _HEATED}]
    frame = wire.replace({"load.kind": "force", "load.force": LOADS[0] * wire_section(wire)})
    protocol = parse_protocol({"steps": [*steps, _rest(1.0)], "load": "force"}, frame)
    return simulate_protocol(protocol, frame, STEP)


def clamped(truth: Parameters) -> Simulation:
    """E8: the wire clamped under tension, a staircase below A_s."""
    peak = voltage_for(truth, truth["wire.austenite_start_temperature"] - 4.0)
    levels = [peak * math.sqrt(share) for share in (0.0, 0.25, 0.5, 0.75, 1.0, 0.5, 0.0)]
    steps = [{"kind": "step", "level": v, "duration": 20.0} if v else _rest(20.0) for v in levels]
    return _run(one_wire(truth), steps, boundary=Boundary.clamped(-PRETENSION))


def composite(truth: Parameters, way: dict[str, Any], size: str, *shares: float) -> Simulation:
    """E12: front and back by turns, with enough for the transformation against the stiffer side."""
    stiff = max(truth[f"composite.stress_per_deflection_{side}"] for side in SIDES)
    bend = truth["composite.deflection_per_strain"] * truth["wire.maximum_recoverable_strain"]
    shift = 0.5 * stiff * bend / truth["wire.stress_influence_austenite"]
    peak = voltage_for(truth, truth["wire.austenite_finish_temperature"] + shift + 15.0)
    both = [way | {size: share * peak, "drive": side} for share in shares for side in SIDES]
    return _run(truth, [step for one in both for step in (one, _rest(_REST))])


_TRIANGLE = {"kind": "triangle", "rise": 15.0, "fall": 15.0}
_STEP = {"kind": "step", "duration": 12.0}
# What a bench does in each experiment, and Hz at which it is read.
EXPERIMENTS: dict[str, tuple[Callable[[Parameters], Simulation], float]] = {
    "staircase": (staircase, 20.0), "ramp": (ramp, 100.0), "isobaric": (isobaric, 50.0),
    "clamped": (clamped, 50.0),
    "composite_triangle": (lambda truth: composite(truth, _TRIANGLE, "peak", 1.0), 50.0),
    "composite_step": (lambda truth: composite(truth, _STEP, "level", 1.0, 0.88), 50.0)}


def measured(experiment: str, truth: Parameters, seed: int) -> list[Signal]:
    """What the lab's instruments read in one of EXPERIMENTS, a topic's signals at one time."""
    run, rate = EXPERIMENTS[experiment]
    found, random = run(truth), np.random.default_rng(seed)
    samples: dict[tuple[str, bool], np.ndarray] = {}
    signals = []
    for signal in signals_of(found):
        channel, _, quantity = signal.name.rpartition(".")
        if experiment in ("staircase", "ramp") and not channel:  # no load frame there
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


# --- Whether they give back what the bench was made of.
BAND = (0.88, 0.99)
HEADER = """\
identification of {draws} benches drawn at random (seed {seed})
  bags of each: {bags}
  instruments of the simulator node: noise, quantisation, jitter of +-20 % of a period, 2 % lost
  inputs of the lab, taken as exact: {exact}
"""


def main(argv: Sequence[str] | None = None) -> int:
    options = options_of("identification", __doc__, argv, draws=(50, "benches"),
                         seed=(0, "of the first bench"), **IN_PIECES)
    bags, exact = ", ".join(EXPERIMENTS), ", ".join(EXACT)
    print(HEADER.format(draws=options.draws, seed=options.seed, bags=bags, exact=exact))
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
