"""How often do the confidence intervals of an effect's numbers contain the true value?

    ./bench check effects [--seed 1000] [--cases 60]

The single effects of a development set of the withheld-effect check are fitted to their two records
as in a diagnosis. The true value is the reality's own number if that has the same meaning;
otherwise the best fit without noise and with a known bench. Only effects that gain more than a
verdict requires are counted. Some ten seconds per case; synthetic.
"""

import sys
from collections import namedtuple
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import yaml
from scipy.optimize import fsolve

from examination.blind.cases import IN_FORMS, QUANTITIES, Case, draw_cases, split_of
from examination.blind.judgement import UNSEEN, proportion, unseen_drive
from examination.blind.make import size
from examination.blind.reality import World
from examination.blind.rigs import BACK, FRONT, RECORDS, Stage, true_values
from examination.blind.sensors import Sensors, measure
from examination.pieces import options_of
from sma_bench.diagnose.search import find_start, remainder
from sma_bench.estimation.observation import observe, shared_bin
from sma_bench.estimation.residual import Problem
from sma_bench.estimation.solver import fit, recalibrate
from sma_bench.estimation.unknowns import TEMPERATURES, Unknowns, unknowns_of_records
from sma_bench.records.record import Record

INTERVAL = 1.645  # standard errors: 90 %
WANTED = (0.80, 0.95)
_QUIET = 1e-3  # of the sensors' noise: as good as none
_WORTH_NAMING = 5.5  # nats over recalibration, as required for a verdict
_STARTS = (0.3, 3.0)  # prior deviations of the kinetics' spread at which a diagnosis starts
SAME: dict[str, str] = yaml.safe_load(Path(__file__).with_suffix(".yaml").read_text())
_SLOPE = "effect.stress_dependent_transition."

# A number of an effect: estimate, its error by noise alone, true value; gain of the effect [nats].
Claim = namedtuple("Claim", "case number value std noise_std true same_meaning gain")


def deviations_of(unknowns: Unknowns, values: Sequence[float]) -> np.ndarray:
    """(k,) prior deviations at which the unknowns have these values."""
    x, moving = unknowns.x_of(values), np.isin(unknowns.names, TEMPERATURES)

    def missed(own: np.ndarray) -> np.ndarray:
        x[moving] = own
        return (unknowns.values(x) - values)[moving]

    if moving.any():  # transition temperatures move together
        x[moving] = fsolve(missed, np.zeros(moving.sum()))
    return x


def claims_of(case: Case) -> list[Claim]:
    (effect,) = case.card.effects
    stage = replace(case)  # the copy's cached simulations are discarded with it
    features = size(stage).features

    def recorded(stage: Stage, name: str, sensors: Sensors) -> Record:
        random = case.stream(name) if name in RECORDS else np.random.default_rng(case.seed)
        outcome, quantities = stage.play(features, name), QUANTITIES[case.card.signals]
        signals = measure(outcome, World(case.truth, features), sensors, random, quantities)
        return Record(Path(name), 0, {signal.name: signal for signal in signals})

    # Fit with this effect, and its gain over recalibration.
    records = [recorded(stage, name, case.sensors) for name in RECORDS]
    shortest = shared_bin(records, case.nominal)
    seen = [observe(record, case.nominal, shortest) for record in records]
    baseline = unknowns_of_records(case.nominal, tuple({q: 0 for o in seen for q in o.quantities}))
    starts = [baseline.start(spread) for spread in _STARTS]
    recalibrated, _ = recalibrate(Problem.of(seen), case.nominal, baseline, starts)
    unknowns = baseline.with_effects([effect])
    start = find_start(recalibrated, remainder(recalibrated), unknowns)
    first = fit(recalibrated.problem, unknowns, start.x, rounds=2, frozen=recalibrated.derivatives)
    found = fit(first.problem.with_nuisances(first.parameters), unknowns, first.x, rounds=2)
    gain = found.evidence - recalibrated.evidence
    # Numbers of the effect that fit best without noise.
    drives = {**case.drives, UNSEEN: unseen_drive(case.drives)}
    noise = {q: replace(n, std=_QUIET * n.std) for q, n in case.sensors.noise.items()}
    quiet = replace(case.sensors, noise=noise)
    stage = Stage(case.truth, quiet, drives)
    right = true_values(case.truth)
    known = case.nominal.replace(right | {BACK: right[FRONT]})
    clear = tuple(observe(recorded(stage, name, quiet), known, shortest) for name in drives)
    plain = unknowns_of_records(known, tuple({q: 0 for o in clear for q in o.quantities}))
    wanted = plain.with_effects(found.unknowns.effects)
    x = deviations_of(wanted, found.unknowns.values(found.x))
    x = np.clip(x, *wanted.bounds())
    problem = replace(Problem.of(clear), noise=found.problem.noise)
    problem = problem.with_nuisances(wanted.parameters(x))
    fitted = wanted.values(fit(problem, wanted, x, rounds=2, keep_noise=True).x)
    best = {wanted.names[k]: float(fitted[k]) for k in range(plain.baseline, len(fitted))}

    claims, values = [], found.unknowns.values(found.x)
    for k in range(found.unknowns.baseline, len(found.x)):
        name = found.unknowns.names[k]
        is_slope = name.startswith(_SLOPE)
        true = features[SAME[name]] if name in SAME else best[name]
        if is_slope:
            influence = name.replace(_SLOPE, "stress_influence_")
            factor = features[influence.replace("influence", "influence_factor")]
            true = (factor - 1.0) / case.truth[f"wire.{influence}"]
        errors, same = (float(found.errors[k]), float(found.std[k])), is_slope or name in SAME
        claims.append(Claim(case.name, name, float(values[k]), *errors, true, same, gain))
    return claims


def main(argv: Sequence[str] | None = None) -> int:
    options = options_of("effects", __doc__, argv, seed=(1000, "1000 to 1999"),
                         cases=(60, "size of the set"))  # fmt: skip
    if split_of(options.seed) != "development" or options.seed in IN_FORMS:
        print(f"seed {options.seed}, expected one of development, 1000 to 1999", file=sys.stderr)
        return 2
    counted: list[Claim] = []
    for case in draw_cases(options.seed, options.cases):
        for c in claims_of(case) if case.card.kind == "single" else ():
            counts = c.gain > _WORTH_NAMING
            counted += [c] * counts
            print(f"{c.case} {c.number.removeprefix('effect.'):55s} {c.value:11.4g}"
                  f" +- {c.std:8.2g} (noise alone {c.noise_std:8.2g})"
                  f" true {c.true:11.4g}{'' if c.same_meaning else ' (best)':7s}"
                  f" {(c.value - c.true) / c.std:+5.1f}{'' if counts else '  not counted'}",
                  flush=True)
    for title, error in (("noise alone", "noise_std"), ("as stated", "std")):
        held = [abs(c.value - c.true) < INTERVAL * getattr(c, error) for c in counted]
        share = proportion(held)
        print(f"{title}: {share.hits} of {share.n} 90 % intervals contain the truth,"
              f" {100 * share.value:.0f} % ({100 * share.low:.0f} to {100 * share.high:.0f} %)")
    return 0 if WANTED[0] <= share.value <= WANTED[1] else 1
