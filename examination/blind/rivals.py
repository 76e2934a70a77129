"""Three naive rivals of the diagnosis, which sit the same examination."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.special import gammaincc, gammaln

from examination.blind.case_files import NO_EFFECT, NO_GAP, RECALIBRATION, STAGE_OF
from examination.blind.rival_fitting import (
    QUANTITIES,
    Fit,
    Observed,
    baseline_knobs,
    effect_knobs,
    fit,
    jacobian,
    observe,
    slope_at,
    whitened,
)
from sma_bench.parameters import Parameters
from sma_bench.parameters.table import BY_NAME
from sma_bench.physics.effects import EFFECTS
from sma_bench.records import Record

Array = npt.NDArray[np.float64]
Choose = Callable[[Sequence[Observed], Parameters], tuple[dict[str, float], Parameters]]


# --- Largest drop: each effect alone, fitted with the baseline as the lab believes it.
#
# What an engineer does by hand: try one cause after the other, keep the one that fits best. The
# noise counts for nothing, wrong parameters are not thought of, and the probabilities are shares
# of the drops.

# Root mean square residual over noise below which there is nothing to explain.
_QUIET = 1.2


def largest_drop(
    observed: Sequence[Observed], nominal: Parameters
) -> tuple[dict[str, float], Parameters]:
    """Probabilities, and the lab's parameters with the winner in them."""
    residual = whitened(observed, nominal)
    before = float(np.sqrt(np.mean(residual**2)))
    if before < _QUIET:
        return {NO_GAP: 1.0}, nominal
    fits = {name: fit(observed, nominal, effect_knobs(name, nominal)) for name in EFFECTS}
    drops = {
        name: max(before - float(np.sqrt(found.square / len(residual))), 0.0)
        for name, found in fits.items()
    }
    total = sum(drops.values())
    if total == 0.0:
        return {NO_GAP: 1.0}, nominal
    best = max(drops, key=lambda name: drops[name])
    return {name: drop / total for name, drop in drops.items()}, fits[best].parameters


# --- Smallest p: the Lagrange multiplier test of every effect at the lab's parameters.
#
#     LM = r'J (J'J)^-1 J'r   ~   chi2(k)
#
# with the residuals r over noise that is taken as white, and J their change with the k numbers of
# the effect where it is off (Rao's score test). Wrong parameters are not thought of.

_LEVEL = 0.01
_RANK = 1e-8
_SMALLEST = 1e-280


def smallest_p(
    observed: Sequence[Observed], nominal: Parameters
) -> tuple[dict[str, float], Parameters]:
    """Probabilities, and the lab's parameters with the winner fitted."""
    residual = whitened(observed, nominal)
    log_p: dict[str, float] = {}
    for name in EFFECTS:
        knobs = effect_knobs(name, nominal)
        slope = jacobian(observed, nominal, knobs, residual)
        step, _, rank, _ = np.linalg.lstsq(slope, -residual, rcond=_RANK)
        explained = float(np.sum((slope @ step) ** 2))
        log_p[name] = log_tail(explained, max(int(rank), 1))
    best = min(log_p, key=lambda name: log_p[name])
    if log_p[best] > np.log(_LEVEL / len(log_p)):
        return {NO_GAP: 1.0}, nominal
    weights = {name: -value for name, value in log_p.items()}
    return shares_of(weights), fit(observed, nominal, effect_knobs(best, nominal)).parameters


def log_tail(x: float, k: int) -> float:
    """ln P(chi2(k) > x), also where P itself is too small for a number.

    Far out Q(a, z) goes as z^(a - 1) exp(-z)/Gamma(a) (DLMF 8.11.2).
    """
    a, z = k / 2.0, x / 2.0
    tail = float(gammaincc(a, z))
    if tail > _SMALLEST:
        return float(np.log(tail))
    return float((a - 1.0) * np.log(z) - z - gammaln(a))


