"""How large a gap is in the noise of the sensors, and where it lies."""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from sma_bench.diagnose.result import Cell
from sma_bench.estimation.residual import DRIFT_EFFECT, Block, Problem
from sma_bench.estimation.solver import Fit
from sma_bench.parameters import Parameters
from sma_bench.physics.effects import EFFECTS

Array = NDArray[np.float64]

INITIAL, DRIVE, REST = "initial", "drive", "rest"


def without_effects(parameters: Parameters, names: Iterable[str]) -> Parameters:
    """The same bench with some effects off."""
    numbers = (p for name in names for p in EFFECTS[name].parameters)
    return parameters.replace({p.name: p.default for p in numbers})


def contribution(fitted: Fit, names: Iterable[str]) -> Array:
    """(n,) what effects of a fit add to the readings, less what the parameters beside them do."""
    problem, chosen = fitted.problem, tuple(names)
    added = fitted.predicted - problem.predict(without_effects(fitted.parameters, chosen))
    if DRIFT_EFFECT in chosen:
        for block in problem.of_signal("deflection"):
            noise = problem.noise["deflection"]
            added[block.rows] += noise.drift_in(fitted.left[block.rows])
    known = fitted.unknowns.names
    beside = [known.index(p) for n in chosen if (p := EFFECTS[n].beside) in known]
    if beside:
        columns = fitted.derivatives[:, beside]
        white = problem.whiten(columns)
        added -= columns @ np.linalg.lstsq(white, problem.whiten(added), rcond=None)[0]
    return added


def sample_noise(problem: Problem, name: str) -> float:
    """Standard deviation of a sample of a signal: what scatters, and what drifts unless it is an
    effect that it drifts."""
    signal = next(problem.of_signal(name)).signal
    noise = problem.noise[name]
    white = noise.white * np.sqrt(float(np.median(signal.count)))
    return float(white if noise.wanders else np.hypot(white, noise.drift))


def largest_gap(problem: Problem, difference: Array) -> float:
    """Largest root mean square over the noise, over signals and records."""
    return max(
        float(np.sqrt(np.mean(difference[b.rows] ** 2))) / sample_noise(problem, b.signal.name)
        for b in problem.blocks
    )


def locate(problem: Problem, difference: Array) -> list[Cell]:
    """Where a difference (n,), in the signals' units, lies; the largest share first, of equal ones
    what comes first in time."""
    squares: dict[tuple[str, str, str], list[tuple[float, float, float]]] = {}
    for block in problem.blocks:
        signal, part = block.signal, difference[block.rows]
        noise = sample_noise(problem, signal.name)
        phase, side = block.observation.phase_of(signal.time), _sides(block)
        for p, s in dict.fromkeys(zip(phase.tolist(), side.tolist(), strict=True)):
            here = (phase == p) & (side == s)
            count = float(signal.count[here].sum())
            power = float(np.sum(part[here] ** 2 * signal.count[here]))
            cell = squares.setdefault((signal.name, p, s), [])
            cell.append((count, power, power / noise**2))
    total = sum(row[2] for rows in squares.values() for row in rows) or 1.0
    cells = []
    for (name, p, s), rows in squares.items():
        count, power, energy = (sum(row[k] for row in rows) for k in range(3))
        cells.append(
            Cell(name, p, s, float(np.sqrt(energy / count)), energy / total,
                 float(np.sqrt(power / count)))
        )
    return sorted(cells, key=lambda cell: -round(cell.share, 9))


def _sides(block: Block) -> NDArray[np.str_]:
    """The wire's own side; for the deflection the side that was driven last; "" where there is but
    one."""
    obs, time = block.observation, block.signal.time
    if len(set(obs.sides)) == 1:
        return np.full(len(time), "")
    if block.signal.quantity != "deflection":
        return np.full(len(time), obs.sides[block.signal.wire])
    names = list(dict.fromkeys(obs.sides))
    power = np.column_stack(
        [
            np.max(obs.voltage[:, [k for k, n in enumerate(obs.sides) if n == name]], axis=1)
            for name in names
        ]
    )
    driven = power.max(axis=1) > 0.02 * max(float(power.max()), 1e-9)
    strongest = np.argmax(power, axis=1)
    last = np.maximum.accumulate(np.where(driven, np.arange(len(driven)), -1))
    first = int(np.argmax(driven)) if driven.any() else 0
    at = np.clip(np.searchsorted(obs.grid, time, side="right") - 1, 0, len(obs.grid) - 1)
    return np.array(names)[strongest[np.where(last[at] < 0, first, last[at])]]
