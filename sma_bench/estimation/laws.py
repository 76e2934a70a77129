"""Which law a wire follows: the whole model fitted under each, all with one thermal part, and the
laws weighed by their evidence.

A quarter of the evidence (`log_evidence`) counts: sharp features of a few runs, all alike, choose a
law more surely than the law predicts other runs.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sma_bench.errors import FitError, InputError
from sma_bench.estimation.noise_model import Array
from sma_bench.estimation.nuisances import OFFSET, STATE
from sma_bench.estimation.observation import MOVED, Observation
from sma_bench.estimation.residual import Problem
from sma_bench.estimation.solver import (
    Fit,
    fit_imperfect,
    independent_readings,
    log_evidence,
)
from sma_bench.estimation.unknowns import Unknowns, as_in_the_field, unknowns_of_records
from sma_bench.parameters import Parameters
from sma_bench.parameters.parameters import ORIENTING
from sma_bench.progress import Report, part, silent

# How probable a law is before any record: real wires have inner loops and soft ends.
PRIOR = {"normal": 0.72, "logistic": 0.14, "cosine": 0.1, "exponential": 0.04}
PRIOR |= dict.fromkeys(ORIENTING, 0.1)
_TEMPERED = 0.25
_DIFFERENT = 0.7  # probability that the runs of a bench differ, before any
_STARTS, _SEED = 2, 17
_SPREADS = (0.3, 3.0)  # prior deviations: sharp kinetics can trap a fit that smooth ones let go
_DRAWN = 2  # further starts, drawn from the prior


@dataclass(frozen=True, eq=False)
class LawFit:
    """The model under one law, and how probable this law is; `others`: its less probable fit, with
    runs that differ or are alike."""

    law: str
    probability: float
    fit: Fit
    tried: tuple[Fit, ...]
    others: tuple[Fit, ...] = ()

    @property
    def weighed(self) -> tuple[tuple[float, Fit], ...]:
        """Every fit with what it counts in a prediction: those of one law alike, as what fitted
        runs differ by, which tells such fits apart, says nothing of another run."""
        fits = (self.fit, *self.others)
        return tuple((self.probability / len(fits), one) for one in fits)


def weigh_laws(
    observations: Sequence[Observation], parameters: Parameters, quantities: Sequence[str],
    report: Report = silent,
) -> tuple[LawFit, ...]:
    """The laws that the wire may follow, the most probable first: the one that a file states, else
    all; those of which the load decides the strain only where a number of theirs is stated. An h
    that is not stated is that of free convection.

    Raises:
        InputError: no law goes with what is stated, or leads to a fit.
    """
    stated = "wire.law" in parameters.given
    known = [n for n in PRIOR if n not in ORIENTING or parameters.given & {*ORIENTING[n]}]
    laws = [parameters["wire.law"]] if stated else known
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
    logs = np.array([
        np.log(PRIOR[law] * (_DIFFERENT if one.problem.states else 1.0 - _DIFFERENT))
        + _TEMPERED * log_evidence(one, readings)
        for law, one in every
    ])
    weights = np.exp(logs - logs.max())
    weights /= weights.sum()
    weighed = []
    for law, (_, tried) in fits.items():
        fitted = sorted(
            ((float(w), one) for w, (name, one) in zip(weights, every, strict=True) if name == law),
            key=lambda pair: -pair[0],
        )
        probability = sum(w for w, _ in fitted)
        best, *rest = (one.with_repeated_misfit() for _, one in fitted)
        weighed.append(LawFit(law, probability, best, tuple(tried), tuple(rest)))
    return tuple(sorted(weighed, key=lambda one: -one.probability))


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
        if block.signal.quantity in MOVED:
            own = rows[block.rows]
            power = (own @ fitted.z[which]) ** 2 + np.einsum("ij,jk,ik->i", own, doubt, own)
            squares.append(float(np.mean(power)) / float(np.ptp(block.signal.value)) ** 2)
    return float(np.sqrt(2.0 * np.mean(squares))) if squares else float("nan")
