"""Which law a wire follows: the whole model fitted under each, all with one thermal part, and the
laws weighed by a quarter of their evidence, as sharp features of a few runs choose a law more
surely than it predicts other runs. Where nothing is stated of h, that is the free convection of
still air; the likeliest law and the paper's cosine are fitted with a constant h too."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np
from scipy.special import ndtri

from sma_bench.errors import FitError, InputError
from sma_bench.estimation.noise_model import Array
from sma_bench.estimation.nuisances import OFFSET, STATE, STATES, in_state
from sma_bench.estimation.observation import MOVED, RETURNS, Observation
from sma_bench.estimation.residual import Problem
from sma_bench.estimation.solver import (
    Fit,
    fit_imperfect,
    independent_readings,
    least_scale,
    log_evidence,
)
from sma_bench.estimation.unknowns import (
    TEMPERATURES,
    Unknowns,
    as_in_the_field,
    range_of,
    unknowns_of,
    unknowns_of_records,
)
from sma_bench.parameters import Parameters
from sma_bench.parameters.parameter import EFFECT_PREFIX
from sma_bench.parameters.parameters import ORIENTING
from sma_bench.progress import Report, part, silent
from sma_bench.records.record import Signal

# How probable a law is before any record: real wires have inner loops and soft ends, and under most
# loads all martensite is oriented, where brinson is the cosine with numbers that fit anything.
PRIOR = {"normal": 0.9, "logistic": 0.05, "cosine": 0.035, "exponential": 0.015}
PRIOR |= dict.fromkeys(ORIENTING, 0.004)
AIR = {"free": 0.8, "constant": 0.2}  # and what becomes of the heat, where nothing is stated
_TEMPERED = 0.25
_DIFFERENT = 0.7  # probability that the runs of a bench differ, before any
_STARTS, _ALL_STARTS, _SEED = 2, 8, 17  # of a fit at least, of all together
_PAIRS, _FEWEST = 24, 6  # of draws, of all laws and of one fit
_BENCHES, _BAND_SEED = 40, 43  # that are drawn for a band
FLOOR = 0.005  # of what a signal spans, that no model predicts
_NEGLIGIBLE = 0.01  # share of a prediction
_SPREADS = (0.3, 3.0)  # prior deviations: sharp kinetics can trap a fit that smooth ones let go
_DRAWN, _DRAWN_FIRST = 2, 12  # further starts, drawn from the prior; of which the best are tried

# By law and air: the fit, or two of several runs, and those that were tried.
Fits = dict[tuple[str, str], tuple[list[Fit], list[Fit]]]


@dataclass(frozen=True, eq=False)
class LawFit:
    """The model under one law, and how probable this law is; `others`: its less probable fits, with
    runs that differ or are alike, which count the same in a prediction, as what fitted runs differ
    by says nothing of another, and with another h. `shares`: what `fit` and each of these count."""

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
        """As `weighed`, without what counts for nothing, with places (p, k) drawn in pairs."""
        found, random = [], np.random.default_rng(_SEED)
        for share, one in (own for own in self.weighed if own[0] >= _NEGLIGIBLE):
            pairs = max(round(_PAIRS * share), _FEWEST)
            steps = random.standard_normal((pairs, len(one.x))) @ one.directions.T
            steps = one.within_reach(np.vstack([steps, -steps]))
            found.append((share, one, one.x + steps))
        return tuple(found)


def weigh_laws(observations: Sequence[Observation], parameters: Parameters,
               quantities: Sequence[str], report: Report = silent) -> tuple[LawFit, ...]:
    """The laws that the wire may follow, the most probable first: the stated one, else all, but
    `extended` only with a number of its own. InputError: none fits, or goes with what is stated."""
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
        assumed = {"wire.law": law} | ({} if settled else {"wire.convection": air})
        try:
            own = as_in_the_field(parameters.assuming(assumed, {}))
            unknowns = unknowns_of_records(own, quantities, load_frame=framed, sides_apart=True,
                                           unmodelled=True)
            tries = nearest_starts(problem, unknowns, _DRAWN_FIRST)[:most]
            if air != usual:  # from where the usual one ended, as far as it has these unknowns
                one, begin = fits[law, usual][0][0], unknowns.start().tolist()
                ended = dict(zip(unknowns.names, begin, strict=True))
                ended |= dict(zip(one.unknowns.names, one.x.tolist(), strict=True))
                tries.append(np.array([ended[name] for name in unknowns.names]))
            share = part(report, done / count, (done + 1) / count, law)
            fits[law, air] = fit_imperfect(problem, own, unknowns, tries, share)
        except (FitError, InputError) as error:  # or not with what else is stated
            faults.append(InputError(str(error)))

    for law in laws:
        fit_with(law, usual)
    if not fits:
        raise faults[0] if faults else InputError("no law of the wire was tried")
    readings = max(independent_readings(one) for found, _ in fits.values() for one in found)
    evidence = {law: max(log_evidence(one, readings) for one in found)
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
                     + _TEMPERED * log_evidence(one, readings)
                     for (law, air), one in every])
    weights = np.exp(logs - logs.max())
    weights /= weights.sum()
    laws = []
    for law in dict.fromkeys(law for law, _ in fits):
        rows = []  # weight, share in a prediction, those that were tried, fit
        for key in (key for key in fits if key[0] == law):
            own = [(float(w), one) for w, (k, one) in zip(weights, every, strict=True) if k == key]
            share = sum(w for w, _ in own) / len(own)
            rows += [(w, share, fits[key][1], one.with_repeated_misfit()) for w, one in own]
        rows.sort(key=lambda row: -row[0])
        weights_of, shares, tried, (best, *others) = zip(*rows, strict=True)
        laws.append(LawFit(law, sum(weights_of), best, tuple(tried[0]), tuple(others), shares))
    return tuple(sorted(laws, key=lambda one: -one.probability))


def starts(unknowns: Unknowns, drawn: int = _DRAWN) -> list[Array]:
    """What is believed, with sharp and with smooth kinetics, and some believable benches."""
    tries, random = [unknowns.start(spread) for spread in _SPREADS], np.random.default_rng(_SEED)
    if np.array_equal(tries[0], tries[1]):  # a law without a spread
        tries.pop()
    for _ in range(drawn):
        x = unknowns.start(abs(float(random.standard_normal())))
        x[: unknowns.bench] = random.standard_normal(unknowns.bench)
        tries.append(x)
    return tries


def nearest_starts(problem: Problem, unknowns: Unknowns, drawn: int) -> list[Array]:
    """The same, those first that move as the records do: no small step sets a still wire off."""
    tries = starts(unknowns, drawn)
    benches = [unknowns.parameters(np.clip(x, *unknowns.bounds())) for x in tries]
    readings = problem.coarse.predict_many(benches)
    missed = sum(np.std(b.signal.value[:, np.newaxis] - readings[b.rows], axis=0)
                 / max(np.ptp(b.signal.value), b.signal.noise)
                 for b in problem.blocks if b.signal.quantity in MOVED)
    return [tries[k] for k in np.argsort(missed)]


def repeatability(fitted: Fit) -> float:
    """By how much runs of the same input differ, root mean square in strokes; nan of one run."""
    problem, squares = fitted.problem, []
    which, k = np.flatnonzero(problem.of_kind(STATE) | problem.of_kind(OFFSET)), len(fitted.x)
    rows, doubt = problem.nuisance_rows[:, which], fitted.joint[k:, k:][np.ix_(which, which)]
    for block in problem.blocks:
        if block.signal.quantity in MOVED:
            own = rows[block.rows]
            power = (own @ fitted.z[which]) ** 2 + np.einsum("ij,jk,ik->i", own, doubt, own)
            squares.append(float(np.mean(power)) / float(np.ptp(block.signal.value)) ** 2)
    several = squares and len(problem.observations) > 1
    return float(np.sqrt(2.0 * np.mean(squares))) if several else float("nan")


# --- Between which limits a bench will read: by an identification, or as far as a file says.
# Benches are drawn within what is open of their numbers, each in a run of its own (`STATES`);
# limits are those of a normal distribution, with a floor of 0.5 % of what the signal spans.


@dataclass(frozen=True, eq=False)
class Band:
    """Mean and limits (n,) of a share of a signal's readings at `time` (n,) s, in its unit."""

    time: Array
    mean: Array
    low: Array
    high: Array

    @classmethod
    def about(cls, time: Array, mean: Array, variance: Array, reach: float) -> "Band":
        """Limits that are `reach` standard deviations off."""
        off = reach * np.sqrt(variance + (FLOOR * float(np.ptp(mean))) ** 2)
        return cls(time, mean, mean - off, mean + off)


