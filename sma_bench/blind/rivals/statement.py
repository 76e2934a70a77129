"""A rival's choice put into the form of the contract."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from sma_bench.blind.answers import NO_EFFECT, NO_GAP, STAGE_OF
from sma_bench.blind.rivals.observed import QUANTITIES, Observed
from sma_bench.parameters import Parameters
from sma_bench.parameters.table import BY_NAME
from sma_bench.physics.effects import EFFECTS

Array = npt.NDArray[np.float64]

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
