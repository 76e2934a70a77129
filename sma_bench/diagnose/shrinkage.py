"""How far the gap shrinks, on data that no fit saw.

    fraction = 1 - sqrt((after^2 - noise^2)/(before^2 - noise^2))

of the part of the gap that is not noise: a perfect model reaches 1, whatever the sensor. The models
are simulated as by whoever loads their parameters: no zero, delay or moment of a jump that a fit
has found is taken along, and no more drift counts as noise than the least that a candidate needs,
or a usual instrument has: what a model misses is slow, too.

Other drives keep another share. What is left of the gap scatters from drive to drive by a factor,
fitted to drives of another kind in the development split of the withheld-effect check.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from sma_bench.diagnose.result import Shrinkage
from sma_bench.estimation.noise_model import Noise
from sma_bench.estimation.observation import BinnedSignal, Observation
from sma_bench.estimation.solver import Fit
from sma_bench.parameters import Parameters

Array = NDArray[np.float64]

_BLOCK = 8.0  # s, longer than any sensor remembers
_DRAWS = 400
_SEED = 1
_SMALLEST = 0.3  # of the noise: below it there is no gap to shrink
# From one drive to another: standard deviations of the log of what is left, and of what no drive is
# without.
_BETWEEN_DRIVES, _AT_LEAST = 0.4, 0.007
_STATE_STEP, _MOST_STATES = 0.25, 4000  # s
_STATE = 4  # numbers of a wire's state
_KNOWN_STATE = 0.15  # of the fitted records' range


def shrinkage(
    observations: Sequence[Observation], nominal: Parameters, recalibrated: Parameters,
    improved: Parameters, noises: Mapping[str, Noise],
) -> dict[str, Shrinkage]:
    """Of every quantity that the held-out data have.

    Args:
        observations: held-out data; nominal: parameters as believed.
        recalibrated, improved: of fits that have not seen these data, without and with effects.
        noises: of the sensors, by signal.
    """
    found: dict[str, list[tuple[Array, Array, float]]] = {}
    for obs in observations:
        models = [obs.readings(obs.simulate(p)) for p in (nominal, recalibrated, improved)]
        for signal, *readings in zip(obs.signals, *models, strict=True):
            noise = noises[signal.name]
            # (blocks, models) sums of squares of samples, and (blocks,) counts.
            which = np.floor((signal.time - signal.time[0]) / _BLOCK).astype(np.intp)
            _, which = np.unique(which, return_inverse=True)
            # A bin's mean hides most of its samples' white noise: it is added again.
            hidden = noise.white**2 * np.median(signal.count) * (signal.count - 1.0)
            rows = [
                np.bincount(which, signal.count * (signal.value - model) ** 2 + hidden)
                for model in readings
            ]
            counts = np.bincount(which, signal.count).astype(np.float64)
            found.setdefault(signal.quantity, []).append(
                (*(np.column_stack(rows).astype(np.float64), counts), _floor(signal, noise))
            )
    return {quantity: _of(parts) for quantity, parts in found.items()}


def sensors_noise(model: Fit, candidates: Iterable[Fit]) -> dict[str, Noise]:
    """Of every signal of a model, the drift no larger than any of the candidates needs."""
    least = [fitted.problem.noise for fitted in candidates]
    return {
        name: replace(noise, drift=min(noise.drift, noise.usual, *(n[name].drift for n in least)))
        for name, noise in model.problem.noise.items()
    }


def unknown_share(
    fitted: Sequence[Observation], held_out: Sequence[Observation], parameters: Parameters
) -> float:
    """Share of the held-out time in which some wire is where no fitted record has had one:
    temperature, its rate, martensite fraction and the temperature of the other side together."""
    known = np.concatenate([_states(obs, parameters).reshape(-1, _STATE) for obs in fitted])
    scale = np.maximum(np.ptp(known, axis=0), 1e-9)
    tree = cKDTree(known / scale)
    far = [tree.query(_states(obs, parameters) / scale)[0] > _KNOWN_STATE for obs in held_out]
    return float(np.mean(np.concatenate([some.any(axis=1) for some in far])))


def _states(obs: Observation, parameters: Parameters) -> Array:
    """(n, wires, 4) at even times, while something was read."""
    run, sides = obs.simulate(parameters), np.array(obs.sides)
    read = np.concatenate([signal.time for signal in obs.signals])
    steps = min(max(round(float(np.ptp(read)) / _STATE_STEP), 1), _MOST_STATES)
    time = np.linspace(read.min(), read.max(), steps + 1)

    def at(columns: Array) -> Array:
        return np.column_stack([np.interp(time, obs.grid, column) for column in columns.T])

    own, xi = at(run.temperature), at(run.martensite_fraction)
    across = [own[:, sides != side].mean(axis=1) if (sides != side).any() else 0.0 * time
              for side in sides]
    return np.stack([own, np.gradient(own, time, axis=0), xi, np.column_stack(across)], axis=2)


def _floor(signal: BinnedSignal, noise: Noise) -> float:
    """Variance of a sample's noise."""
    return float(noise.white**2 * np.median(signal.count) + noise.drift**2)


def _of(parts: list[tuple[Array, Array, float]]) -> Shrinkage:
    squares = np.concatenate([rows for rows, _, _ in parts])
    counts = np.concatenate([count for _, count, _ in parts])
    floors = np.concatenate([np.full(len(count), floor) for _, count, floor in parts])
    random = np.random.default_rng(_SEED)
    draws = random.integers(0, len(counts), (_DRAWS, len(counts)))
    drawn = [_fraction(squares[d], counts[d], floors[d]) for d in draws]
    value = _fraction(squares, counts, floors)
    factor, more = random.standard_normal((2, _DRAWS))
    left = (1.0 - np.asarray(drawn)) * np.exp(_BETWEEN_DRIVES * factor) + _AT_LEAST * more
    low, high = np.quantile(1.0 - left, [0.05, 0.95])
    total = float(counts.sum())
    before, recalibrated, after = np.sqrt(squares.sum(axis=0) / total).tolist()
    return Shrinkage(
        before, after, value, (float(min(low, value)), float(min(max(high, value), 1.0))),
        float(np.sqrt((counts * floors).sum() / total)), recalibrated,
    )


def _fraction(squares: Array, counts: Array, floors: Array) -> float:
    total = counts.sum()
    noise = float((counts * floors).sum() / total)
    before, _, after = squares.sum(axis=0) / total - noise
    if before < _SMALLEST**2 * noise:
        return 0.0
    return float(1.0 - np.sqrt(max(after, 0.0) / before))
