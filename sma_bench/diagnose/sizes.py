"""How large a gap is in the sensors' noise, where it lies, how far it shrinks on data held out.

    fraction = 1 - sqrt((after^2 - noise^2)/(before^2 - noise^2))

of the part of the gap that is not noise: a perfect model reaches 1, whatever the sensor. The models
are simulated as by whoever loads their parameters: no zero, delay or moment of a jump that a fit
has found is taken along, and no more drift counts as noise than the least that a candidate needs,
or a usual instrument has: what a model misses is slow, too.

Other drives keep another share. What is left of the gap scatters from drive to drive by a factor,
fitted to drives of another kind in the development split of the withheld-effect check.
"""

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from sma_bench.arrays import Array
from sma_bench.diagnose.result import Cell, Shrinkage
from sma_bench.estimation.noise_model import Noise
from sma_bench.estimation.observation import Observation
from sma_bench.estimation.residual import DRIFT_EFFECT, Block, Problem
from sma_bench.estimation.solver import Fit
from sma_bench.parameters import Parameters
from sma_bench.physics.effects import EFFECTS

INITIAL, DRIVE, REST = "initial", "drive", "rest"
_BLOCK = 8.0  # s, longer than any sensor remembers
_DRAWS, _SEED = 400, 1
_SMALLEST = 0.3  # of the noise: below it there is no gap to shrink
# From one drive to another: standard deviations of the log of what is left, and of what all have.
_BETWEEN_DRIVES, _AT_LEAST = 0.4, 0.007
_STATE_STEP, _MOST_STATES = 0.25, 4000  # s
_STATE = 4  # numbers of a wire's state
_KNOWN_STATE = 0.15  # of the fitted records' range


def contribution(fitted: Fit, names: Iterable[str]) -> Array:
    """(n,) what effects of a fit add to the readings, less what the parameters beside them do."""
    problem, chosen = fitted.problem, tuple(names)
    off = {p.name: p.default for name in chosen for p in EFFECTS[name].parameters}
    added = fitted.predicted - problem.predict(fitted.parameters.replace(off))
    if DRIFT_EFFECT in chosen:
        for block in problem.of_signal("deflection"):
            noise = problem.noise["deflection"]
            added[block.rows] += noise.drift_in(fitted.left[block.rows])
    known = fitted.unknowns.names
    beside = [known.index(p) for n in chosen for p in EFFECTS[n].beside if p in known]
    if beside:
        columns = fitted.derivatives[:, beside]
        white = problem.whiten(columns)
        added -= columns @ np.linalg.lstsq(white, problem.whiten(added), rcond=None)[0]
    return added


def sample_noise(problem: Problem, name: str) -> float:
    """Standard deviation of a sample: what scatters, and drifts unless an effect drifts it."""
    signal = next(problem.of_signal(name)).signal
    noise = problem.noise[name]
    white = noise.white * np.sqrt(signal.usual_count)
    return float(white if noise.wanders else np.hypot(white, noise.drift))


def largest_gap(problem: Problem, difference: Array) -> float:
    """Largest root mean square over the noise, over signals and records."""
    return max(float(np.sqrt(np.mean(difference[b.rows] ** 2)))
               / sample_noise(problem, b.signal.name)
               for b in problem.blocks)


def locate(problem: Problem, difference: Array) -> list[Cell]:
    """Where a difference (n,), in the signals' units, lies; the largest share first, of equal ones
    what comes first in time."""
    squares = defaultdict[tuple[str, str, str], list[tuple[float, float, float]]](list)
    for block in problem.blocks:
        signal, part = block.signal, difference[block.rows]
        noise = sample_noise(problem, signal.name)
        phase, side = block.observation.phase_of(signal.time), _sides(block)
        for p, s in dict.fromkeys(zip(phase.tolist(), side.tolist(), strict=True)):
            here = (phase == p) & (side == s)
            count = float(signal.count[here].sum())
            power = float(np.sum(part[here] ** 2 * signal.count[here]))
            squares[signal.name, p, s].append((count, power, power / noise**2))
    total = sum(row[2] for rows in squares.values() for row in rows) or 1.0
    cells = []
    for (name, p, s), rows in squares.items():
        count, power, energy = map(sum, zip(*rows, strict=True))
        gap, rms = float(np.sqrt(energy / count)), float(np.sqrt(power / count))
        cells.append(Cell(name, p, s, gap, energy / total, rms))
    return sorted(cells, key=lambda cell: -round(cell.share, 9))


def _sides(block: Block) -> NDArray[np.str_]:
    """The wire's own side; for the deflection the side driven last; "" where there is but one."""
    obs, time = block.observation, block.signal.time
    if len(set(obs.sides)) == 1:
        return np.full(len(time), "")
    if block.signal.quantity != "deflection":
        return np.full(len(time), obs.sides[block.signal.wire])
    names = list(dict.fromkeys(obs.sides))
    of_wires = np.array(obs.sides)
    power = np.column_stack([obs.voltage[:, of_wires == name].max(axis=1) for name in names])
    driven = power.max(axis=1) > 0.02 * max(float(power.max()), 1e-9)
    strongest = np.argmax(power, axis=1)
    last = np.maximum.accumulate(np.where(driven, np.arange(len(driven)), -1))
    first = int(np.argmax(driven)) if driven.any() else 0
    at = np.clip(np.searchsorted(obs.grid, time, side="right") - 1, 0, len(obs.grid) - 1)
    return np.array(names)[strongest[np.where(last[at] < 0, first, last[at])]]