def reach_of(probability: float) -> float:
    """Standard deviations within which that share of readings lies. Raises InputError: no share."""
    if not 0.0 < probability < 1.0:
        raise InputError(f"a band of {probability:g}, expected a share between 0 and 1")
    return float(ndtri(0.5 + probability / 2.0))


def predict(laws: Sequence[LawFit], observation: Observation,
            probability: float = 0.9) -> dict[str, Band]:
    """What a run with this drive will show, by signal, after an identification of other runs: the
    mean over the laws, half way from what is most probable to the mean of all that is open; the
    limits as laws and numbers leave them. Raises InputError: `probability` is no share."""
    reach, random = reach_of(probability), np.random.default_rng(_BAND_SEED)
    means, weights, variances = [], [], []
    for weight, fitted, places in (own for one in laws for own in one.drawn):
        differ = max(fitted.problem.states, least_scale(fitted))
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
    bands, ends = {}, np.cumsum([len(signal.time) for signal in observation.signals])[:-1]
    for signal, own, spread in zip(observation.signals, np.split(mean, ends),
                                   np.split(variance, ends), strict=True):
        zero = RETURNS * float(np.ptp(own)) if signal.quantity in MOVED else 0.0
        bands[signal.name] = Band.about(signal.time, own, spread + zero**2, reach)
    return bands


