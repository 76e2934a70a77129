"""How large a gap is in the noise of the sensors, and where it lies."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sma_bench.diagnose.fit import Fit
from sma_bench.diagnose.problem import DRIFT_EFFECT, Problem
from sma_bench.diagnose.view import View
from sma_bench.parameters import Parameters
from sma_bench.physics.effects import EFFECTS

Array = NDArray[np.float64]
Readings = Sequence[Sequence[Array]]

INITIAL, DRIVE, REST = "initial", "drive", "rest"


@dataclass(frozen=True)
class Cell:
    """One signal in one phase on one side.

    `gap` is the root mean square over the noise of a sample; `share` of the squared gap over noise
    of all samples of all records; `rms` in the signal's unit.
    """

    signal: str
    phase: str
    side: str
    gap: float
    share: float
    rms: float


def without_effects(parameters: Parameters, names: Iterable[str]) -> Parameters:
    """The same bench with some effects off."""
    numbers = (p for name in names for p in EFFECTS[name].parameters)
    return parameters.replace({p.name: p.default for p in numbers})


def contribution(fitted: Fit, names: Iterable[str]) -> list[list[Array]]:
    """What effects of a fit add to the readings, per view and signal (b,)."""
    problem, chosen = fitted.problem, tuple(names)
    off = problem.predict(without_effects(fitted.parameters, chosen))
    added = between(fitted.predicted, off)
    if DRIFT_EFFECT in chosen:
        for view, own, left in zip(problem.views, added, fitted.left, strict=True):
            for k, signal in enumerate(view.signals):
                if signal.name == "deflection":
                    own[k] = own[k] + problem.noise[signal.name].drift_in(left[k])
    return added


def sample_noise(problem: Problem, name: str) -> float:
    """Standard deviation of a sample of a signal: what scatters, and what drifts unless it is an
    effect that it drifts."""
    signal = next(s for v in problem.views for s in v.signals if s.name == name)
    noise = problem.noise[name]
    white = noise.white * np.sqrt(float(np.median(signal.count)))
    return float(white if noise.wanders else np.hypot(white, noise.drift))


def largest_gap(problem: Problem, difference: Readings) -> float:
    """Largest root mean square over the noise, over signals and records."""
    return max(
        float(np.sqrt(np.mean(part**2))) / sample_noise(problem, s.name)
        for view, own in zip(problem.views, difference, strict=True)
        for s, part in zip(view.signals, own, strict=True)
    )


def between(first: Readings, second: Readings) -> list[list[Array]]:
    """First less second, per view and signal."""
    return [
        [a - b for a, b in zip(one, two, strict=True)]
        for one, two in zip(first, second, strict=True)
    ]


def locate(problem: Problem, difference: Readings) -> list[Cell]:
    """Where a difference lies, the cell with the largest share first.

    Args:
        difference: per view and signal (b,), in the signals' units.
    """
    squares: dict[tuple[str, str, str], list[tuple[float, float, float]]] = {}
    for view, own in zip(problem.views, difference, strict=True):
        for signal, part in zip(view.signals, own, strict=True):
            noise = sample_noise(problem, signal.name)
            phase, side = view.phase_of(signal.time), _sides(view, signal.wire, signal.quantity,
                                                             signal.time)
            for p, s in {*zip(phase.tolist(), side.tolist(), strict=True)}:
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
    return sorted(cells, key=lambda cell: -cell.share)


def _sides(view: View, wire: int, quantity: str, time: Array) -> NDArray[np.str_]:
    """The wire's own side; for the deflection the side that was driven last."""
    if quantity != "deflection":
        return np.full(len(time), view.sides[wire])
    names = list(dict.fromkeys(view.sides))
    power = np.column_stack(
        [
            np.max(view.voltage[:, [k for k, n in enumerate(view.sides) if n == name]], axis=1)
            for name in names
        ]
    )
    driven = power.max(axis=1) > 0.02 * max(float(power.max()), 1e-9)
    strongest = np.argmax(power, axis=1)
    last = np.maximum.accumulate(np.where(driven, np.arange(len(driven)), -1))
    first = int(np.argmax(driven)) if driven.any() else 0
    at = np.clip(np.searchsorted(view.grid, time, side="right") - 1, 0, len(view.grid) - 1)
    return np.array(names)[strongest[np.where(last[at] < 0, first, last[at])]]