# --- Lowest BIC: the baseline's numbers and one effect refitted together, noise taken as white.
#
#     BIC = n ln(S/n) + k ln n
#
# with the sum S of n squared residuals over noise and k fitted numbers (Schwarz, Annals of
# Statistics 6, 1978); the lab's parameters as they are (k = 0) and refitted alone compete.
# Probabilities go as exp(-BIC/2). Neither the lab's uncertainties nor the noise's correlation
# enter.

_ROUNDS_BASELINE, _ROUNDS_ALONE, _ROUNDS_EFFECT = 15, 3, 4


def lowest_bic(
    observed: Sequence[Observed], nominal: Parameters
) -> tuple[dict[str, float], Parameters]:
    """Probabilities, and the parameters of the winner's fit."""
    residual = whitened(observed, nominal)
    baseline = baseline_knobs(nominal)
    fits = {NO_GAP: Fit(nominal, float(residual @ residual), ())}
    fits[RECALIBRATION] = fit(observed, nominal, baseline, _ROUNDS_BASELINE)
    refitted = fits[RECALIBRATION].parameters
    near = slope_at(observed, refitted, baseline, whitened(observed, refitted))
    for name in EFFECTS:
        knobs = effect_knobs(name, nominal)
        # The refit may have led away from a large effect, which is then found alone first.
        alone = fit(observed, nominal, knobs, _ROUNDS_ALONE).parameters
        far = slope_at(observed, alone, baseline, whitened(observed, alone))
        trials = [
            fit(observed, start, knobs, _ROUNDS_EFFECT, slow)
            for start, slow in ((refitted, near), (alone, far))
        ]
        fits[name] = min(trials, key=lambda trial: trial.square)
    n = len(residual)
    bic = {
        name: n * np.log(found.square / n) + len(found.knobs) * np.log(n)
        for name, found in fits.items()
    }
    best = min(bic, key=lambda name: bic[name])
    return shares_of({name: -0.5 * value for name, value in bic.items()}), fits[best].parameters


# --- What a rival answers, in the form of the contract.

RIVALS: Mapping[str, Choose] = {
    "rmse": largest_drop, "score": smallest_p, "bic": lowest_bic,
}  # fmt: skip


def rival_answer(
    name: str, records: Sequence[Record], hold_out: Sequence[Record], nominal: Parameters
) -> tuple[dict[str, Any], Parameters]:
    """What a rival says, to the contract, and its improved parameters.

    Args:
        name: of RIVALS.
        records: to fit; hold_out: to measure the shrinkage on.
        nominal: what the lab believes.

    Raises:
        InputError: a record without voltages or without anything to compare.
    """
    training = [observe(record, nominal) for record in records]
    unseen = [observe(record, nominal) for record in hold_out]
    probability, improved = RIVALS[name](training, nominal)
    return statement(probability, nominal, improved, training, unseen), improved


_BLOCK = 50  # bins of a bootstrap block: 5 s
_RESAMPLES = 400
_STAGE_OF_QUANTITY = {
    "current": "electrical", "temperature": "thermal", "deflection": "mechanical",
}  # fmt: skip


def statement(
    probability: Mapping[str, float],
    nominal: Parameters,
    improved: Parameters,
    training: Sequence[Observed],
    hold_out: Sequence[Observed],
) -> dict[str, Any]:
    """The answer of a rival that is never in doubt.

    Args:
        probability: of every name that the rival considered; the highest is the verdict.
        nominal, improved: parameters before and after.
        training, hold_out: records that were fitted, and that were not.
    """
    names = (*STAGE_OF, *NO_EFFECT)
    shares = {name: float(probability.get(name, 0.0)) for name in names}
    best = max(shares, key=lambda name: shares[name])
    verdict = best if best in NO_EFFECT else "effect"
    return {
        "verdict": verdict,
        "cause": [best] if verdict == "effect" else [],
        "candidates": [
            {
                "name": name,
                "stage": STAGE_OF.get(name, ""),
                "probability": shares[name],
                "parameters": _parameters(improved, name) if name == best else {},
            }
            for name in sorted(names, key=lambda n: -shares[n])
        ],
        "where": None if verdict == NO_GAP else where(training, nominal, best),
        "shrinkage": shrinkage(hold_out or training, nominal, improved),
        "next_experiment": None,
    }


