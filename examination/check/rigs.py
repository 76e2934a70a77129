"""Does a fit stay in the range of a bench's numbers, whatever parameters are stated?

Rigs with every load are drawn, with stated uncertainties from exact to absurdly wide. A short
record of each is simulated, identified and diagnosed. Each must have a finite result, or an error
of one line; no other exception, no warning of a library, and no "nothing to identify".

    ./bench check rigs --draws 200 --seed 0 --json result.json
"""

import json
import math
import traceback
import warnings
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np

import sma_bench
from examination.pieces import IN_PIECES, in_pieces, options_of
from sma_bench.errors import InputError
from sma_bench.estimation.unknowns import BENDING, HEAT, LOADS, MATERIAL, TEMPERATURES
from sma_bench.parameters import Parameters
from sma_bench.parameters.parameter import BY_NAME, LOAD_KINDS
from sma_bench.physics.effects import EFFECTS
from sma_bench.records import Record

RATE, STROKE = 10.0, 6.0  # Hz; s
DENSITY, RESISTIVITY = 6450.0, 85e-8
WIDE = {"wire.mass", "wire.surface_area", "wire.diameter"}
# Probability of each kind of statement, and its relative error.
KINDS = {"no": 0.25, "exact": 0.05, "tight": 0.15, "usual": 0.3, "wide": 0.15, "absurd": 0.1}
FACTORS = {"tight": 1e-4, "usual": 0.05, "wide": 1.0}
FINE, REFUSED, HIDDEN, RAISED = "finite", "refused", "nothing to identify", "exception"


def main(argv: Sequence[str] | None = None) -> int:
    """Draw and try; 0 if nothing failed, 1 if something did."""
    own = {"draws": (20, "rigs"), "seed": (0, "of the first rig")}
    options = options_of("rigs", __doc__, argv, **own, **IN_PIECES)
    jobs = [(options.seed + k,) for k in range(options.draws)]
    found = in_pieces(try_rig, jobs, options)
    for one, work in product(found, WORK):
        print(f"{one['seed']}: {one['load']}: {work} {one[work]} {one[f'{work} said']}".strip())
    for load, work in product(LOAD_KINDS, WORK):
        count = Counter(one[work] for one in found if one["load"] == load)
        print(f"{load}, {work}: {', '.join(f'{n} {end}' for end, n in count.items())}")
    return 0 if all(one[work] in (FINE, REFUSED) for one in found for work in WORK) else 1


def try_rig(seed: int) -> dict[str, Any]:
    """One rig: the outcome of each task, with a text if it is not finite."""
    rng = np.random.default_rng([38, seed])
    load = LOAD_KINDS[seed % len(LOAD_KINDS)]
    truth = draw_rig(load, rng)
    record = draw_record(truth, rng)
    stated = draw_statements(truth, rng)
    found: dict[str, Any] = {"load": load, "seed": seed}
    for work in WORK:
        outcome, said = FINE, ""
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error", RuntimeWarning)
                numbers, improved = WORK[work](record, stated)
            a_s, a_f, m_s, m_f = (improved[name] for name in TEMPERATURES)
            if not all(map(math.isfinite, numbers)) or a_s >= a_f or m_f >= m_s:
                said = f"not finite, or out of order: {numbers}, {a_s, a_f, m_s, m_f}"
                outcome = RAISED
        except InputError as error:
            said = str(error)
            outcome = HIDDEN if HIDDEN in said or "\n" in said else REFUSED
        except Exception:
            outcome, said = RAISED, traceback.format_exc()
        found[work], found[f"{work} said"] = outcome, said
    return found


def identified(record: Record, stated: Parameters) -> tuple[list[float], Parameters]:
    """All numbers of the result, and the improved parameters."""
    result = sma_bench.identify(record, stated)
    return [n for e in result.estimates.values() for n in (e.value, e.std)], result.parameters


def diagnosed(record: Record, stated: Parameters) -> tuple[list[float], Parameters]:
    result = sma_bench.diagnose(record, stated)
    json.dumps(result.to_json(), allow_nan=False)
    numbers = [c.probability for c in result.candidates]
    return [*numbers, *result.model.x.tolist(), *result.model.errors.tolist()], result.improved


WORK = {"identify": identified, "diagnose": diagnosed}