def band_of(parameters: Parameters, simulated: Callable[[Parameters], Sequence[Signal]],
            probability: float, report: Report = silent) -> dict[str, Band]:
    """What a run will show, by signal but the voltages, as far as a parameter file says: numbers of
    wire, room, load and effects with a stated `uncertainty.` are drawn (`benches_within`), all
    others are as they are. `simulated`: signals of the run that is asked for, on a bench. Raises
    InputError: `probability` is no share, or no number has a stated uncertainty."""
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
    """Benches as these parameters leave them open, each in a run of its own. Raises InputError: no
    number of wire, room, load or effects has a stated uncertainty."""
    stated = [n for n, std in parameters.given_uncertainty.items()
              if std > 0.0 and not n.startswith("sensor.")]
    if not stated:
        raise InputError("a band needs numbers with an uncertainty., the parameters have none")
    names = [n for n in stated if not n.startswith(EFFECT_PREFIX)]
    if set(names) & set(TEMPERATURES):
        names = [*(n for n in names if n not in TEMPERATURES), *TEMPERATURES]
    shapes = {n: (parameters.std(n), *range_of(n)) for n in stated if n.startswith(EFFECT_PREFIX)}
    unknowns = unknowns_of(parameters, names, shapes=shapes)
    random, k = np.random.default_rng(_BAND_SEED), len(unknowns.items)
    drawn = random.standard_normal((count, k + len(STATES)))
    return [_moved(unknowns, x[:k], x[k:]) for x in drawn]


def _moved(unknowns: Unknowns, x: Array, off: Array) -> Parameters:
    """A bench at x (k,), within its bounds, its `STATES` so many times the usual off."""
    there = unknowns.parameters(np.clip(x, *unknowns.bounds()))
    return in_state(there, dict(zip(STATES, off.tolist(), strict=True)))
