"""Which law a wire follows: the whole model fitted under each, all with one thermal part, and the
laws weighed by their evidence. What they leave open together is what a prediction is made of.

A quarter of the evidence (`log_evidence`) counts: sharp features of a few runs, all alike, choose a
law more surely than the law predicts other runs.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri

from sma_bench.errors import FitError, InputError
from sma_bench.estimation.noise_model import Array
from sma_bench.estimation.nuisances import OFFSET, STATE, STATES, in_state
from sma_bench.estimation.observation import Observation
from sma_bench.estimation.residual import Problem
from sma_bench.estimation.solver import (
    Fit,
    fit_imperfect,
    independent_readings,
    least_scale,
    log_evidence,
)
from sma_bench.estimation.unknowns import Unknowns, as_in_the_field, unknowns_of_records
from sma_bench.parameters import Parameters
from sma_bench.parameters.parameter import LAWS
from sma_bench.progress import Report, part, silent

# How probable a law is before any record: real wires have inner loops and soft ends.
PRIOR = {"normal": 0.72, "logistic": 0.14, "cosine": 0.1, "exponential": 0.04}
_TEMPERED = 0.25
_DIFFERENT = 0.7  # probability that the runs of a bench differ, before any
_TINY = 1e-300
_NEGLIGIBLE = 0.02  # probability
_DRAWS, _FEWEST = 30, 8  # of all laws; of one
_FLOOR = 0.005  # of what a signal spans, that no model predicts
_SEED = 43
_STARTS = 2
_SPREADS = (0.3, 3.0)  # prior deviations: sharp kinetics can trap a fit that smooth ones let go
_DRAWN = 2  # further starts, drawn from the prior
_ZERO = 0.012  # of a stroke, that a run's zero lies off
_MOTIONS = ("deflection", "elongation")


@dataclass(frozen=True, eq=False)
class LawFit:
    """The model under one law, and how probable this law is beside the others; `others`: its less
    probable fit, with runs that differ or are alike, and the share of the probability that it has
    of this law's."""

    law: str
    probability: float
    fit: Fit
    tried: tuple[Fit, ...]
    others: tuple[tuple[float, Fit], ...] = ()

    @property
    def weighed(self) -> tuple[tuple[float, Fit], ...]:
        """Every fit with its probability."""
        rest = 1.0 - sum(share for share, _ in self.others)
        shares = ((rest, self.fit), *self.others)
        return tuple((self.probability * share, one) for share, one in shares)


@dataclass(frozen=True, eq=False)
class Band:
    """What a signal will read: `mean` and the limits (n,) of a share of readings at `time` (n,) s,
    in the signal's unit."""

    time: Array
    mean: Array
    low: Array
    high: Array


def weigh_laws(
    observations: Sequence[Observation], parameters: Parameters, quantities: Sequence[str],
    report: Report = silent,
) -> tuple[LawFit, ...]:
    """The laws that the wire may follow, the most probable first: the one that a file states, else
    all. Where nobody states h, it is that of free convection.

    Raises:
        InputError: no law goes with what is stated, or leads to a fit.
    """
    stated = "wire.law" in parameters.given
    laws = [parameters["wire.law"]] if stated else [name for name in LAWS if name in PRIOR]
    if not parameters.given & {"wire.convection", "wire.heat_transfer_coefficient"}:
        parameters = parameters.assuming({"wire.convection": "free"}, {})
    problem = Problem.of([one.zeroed() for one in observations])
    fits: dict[str, tuple[list[Fit], list[Fit]]] = {}
    fault: InputError | None = None
    for number, law in enumerate(laws):
        try:
            own = as_in_the_field(parameters.assuming({"wire.law": law}, {}))
        except InputError as error:  # not with the effects and temperatures that are stated
            fault = error
            continue
        unknowns = unknowns_of_records(
            own, quantities, load_frame=any(one.holds for one in observations), own_load=True,
            sides_apart=True, unmodelled=True,
        )
        share = part(report, number / len(laws), (number + 1) / len(laws), law)
        try:
            fits[law] = fit_imperfect(problem, own, unknowns, starts(unknowns)[:_STARTS], share)
        except FitError as error:
            fault = InputError(str(error))
    if not fits:
        raise fault or InputError("no law of the wire was tried")
    every = [(law, one) for law, (found, _) in fits.items() for one in found]
    readings = max(independent_readings(one) for _, one in every)
    told = np.array([
        np.log(PRIOR.get(law, 1.0) * (_DIFFERENT if one.problem.states else 1.0 - _DIFFERENT))
        + _TEMPERED * log_evidence(one, readings)
        for law, one in every
    ])
    weights = np.exp(told - told.max())
    weights /= weights.sum()
    weighed = []
    for law, (_, tried) in fits.items():
        fitted = sorted(
            ((float(w), one) for w, (name, one) in zip(weights, every, strict=True) if name == law),
            key=lambda pair: -pair[0],
        )
        probability = sum(w for w, _ in fitted)
        others = tuple((w / max(probability, _TINY), one) for w, one in fitted[1:])
        weighed.append(LawFit(law, probability, fitted[0][1], tuple(tried), others))
    return tuple(sorted(weighed, key=lambda one: -one.probability))


