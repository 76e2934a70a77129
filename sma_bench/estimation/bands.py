"""Between which limits a bench will read: by an identification, or as far as a parameter file says.

Benches are drawn within what is open of their numbers, each in a run of its own (`STATES`). The
limits are those of a normal distribution about the reading asked for, with a floor of 0.5 % of what
the signal spans. Where no fitted record has been, the draws part by themselves.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri

from sma_bench.errors import InputError
from sma_bench.estimation.laws import LawFit
from sma_bench.estimation.noise_model import Array
from sma_bench.estimation.nuisances import STATES, in_state
from sma_bench.estimation.observation import MOVED, RETURNS, Observation
from sma_bench.estimation.solver import least_scale
from sma_bench.estimation.unknowns import TEMPERATURES, Unknowns, range_of, unknowns_of
from sma_bench.parameters import Parameters
from sma_bench.parameters.parameter import EFFECT_PREFIX
from sma_bench.progress import Report, silent
from sma_bench.records.record import Signal

_DRAWS, _SEED = 40, 43
FLOOR = 0.005  # of what a signal spans, that no model predicts


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
    mean over the laws, half way from what is most probable to the mean of all that is open, which
    rounds every corner; the limits as laws and numbers leave them. Raises InputError: `probability`
    is no share."""
    reach, random = reach_of(probability), np.random.default_rng(_SEED)
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
    bands, first = {}, 0
    for signal in observation.signals:
        own = slice(first, first + len(signal.time))
        first = own.stop
        zero = RETURNS * float(np.ptp(mean[own])) if signal.quantity in MOVED else 0.0
        bands[signal.name] = Band.about(signal.time, mean[own], variance[own] + zero**2, reach)
    return bands


def band_of(parameters: Parameters, simulated: Callable[[Parameters], Sequence[Signal]],
            probability: float, report: Report = silent) -> dict[str, Band]:
    """What a run will show, by signal but the voltages, as far as a parameter file says: numbers of
    wire, room, load and effects with a stated `uncertainty.` are drawn, each by itself
    (`benches_within`); sensors and all others are as they are. `simulated`: signals of the run that
    is asked for, on a bench. Raises InputError: `probability` is no share, or no number has a
    stated uncertainty."""
    reach, benches = reach_of(probability), benches_within(parameters, _DRAWS)
    exact, drawn = simulated(parameters), []
    for number, bench in enumerate(benches):
        report(number / _DRAWS, f"draw {number + 1} of {_DRAWS}")
        drawn.append(simulated(bench))
    return {
        signal.name: Band.about(
            signal.time, signal.values,
            np.mean([(one[i].values - signal.values) ** 2 for one in drawn], axis=0), reach,
        )
        for i, signal in enumerate(exact) if not signal.name.endswith("voltage")
    }


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
    random, benches = np.random.default_rng(_SEED), []
    for _ in range(count):
        x, off = (random.standard_normal(n) for n in (len(unknowns.items), len(STATES)))
        benches.append(_moved(unknowns, x, off))
    return benches


def _moved(unknowns: Unknowns, x: Array, off: Array) -> Parameters:
    """A bench at x (k,), within its bounds, its `STATES` so many times the usual off."""
    there = unknowns.parameters(np.clip(x, *unknowns.bounds()))
    return in_state(there, dict(zip(STATES, off.tolist(), strict=True)))