def draw_rig(load: str, rng: np.random.Generator) -> Parameters:
    """A bench that could be built: the sizes of its wires are consistent."""
    sides = ("front", "back") if load in ("antagonist", "beam") else ("front",)
    diameter, length = rng.uniform(1e-4, 4e-4), rng.uniform(0.08, 0.4)
    section = math.pi * diameter**2 / 4.0
    centre, half = rng.uniform(325.0, 365.0), rng.uniform(1.0, 12.0)
    up, down = rng.uniform(6.0, 25.0, 2) / 2.0
    pull = section * rng.uniform(40e6, 150e6)
    given = {"bench.channels": tuple(f"{side}_wire" for side in sides),
             "bench.channel_sides": sides, "bench.maximum_voltage": 60.0, "load.kind": load,
             "wire.length": length, "wire.diameter": diameter,
             "wire.mass": DENSITY * section * length,
             "wire.surface_area": math.pi * diameter * length,
             "wire.resistance": RESISTIVITY * length / section,
             "wire.heat_transfer_coefficient": rng.uniform(60.0, 250.0),
             "wire.specific_heat": rng.uniform(320.0, 550.0)}
    ends = (centre + half - up, centre + half + up, centre - half + down, centre - half - down)
    given |= zip(TEMPERATURES, ends, strict=True)
    if load in ("force", "antagonist"):
        given["load.force"] = pull if load == "force" else 0.0
    if load in ("spring", "antagonist"):
        given |= {"load.preload": pull, "load.stiffness": pull / (0.04 * length)}
    return Parameters(given)


def draw_record(truth: Parameters, rng: np.random.Generator) -> Record:
    """Three strokes to about A_f and back, a staircase between clamps; some sensors are missing."""
    rise = truth[TEMPERATURES[1]] + 15.0 - truth["environment.ambient_temperature"]
    loss = truth["wire.heat_transfer_coefficient"] * truth["wire.surface_area"]
    volts = math.sqrt(rise * loss * truth["wire.resistance"])
    clock = np.arange(0.0, 3.0 * STROKE, 1.0 / RATE)
    wires = len(truth["bench.channels"])
    drive = np.zeros((len(clock), wires))
    for k, share in enumerate((1.0, rng.uniform(0.8, 1.1), rng.uniform(0.9, 1.2))):
        inside = (clock >= k * STROKE + 0.5) & (clock < (k + 0.6) * STROKE)
        drive[inside, k % wires] = share * volts
    if truth["load.kind"] == "clamped":
        levels = np.array([0.0, 0.4, 0.55, 0.7, 0.85, 1.0, 0.7, 0.4, 0.0])
        clock = np.arange(0.0, 1.5 * STROKE * len(levels), 1.0 / RATE)
        drive = volts * levels[(clock / (1.5 * STROKE)).astype(int)][:, np.newaxis]
    record = sma_bench.measure(sma_bench.simulate((clock, drive), truth), int(rng.integers(1e6)))
    quantities = {name.rpartition(".")[2] for name in record.signals} - {"voltage"}
    motion = quantities & {"deflection", "elongation"}
    gone = {q for q in sorted(quantities - motion) if rng.random() < 0.25}
    if truth["load.kind"] == "clamped" and "current" in gone:
        gone -= {"temperature"}  # the only signal left
    kept = {n: s for n, s in record.signals.items() if n.rpartition(".")[2] not in gone}
    return replace(record, signals=kept)


def draw_statements(truth: Parameters, rng: np.random.Generator) -> Parameters:
    """The lab's statements: some numbers missing, others exact, absurdly wide, or at a limit."""
    load = truth["load.kind"]
    exact = {n for n, p in BY_NAME.items() if p.uncertainty is None or n == "wire.length"}
    rig = {n: truth[n] for n in truth.given if n not in BY_NAME or n in exact}
    names = [*HEAT, *MATERIAL, *sorted(WIDE), *LOADS.get(load, ())]
    names += BENDING if load == "beam" else ()
    while True:
        values, stds = {}, {}
        for name in names:
            low, high = float(BY_NAME[name].low or 0.0), float(BY_NAME[name].high or 0.0)
            kind = rng.choice(list(KINDS), p=list(KINDS.values()))
            size = max(abs(truth[name]), 1e-2 * float(BY_NAME[name].uncertainty or 0.0))
            absurd = 10.0 ** rng.uniform(1.0, 12.0)
            factor = absurd if kind == "absurd" else FACTORS.get(kind, 0.0)
            if kind == "no" and name not in LOADS.get(load, ()):
                continue
            off = truth[name] + 0.05 * size * min(factor, 1.0) * rng.standard_normal()
            off = rng.choice([low, high]) if rng.random() < 0.04 else off
            values[name], stds[name] = float(np.clip(off, low, high)), factor * size
            if kind in ("no", "usual") and rng.random() < 0.3:
                del stds[name]
        effect = EFFECTS[rng.choice(sorted(n for n, e in EFFECTS.items() if load in e.loads))]
        if rng.random() < 0.4:
            number = effect.size
            sign = -1.0 if number.low < 0.0 and rng.random() < 0.5 else 1.0
            size = sign * number.uncertainty * rng.uniform()
            values[number.name] = float(np.clip(size, number.low, number.high))
            stds[number.name] = float(number.uncertainty * 10.0 ** rng.uniform(-2.0, 4.0))
        try:
            return Parameters(rig | values, stds)
        except InputError:  # such a parameter file would be refused
            continue