def starts(unknowns: Unknowns) -> list[Array]:
    """What is believed, with sharp and with smooth kinetics, and some believable benches."""
    tries, random = [unknowns.start(spread) for spread in _SPREADS], np.random.default_rng(17)
    if np.array_equal(tries[0], tries[1]):  # a law without a spread
        tries.pop()
    for _ in range(_DRAWN):
        x = unknowns.start(abs(float(random.standard_normal())))
        x[: unknowns.bench] = random.standard_normal(unknowns.bench)
        tries.append(x)
    return tries



def repeatability(fitted: Fit) -> float:
    """By how much one run of this bench predicts another of the same input, root mean square as a
    share of the stroke: what the states of its runs differ by; nan of a single run."""
    problem, squares = fitted.problem, []
    if len(problem.observations) < 2:
        return float("nan")
    kinds = [item.kind in (STATE, OFFSET) for own in problem.nuisances for item in own.items]
    which = np.flatnonzero(kinds)
    rows = problem.nuisance_rows[:, which]
    k = len(fitted.x)
    doubt = fitted.joint[k:, k:][np.ix_(which, which)]
    for block in problem.blocks:
        if block.signal.quantity in ("deflection", "elongation"):
            own = rows[block.rows]
            power = (own @ fitted.z[which]) ** 2 + np.einsum("ij,jk,ik->i", own, doubt, own)
            squares.append(float(np.mean(power)) / float(np.ptp(block.signal.value)) ** 2)
    return float(np.sqrt(2.0 * np.mean(squares))) if squares else float("nan")


def predict(
    laws: Sequence[LawFit], observation: Observation, probability: float = 0.9
) -> dict[str, Band]:
    """What a run with this drive will show, by signal.

    The mean is that of the laws' most probable numbers. The limits come from draws of what each law
    leaves open of its numbers, and of what runs of one bench differ by, with a floor of 0.5 % of
    what the signal spans. Where no fitted record has been, the draws part by themselves.
    """
    random = np.random.default_rng(_SEED)
    means, weights, variance = [], [], 0.0
    for weight, fitted in (pair for one in laws for pair in one.weighed):
        if weight < _NEGLIGIBLE:
            continue
        unknowns, differ = fitted.unknowns, max(fitted.problem.states, least_scale(fitted))
        low, high = unknowns.bounds()
        values, vectors = np.linalg.eigh(fitted.covariance)
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        benches = []
        for _ in range(max(round(_DRAWS * weight), _FEWEST)):
            x = np.clip(fitted.x + root @ random.standard_normal(len(root)), low, high)
            off = differ * random.standard_normal(len(STATES))
            away = dict(zip(STATES, off.tolist(), strict=True))
            benches.append(in_state(unknowns.parameters(x), away))
        best, drawn = np.split(observation.predict([fitted.parameters, *benches]), [1], axis=1)
        means.append(best[:, 0])
        weights.append(weight)
        variance = variance + weight * np.mean((drawn - best) ** 2, axis=1)
    shares = np.array(weights) / np.sum(weights)
    mean = shares @ np.array(means)
    variance = variance / np.sum(weights) + shares @ (np.array(means) - mean) ** 2
    bands, first = {}, 0
    reach = float(ndtri(0.5 + probability / 2.0))
    for signal in observation.signals:
        own = slice(first, first + len(signal.time))
        first = own.stop
        floor = _FLOOR * float(np.ptp(mean[own]))
        zero = _ZERO * float(np.ptp(mean[own])) if signal.quantity in _MOTIONS else 0.0
        off = reach * np.sqrt(variance[own] + floor**2 + zero**2)
        bands[signal.name] = Band(signal.time, mean[own], mean[own] - off, mean[own] + off)
    return bands