def shares_of(weights: Mapping[str, float]) -> dict[str, float]:
    """Logarithmic weights as probabilities."""
    top = max(weights.values())
    relative = {name: float(np.exp(weight - top)) for name, weight in weights.items()}
    total = sum(relative.values())
    return {name: value / total for name, value in relative.items()}


def _parameters(improved: Parameters, name: str) -> dict[str, Any]:
    if name not in EFFECTS:
        return {}
    return {
        p.name: {"value": float(improved[p.name]), "std": None, "unit": BY_NAME[p.name].unit}
        for p in EFFECTS[name].parameters
    }


def where(observed: Sequence[Observed], nominal: Parameters, cause: str) -> dict[str, Any]:
    """Cell of quantity, phase and side with the most squared residual over noise."""
    cells: dict[tuple[str, str, str], float] = {}
    for one in observed:
        sides = dict(zip(one.channels, one.sides, strict=True))
        for reading, row in zip(one.readings, one.residuals(nominal), strict=True):
            of_wire = sides.get(reading.name.rpartition(".")[0])
            for phase in ("drive", "rest", "initial"):
                for side in ("front", "back"):
                    here = one.phase[reading.at] == phase
                    if of_wire is None:
                        here &= one.driven_side[reading.at] == side
                    elif of_wire != side:
                        continue
                    key = (reading.quantity, phase, side)
                    energy = float(np.sum((row[here] / reading.noise) ** 2))
                    cells[key] = cells.get(key, 0.0) + energy
    quantity, phase, side = max(cells, key=lambda key: cells[key])
    stage = STAGE_OF.get(cause, _STAGE_OF_QUANTITY[quantity])
    return {"signal": quantity, "phase": phase, "side": side, "stage": stage, "table": []}


def shrinkage(
    observed: Sequence[Observed], nominal: Parameters, improved: Parameters
) -> dict[str, Any]:
    """Claim of every quantity, its interval by a bootstrap of blocks of 5 s."""
    found = {}
    before = [one.residuals(nominal) for one in observed]
    after = [one.residuals(improved) for one in observed]
    for quantity in QUANTITIES:
        rows = [
            (b, a, np.full(len(b), reading.noise))
            for one, bs, as_ in zip(observed, before, after, strict=True)
            for reading, b, a in zip(one.readings, bs, as_, strict=True)
            if reading.quantity == quantity
        ]
        if rows:
            found[quantity] = _claim(rows)
    return found


def _claim(rows: Sequence[tuple[Array, Array, Array]]) -> dict[str, Any]:
    blocks = np.array([
        [np.sum(part**2) for part in parts] + [len(parts[0])]
        for row in rows
        for parts in zip(*(np.array_split(r, max(1, len(r) // _BLOCK)) for r in row), strict=True)
    ])  # fmt: skip
    b2, a2, n2, count = blocks.sum(axis=0)
    drawn = np.random.default_rng(1).integers(0, len(blocks), (_RESAMPLES, len(blocks)))
    resampled = blocks[drawn].sum(axis=1)
    fractions = [_fraction(*(sums[:3] / sums[3])) for sums in resampled]
    fraction = _fraction(b2 / count, a2 / count, n2 / count)
    sure = [f for f in fractions if f is not None]
    interval = None
    if fraction is not None:
        low, high = np.percentile(sure or [fraction], [5.0, 95.0])
        interval = [min(float(low), fraction), max(float(high), fraction)]
    return {
        "rmse_before": float(np.sqrt(b2 / count)), "rmse_after": float(np.sqrt(a2 / count)),
        "fraction": fraction, "ci90": interval, "noise_floor": float(np.sqrt(n2 / count)),
    }  # fmt: skip


def _fraction(before: float, after: float, noise: float) -> float | None:
    """Share of the reducible root mean square that is gone; None where nothing was reducible."""
    if before <= 1.1 * noise:
        return None
    return float(1.0 - np.sqrt(max(after - noise, 0.0) / (before - noise)))