# --- How far it shrinks.


def shrinkage(observations: Sequence[Observation], nominal: Parameters, recalibrated: Parameters,
              improved: Parameters, noises: Mapping[str, Noise]) -> dict[str, Shrinkage]:
    """Of every quantity that held-out data have: with the parameters as believed and those of fits
    that have not seen these data, without and with effects; `noises` of the sensors, by signal."""
    # By quantity, a row a block: samples, the variance of their noise, sums of squares by model.
    found = defaultdict[str, list[Array]](list)
    for obs in observations:
        models = [obs.readings(obs.simulate(p)) for p in (nominal, recalibrated, improved)]
        for signal, *readings in zip(obs.signals, *models, strict=True):
            noise, usual = noises[signal.name], signal.usual_count
            which = np.floor((signal.time - signal.time[0]) / _BLOCK).astype(np.intp)
            _, which = np.unique(which, return_inverse=True)
            counts = np.bincount(which, signal.count)
            floor = float(noise.white**2 * usual + noise.drift**2)
            # A bin's mean hides most of its samples' white noise: it is added again.
            hidden = noise.white**2 * usual * (signal.count - 1.0)
            squares = [np.bincount(which, signal.count * (signal.value - model) ** 2 + hidden)
                       for model in readings]
            rows = np.column_stack([counts, np.full(len(counts), floor), *squares])
            found[signal.quantity].append(rows)
    return {quantity: _of(np.concatenate(rows)) for quantity, rows in found.items()}


def _of(rows: Array) -> Shrinkage:
    """Of blocks (b, 5), and their interval from blocks drawn anew."""
    counts, floors, squares = rows[:, 0], rows[:, 1], rows[:, 2:]

    def fraction(drawn: Any) -> float:
        total = counts[drawn].sum()
        noise = float((counts[drawn] * floors[drawn]).sum() / total)
        before, _, after = squares[drawn].sum(axis=0) / total - noise
        if before < _SMALLEST**2 * noise:
            return 0.0
        return float(1.0 - np.sqrt(max(after, 0.0) / before))

    random = np.random.default_rng(_SEED)
    draws = random.integers(0, len(counts), (_DRAWS, len(counts)))
    gone = np.array([fraction(drawn) for drawn in draws])
    value = fraction(slice(None))
    factor, more = random.standard_normal((2, _DRAWS))
    left = (1.0 - gone) * np.exp(_BETWEEN_DRIVES * factor) + _AT_LEAST * more
    low, high = np.quantile(1.0 - left, [0.05, 0.95])
    total = float(counts.sum())
    before, recalibrated, after = np.sqrt(squares.sum(axis=0) / total).tolist()
    return Shrinkage(before, after, value,
                     (float(min(low, value)), float(min(max(high, value), 1.0))),
                     float(np.sqrt((counts * floors).sum() / total)), recalibrated)


def sensors_noise(model: Fit, candidates: Iterable[Fit]) -> dict[str, Noise]:
    """Of every signal of a model, the drift no larger than any of the candidates needs."""
    least = [fitted.problem.noise for fitted in candidates]
    return {name: replace(noise,
                          drift=min(noise.drift, noise.usual, *(n[name].drift for n in least)))
            for name, noise in model.problem.noise.items()}


def unknown_share(fitted: Sequence[Observation], held_out: Sequence[Observation],
                  parameters: Parameters) -> float:
    """Share of the held-out time in which some wire is where no fitted record has had one:
    temperature, its rate, martensite fraction and the temperature of the other side together."""
    known = np.concatenate([_states(obs, parameters).reshape(-1, _STATE) for obs in fitted])
    scale = np.maximum(np.ptp(known, axis=0), 1e-9)
    tree = cKDTree(known / scale)
    far = [tree.query(_states(obs, parameters) / scale)[0] > _KNOWN_STATE for obs in held_out]
    return float(np.mean(np.concatenate([some.any(axis=1) for some in far])))


def _states(obs: Observation, parameters: Parameters) -> Array:
    """(n, wires, 4) at even times."""
    run, sides = obs.simulate(parameters), np.array(obs.sides)
    steps = min(max(round(float(np.ptp(obs.grid)) / _STATE_STEP), 1), _MOST_STATES)
    time = np.linspace(obs.grid[0], obs.grid[-1], steps + 1)
    own, xi = (np.column_stack([np.interp(time, obs.grid, column) for column in columns.T])
               for columns in (run.temperature, run.martensite_fraction))
    across = [own[:, sides != side].mean(axis=1) if (sides != side).any() else 0.0 * time
              for side in sides]
    return np.stack([own, np.gradient(own, time, axis=0), xi, np.column_stack(across)], axis=2)
