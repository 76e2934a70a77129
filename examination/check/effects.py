"""How often do the intervals of an effect's numbers hold the truth?

    ./bench check effects [--seed 1000] [--cases 60] [--json FILE]

The single effects of a development set of the withheld-effect check (seeds 1000 to 1999), each
fitted to its two records as a diagnosis fits it, and its numbers with the errors that a diagnosis
states. The truth is the reality's own number where it has the same meaning; else the one that
fits best where there is no noise and nothing of the bench unknown beyond what is stated: the two
records and one more, five minutes. Counted are effects that gain more over recalibration than a
verdict asks for. Some ten seconds a case; synthetic.
"""

import argparse
import json
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")  # small matrices: idle threads would only wait

import numpy as np

from examination.blind.cases import QUANTITIES, SPLITS, Case, draw_cases
from examination.blind.judgement import UNSEEN, unseen_drive
from examination.blind.measures import Measured, proportion
from examination.blind.reality import World
from examination.blind.rigs import BACK, CHANNELS, FRONT, RECORDS, Stage, true_values
from examination.blind.sensors import Sensors, measure
from examination.blind.severity import size
from sma_bench.diagnose.decision import THRESHOLD
from sma_bench.diagnose.starts import Remainder, find_start
from sma_bench.estimation.observation import Observation, observe, shared_bin
from sma_bench.estimation.residual import Problem
from sma_bench.estimation.solver import Fit, fit, recalibrate
from sma_bench.estimation.unknowns import unknowns_of_records
from sma_bench.parameters import Parameters
from sma_bench.records.record import Record

INTERVAL = 1.645  # standard errors: 90 %
WANTED = (0.80, 0.95)
_QUIET = 1e-3  # of the sensors' noise
_STARTS = (0.3, 3.0)  # prior deviations of the kinetics' spread, as a diagnosis begins

Features = Mapping[str, float]
# Numbers that mean the same in the model and in the reality. The others do not: two relaxation
# times are no one, a wave no parabola, the silicone beside a wire no room.
SAME: dict[str, Callable[[Features, Parameters], float]] = {
    "effect.supply_drop.resistance": lambda f, _: f["supply_resistance"],
    "effect.phase_dependent_resistance.austenite_change": (
        lambda f, _: f["resistance_austenite_change"]
    ),
    "effect.phase_dependent_resistance.temperature_coefficient": (
        lambda f, _: f["resistance_temperature_coefficient"]
    ),
    "effect.latent_heat.heat": lambda f, _: f["latent_heat"],
    "effect.side_heat_coupling.conductance": lambda f, _: f["side_conductance"],
    "effect.stress_dependent_transition.austenite": (
        lambda f, p: (f["stress_influence_factor_austenite"] - 1.0)
        / p["wire.stress_influence_austenite"]
    ),
    "effect.stress_dependent_transition.martensite": (
        lambda f, p: (f["stress_influence_factor_martensite"] - 1.0)
        / p["wire.stress_influence_martensite"]
    ),
    "effect.residual_strain.share": lambda f, _: f["unrecovered_strain"],
    "effect.side_asymmetry.ratio": lambda f, _: f["stiffness_asymmetry"],
    "effect.slack.strain": lambda f, _: f["slack"],
    "effect.temperature_lag.time_constant": lambda f, _: f["camera_lag"],
}


@dataclass(frozen=True)
class Claim:
    """One number of an effect: as stated, with the error of the noise alone beside it, and true;
    `gain` of its effect over recalibration [nats]."""

    case: str
    number: str
    value: float
    std: float
    noise_std: float
    true: float
    same_meaning: bool
    gain: float

    @property
    def off(self) -> float:
        """In stated standard errors."""
        return (self.value - self.true) / self.std


def claims_of(case: Case) -> list[Claim]:
    """Numbers of a case's effect."""
    (effect,) = case.card.effects
    stage = Stage(case.truth, case.sensors, case.drives)
    features = size(case, stage).features
    records = [_record(case, stage, features, name, case.sensors) for name in RECORDS]
    shortest = shared_bin(records, case.nominal)
    seen = [observe(record, case.nominal, shortest) for record in records]
    found, gain = fitted(effect, seen, case.nominal)
    best = best_fitting(case, features, found, shortest)
    claims = []
    for k in range(found.unknowns.baseline, len(found.x)):
        name = found.unknowns.names[k]
        true = SAME[name](features, case.truth) if name in SAME else best[name]
        value = float(found.unknowns.values(found.x)[k])
        errors = float(found.errors[k]), float(found.std[k])
        claims.append(Claim(case.name, name, value, *errors, true, name in SAME, gain))
    return claims


