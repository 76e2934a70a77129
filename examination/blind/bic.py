"""A naive rival of the diagnosis, which sits the same examination: the lowest BIC.

The baseline's numbers and one effect are refitted together by least squares, noise taken as white:

    BIC = n ln(S/n) + k ln n

with the sum S of n squared residuals over noise and k fitted numbers (Schwarz, Annals of Statistics
6, 1978); the lab's parameters as they are (k = 0) and refitted alone compete. Probabilities go as
exp(-BIC/2). Neither the lab's uncertainties nor the noise's correlation enter.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares

from examination.blind.case_files import NO_EFFECT, NO_GAP, RECALIBRATION, STAGE_OF
from sma_bench.estimation.observation import Observation, observe
from sma_bench.parameters import Parameters
from sma_bench.parameters.table import BY_NAME
from sma_bench.physics.effects import EFFECTS
from sma_bench.records import Record

Array = npt.NDArray[np.float64]

_STEP = 0.05  # of a finite difference, in standard deviations
_ENOUGH = 1e-4  # relative gain below which a fit is done
_BLOCK = 25  # bins of a bootstrap block: 5 s
_STAGES = {"current": "electrical", "temperature": "thermal"}
_BACK = {"composite.stress_per_deflection_front": "composite.stress_per_deflection_back"}
# Those of the baseline that may be off. The area acts only together with h, the mass only together
# with c_p; both sides share one beta.
_BASELINE = (
    "environment.ambient_temperature", "composite.deflection_per_strain", *_BACK,
    *(f"wire.{name}" for name in (
        "resistance", "heat_transfer_coefficient", "specific_heat", "thermal_expansion_factor",
        "austenite_start_temperature", "austenite_finish_temperature",
        "martensite_start_temperature", "martensite_finish_temperature",
        "stress_influence_austenite", "stress_influence_martensite",
        "martensite_modulus", "austenite_modulus", "maximum_recoverable_strain",
    )),
)  # fmt: skip
_ORDERED = (("austenite_start", "austenite_finish"), ("martensite_finish", "martensite_start"))


@dataclass(frozen=True, eq=False)
class Fit:
    """Fitted parameters, the sum of squares of the residuals over noise, how many were fitted."""

    parameters: Parameters
    square: float
    fitted: int


def whitened(observed: Sequence[Observation], benches: Sequence[Parameters]) -> Array:
    """(n, p) residuals over the white noise of p benches, of all signals of all records."""
    rows = []
    for one in observed:
        noise = np.concatenate([np.full(len(s.value), s.noise) for s in one.signals])
        value = np.concatenate([s.value for s in one.signals])
        rows.append((value[:, None] - one.predict(benches)) / noise[:, None])
    return np.vstack(rows)


def moved(parameters: Parameters, names: Sequence[str], steps: Array) -> Parameters:
    """Parameters moved by so many of their stated standard deviations, held within their ranges; a
    transformation that would end before it begins keeps its temperatures."""
    values = {}
    for name, step in zip(names, steps.tolist(), strict=True):
        low, high = BY_NAME[name].low, BY_NAME[name].high
        value = parameters[name] + step * parameters.std(name)
        value = value if low is None else max(value, low)
        values[name] = float(value if high is None else min(value, high))
        if name in _BACK:
            values[_BACK[name]] = values[name]
    for pair in _ORDERED:
        first, last = (f"wire.{which}_temperature" for which in pair)
        if values.get(last, parameters[last]) - values.get(first, parameters[first]) < 0.5:
            values.pop(first, None), values.pop(last, None)
    return parameters.replace(values)


def slopes(observed: Sequence[Observation], at: Parameters, names: Sequence[str]) -> Array:
    """(n, k) change of the residuals a standard deviation of each parameter, taken both ways: at
    the end of its range a number moves one way only."""
    rows = _STEP * np.eye(len(names))
    up, down = ([moved(at, names, sign * row) for row in rows] for sign in (1.0, -1.0))
    above, below = np.hsplit(whitened(observed, [*up, *down]), 2)
    spans = zip(names, up, down, strict=True)
    widths = np.array([(one[n] - other[n]) / at.std(n) for n, one, other in spans])
    return (above - below) / np.maximum(widths, 1e-9)


def fit(
    observed: Sequence[Observation], start: Parameters, names: Sequence[str], rounds: int,
    slow: Sequence[str] = (),
) -> Fit:
    """Least squares over some parameters; `slow` are fitted too, with their slopes at the start."""
    every = (*names, *slow)
    columns = slopes(observed, start, slow) if slow else None

    def residual(steps: Array) -> Array:
        return whitened(observed, [moved(start, every, steps)])[:, 0]

    def jacobian(steps: Array) -> Array:
        fast = slopes(observed, moved(start, every, steps), names)
        return fast if columns is None else np.hstack([fast, columns])

    found = least_squares(
        residual, np.zeros(len(every)), jacobian, method="lm", x_scale="jac", ftol=_ENOUGH,
        max_nfev=2 * rounds,
    )
    return Fit(moved(start, every, found.x), 2.0 * float(found.cost), len(every))


def every_fit(observed: Sequence[Observation], nominal: Parameters) -> Mapping[str, Fit]:
    """The lab's parameters, refitted, and refitted with each effect."""
    baseline = [n for n in _BASELINE if nominal[n] != 0.0 and nominal.std(n) > 0.0]
    fits = {NO_GAP: Fit(nominal, float(np.sum(whitened(observed, [nominal]) ** 2)), 0)}
    fits[RECALIBRATION] = fit(observed, nominal, baseline, 15)
    for name, effect in EFFECTS.items():
        numbers = [p.name for p in effect.parameters]
        # The refit may have led away from a large effect, which is then found alone first.
        alone = fit(observed, nominal, numbers, 3).parameters
        starts = (fits[RECALIBRATION].parameters, alone)
        trials = [fit(observed, start, numbers, 4, baseline) for start in starts]
        fits[name] = min(trials, key=lambda trial: trial.square)
    return fits


