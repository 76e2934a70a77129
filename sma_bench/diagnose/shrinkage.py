"""How far the gap shrinks, on data that no fit saw.

    fraction = 1 - sqrt((after^2 - noise^2)/(before^2 - noise^2))

of the part of the gap that is not noise: a perfect model reaches 1, whatever the sensor.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sma_bench.estimation.noise_model import Noise
from sma_bench.estimation.observation import BinnedSignal, Observation
from sma_bench.estimation.solver import Fit
from sma_bench.parameters import Parameters

Array = NDArray[np.float64]

_BLOCK = 8.0  # s, longer than any sensor remembers
_DRAWS = 400
_SEED = 1
_SMALLEST = 0.3  # of the noise: below it there is no gap to shrink
_BETWEEN_DRIVES = 0.03  # standard deviation of the fraction from one drive to another


@dataclass(frozen=True)
class Shrinkage:
    """Root mean squares in the signal's unit over the samples of the held-out data: with the
    parameters as believed, with the best ones of the model without an effect, with the effect.

    `fraction` of the gap beyond `noise_floor` that is gone; `ci90` its interval, from blocks of
    time drawn anew and the spread between drives.
    """

    rmse_before: float
    rmse_recalibrated: float
    rmse_after: float
    fraction: float
    ci90: tuple[float, float]
    noise_floor: float


def shrinkage(
    observations: Sequence[Observation], nominal: Parameters, recalibrated: Parameters,
    improved: Parameters, fitted: Fit,
) -> dict[str, Shrinkage]:
    """Of every quantity that the held-out data have.

    Args:
        observations: held-out data; nominal: parameters as believed.
        recalibrated, improved: of fits that have not seen these data, without and with effects.
        fitted: for the sensors' noise.
    """
    found: dict[str, list[tuple[Array, Array, float]]] = {}
    for obs in observations:
        models = [obs.readings(obs.simulate(p)) for p in (nominal, recalibrated, improved)]
        for signal, *readings in zip(obs.signals, *models, strict=True):
            noise = fitted.problem.noise[signal.name]
            found.setdefault(signal.quantity, []).append(
                (*_blocks(signal, readings, noise), _floor(signal, noise))
            )
    return {quantity: _of(parts) for quantity, parts in found.items()}


def _floor(signal: BinnedSignal, noise: Noise) -> float:
    """Variance of a sample's noise."""
    return float(noise.white**2 * np.median(signal.count) + noise.drift**2)


def _blocks(
    signal: BinnedSignal, readings: Sequence[Array], noise: Noise
) -> tuple[Array, Array]:
    """(blocks, models) sums of squares of samples, and (blocks,) counts."""
    which = np.floor((signal.time - signal.time[0]) / _BLOCK).astype(np.intp)
    _, which = np.unique(which, return_inverse=True)
    # A bin's mean hides most of its samples' white noise: it is added again.
    hidden = noise.white**2 * np.median(signal.count) * (signal.count - 1.0)
    rows = [
        np.bincount(which, signal.count * (signal.value - model) ** 2 + hidden)
        for model in readings
    ]
    counts = np.bincount(which, signal.count).astype(np.float64)
    return np.column_stack(rows).astype(np.float64), counts


def _of(parts: list[tuple[Array, Array, float]]) -> Shrinkage:
    squares = np.concatenate([rows for rows, _, _ in parts])
    counts = np.concatenate([count for _, count, _ in parts])
    floors = np.concatenate([np.full(len(count), floor) for _, count, floor in parts])
    random = np.random.default_rng(_SEED)
    draws = random.integers(0, len(counts), (_DRAWS, len(counts)))
    drawn = [_fraction(squares[d], counts[d], floors[d]) for d in draws]
    value = _fraction(squares, counts, floors)
    spread = np.asarray(drawn) + _BETWEEN_DRIVES * random.standard_normal(_DRAWS)
    low, high = np.quantile(spread, [0.05, 0.95])
    total = float(counts.sum())
    before, recalibrated, after = np.sqrt(squares.sum(axis=0) / total).tolist()
    return Shrinkage(
        before, recalibrated, after, value,
        (float(min(low, value)), float(min(max(high, value), 1.0))),
        float(np.sqrt((counts * floors).sum() / total)),
    )


def _fraction(squares: Array, counts: Array, floors: Array) -> float:
    total = counts.sum()
    noise = float((counts * floors).sum() / total)
    before, _, after = squares.sum(axis=0) / total - noise
    if before < _SMALLEST**2 * noise:
        return 0.0
    return float(1.0 - np.sqrt(max(after, 0.0) / before))