def _record(
    case: Case, stage: Stage, features: Features, name: str, sensors: Sensors
) -> Record:
    random = case.stream(name) if name in RECORDS else np.random.default_rng(case.seed)
    outcome, quantities = stage.play(features, name), QUANTITIES[case.card.signals]
    world = World(case.truth, features)
    signals = measure(outcome, world, sensors, CHANNELS, random, quantities)
    return Record(Path(name), 0, {signal.name: signal for signal in signals})


def fitted(
    effect: str, seen: Sequence[Observation], believed: Parameters
) -> tuple[Fit, float]:
    """The candidate of this effect, and its gain over recalibration."""
    baseline = unknowns_of_records(believed, tuple({q: 0 for o in seen for q in o.quantities}))
    starts = [baseline.start(spread) for spread in _STARTS]
    recalibrated, _ = recalibrate(Problem.of(seen), believed, baseline, starts)
    unknowns = baseline.with_effects([effect])
    start = find_start(Remainder(recalibrated), unknowns, effect)
    first = fit(recalibrated.problem, unknowns, start.x, rounds=2, frozen=recalibrated.derivatives)
    about = first.problem.with_nuisances(first.parameters)
    found = fit(about, unknowns, first.x, rounds=2)
    return found, found.evidence - recalibrated.evidence


def best_fitting(
    case: Case, features: Features, found: Fit, shortest: float
) -> dict[str, float]:
    """Numbers of the effect that fit best where there is no noise."""
    drives = {**case.drives, UNSEEN: unseen_drive(case.drives)}
    noise = {q: replace(n, std=_QUIET * n.std) for q, n in case.sensors.noise.items()}
    quiet = replace(case.sensors, noise=noise)
    stage = Stage(case.truth, quiet, drives)
    right = true_values(case.truth)
    known = case.nominal.replace(right | {BACK: right[FRONT]})
    records = [_record(case, stage, features, name, quiet) for name in drives]
    seen = tuple(observe(record, known, shortest) for record in records)
    baseline = unknowns_of_records(known, tuple({q: 0 for o in seen for q in o.quantities}))
    unknowns = baseline.with_effects(found.unknowns.effects)
    start = np.clip(unknowns.x_of(found.unknowns.values(found.x)), *unknowns.bounds())
    problem = Problem(seen, found.problem.noise, ()).with_nuisances(unknowns.parameters(start))
    best = fit(problem, unknowns, start, rounds=2, keep_noise=True)
    values = unknowns.values(best.x)
    return {unknowns.names[k]: float(values[k]) for k in range(baseline.baseline, len(values))}


def held(claims: Sequence[Claim], noise_alone: bool = False) -> Measured:
    """Share of the 90 % intervals that hold the truth."""
    return proportion(
        [
            abs(c.value - c.true) < INTERVAL * (c.noise_std if noise_alone else c.std)
            for c in claims
        ]
    )


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--seed", type=int, default=1000, help="1000 to 1999")
    parser.add_argument("--cases", type=int, default=60, metavar="N", help="size of the set")
    parser.add_argument("--json", metavar="FILE")
    args = parser.parse_args(argv)
    if args.seed not in SPLITS["development"]:
        parser.error(f"seed {args.seed}, expected one of development, 1000 to 1999")
    claims: list[Claim] = []
    for case in draw_cases(args.seed, args.cases):
        if case.card.kind != "single":
            continue
        for claim in claims_of(case):
            counted = claim.gain > THRESHOLD
            if counted:
                claims.append(claim)
            print(
                f"{claim.case} {claim.number.removeprefix('effect.'):55s} {claim.value:11.4g}"
                f" +- {claim.std:8.2g} (noise alone {claim.noise_std:8.2g})"
                f" true {claim.true:11.4g}{'' if claim.same_meaning else ' (best)':7s}"
                f" {claim.off:+5.1f}{'' if counted else '  not counted'}",
                flush=True,
            )
    for title, share in (("noise alone", held(claims, True)), ("as stated", held(claims))):
        print(
            f"{title}: {share.hits} of {share.n} intervals of 90 % hold the truth,"
            f" {100 * share.value:.0f} % ({100 * share.low:.0f} to {100 * share.high:.0f} %)"
        )
    if args.json:
        Path(args.json).write_text(json.dumps([asdict(c) for c in claims], indent=1) + "\n")
    low, high = WANTED
    return 0 if low <= held(claims).value <= high else 1


if __name__ == "__main__":
    raise SystemExit(main())
