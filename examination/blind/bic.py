"""A naive rival of the diagnosis, which sits the same examination: the lowest BIC.

The baseline's numbers and one effect are refitted together by least squares, noise taken as white:

    BIC = n ln(S/n) + k ln n

with the sum S of n squared residuals over noise and k fitted numbers (Schwarz, Annals of Statistics
6, 1978); the lab's parameters as they are (k = 0) and refitted alone compete. Probabilities go as
exp(-BIC/2). Neither the lab's uncertainties nor the noise's correlation enter. Where the gap is and
how far it shrinks is measured as the diagnosis does.
"""

from collections import namedtuple
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from examination.blind.case_files import NO_EFFECT, NO_GAP, RECALIBRATION, STAGE_OF
from sma_bench.arrays import Array
from sma_bench.diagnose.sizes import locate, shrinkage
from sma_bench.estimation.observation import observe
from sma_bench.estimation.residual import Problem
from sma_bench.estimation.unknowns import Unknowns, unknowns_of_records
from sma_bench.parameters import Parameters
from sma_bench.physics.effects import EFFECTS
from sma_bench.records import Record

_ENOUGH = 1e-4  # relative gain below which a fit is done
_STAGES = {"current": "electrical", "temperature": "thermal"}

# Fitted parameters, the numbers that were fitted, the sum of squares over noise.
Fit = namedtuple("Fit", "parameters x square")


def every_fit(problem: Problem, nominal: Parameters) -> Mapping[str, Fit]:
    """The lab's parameters, refitted, and refitted with each effect from there."""
    noise = np.concatenate([np.full(len(b.signal.value), b.signal.noise) for b in problem.blocks])

    def fit(unknowns: Unknowns, x: Array, rounds: int, held: Array | None = None) -> Fit:
        """Least squares from x; slopes that are `held` stay as they are."""
        first = 0 if held is None else held.shape[1]

        def residual(x: Array) -> Array:
            return (problem.predict(unknowns.parameters(x)) - problem.measured) / noise

        def jacobian(x: Array) -> Array:
            own = slopes(unknowns, x, range(first, len(x)))
            return (own if held is None else np.hstack([held, own])) / noise[:, None]

        found = least_squares(residual, x, jacobian, bounds=unknowns.bounds(), x_scale="jac",
                              ftol=_ENOUGH, max_nfev=2 * rounds)  # fmt: skip
        return Fit(unknowns.parameters(found.x), found.x, 2.0 * float(found.cost))

    def slopes(unknowns: Unknowns, x: Array, which: range) -> Array:
        return problem.derivatives(unknowns, x, problem.predict(unknowns.parameters(x)), which)

    quantities = [q for one in problem.observations for q in one.quantities]
    every = unknowns_of_records(nominal, quantities)
    baseline = replace(every, items=every.items[: every.bench], baseline=every.bench)
    again = fit(baseline, np.zeros(every.bench), 15)
    left = (problem.predict(nominal) - problem.measured) / noise
    fits = {NO_GAP: Fit(nominal, np.zeros(0), float(left @ left)), RECALIBRATION: again}
    at_fit = slopes(baseline, again.x, range(every.bench))
    for name in EFFECTS:
        unknowns = baseline.with_effects([name])
        off = np.zeros(len(unknowns.items) - every.bench)
        fits[name] = fit(unknowns, np.append(again.x, off), 6, at_fit)
    return fits


def bic_answer(records: Sequence[Record], hold_out: Sequence[Record],
               nominal: Parameters) -> tuple[dict[str, Any], Parameters]:
    """The rival's answer and improved parameters; `hold_out` measures the shrinkage."""
    problem = Problem.of([observe(record, nominal).coarse for record in records])
    fits = every_fit(problem, nominal)
    n = len(problem.measured)
    bic = {k: n * np.log(f.square / n) + len(f.x) * np.log(n) for k, f in fits.items()}
    weights = {name: float(np.exp(-0.5 * (b - min(bic.values())))) for name, b in bic.items()}
    shares = dict.fromkeys((*STAGE_OF, *NO_EFFECT), 0.0)
    shares |= {name: weight / sum(weights.values()) for name, weight in weights.items()}
    best = max(shares, key=lambda name: shares[name])
    named = best not in NO_EFFECT
    improved = fits[best].parameters
    candidates: list[dict[str, Any]] = [
        {"name": name, "stage": STAGE_OF.get(name, ""), "probability": shares[name]}
        for name in sorted(shares, key=lambda name: -shares[name])]
    if named:
        values = {p.name: {"value": float(improved[p.name])} for p in EFFECTS[best].parameters}
        candidates[0]["parameters"] = values
    cell = locate(problem, problem.measured - problem.predict(nominal))[0]
    quantity = cell.signal.rpartition(".")[2]
    unseen = Problem.of([observe(record, nominal) for record in hold_out or records])
    refitted = fits[RECALIBRATION].parameters
    claims = shrinkage(unseen.observations, nominal, refitted, improved, unseen.noise)
    answer = {"verdict": "effect" if named else best, "cause": [best] if named else [],
              "candidates": candidates, "next_experiment": None,
              "where": {"signal": quantity, "phase": cell.phase, "side": cell.side,
                        "stage": STAGE_OF.get(best) or _STAGES.get(quantity, "mechanical")},
              "shrinkage": {quantity: {"fraction": None, "ci90": None} if one.at_noise
                            else {"fraction": one.fraction, "ci90": list(one.ci90)}
                            for quantity, one in claims.items()}}
    return answer, improved
