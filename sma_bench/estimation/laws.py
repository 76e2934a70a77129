"""Which transformation law a wire follows: the whole model is fitted under each law, and the laws
are weighted. Only a quarter of the log evidence counts, because sharp features of a few runs favour
a law more strongly than its predictions of other runs justify. If nothing is stated about h, all
laws have free convection; the likeliest and the paper's cosine are fitted with constant h, too."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product

import numpy as np
from scipy.special import ndtri

from sma_bench.arrays import Array
from sma_bench.errors import FitError, InputError
from sma_bench.estimation import solver
from sma_bench.estimation import unknowns as priors
from sma_bench.estimation.nuisances import OFFSET, STATE, STATES, in_state
from sma_bench.estimation.observation import MOVED, RETURNS, Observation
from sma_bench.estimation.residual import Problem
from sma_bench.estimation.solver import Fit
from sma_bench.estimation.unknowns import Unknown, Unknowns
from sma_bench.parameters import Parameters
from sma_bench.parameters.parameter import EFFECT_PREFIX
from sma_bench.parameters.parameters import ORIENTING
from sma_bench.progress import Report, part, silent
from sma_bench.records.record import Signal

# Prior probability of each law. Real wires have inner loops and gradual starts and finishes; under
# most loads all martensite is oriented, and brinson is then a cosine with too many free numbers.
PRIOR = {"normal": 0.9, "logistic": 0.05, "cosine": 0.035, "exponential": 0.015}
PRIOR |= dict.fromkeys(ORIENTING, 0.004)
AIR = {"free": 0.8, "constant": 0.2}  # prior of `wire.convection`, unless it or h is stated
_TEMPERED = 0.25  # share of the log evidence that counts
_DIFFERENT = 0.7  # prior probability that a bench is in another state in each run
_STARTS, _ALL_STARTS, _SEED = 2, 8, 17  # of each fit, at least; of all fits together
_PAIRS, _FEWEST_PAIRS = 24, 6  # pairs of antithetic draws: of all laws; of one fit, at least
_BENCHES, _BAND_SEED = 40, 43  # drawn for a band
FLOOR = 0.005  # of a signal's range: no model predicts it better
_NEGLIGIBLE = 0.01  # weight in a prediction
_SPREADS = (0.3, 3.0)  # prior deviations: smooth kinetics escape where sharp ones trap a fit
_DRAWN, _DRAWN_FIRST = 2, 12  # further starts drawn from the prior: all used; the best of them used

# By law and convection: the final fits, two if there are several runs, and those of all starts.
Fits = dict[tuple[str, str], tuple[list[Fit], list[Fit]]]


@dataclass(frozen=True, eq=False)
class LawFit:
    """A law with its most probable `fit`, and `others` with equal or different states of runs or
    another convection. `shares`: their weights in a prediction, the same for equal and different
    states, as how fitted runs differ says nothing about a new one. `tried`: fits of all starts."""

    law: str
    probability: float
    fit: Fit
    tried: tuple[Fit, ...]
    others: tuple[Fit, ...]
    shares: tuple[float, ...]

    @property
    def weighed(self) -> tuple[tuple[float, Fit], ...]:
        return tuple(zip(self.shares, (self.fit, *self.others), strict=True))

    @cached_property
    def drawn(self) -> tuple[tuple[float, Fit, Array], ...]:
        """`weighed` without negligible fits, each with antithetic draws (p, k) of its unknowns."""
        found, random = [], np.random.default_rng(_SEED)
        for share, one in (own for own in self.weighed if own[0] >= _NEGLIGIBLE):
            pairs = max(round(_PAIRS * share), _FEWEST_PAIRS)
            steps = random.standard_normal((pairs, len(one.x))) @ one.directions.T
            steps = one.within_reach(np.vstack([steps, -steps]))
            found.append((share, one, one.x + steps))
        return tuple(found)


def weigh_laws(observations: Sequence[Observation], parameters: Parameters,
               quantities: Sequence[str], report: Report = silent,
               more: tuple[Unknown, ...] = ()) -> tuple[LawFit, ...]:
    """Laws that a wire may follow, the most probable first: the stated one, else all (`extended` if
    one of its own parameters is stated). `more`: further unknowns of the fit. InputError: none
    fits, or all contradict the stated."""
    stated = "wire.law" in parameters.given
    known = [n for n in PRIOR if n != "extended" or parameters.given & {*ORIENTING[n]}]
    laws = [parameters["wire.law"]] if stated else known
    settled = parameters.given & {"wire.convection", "wire.heat_transfer_coefficient"}
    usual, *others = (str(parameters["wire.convection"]),) if settled else AIR
    count = len(laws) + min(len(laws), 2) * len(others)
    most = max(_STARTS, _ALL_STARTS // count)
    problem = Problem.of([one.zeroed() for one in observations])
    framed = any(one.holds for one in observations)
    fits: Fits = {}
    faults: list[InputError] = []

    def fit_with(law: str, air: str) -> None:
        done = len(fits) + len(faults)
        share = part(report, done / count, (done + 1) / count, law)
        share(0.0, "choosing the starts")
        assumed = {"wire.law": law} | ({} if settled else {"wire.convection": air})
        try:
            own = priors.as_in_the_field(parameters.assuming(assumed, {}))
            unknowns = priors.unknowns_of_records(own, quantities, load_frame=framed,
                                                  sides_apart=True, unmodelled=True)
            unknowns = replace(unknowns, items=(*unknowns.items, *more),
                               baseline=unknowns.baseline + len(more))
            tries = nearest_starts(problem, unknowns, _DRAWN_FIRST)[:most]
            # With another convection also from the fits of this law, or with this convection.
            for (other, with_air), (found, _) in fits.items() if air != usual else ():
                if law == other or air == with_air:
                    begin = dict(zip(unknowns.names, unknowns.start().tolist(), strict=True))
                    begin |= zip(found[0].unknowns.names, found[0].x.tolist(), strict=True)
                    tries.append(np.array([begin[name] for name in unknowns.names]))
            fits[law, air] = solver.fit_imperfect(problem, own, unknowns, tries, share)
        except (FitError, InputError) as error:  # or the law contradicts stated parameters
            faults.append(InputError(str(error)))

    for law in laws:
        fit_with(law, usual)
    if not fits:
        raise faults[0] if faults else InputError("no law of the wire was tried")
    readings = max(solver.independent_readings(one) for found, _ in fits.values() for one in found)
    evidence = {law: max(solver.log_evidence(one, readings) for one in found)
                for (law, _), (found, _) in fits.items()}
    likeliest = max(evidence, key=evidence.__getitem__)
    for law, air in product(dict.fromkeys((likeliest, "cosine")), others):
        if law in evidence:
            fit_with(law, air)
    return _weighed(fits, {} if settled else AIR, readings)


def _weighed(fits: Fits, airs: Mapping[str, float], readings: float) -> tuple[LawFit, ...]:
    """Every law with its fits, the most probable of each first."""
    every = [(key, one) for key, (found, _) in fits.items() for one in found]
    logs = np.array([np.log(PRIOR[law]) + np.log(airs.get(air, 1.0))
                     + np.log(_DIFFERENT if one.problem.states else 1.0 - _DIFFERENT)
                     + _TEMPERED * solver.log_evidence(one, readings)
                     for (law, air), one in every])
    weights = np.exp(logs - logs.max())
    weights /= weights.sum()
    laws = []
    for law in dict.fromkeys(law for law, _ in fits):
        rows = []  # probability, weight in a prediction, fits of all starts, fit
        for key in (key for key in fits if key[0] == law):
            own = [(float(w), one) for w, (k, one) in zip(weights, every, strict=True) if k == key]
            share = sum(w for w, _ in own) / len(own)
            rows += [(w, share, fits[key][1], one.with_repeated_misfit()) for w, one in own]
        rows.sort(key=lambda row: -row[0])
        weights_of, shares, tried, (best, *others) = zip(*rows, strict=True)
        laws.append(LawFit(law, sum(weights_of), best, tuple(tried[0]), tuple(others), shares))
    return tuple(sorted(laws, key=lambda one: -one.probability))


def starts(unknowns: Unknowns, drawn: int = _DRAWN) -> list[Array]:
    """Starts (k,): prior means with sharp and with smooth kinetics, and draws from the prior."""
    tries, random = [unknowns.start(spread) for spread in _SPREADS], np.random.default_rng(_SEED)
    if np.array_equal(tries[0], tries[1]):  # a law without a transition spread
        tries.pop()
    for _ in range(drawn):
        x = unknowns.start(abs(float(random.standard_normal())))
        x[: unknowns.bench] = random.standard_normal(unknowns.bench)
        tries.append(x)
    return tries


def nearest_starts(problem: Problem, unknowns: Unknowns, drawn: int) -> list[Array]:
    """`starts`, best predictions of motions first: no small step sets a still wire in motion."""
    tries = starts(unknowns, drawn)
    benches = [unknowns.parameters(np.clip(x, *unknowns.bounds())) for x in tries]
    readings = problem.coarse.predict_many(benches)
    missed = sum(np.std(b.signal.value[:, np.newaxis] - readings[b.rows], axis=0)
                 / max(np.ptp(b.signal.value), b.signal.noise)
                 for b in problem.blocks if b.signal.quantity in MOVED)
    return [tries[k] for k in np.argsort(missed)]


def repeatability(fitted: Fit) -> float:
    """Root-mean-square difference of runs with the same input, in strokes; NaN for one run."""
    problem, squares = fitted.problem, []
    which, k = np.flatnonzero(problem.of_kind(STATE) | problem.of_kind(OFFSET)), len(fitted.x)
    rows, covariance = problem.nuisance_rows[:, which], fitted.joint[k:, k:][np.ix_(which, which)]
    for block in problem.blocks:
        if block.signal.quantity in MOVED:
            own = rows[block.rows]
            power = (own @ fitted.z[which]) ** 2 + np.einsum("ij,jk,ik->i", own, covariance, own)
            squares.append(float(np.mean(power)) / float(np.ptp(block.signal.value)) ** 2)
    several = squares and len(problem.observations) > 1
    return float(np.sqrt(2.0 * np.mean(squares))) if several else float("nan")


# --- Prediction bands, after an identification or from the uncertainties of a parameter file.
# Benches are drawn within their uncertainties, each in a random state of its run (`STATES`);
# limits are those of a normal distribution, with a floor of 0.5 % of the signal's range.


@dataclass(frozen=True, eq=False)
class Band:
    """Mean of a signal and limits of a share of its readings, (n,) in its unit at `time` (n,) s."""

    time: Array
    mean: Array
    low: Array
    high: Array

    @classmethod
    def about(cls, time: Array, mean: Array, variance: Array, reach: float) -> "Band":
        """Limits at `reach` standard deviations."""
        off = reach * np.sqrt(variance + (FLOOR * float(np.ptp(mean))) ** 2)
        return cls(time, mean, mean - off, mean + off)


def reach_of(probability: float) -> float:
    """Standard deviations within which that share of readings lies. InputError: not in (0, 1)."""
    if not 0.0 < probability < 1.0:
        raise InputError(f"a band of {probability:g}, expected a share between 0 and 1")
    return float(ndtri(0.5 + probability / 2.0))


def predict(laws: Sequence[LawFit], observation: Observation,
            probability: float = 0.9) -> dict[str, Band]:
    """Bands by signal for a run with this drive, after an identification of other runs. The mean
    lies half way between the most probable prediction and the mean over the draws; the limits span
    laws, parameters and states of the run. Raises InputError: `probability` is not in (0, 1)."""
    reach, random = reach_of(probability), np.random.default_rng(_BAND_SEED)
    means, weights, variances = [], [], []
    for weight, fitted, places in (own for one in laws for own in one.drawn):
        differ = max(fitted.problem.states, solver.least_scale(fitted))
        runs = differ * random.standard_normal((len(places) // 2, len(STATES)))
        benches = [_moved(fitted.unknowns, x, off)
                   for x, off in zip(places, np.vstack([runs, -runs]), strict=True)]
        readings = observation.predict([fitted.parameters, *benches])
        best, drawn = readings[:, 0], readings[:, 1:]
        means.append(0.5 * (best + np.mean(drawn, axis=1)))
        weights.append(weight)
        variances.append(np.mean((drawn - means[-1][:, np.newaxis]) ** 2, axis=1))
    shares, every = np.array(weights) / np.sum(weights), np.array(means)
    mean = shares @ every
    variance = shares @ (np.array(variances) + (every - mean) ** 2)
    bands, parts = {}, (observation.by_signal(own) for own in (mean, variance))
    for signal, own, spread in zip(observation.signals, *parts, strict=True):
        zero = RETURNS * float(np.ptp(own)) if signal.quantity in MOVED else 0.0
        bands[signal.name] = Band.about(signal.time, own, spread + zero**2, reach)
    return bands


def band_of(parameters: Parameters, simulated: Callable[[Parameters], Sequence[Signal]],
            probability: float, report: Report = silent) -> dict[str, Band]:
    """Bands by signal, without the voltages, from a parameter file: numbers of wire, room, load and
    effects with a stated `uncertainty.` are drawn (`benches_within`), all others are fixed.
    `simulated`: the signals of the run for given parameters. Raises InputError: `probability` is
    not in (0, 1), or no number has a stated uncertainty."""
    reach, benches = reach_of(probability), benches_within(parameters, _BENCHES)
    exact, drawn = simulated(parameters), []
    for number, bench in enumerate(benches):
        report(number / _BENCHES, f"draw {number + 1} of {_BENCHES}")
        drawn.append(simulated(bench))
    bands = {}
    for signal, *others in zip(exact, *drawn, strict=True):
        if not signal.name.endswith("voltage"):
            variance = np.mean([(one.values - signal.values) ** 2 for one in others], axis=0)
            bands[signal.name] = Band.about(signal.time, signal.values, variance, reach)
    return bands


def benches_within(parameters: Parameters, count: int) -> list[Parameters]:
    """Benches drawn within the stated uncertainties, each in a random state of its run. Raises
    InputError: no number of wire, room, load or effects has a stated uncertainty."""
    stated = [n for n, std in parameters.given_uncertainty.items()
              if std > 0.0 and not n.startswith("sensor.")]
    if not stated:
        raise InputError("a band needs numbers with an uncertainty.NAME, the parameters have none")
    names = [n for n in stated if not n.startswith(EFFECT_PREFIX)]
    if set(names) & set(priors.TEMPERATURES):
        names = [*(n for n in names if n not in priors.TEMPERATURES), *priors.TEMPERATURES]
    shapes = {n: (parameters.std(n), *priors.range_of(n))
              for n in stated if n.startswith(EFFECT_PREFIX)}
    unknowns = priors.unknowns_of(parameters, names, shapes=shapes)
    random, k = np.random.default_rng(_BAND_SEED), len(unknowns.items)
    drawn = random.standard_normal((count, k + len(STATES)))
    return [_moved(unknowns, x[:k], x[k:]) for x in drawn]


def _moved(unknowns: Unknowns, x: Array, off: Array) -> Parameters:
    """The bench at x (k,), clipped to its bounds, its `STATES` `off` times the usual away."""
    there = unknowns.parameters(np.clip(x, *unknowns.bounds()))
    return in_state(there, dict(zip(STATES, off.tolist(), strict=True)))