def bic_answer(
    records: Sequence[Record], hold_out: Sequence[Record], nominal: Parameters
) -> tuple[dict[str, Any], Parameters]:
    """What the rival says, to the contract, and its improved parameters; `hold_out` measures the
    shrinkage."""
    observed = [observe(record, nominal).coarse for record in records]
    fits = every_fit(observed, nominal)
    n = sum(len(signal.value) for one in observed for signal in one.signals)
    bic = {k: n * np.log(f.square / n) + f.fitted * np.log(n) for k, f in fits.items()}
    weights = {name: float(np.exp(-0.5 * (b - min(bic.values())))) for name, b in bic.items()}
    shares = dict.fromkeys((*STAGE_OF, *NO_EFFECT), 0.0)
    shares |= {name: weight / sum(weights.values()) for name, weight in weights.items()}
    best = max(shares, key=lambda name: shares[name])
    named = best not in NO_EFFECT
    improved = fits[best].parameters
    candidates: list[dict[str, Any]] = [
        {"name": name, "stage": STAGE_OF.get(name, ""), "probability": shares[name]}
        for name in sorted(shares, key=lambda name: -shares[name])
    ]
    if named:
        values = {p.name: {"value": float(improved[p.name])} for p in EFFECTS[best].parameters}
        candidates[0]["parameters"] = values
    unseen = [observe(record, nominal).coarse for record in hold_out] or observed
    answer = {
        "verdict": "effect" if named else best,
        "cause": [best] if named else [],
        "candidates": candidates,
        "where": where(observed, nominal, best),
        "shrinkage": shrinkage(unseen, nominal, improved),
        "next_experiment": None,
    }
    return answer, improved


def where(observed: Sequence[Observation], nominal: Parameters, cause: str) -> dict[str, str]:
    """Signal, phase and side with the most squared residual."""
    cells: dict[tuple[str, str, str], float] = {}
    for one in observed:
        # The side that is driven now, or was last.
        driven = (one.voltage > 0.0).any(axis=1)
        last = np.maximum.accumulate(np.where(driven, np.arange(len(driven)), 0))
        side = np.array(one.sides)[np.argmax(one.voltage[last], axis=1)]
        for signal, read in zip(one.signals, one.readings(one.simulate(nominal)), strict=True):
            square = ((signal.value - read) / signal.noise) ** 2
            sides = side[np.searchsorted(one.grid, signal.time, side="right") - 1]
            if signal.quantity in _STAGES:
                sides = np.full(len(square), one.sides[signal.wire])
            phases = one.phase_of(signal.time).tolist()
            for phase, own, part in zip(phases, sides.tolist(), square.tolist(), strict=True):
                key = (signal.quantity, phase, own)
                cells[key] = cells.get(key, 0.0) + part
    quantity, when, which = max(cells, key=lambda key: cells[key])
    stage = STAGE_OF.get(cause) or _STAGES.get(quantity, "mechanical")
    return {"signal": quantity, "phase": when, "side": which, "stage": stage}


def shrinkage(
    observed: Sequence[Observation], nominal: Parameters, improved: Parameters
) -> dict[str, dict[str, Any]]:
    """Claims by quantity: share of the reducible root mean square that is gone, blocks of 5 s
    bootstrapped."""
    rows: dict[str, list[Array]] = {}
    for one in observed:
        both = [one.readings(one.simulate(p)) for p in (nominal, improved)]
        for signal, *reads in zip(one.signals, *both, strict=True):
            square = np.column_stack([((signal.value - r) / signal.noise) ** 2 for r in reads])
            blocks = np.array_split(square, max(1, len(square) // _BLOCK))
            rows.setdefault(signal.quantity, []).extend(block.mean(axis=0) for block in blocks)
    claims: dict[str, dict[str, Any]] = {}
    for quantity, found in rows.items():
        means = np.array(found)
        drawn = np.random.default_rng(1).integers(0, len(means), (400, len(means)))
        value, *others = (_gone(each) for each in (means, *means[drawn]))
        known = np.isfinite(value) and np.isfinite(others).any()
        ends = np.nanpercentile([value, *others], [5.0, 95.0]).tolist() if known else []
        interval = [min(ends[0], value), max(ends[1], value)] if known else None
        claims[quantity] = {"fraction": value if known else None, "ci90": interval}
    return claims


def _gone(means: Array) -> float:
    """Of mean squares over the noise's before and after; NaN where nothing was reducible."""
    before, after = means.mean(axis=0) - 1.0
    return float(1.0 - np.sqrt(max(after, 0.0) / before)) if before > 0.1 else float("nan")
